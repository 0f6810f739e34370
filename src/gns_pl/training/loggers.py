"""The loggers of a training."""

from __future__ import annotations

from hydra.utils import instantiate
from lightning.pytorch.loggers import Logger
from omegaconf import DictConfig, OmegaConf

from gns_pl.evaluation.tracking import wandb_mode


def make_loggers(cfg: DictConfig) -> list[Logger]:
    """Return the loggers of conf/logger; W&B's as WANDB_MODE allows.

    Raises:
        InputError: WANDB_MODE is none of W&B's modes.
    """
    loggers: list[Logger] = []
    for logger in cfg.values():
        if not OmegaConf.is_config(logger):
            continue
        if not logger._target_.endswith(".WandbLogger"):
            loggers.append(instantiate(logger))
        elif (mode := wandb_mode(bool(logger.offline))) != "disabled":
            loggers.append(instantiate(logger, offline=mode == "offline"))
    return loggers
