"""Figures of a validation rollout for loggers that take images, W&B's among them."""

from __future__ import annotations

import math
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from lightning.pytorch import Callback, LightningModule, Trainer

from gns_pl.errors import tolerated
from gns_pl.metrics.curves import compute_curves
from gns_pl.metrics.measures import particle_spacing
from gns_pl.scene.extent import characteristic_time, initial_extent
from gns_pl.training.loggers import log_image
from gns_pl.trajectory import Trajectory
from gns_pl.viz import missing_packages, plot_curves, plot_evolution


class RolloutFigure(Callback):
    """After every validation, logs one of its rollouts beside MPM: runout and height, and both final deposits.

    It is the one in which MPM runs out farthest, over the body's length. Loggers without `log_image` (CSV) get nothing,
    and where none has it nothing is drawn.
    """

    def __init__(self) -> None:
        self._shown: tuple[Trajectory, Trajectory] | None = None
        self._farthest = -math.inf

    def on_validation_batch_end(
        self,
        trainer: Trainer,
        pl_module: LightningModule,
        outputs: Any,
        batch: Trajectory | None,
        batch_idx: int,
        dataloader_idx: int = 0,
    ) -> None:
        """Keep the rollout and its reference if it is the farthest so far."""
        if batch is None or outputs is None:  # an empty slot of this process, or a run that broke
            return
        advance = float(np.diff(np.percentile(batch.position[[0, -1], :, 0], 99, axis=1))[0])
        advance /= initial_extent(batch.scene)[0]
        if advance > self._farthest:
            self._shown, self._farthest = (outputs["predicted"], batch), advance

    def on_validation_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Draw and log; before the module's own hook, which takes the time out of the training's pace."""
        loggers = [logger for logger in trainer.loggers if hasattr(logger, "log_image")]
        shown, self._shown, self._farthest = self._shown, None, -math.inf
        if not loggers or shown is None or not trainer.is_global_zero or missing_packages():
            return
        with tolerated("the figures of a validation rollout"), TemporaryDirectory() as folder:
            curves, deposit = Path(folder) / "curves.png", Path(folder) / "deposit.png"
            draw_rollout(*shown, curves=curves, deposit=deposit)
            for path in (curves, deposit):
                log_image(loggers, f"rollout/{path.stem}", path, trainer.global_step)


def draw_rollout(predicted: Trajectory, reference: Trajectory, *, curves: Path, deposit: Path) -> None:
    """Draw runout and height over time, and the last frame from the side, of a rollout beside its reference.

    Args:
        predicted: the rollout, finite; it may have ended early.
        reference: MPM, of the same particles.
        curves: file for the curves.
        deposit: file for the last frame.
    """
    time_scale = characteristic_time(reference.scene)
    pair = {"MPM": reference, "learned": predicted}
    named = {name: compute_curves(flow) for name, flow in pair.items()}
    plot_curves({reference.scene.name: named}, ("runout", "height"), [curves])
    plot_evolution(
        {"learned": predicted, "MPM": reference},
        [deposit],
        time_scale=time_scale,
        times=[],
        diameter=particle_spacing(reference),
        pixels=600,
    )
