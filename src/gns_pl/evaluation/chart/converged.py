"""What all settings are judged by: the finest affordable material point runs, and how far they can be trusted."""

from __future__ import annotations

import hashlib
import json
import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gns_pl.errors import InputError
from gns_pl.evaluation.chart.plan import SceneFacts
from gns_pl.generation import reference_trajectory
from gns_pl.metrics.curves import compute_curves
from gns_pl.metrics.measures import Floats, deposit_profile, particle_spacing
from gns_pl.scene import Scene
from gns_pl.scene.extent import initial_extent
from gns_pl.solvers.measured_range import setup_text
from gns_pl.solvers.reduction import reduce_scene
from gns_pl.trajectory import Trajectory

FAILED = dict.fromkeys(("runout_error", "curve_error", "height_error", "profile_error"), math.inf) | {
    "runout": math.nan
}
"""Errors of a run that did not reach its end with finite positions."""


@dataclass(frozen=True)
class Converged:
    """A scene and what becomes of it.

    Attributes:
        scene: in three dimensions, or in two if it was given so.
        flat: what is run in its place where two dimensions do: its slice in plane strain, else itself.
        interval: time between frames [s].
        runs: finest runs, of several placements.
        runout: mean over them of the 99 % runout over time [T] [L0].
        height: mean over them of the final mean height [m].
        uncertainty: of the final runout, relative (`uncertainty_of`).
        seconds: wall time of one of the runs, in the mean; of the machine that made it.
        identity: hash of scene, interval and all settings.
        words: how it was made.
    """

    scene: Scene
    flat: Scene
    interval: float
    runs: tuple[Trajectory, ...]
    runout: Floats
    height: float
    uncertainty: float
    seconds: float
    identity: str
    words: str

    @classmethod
    def by(cls, runs: Sequence[Trajectory], scene: Scene, **others: Any) -> Converged:
        """Return what runs of a scene say in the mean.

        Args:
            runs: of several placements, with equal numbers of frames.
            scene: as of the attributes, like the others.
            others: all that do not follow from the runs.
        """
        curves = [compute_curves(each) for each in runs]
        return cls(
            scene=scene,
            interval=runs[0].dt,
            runs=tuple(runs),
            runout=np.mean([each["runout_99"] for each in curves], axis=0),
            height=float(np.mean([each["mean_height"][-1] for each in curves])),
            seconds=statistics.mean(float(each.provenance.get("wall_seconds", math.nan)) for each in runs),  # type: ignore[arg-type]
            **others,
        )

    @property
    def num_frames(self) -> int:
        """T."""
        return len(self.runout)

    @property
    def facts(self) -> SceneFacts:
        """What the chart says of it."""
        length, height = initial_extent(self.scene)
        return SceneFacts(
            name=self.scene.name,
            judged=self.identity,
            aspect_ratio=height / length,
            runout=float(self.runout[-1]),
            uncertainty=self.uncertainty,
            seconds=self.seconds,
            duration=(self.num_frames - 1) * self.interval,
            interval=self.interval,
            words=self.words,
            setup=setup_text(self.scene),
        )


def converged(
    scene: Scene,
    *,
    mpm: Mapping[str, Any],
    cells_per_metre: Sequence[float],
    placements: int,
    order: float,
    interval: float,
    cache: Path,
) -> Converged:
    """Run a scene as finely as is asked for, and on some coarser cells besides; runs of earlier are found again.

    Args:
        scene: what to run; in two dimensions where it is in plane strain, as its half where a mirror gives the other.
        mpm: settings of the solver but for the cells.
        cells_per_metre: the finest first, then those by which its uncertainty is known [1/m].
        placements: of the particles, over which is averaged.
        order: to which runouts converge with the cells, for the uncertainty.
        interval: time between frames [s].
        cache: folder of reference runs.

    Raises:
        InputError: no cells, or settings the solver refuses.
    """
    if not cells_per_metre or any(not number > 0 for number in cells_per_metre) or placements < 1:
        raise InputError("reference: needs one cells_per_metre at least, all positive, and one placement at least.")
    if list(cells_per_metre) != sorted(cells_per_metre, reverse=True):
        raise InputError(f"reference.cells_per_metre: the finest comes first, not {list(cells_per_metre)}.")
    reduced, runs = reduce_scene(scene), []
    for number in cells_per_metre:
        settings = {**mpm, "cell_size": 1 / number}
        made = [
            reference_trajectory(reduced.scene, settings, frame_interval=interval, seed=seed, cache_directory=cache)
            for seed in range(placements)
        ]
        # A slice is measured as it is: its layers would all say the same.
        runs.append([each if each.scene.dim < scene.dim else reduced.lift(each) for each in made])
    ends = [[float(compute_curves(each)["runout_99"][-1]) for each in made] for made in runs]
    finest = f"cells of 1/{cells_per_metre[0]:g} m, {placements} placement{'s' if placements > 1 else ''}"
    return Converged.by(
        runs[0],
        scene,
        flat=reduced.scene if reduced.scene.dim < scene.dim else scene,
        uncertainty=uncertainty_of(ends, cells_per_metre, order),
        identity=hashed([scene.to_dict(), dict(mpm), list(cells_per_metre), placements, interval]),
        words=f"MPM on {finest}{f' ({reduced.description})' if reduced.description else ''}",
    )


def uncertainty_of(runouts: Sequence[Sequence[float]], cells_per_metre: Sequence[float], order: float) -> float:
    """Return the relative uncertainty of a runout: the largest of three estimates, as in docs/reference.md.

    Roache's grid convergence index of the two finest grids, 1.25 |f − m| / (r^p − 1); twice the scatter of the
    placements; half the range over the grids, since fine ones differ without order.

    Args:
        runouts: of every placement, for every size of cells, the finest first.
        cells_per_metre: of these.
        order: p.
    """
    means = [statistics.mean(each) for each in runouts]
    found = [2 * statistics.pstdev(runouts[0]), (max(means) - min(means)) / 2]
    if len(means) > 1:
        ratio = cells_per_metre[0] / cells_per_metre[1]
        found.append(1.25 * abs(means[0] - means[1]) / (ratio**order - 1))
    return max(found) / means[0]


def errors_of(made: Trajectory | None, fine: Converged) -> dict[str, float]:
    """Return the errors of a run, by their names in `RunRow`.

    Args:
        made: frames as far apart as the reference's, in two or three dimensions; None if it failed.
        fine: what it should be.
    """
    if made is None or made.num_frames < fine.num_frames or not np.isfinite(made.position).all():
        return dict(FAILED)
    curves = compute_curves(made)
    runout = curves["runout_99"][: fine.num_frames]
    end, width = fine.runout[-1], 2 * max(particle_spacing(made), particle_spacing(fine.runs[0]))
    profile, *wanted = (
        deposit_profile(each.position[-1].astype(np.float64), each.mass.astype(np.float64), fine.scene, width)[1]
        for each in (made, *fine.runs)
    )
    true = np.mean(wanted, axis=0)
    return {
        "runout": float(runout[-1]),
        "runout_error": float(runout[-1] / end - 1),
        "curve_error": float(np.abs(runout - fine.runout).mean() / end),
        "height_error": float(curves["mean_height"][fine.num_frames - 1] / fine.height - 1),
        "profile_error": float(np.abs(profile - true).sum() / true.sum()),
    }


def hashed(value: Any) -> str:
    """Return a short hash of plain values."""
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()[:16]
