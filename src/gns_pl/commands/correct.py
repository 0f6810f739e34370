"""python correct.py [key=value …]: fit a network that corrects coarse material point runs."""

import hydra
from omegaconf import DictConfig

from gns_pl.commands.command import CONF, job, start


@hydra.main(version_base=None, config_path=str(CONF), config_name="correction")
def main(cfg: DictConfig) -> None:
    """Fit with one config."""
    with job("correct.py", cfg):
        from gns_pl.training.correction import correction_config

        correction_config(cfg)


def run() -> None:
    """Run the command with the arguments that this process was started with."""
    start(main, "correction")
