"""The loggers of conf/logger, one group each: CSV alone, W&B or TensorBoard beside it, or none."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from hydra.utils import instantiate
from lightning.pytorch.loggers import Logger, TensorBoardLogger, WandbLogger
from omegaconf import DictConfig, OmegaConf

from gns_pl.errors import InputError, tolerated
from gns_pl.io.tracking import wandb_mode


class WandbRun(WandbLogger):
    """Lightning's logger for W&B, for every start in one process.

    Without the setting `anonymous`, which W&B has given up and warns of. Lightning asks for a run on this disk by
    WANDB_MODE alone, which W&B reads once in a process. W&B's own process writes the run, and stays in the working
    directory of the first start: it is told where to, whole.
    """

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self._wandb_init.pop("anonymous", None)
        self._wandb_init["dir"] = str(Path(self._wandb_init["dir"]).absolute())
        if self._offline:
            self._wandb_init["mode"] = "offline"


class TensorBoard(TensorBoardLogger):
    """Lightning's logger for TensorBoard; it takes images as W&B's does.

    Raises:
        InputError: TensorBoard is not installed.
    """

    def __init__(self, **settings: Any) -> None:
        if not any(map(find_spec, ("tensorboard", "tensorboardX"))):
            raise InputError(
                "logger=tensorboard needs the package tensorboard (pip install 'gns_pl[tensorboard]'); "
                "logger=csv needs nothing."
            )
        super().__init__(**settings)

    def log_image(self, key: str, images: Sequence[str], step: int | None = None) -> None:
        """Log PNG files under a key."""
        import numpy as np
        from PIL import Image

        for path in images:
            with Image.open(path) as image:
                self.experiment.add_image(key, np.asarray(image.convert("RGB")), step, dataformats="HWC")


def make_loggers(cfg: DictConfig | None) -> list[Logger]:
    """Return the loggers of conf/logger; W&B's as WANDB_MODE allows.

    Args:
        cfg: the group `logger`; None if it was taken away.

    Raises:
        InputError: WANDB_MODE is none of W&B's modes, or a package is missing.
    """
    loggers: list[Logger] = []
    for logger in (cfg or {}).values():
        if not OmegaConf.is_dict(logger):
            continue
        if not logger._target_.endswith((".WandbLogger", ".WandbRun")):
            loggers.append(instantiate(logger))
        elif (mode := wandb_mode(bool(logger.offline))) != "disabled":
            loggers.append(instantiate(logger, offline=mode == "offline"))
    return loggers


def log_settings(loggers: Sequence[Logger], settings: Mapping[str, Any]) -> None:
    """Write the resolved config to every logger, which starts them.

    Raises:
        InputError: W&B refuses to start, as it does online without an account.
    """
    import wandb

    try:
        for logger in loggers:
            logger.log_hyperparams(dict(settings))
    except wandb.errors.Error as error:
        raise InputError(f"W&B could not start ({error}); logger.offline=true needs no account.") from error


def close_loggers(loggers: Sequence[Logger]) -> None:
    """End the run of W&B, or the jobs of a sweep would merge into one."""
    if any(isinstance(logger, WandbLogger) for logger in loggers):
        import wandb

        with tolerated("the run of W&B"):
            wandb.finish()


def log_image(loggers: Sequence[Logger], key: str, path: Path, step: int) -> None:
    """Give a PNG file to the loggers that take images."""
    for logger in loggers:
        if hasattr(logger, "log_image"):
            with tolerated(f"{key} in {type(logger).__name__}"):
                logger.log_image(key, [str(path)], step=step)
