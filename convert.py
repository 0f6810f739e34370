"""python convert.py source=THEIRS target=FOLDER [to=FORMAT] [key=value …]: others' data and weights, in and out."""

import hydra
from omegaconf import DictConfig

from gns_pl.commands import job, start


@hydra.main(version_base=None, config_path="conf", config_name="convert")
def main(cfg: DictConfig) -> None:
    """Convert with one config."""
    with job("convert.py", cfg):
        from gns_pl.convert.door import convert_config

        convert_config(cfg)


if __name__ == "__main__":
    start(main, "convert")
