"""python simulate.py [ckpt=FILE] scene=FILE.yaml|NAME [key=value …]: run scenes, frames into HDF5."""

from pathlib import Path

import hydra
from omegaconf import DictConfig

from gns_pl.commands.command import CONF, job, start, sweep_label
from gns_pl.commands.scene_sweep import sweep_tabled


@hydra.main(version_base=None, config_path=str(CONF), config_name="simulate")
def main(cfg: DictConfig) -> list[Path]:
    """Simulate with one config; Hydra calls it once per job of a sweep."""
    with job("simulate.py", cfg):
        from gns_pl.evaluation.simulation import simulate_and_describe

        return simulate_and_describe(cfg, label=sweep_label())


def run() -> None:
    """Run the command with the arguments that this process was started with."""
    with sweep_tabled():
        start(main, "simulate")
