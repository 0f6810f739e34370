"""python simulate.py [ckpt=FILE] scene=FILE.yaml|NAME [key=value …]: run scenes, frames into HDF5."""

import re
import sys

import hydra
from omegaconf import DictConfig

from gns_pl.errors import told_plainly


@hydra.main(version_base=None, config_path="conf", config_name="simulate")
def main(cfg: DictConfig) -> None:
    """Simulate with one config."""
    with told_plainly("simulate.py"):
        from gns_pl.evaluation.simulation import simulate_and_describe

        simulate_and_describe(cfg)


def of_catalogue(arguments: list[str]) -> list[str]:
    """Return the arguments with scene.KEY=… where Hydra finds it: at the scene's place in the catalogue."""
    name = next((each.partition("=")[2] for each in arguments if each.startswith("scene=")), "")
    return [re.sub(r"^scene\.", f"catalogue.{name}.", each) for each in arguments]


if __name__ == "__main__":
    sys.argv[1:] = of_catalogue(sys.argv[1:])
    main()
