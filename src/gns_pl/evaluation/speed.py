"""How fast the learned simulator is beside the cheapest MPM that is as accurate: both warm, both in this session."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from time import perf_counter
from typing import TYPE_CHECKING, Any

from gns_pl.metrics.curves import cut
from gns_pl.metrics.summary import MINIMAL_RUNOUT, Measured

if TYPE_CHECKING:
    from gns_pl.evaluation.references import Reference
    from gns_pl.solvers.learned import LearnedSolver

SIZES = (3.0, 2.5, 2.0, 1.75, 1.5, 1.25, 1.0)
"""Cells of the MPM runs that are tried, over those of the data, the cheapest first."""

RUNS = 3
"""Timed runs of each; their median is the time, their root mean square error the error."""


def measure_speed(
    reference: Reference,
    solver: LearnedSolver,
    errors: Sequence[float | None],
    *,
    given: int,
    seed: int,
) -> dict[str, Any] | None:
    """Time the learned rollout, then MPM on finer and finer cells until its final runout is as accurate.

    MPM runs a slice or a half where the scene allows it, on as many threads as are best for it. Nothing is taken from
    the cache, and what is compiled at first use is compiled before.

    Args:
        reference: what both are compared with: the 99 % runout of all points.
        solver: the learned simulator.
        errors: relative errors of its final 99 % runout, of every placement.
        given: frames of a start that are taken as they are.
        seed: of the reference; MPM's placements are others.

    Returns:
        The "speed" part of a scene in metrics.json; None where the runouts cannot be compared.
    """
    from gns_pl.mpm.config import SimulationError
    from gns_pl.solvers.mpm import MPMSolver

    whole, known = reference.whole, [error for error in errors if error is not None and math.isfinite(error)]
    truth = whole.summary["runout_99"]
    if not known or len(known) < len(errors) or abs(truth) < MINIMAL_RUNOUT:
        return None
    scene, interval, frames = whole.trajectory.scene, whole.trajectory.dt, whole.trajectory.num_frames
    start = reference.trajectory
    seconds = []
    for _ in range(RUNS + 1):  # the first warms up
        trajectory = solver.run(start, num_steps=start.num_frames - given, given=given, monitor=False)
        seconds.append(float(trajectory.provenance["wall_seconds"]))  # type: ignore[arg-type]
    report: dict[str, Any] = {
        "learned": {
            "seconds": statistics.median(seconds[1:]),
            "error": root_mean_square(known),
            "device": trajectory.provenance["device"],
            "num_threads": trajectory.provenance["num_threads"],
        },
        "machine": trajectory.provenance["machine"],
        "mpm": [],
        "as_accurate": None,
    }
    mpm = solver.data["mpm"]
    for size in SIZES:
        rival = MPMSolver("mpm", 0.0, mpm, cell_size=size * mpm["cell_size"])
        times, missed = [], []
        try:
            rival.run(scene.replace(duration=interval), interval=interval, seed=seed)  # compiles what is needed
            for number in range(RUNS):
                began = perf_counter()
                run = rival.run(scene, interval=interval, seed=seed + 1 + number)
                times.append(perf_counter() - began)
                missed.append(Measured(cut(run, frames)).curves["runout_99"][-1] / truth - 1)
        except SimulationError:
            continue
        report["mpm"].append(
            {
                "cell_size": size * mpm["cell_size"],
                "seconds": statistics.median(times),
                "error": root_mean_square(missed),
                "num_threads": run.provenance.get("num_threads"),
            }
        )
        if report["mpm"][-1]["error"] <= report["learned"]["error"]:
            report["as_accurate"] = report["mpm"][-1]
            break
    return report


def root_mean_square(values: Sequence[float]) -> float:
    """Return the root mean square."""
    return math.sqrt(sum(value * value for value in values) / len(values))


def speed_sentence(scene: Mapping[str, Any]) -> str:
    """Return what the times of a scene mean: a ratio only where both were measured for it (`measure_speed`)."""
    from gns_pl.text import number

    wall, speed = scene["wall_seconds"], scene.get("speed")
    if speed is None:
        if not wall["learned"]:
            return ""
        text = f"A learned run takes {number(wall['learned'])} s"
        if wall["reference"]:
            text += f"; MPM on the cells of the data took {number(wall['reference'])} s when it was computed"
        return f"{text}."
    learned, rival = speed["learned"], speed["as_accurate"]
    text = f"Measured warm, in one session: a learned run takes {number(learned['seconds'])} s"
    if rival is None:
        return f"{text}; no MPM on cells of the data or coarser ones is as accurate."
    ratio = rival["seconds"] / learned["seconds"]
    text += f", the cheapest MPM as accurate (cells of {rival['cell_size']:.3g} m, runout off by "
    text += f"{100 * rival['error']:.1f} % against {100 * learned['error']:.1f} %) {number(rival['seconds'])} s: "
    return text + (f"{ratio:.2g} times faster." if ratio >= 1 else f"{1 / ratio:.2g} times slower.")
