"""python benchmark.py [ckpt=[FILE,…]] [key=value …]: time against error, MPM and learned simulators alike."""

import hydra
from omegaconf import DictConfig

from gns_pl.commands.command import CONF, job, start


@hydra.main(version_base=None, config_path=str(CONF), config_name="benchmark")
def main(cfg: DictConfig) -> None:
    """Chart with one config."""
    with job("benchmark.py", cfg):
        from gns_pl.evaluation.chart.benchmark import benchmark_config

        benchmark_config(cfg)


def run() -> None:
    """Run the command with the arguments that this process was started with."""
    start(main, "benchmark")
