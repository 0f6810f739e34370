"""python evaluate.py ckpt=FILE [key=value …]: judge a checkpoint on test scenes against MPM computed on demand."""

import hydra
from omegaconf import DictConfig

from gns_pl.commands.command import CONF, job, start, sweep_label


@hydra.main(version_base=None, config_path=str(CONF), config_name="evaluate")
def main(cfg: DictConfig) -> None:
    """Evaluate with one config."""
    with job("evaluate.py", cfg, on_stop="stopped; the reference runs that are made are kept."):
        from gns_pl.evaluation.evaluate import evaluate_config

        evaluate_config(cfg, label=sweep_label())


def run() -> None:
    """Run the command with the arguments that this process was started with."""
    start(main, "evaluate")
