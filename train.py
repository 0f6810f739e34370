"""python train.py +experiment=NAME [key=value …]: generate the data where missing, train a simulator on them."""

import sys
from pathlib import Path

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig

from gns_pl.errors import told_plainly
from gns_pl.generation.stored import named_folder
from gns_pl.training.resume import find_resume
from gns_pl.training.summary import objective
from gns_pl.training.sweep import sweep_reported


@hydra.main(version_base=None, config_path="conf", config_name="train")
def main(cfg: DictConfig) -> float | None:
    """Train with one config and return its least validation error; Hydra calls it once per job of a sweep."""
    with told_plainly("train.py", in_sweep=HydraConfig.get().mode == RunMode.MULTIRUN):
        output = Path(HydraConfig.get().runtime.output_dir)
        if cfg.advise:
            from gns_pl.training.advice import advise

            advise(cfg, output)
            return None
        resume = find_resume(cfg.resume, output)  # before the heavy imports: torch, Lightning, W&B
        from gns_pl.training.train import train

        print(f"To judge its last state: python evaluate.py ckpt={train(cfg, output, resume)}")
    return objective(output)


if __name__ == "__main__":
    sys.argv[1:] = named_folder(sys.argv[1:])
    with sweep_reported():
        main()
