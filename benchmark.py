"""python benchmark.py [ckpt=[FILE,…]] [key=value …]: time against error, MPM and learned simulators alike."""

import hydra
from omegaconf import DictConfig

from gns_pl.commands import job, start


@hydra.main(version_base=None, config_path="conf", config_name="benchmark")
def main(cfg: DictConfig) -> None:
    """Chart with one config."""
    with job("benchmark.py", cfg):
        from gns_pl.evaluation.chart.benchmark import benchmark_config

        benchmark_config(cfg)


if __name__ == "__main__":
    start(main, "benchmark")
