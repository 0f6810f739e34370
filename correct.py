"""python correct.py [key=value …]: fit a network that corrects coarse material point runs."""

import hydra
from omegaconf import DictConfig

from gns_pl.commands import job, start


@hydra.main(version_base=None, config_path="conf", config_name="correction")
def main(cfg: DictConfig) -> None:
    """Fit with one config."""
    with job("correct.py", cfg):
        from gns_pl.training.correction import correction_config

        correction_config(cfg)


if __name__ == "__main__":
    start(main, "correction")
