"""python simulate.py ckpt=FILE scene=FILE.yaml [key=value …]: run scenes in a learned simulator, frames into HDF5."""

import hydra
from omegaconf import DictConfig

from gns_pl.errors import told_plainly


@hydra.main(version_base=None, config_path="conf", config_name="simulate")
def main(cfg: DictConfig) -> None:
    """Simulate with one config."""
    with told_plainly("simulate.py"):
        from gns_pl.rollout.simulate import simulate_config

        simulate_config(cfg)


if __name__ == "__main__":
    main()
