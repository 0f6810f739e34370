"""One scene judged: learned rollouts beside their reference, measured in the same way."""

from __future__ import annotations

import statistics
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from gns_pl.evaluation.placements import Band, Placements
from gns_pl.metrics.curves import Curves, compute_curves, cut, num_finite_frames
from gns_pl.metrics.measures import particle_spacing
from gns_pl.metrics.summary import COMPARISON, FLOW, SUMMARY, compare
from gns_pl.scene.extent import characteristic_time, initial_extent
from gns_pl.trajectory import Trajectory

if TYPE_CHECKING:
    from gns_pl.evaluation.references import Reference
    from gns_pl.solvers.learned import LearnedSolver
    from gns_pl.solvers.ood import OutOfDistribution


@dataclass(frozen=True)
class SceneResult:
    """What one scene gave.

    Attributes:
        trajectories: "reference" (MPM) and "learned", which have the same particles, the latter with its finite frames
            only.
        curves: the same keys → curves: of all points of the reference, and the mean over the placements.
        failed_at: time of the rollout's first frame that is not finite [s]; None if there is none.
        report: this scene's part of metrics.json.
        ood: how far the rollout was from training; None if the checkpoint does not say what it saw.
        band: name of a curve → its range over the placements; empty without placements.
    """

    trajectories: dict[str, Trajectory]
    curves: dict[str, Curves]
    failed_at: float | None
    report: dict[str, Any]
    ood: OutOfDistribution | None = None
    band: dict[str, Band] = field(default_factory=dict)


def judge_scene(
    name: str,
    reference: Reference,
    solver: LearnedSolver,
    *,
    given: int = 1,
) -> SceneResult:
    """Run one scene by a learned simulator, and measure both.

    One rollout starts from the reference's first frame, so both have the same particles, one to one: what follows
    single particles is measured on it. Everything else is the mean over the placements (`Reference.starts`), against
    all points of the reference; where there are none it is of that one rollout. A rollout that ends before the
    reference or stops being finite is reported as failed; nothing is raised.

    Args:
        name: of the scene, for messages.
        reference: of the material point method.
        solver: the learned simulator.
        given: frames of each start that are taken as they are.

    Raises:
        InputError: particles without a neighbour within the simulator's radius, or outside their box.
    """
    from gns_pl.data.places import check_reach
    from gns_pl.rollout.failure import first_failure
    from gns_pl.rollout.progress import counting
    from gns_pl.solvers.ood import compute_ood

    truth, whole = reference.trajectory, reference.whole
    check_reach(truth, solver.checkpoint.simulator.config.connectivity_radius)
    steps = truth.num_frames - given
    # What fails is told and measured to its end, so that weak models can be compared too.
    run = partial(solver.run, given=given, monitor=False)
    run(truth, num_steps=min(2, steps))  # what is compiled at first use is not timed
    with counting(f"{name}: learned rollout", truth.dt) as on_step:
        learned = run(truth, num_steps=steps, on_step=on_step)
    with counting(f"{name}: other placements", truth.dt) as on_step:
        runs = [run(start, num_steps=steps, on_step=on_step) for start in reference.starts]
    finite = num_finite_frames(learned)
    failed_at = finite * learned.dt if finite < truth.num_frames else None
    failure = first_failure(cut(learned, finite))
    trajectories = {"reference": truth, "learned": cut(learned, finite)}
    still, errors = (compare(each, truth, whole, given=given) for each in (_motionless(truth), learned))
    placed = Placements.of(runs, whole) if runs else None
    own = compute_curves(trajectories["learned"])
    curves = {"reference": whole.curves, "learned": own if placed is None or placed.curves is None else placed.curves}
    flow = {**errors, **dict.fromkeys(FLOW, float("nan")), **placed.over(np.mean)} if placed else errors
    scatter = placed.over(np.std) if placed else {}
    length, height = initial_extent(truth.scene)
    found = compute_ood(solver.checkpoint, trajectories["learned"])
    seconds = [float(run.provenance["wall_seconds"]) for run in runs or [learned]]  # type: ignore[arg-type]
    report: dict[str, Any] = {
        "scene": truth.scene.to_dict(),
        "length": length,
        "height": height,
        "aspect_ratio": height / length,
        "characteristic_time": characteristic_time(truth.scene),
        "spacing": particle_spacing(truth),
        "num_particles": truth.num_particles,
        "num_steps": truth.num_frames - 1,
        "dt": truth.dt,
        "given_frames": given,
        "reference_points": {
            "number": whole.trajectory.num_particles,
            "spacing": particle_spacing(whole.trajectory),
            "all": reference.complete,
        },
        "failed_at": failed_at,
        "failure": None if failure is None else failure.message,
        "reference": whole.summary,
        "learned": {quantity.name: flow[quantity.name] for quantity in SUMMARY},
        "no_motion": {quantity.name: still[quantity.name] for quantity in SUMMARY},
        "ood": None
        if found is None
        else {
            "exit_time": found.exit_time,
            "early_score": found.early_score(characteristic_time(truth.scene)),
            "message": found.message(),
            "reasons": list(found.reasons),
        },
        "placements": {
            "number": len(runs),
            "failed": sum(num_finite_frames(run) < truth.num_frames for run in runs),
            "runout_99": placed.values["runout_99"] if placed else [],
            "runout_99_error": placed.values["runout_99_error"] if placed else [],
            "std": scatter,
        },
        "reference_spread": {"cells": list(reference.cells), **reference.spread},
        "errors": {
            "learned": {quantity.name: flow[quantity.name] for quantity in COMPARISON},
            "no_motion": {quantity.name: still[quantity.name] for quantity in COMPARISON},
        },
        "wall_seconds": {
            "reference": truth.provenance.get("wall_seconds"),
            "learned": statistics.median(seconds),
        },
        "made_by": {"reference": truth.provenance, "learned": learned.provenance},
    }
    return SceneResult(trajectories, curves, failed_at, report, found, placed.band if placed else {})


def _motionless(reference: Trajectory) -> Trajectory:
    """Return the trivial baseline: nothing moves."""
    return replace(
        reference,
        position=np.repeat(reference.position[:1], reference.num_frames, axis=0),
        initial_velocity=np.zeros_like(reference.initial_velocity),
    )
