"""What all settings are judged by: the finest affordable material point runs, and how far they can be trusted.

Of these runs only what is compared is kept, in a file of some KB. Those of the package's scene sets come with it, so
that solvers are judged without the runs.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gns_pl.errors import InputError
from gns_pl.evaluation.chart.kept import SHIPPED, read_kept, write_kept
from gns_pl.evaluation.chart.observed import Observed, errors_of
from gns_pl.evaluation.chart.plan import SceneFacts
from gns_pl.generation import reference_trajectory
from gns_pl.metrics.release import is_column
from gns_pl.scene import Scene
from gns_pl.scene.extent import initial_extent
from gns_pl.solvers.measured_range import setup_text
from gns_pl.solvers.reduction import Reduction, reduce_scene
from gns_pl.solvers.solver import hashed
from gns_pl.trajectory import Trajectory

OBSERVABLES: Mapping[str, Callable[[Observed], Any]] = {
    "front": lambda run: run.front[-1],
    "map": lambda run: run.volumes,
    "height": lambda run: run.height[-1],
    "arrest": lambda run: run.arrest,
}
"""Measure → what of a run has an uncertainty: a number, or a map."""


@dataclass(frozen=True)
class Converged:
    """A scene and what becomes of it.

    Attributes:
        scene: in three dimensions, or in two if it was given so.
        flat: what is run in its place where two dimensions do: its slice in plane strain, else itself.
        across: the axis that the slice lacks; None if it is none.
        interval: time between frames [s].
        observed: mean over the finest runs, of several placements.
        uncertainty: measure of `OBSERVABLES` → its relative uncertainty (`uncertainty_of`).
        seconds: processor time of one of the runs, in the mean; of the machine that made it.
        identity: hash of scene, interval and all settings.
        words: how it was made.
    """

    scene: Scene
    flat: Scene
    across: int | None
    interval: float
    observed: Observed
    uncertainty: Mapping[str, float]
    seconds: float
    identity: str
    words: str

    @property
    def num_frames(self) -> int:
        """T."""
        return len(self.observed.front)

    @property
    def facts(self) -> SceneFacts:
        """What the chart says of it."""
        length, height = initial_extent(self.scene)
        return SceneFacts(
            name=self.scene.name,
            judged=self.identity,
            aspect_ratio=height / length,
            length=length,
            column=is_column(self.scene),
            front=float(self.observed.front[-1]),
            uncertainty=dict(self.uncertainty),
            seconds=self.seconds,
            duration=(self.num_frames - 1) * self.interval,
            interval=self.interval,
            words=self.words,
            setup=setup_text(self.scene),
        )

    def errors(self, run: Trajectory | None) -> dict[str, float]:
        """Return the errors of a run (`observed.errors_of`).

        Args:
            run: frames as far apart as the reference's, in two or three dimensions; None if it failed.
        """
        if run is None or run.num_frames < self.num_frames or not np.isfinite(run.position).all():
            return errors_of(None, self.observed)
        return errors_of(Observed.of(run, self.flat, self.across, self.num_frames), self.observed)


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
    """Return what becomes of a scene on cells as fine as is asked for, and how far coarser ones differ.

    What is kept from before is not run again: in the package, or in the folder of reference runs, where it is put.

    Args:
        scene: what to run; in two dimensions where it is in plane strain, as its half where a mirror gives the other.
        mpm: settings of the solver but for the cells.
        cells_per_metre: the finest first, then those by which its uncertainty is known [1/m].
        placements: of the particles, over which is averaged.
        order: to which fronts converge with the cells, for the uncertainty.
        interval: time between frames [s].
        cache: folder of reference runs.

    Raises:
        InputError: no cells, or settings the solver refuses.
    """
    if not cells_per_metre or any(not number > 0 for number in cells_per_metre) or placements < 1:
        raise InputError("reference: needs one cells_per_metre at least, all positive, and one placement at least.")
    if list(cells_per_metre) != sorted(cells_per_metre, reverse=True):
        raise InputError(f"reference.cells_per_metre: the finest comes first, not {list(cells_per_metre)}.")
    reduced = reduce_scene(scene)
    flat = reduced.scene if reduced.scene.dim < scene.dim else scene
    identity = hashed([scene.to_dict(), dict(mpm), list(cells_per_metre), placements, order, interval])
    name = f"{scene.name}_{identity}.json"
    path = next((folder / name for folder in (SHIPPED, Path(cache)) if (folder / name).exists()), None)
    if path is None:
        sizes = [1 / number for number in cells_per_metre]
        runs, seconds = _runs(reduced, scene, mpm, sizes, placements, interval, cache)
        finest = f"cells of 1/{cells_per_metre[0]:g} m, {placements} placement{'s' if placements > 1 else ''}"
        uncertainty = {
            measure: uncertainty_of([[part(run) for run in of_size] for of_size in runs], cells_per_metre, order)
            for measure, part in OBSERVABLES.items()
        }
        words = f"MPM on {finest}{f' ({reduced.description})' if reduced.description else ''}"
        path = Path(cache) / name
        facts = {"identity": identity, "uncertainty": uncertainty, "seconds": seconds, "words": words}
        write_kept(path, Observed.mean(runs[0]), {"scene": scene.to_dict(), "interval": interval, **facts})
    observed, kept = read_kept(path, ("identity", "uncertainty", "seconds", "words"))
    return Converged(scene, flat, reduced.across, interval, observed, **kept)


def _runs(
    reduced: Reduction,
    scene: Scene,
    mpm: Mapping[str, Any],
    sizes: Sequence[float],
    placements: int,
    interval: float,
    cache: Path,
) -> tuple[list[list[Observed]], float]:
    """Return what every placement on every size of cells did, and the mean processor time on the first of these [s]."""
    observed: list[list[Observed]] = []
    seconds: list[float] = []
    for size in sizes:
        observed.append([])
        for seed in range(placements):
            run = reference_trajectory(
                reduced.scene, {**mpm, "cell_size": size}, frame_interval=interval, seed=seed, cache_directory=cache
            )
            if size == sizes[0]:
                seconds.append(float(run.provenance.get("cpu_seconds", math.nan)))  # type: ignore[arg-type]
            # A slice is measured as it is: its layers would all say the same.
            whole = run if run.scene.dim < scene.dim else reduced.lift(run)
            observed[-1].append(Observed.of(whole, reduced.scene if whole is run else scene, reduced.across))
    return observed, statistics.mean(seconds)


def uncertainty_of(values: Sequence[Sequence[Any]], cells_per_metre: Sequence[float], order: float) -> float:
    """Return a measure's relative uncertainty: the largest of three estimates, as in docs/reference.md.

    Roache's grid convergence index of the two finest grids, 1.25 |f − m| / (r^p − 1); twice the scatter of the
    placements; half the range over the grids, since fine ones differ without order. Maps differ by the share of the
    volume that lies elsewhere.

    Args:
        values: of every placement, numbers or maps, for every size of cells, the finest first.
        cells_per_metre: of these.
        order: p.
    """
    means = [np.mean(of_size, axis=0) for of_size in values]
    whole = (1 if np.ndim(means[0]) == 0 else 2) * np.abs(means[0]).sum()

    def apart(one: Any, other: Any) -> float:
        return float(np.abs(one - other).sum() / whole)

    scatter = math.sqrt(statistics.mean(apart(value, means[0]) ** 2 for value in values[0]))
    estimates = [2 * scatter, max(apart(one, other) for one in means for other in means) / 2]
    if len(means) > 1:
        ratio = cells_per_metre[0] / cells_per_metre[1]
        estimates.append(1.25 * apart(means[0], means[1]) / (ratio**order - 1))
    return max(estimates)
