"""python benchmark.py [ckpt=[FILE,…]] [key=value …]: time against error, MPM and learned simulators alike."""

import hydra
from omegaconf import DictConfig

from gns_pl.errors import told_plainly


@hydra.main(version_base=None, config_path="conf", config_name="benchmark")
def main(cfg: DictConfig) -> None:
    """Chart with one config."""
    with told_plainly("benchmark.py"):
        from gns_pl.evaluation.chart.benchmark import benchmark_config

        benchmark_config(cfg)


if __name__ == "__main__":
    main()
