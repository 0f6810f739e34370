"""python fit.py name=NAME [key=value …]: fit a coarse solver to fine MPM, as a solver of its own."""

import hydra
from omegaconf import DictConfig

from gns_pl.commands.command import CONF, job, start


@hydra.main(version_base=None, config_path=str(CONF), config_name="fit")
def main(cfg: DictConfig) -> None:
    """Fit with one config."""
    with job("fit.py", cfg):
        from gns_pl.inverse.solver_fit import fit_config

        fit_config(cfg)


def run() -> None:
    """Run the command with the arguments that this process was started with."""
    start(main, "fit")
