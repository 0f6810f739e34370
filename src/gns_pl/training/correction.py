"""How a `Corrector` is fitted and judged (`corrector_recipe` puts a training together).

What counts is not the loss but whole runs: at every validation the columns held out are run with the corrector, and the
weights with which their runouts were nearest to the fine ones are kept.
"""

from __future__ import annotations

import math
import time
from dataclasses import asdict
from functools import partial
from typing import Any, cast

import numpy as np
import torch
from lightning.pytorch.callbacks import WeightAveraging
from torch import Tensor

from gns_pl.metrics.curves import compute_curves
from gns_pl.metrics.summary import rollout_errors
from gns_pl.models.checkpoint import FORMAT_VERSION
from gns_pl.models.corrector import Corrector, CorrectorConfig
from gns_pl.models.shipped import CORRECTOR_KIND
from gns_pl.mpm import SimulationError
from gns_pl.rollout import static_of
from gns_pl.scene import fill_scene
from gns_pl.solvers.correction import corrected_run
from gns_pl.training.followed import FollowedRuns, is_column
from gns_pl.training.learning import LearningModule
from gns_pl.training.validation import NAMES, STEP_SECONDS
from gns_pl.trajectory import Trajectory, start_trajectory

PLACEMENTS = 3
"""Of the particles in every validation column, besides that of its fine run: single runs scatter by some per cent."""


def moving_average(average: Tensor, now: Tensor, count: Tensor | int, decay: float) -> Tensor:
    """Return the moving average with one more value; it forgets the first weights faster than later ones."""
    forget = max(1 - decay, 9 / (10 + int(count)))
    return average + forget * (now - average)


class WarmAverage(WeightAveraging):
    """A moving average of the weights that forgets the first ones faster than later ones.

    Args:
        decay: of the average, each step, late in training.
        use_buffers: average buffers too.
    """

    def __init__(self, decay: float, use_buffers: bool = False) -> None:
        super().__init__(use_buffers=use_buffers, avg_fn=partial(moving_average, decay=decay))


class CorrectionModule(LearningModule):
    """Mean squared error of the velocity, over its root mean square. Validation is by whole corrected runs.

    Args:
        model: `CorrectorConfig` as a dict.
        data: specification of the data, stored in the checkpoint.
        learning_rate: the largest; it rises and falls over all steps (Smith 2018).
        num_steps: of the training.
        placement_jitter: of the placements that are judged, in halves of their spacing; without one the fine run's
            placement alone is.
        provenance: stored in the checkpoint.
    """

    def __init__(
        self,
        *,
        model: dict[str, Any],
        data: dict[str, Any],
        learning_rate: float,
        num_steps: int,
        placement_jitter: float,
        provenance: dict[str, Any],
    ) -> None:
        super().__init__()
        self.save_hyperparameters(logger=False)
        self.corrector = Corrector(CorrectorConfig(**model))
        self.data, self.provenance = data, provenance
        self.learning_rate, self.num_steps = learning_rate, num_steps
        self.placement_jitter = placement_jitter

    @property
    def runs(self) -> FollowedRuns:
        """The data module of the fit."""
        return cast(FollowedRuns, cast(Any, self.trainer).datamodule)

    def loss(self, batch: int) -> Tensor:
        """Return the loss of the examples of a step []."""
        examples = self.runs.examples_of(batch)
        static = static_of(*(self.runs.fine[each.run] for each in examples))
        columns = list(zip(*examples, strict=True))[1:]
        before, position, predicted, wanted = (torch.cat([torch.from_numpy(part) for part in each]) for each in columns)
        missed = self.corrector(before, position, predicted, static) - wanted
        return cast(Tensor, (missed / self.corrector.correction_scale).square().mean())

    def on_validation_epoch_start(self) -> None:
        """Begin a new table, and keep the weights that are judged: the average, where there is one."""
        super().on_validation_epoch_start()
        self._column_errors: list[float] = []
        with torch.inference_mode(False):
            self._judged = {name: value.detach().clone() for name, value in self.corrector.state_dict().items()}

    def validation_step(self, reference: Trajectory | None, batch_index: int) -> dict[str, Any] | None:
        """Run a validation scene from its first frame, note its errors, and return the run for figures."""
        if reference is None:
            self._validation.add(None)
            return None
        began = time.perf_counter()
        try:
            predicted = corrected_run(self.corrector, reference, reference.num_frames - 1)
        except SimulationError:
            self._validation.add(dict.fromkeys(NAMES, math.nan))
            self._column_errors += [math.inf] if is_column(reference) else []
            return None
        seconds = (time.perf_counter() - began) / max(1, predicted.num_frames - 1)
        self._validation.add({**rollout_errors(predicted, reference), STEP_SECONDS: seconds})
        if is_column(reference):
            self._column_errors.append(runout_error(self.corrector, reference, predicted, self.placement_jitter))
        return {"predicted": predicted}

    def on_validation_epoch_end(self) -> None:
        """Log the means over all trajectories, and let the judged weights lead some of the runs to learn from."""
        super().on_validation_epoch_end()
        if self._column_errors:
            self.log("valid/column_runout_error", float(np.mean(self._column_errors)), batch_size=1)
        if not self.trainer.sanity_checking:
            with torch.inference_mode(False):
                self.runs.renew(self._judged, self.global_step)

    def configure_optimizers(self) -> Any:
        """Return AdamW with a one-cycle learning rate."""
        optimiser = torch.optim.AdamW(self.corrector.parameters(), lr=self.learning_rate)
        schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, self.learning_rate, self.num_steps + 1)
        return {"optimizer": optimiser, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}

    def entry(self, provenance: dict[str, Any]) -> dict[str, Any]:
        """Return what `load_corrector` reads besides the weights."""
        config = asdict(self.corrector.config)
        entry = {"format_version": FORMAT_VERSION, "kind": CORRECTOR_KIND, "config": config}
        return entry | {"data": self.data, "provenance": provenance}


def runout_error(corrector: Corrector, fine: Trajectory, run: Trajectory, jitter: float = 0.0) -> float:
    """Return the error of a column's final 99 % runout, relative: the mean magnitude over the placements.

    Args:
        corrector: corrects.
        fine: what is to be reached.
        run: the corrected run from the first frame of `fine`.
        jitter: of `PLACEMENTS` more placements of its particles, in halves of their spacing; 0: no more.
    """
    starts = []
    for seed in range(PLACEMENTS if jitter else 0):
        draw = np.random.default_rng(seed)
        particles = fill_scene(fine.scene, corrector.config.spacing, jitter=jitter, generator=draw)
        starts.append(start_trajectory(fine.scene, particles, fine.dt, {}))
    try:
        runs = [run, *(corrected_run(corrector, start, fine.num_frames - 1) for start in starts)]
    except SimulationError:
        return math.inf
    wanted = compute_curves(fine)["runout_99"][-1]
    return float(np.abs([compute_curves(each)["runout_99"][-1] / wanted - 1 for each in runs]).mean())
