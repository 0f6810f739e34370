"""python generate.py data=NAME [key=value …]: make a data set, or what is missing of it."""

from typing import Any

import hydra
from omegaconf import DictConfig, OmegaConf

from gns_pl.errors import told_plainly


@hydra.main(version_base=None, config_path="conf", config_name="generate")
def main(cfg: DictConfig) -> None:
    """Generate with one config."""
    with told_plainly("generate.py"):
        from gns_pl.generation import generate_dataset

        spec: Any = OmegaConf.to_container(cfg.data, resolve=True)
        try:
            generate_dataset(spec, num_workers=cfg.num_workers, device=cfg.device)
        except KeyboardInterrupt:
            raise SystemExit("generate.py: stopped; the same command goes on where it was.") from None


if __name__ == "__main__":
    main()
