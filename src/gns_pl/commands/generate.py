"""python generate.py data=NAME [key=value …]: make a data set, or what is missing of it."""

from typing import Any

import hydra
from omegaconf import DictConfig, OmegaConf

from gns_pl.commands.command import CONF, job, start
from gns_pl.errors import InputError


@hydra.main(version_base=None, config_path=str(CONF), config_name="generate")
def main(cfg: DictConfig) -> None:
    """Generate with one config."""
    with job("generate.py", cfg):
        from gns_pl.generation import generate_dataset, is_imported, resolved_data

        given: Any = OmegaConf.to_container(cfg.data, resolve=True)
        spec = resolved_data(given)
        if is_imported(spec):
            raise InputError(f"{spec['root']}: its data are imported, and no solver of ours can make more of them.")
        generate_dataset(spec, num_workers=cfg.num_workers, device=cfg.device)


def run() -> None:
    """Run the command with the arguments that this process was started with."""
    start(main, "generate")
