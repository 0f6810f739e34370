"""python convert.py source=THEIRS target=FOLDER [to=FORMAT] [key=value …]: others' data and weights, in and out."""

import hydra
from omegaconf import DictConfig

from gns_pl.commands.command import CONF, job, start


@hydra.main(version_base=None, config_path=str(CONF), config_name="convert")
def main(cfg: DictConfig) -> None:
    """Convert with one config."""
    with job("convert.py", cfg):
        from gns_pl.convert.command import convert_config

        convert_config(cfg)


def run() -> None:
    """Run the command with the arguments that this process was started with."""
    start(main, "convert")
