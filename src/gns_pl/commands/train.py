"""python train.py +experiment=NAME [key=value …]: generate the data where missing, train a simulator on them."""

from pathlib import Path

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from gns_pl.commands.command import CONF, job, start
from gns_pl.models.shipped import CORRECTOR, CORRECTOR_KIND
from gns_pl.text import command, override, shown_path
from gns_pl.training.resume import find_resume
from gns_pl.training.summary import objective
from gns_pl.training.sweep import sweep_reported


@hydra.main(version_base=None, config_path=str(CONF), config_name="train")
def main(cfg: DictConfig) -> float | None:
    """Train with one config and return its least validation error; Hydra calls it once per job of a sweep."""
    with job("train.py", cfg):
        output = Path(HydraConfig.get().runtime.output_dir)
        if cfg.advise:
            from gns_pl.training.advice import advise

            advise(cfg, output)
            return None
        resume = find_resume(cfg.resume, output)  # before the heavy imports: torch, Lightning, W&B
        from gns_pl.training.train import train

        last = train(cfg, output, resume)
        if cfg.model.get("kind") == CORRECTOR_KIND:
            made = override("ckpt", shown_path(output / f"{cfg.name}{CORRECTOR}"))
            print(f"To run it: {command('simulate')} {made} scene=FILE.yaml")
        else:
            print(f"To judge its last state: {command('evaluate')} {override('ckpt', shown_path(last))}")
    return objective(output)


def run() -> None:
    """Run the command with the arguments that this process was started with."""
    with sweep_reported():
        start(main, "train")
