"""Lightning's trainer from the resolved config: its callbacks, loggers and plugins, and what it keeps quiet."""

from __future__ import annotations

import logging
import warnings
from pathlib import Path

from hydra.errors import InstantiationException
from hydra.utils import instantiate
from lightning.fabric.utilities.exceptions import MisconfigurationException
from lightning.pytorch import Trainer
from lightning.pytorch.callbacks import LearningRateMonitor, ProgressBar
from omegaconf import DictConfig

from gns_pl.errors import InputError
from gns_pl.training.callbacks import SkipNonFinite, StopAtNonFinite, StopAtSignal
from gns_pl.training.checkpoints import AtomicCheckpointIO, LastCheckpoint
from gns_pl.training.launch import cluster_environments, launched_devices
from gns_pl.training.loggers import make_loggers


def build_trainer(cfg: DictConfig, output: Path, steps: int, stop: StopAtSignal) -> Trainer:
    """Return the trainer with its loggers and callbacks; nothing is started yet.

    Args:
        cfg: the config of conf/train.yaml.
        output: folder of this run.
        steps: training steps in all.
        stop: ends the training at a signal.

    Raises:
        InputError: settings that Lightning refuses, such as more devices than there are.
    """
    every = cfg.trainer.val_check_interval
    launched = launched_devices(cfg.trainer.devices, cfg.trainer.get("num_nodes") or 1)
    try:
        loggers = make_loggers(cfg.get("logger"))
        configured = [instantiate(callback) for callback in (cfg.get("callbacks") or {}).values()]
        if not any(isinstance(callback, LastCheckpoint) for callback in configured):
            raise InputError("callbacks.last is left out, so nothing of the training would be saved; keep it.")
        if not cfg.trainer.enable_progress_bar:
            configured = [callback for callback in configured if not isinstance(callback, ProgressBar)]
        if not loggers:
            configured = [callback for callback in configured if not isinstance(callback, LearningRateMonitor)]
        trainer: Trainer = instantiate(
            cfg.trainer,
            **launched,
            callbacks=[*configured, stop, StopAtNonFinite(output), SkipNonFinite()],
            logger=loggers or False,
            plugins=[AtomicCheckpointIO(), *cluster_environments()],
            use_distributed_sampler=False,  # the data module shares windows and trajectories itself
            val_check_interval=min(every, steps) if isinstance(every, int) else steps if every is None else every,
            default_root_dir=output,  # where Lightning looks for checkpoints of SLURM's jobs, of which there are none
        )
    except InstantiationException as error:
        if isinstance(error.__cause__, MisconfigurationException | ValueError):
            raise InputError(str(error.__cause__)) from error
        raise
    return trainer


def quieten() -> None:
    """Keep Lightning's advertisements, and warnings that tell a user nothing, off the terminal."""
    for library in ("lightning.pytorch", "lightning.fabric"):
        logging.getLogger(library).setLevel(logging.WARNING)
    known = ["exists and is not empty", "does not have many workers", "LeafSpec", "weights_only", "not resumable"]
    known += [
        "has `__len__` defined",
        "in eval mode at the start of training",
        "across ranks is zero",
        "`srun` command",
    ]
    for message in known:
        warnings.filterwarnings("ignore", f".*{message}")
    warnings.filterwarnings("ignore", category=DeprecationWarning)
