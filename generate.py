"""python generate.py data=NAME [key=value …]: make a data set, or what is missing of it."""

from typing import Any

import hydra
from omegaconf import DictConfig, OmegaConf

from gns_pl.commands import job, start


@hydra.main(version_base=None, config_path="conf", config_name="generate")
def main(cfg: DictConfig) -> None:
    """Generate with one config."""
    with job("generate.py", cfg):
        from gns_pl.generation import generate_dataset

        spec: Any = OmegaConf.to_container(cfg.data, resolve=True)
        generate_dataset(spec, num_workers=cfg.num_workers, device=cfg.device)


if __name__ == "__main__":
    start(main, "generate")
