"""One scene judged: the learned rollout beside its reference, measured in the same way."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from gns_pl.evaluation.curves import Curves, compute_curves, cut, num_finite_frames
from gns_pl.evaluation.measures import particle_spacing
from gns_pl.evaluation.metrics import COMPARISON, SUMMARY, compare, summarise
from gns_pl.scene.extent import characteristic_time, initial_extent
from gns_pl.trajectory import Trajectory

if TYPE_CHECKING:
    from gns_pl.checkpoint import Checkpoint
    from gns_pl.evaluation.references import Reference
    from gns_pl.rollout.familiarity import Familiarity


@dataclass(frozen=True)
class SceneResult:
    """What one scene gave.

    Attributes:
        trajectories: "reference" (MPM) and "learned", the latter with its finite frames only.
        curves: the same keys → `compute_curves`.
        failed_at: time of the rollout's first frame that is not finite [s]; None if there is none.
        report: this scene's part of metrics.json.
        familiarity: how far the rollout was from training; None if the checkpoint does not say what it saw.
    """

    trajectories: dict[str, Trajectory]
    curves: dict[str, Curves]
    failed_at: float | None
    report: dict[str, Any]
    familiarity: Familiarity | None = None


def judge_scene(
    name: str,
    reference: Reference,
    checkpoint: Checkpoint,
    *,
    stabilise: Mapping[str, Any] | None = None,
    placements: int = 0,
    seed: int = 0,
) -> SceneResult:
    """Run one scene by the learned simulator, and measure both.

    The rollout starts from the reference's first frame, so both have the same particles, one to one. A rollout that
    ends before the reference or stops being finite is reported as failed.

    Args:
        name: of the scene, for messages.
        reference: of the material point method.
        checkpoint: the simulator.
        stabilise: arguments of `rollout.stabilise.stabilise`.
        placements: number of runs from other placements, for a band on the runout.
        seed: of the first of them.

    Raises:
        InputError: particles without a neighbour within the simulator's radius, or outside their box.
    """
    from gns_pl.data.places import check_reach
    from gns_pl.evaluation.bands import ensemble_bands
    from gns_pl.rollout import rollout
    from gns_pl.rollout.failure import first_failure
    from gns_pl.rollout.familiarity import familiarity
    from gns_pl.rollout.fitted import start_of
    from gns_pl.rollout.progress import counting
    from gns_pl.rollout.stabilise import stabilise as stabilised

    simulator = stabilised(checkpoint.simulator, **(stabilise or {}))
    truth = reference.trajectory
    check_reach(truth, checkpoint.simulator.config.connectivity_radius)
    with counting(f"{name}: learned rollout", truth.dt) as on_step:
        learned = rollout(simulator, truth, truth.num_frames - 1, on_step=on_step)
    kept = {} if simulator is checkpoint.simulator else dict(stabilise or {})
    learned = replace(learned, provenance={**learned.provenance, "stabilise": kept})
    finite = num_finite_frames(learned)
    failed_at = finite * learned.dt if finite < truth.num_frames else None
    failure = first_failure(cut(learned, finite))
    trajectories = {"reference": truth, "learned": cut(learned, finite)}
    curves = {key: compute_curves(trajectory) for key, trajectory in trajectories.items()}
    still, errors = compare(_motionless(truth), truth), compare(learned, truth)
    length, height = initial_extent(truth.scene)
    found = familiarity(checkpoint, trajectories["learned"])
    placed = 0 if "mpm" not in checkpoint.data else placements  # what is imported has bodies of any shape
    starts = [start_of(truth.scene, checkpoint, number, {}) for number in range(seed, seed + placed)]
    duration = (truth.num_frames - 1) * truth.dt
    ends = (
        ensemble_bands([replace(checkpoint, simulator=simulator)], starts, duration=duration).members[:, -1].tolist()
        if starts
        else []
    )
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
        "failed_at": failed_at,
        "failure": None if failure is None else failure.sentence,
        "reference": summarise(truth, curves["reference"]),
        "learned": {quantity.name: errors[quantity.name] for quantity in SUMMARY},
        "no_motion": {quantity.name: still[quantity.name] for quantity in SUMMARY},
        "familiarity": None
        if found is None
        else {
            "left_at": found.left_at,
            "early": found.early(characteristic_time(truth.scene)),
            "sentence": found.sentence(),
            "reasons": list(found.reasons),
        },
        "placements": ends,
        "reference_spread": {"cells": list(reference.cells), **reference.spread},
        "errors": {
            "learned": {quantity.name: errors[quantity.name] for quantity in COMPARISON},
            "no_motion": {quantity.name: still[quantity.name] for quantity in COMPARISON},
        },
        "wall_seconds": {
            "reference": truth.provenance.get("wall_seconds"),
            "learned": learned.provenance.get("wall_seconds"),
        },
        "made_by": {"reference": truth.provenance, "learned": learned.provenance},
    }
    return SceneResult(trajectories, curves, failed_at, report, found)


def _motionless(reference: Trajectory) -> Trajectory:
    """Return the trivial baseline: nothing moves."""
    return replace(
        reference,
        position=np.repeat(reference.position[:1], reference.num_frames, axis=0),
        initial_velocity=np.zeros_like(reference.initial_velocity),
    )
