"""One run in two hands: a learned simulator begins it, and the material point method ends it.

Frames pass from one to the other, and nothing else. The material point method wants a stress besides, which frames do
not show: it gets the one by which each particle carries
what lies above it, as fast as that is seen to fall (`carried`). So a heap neither drops until its weight is borne nor
is blown up, and what falls freely is not pressed.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from gns_pl.graph.context import context_fields
from gns_pl.mpm.settings import stepped_run
from gns_pl.rollout.engine import static_of
from gns_pl.solvers.correction import points_of
from gns_pl.trajectory import Trajectory


def continued_by_mpm(past: Trajectory, mpm: Mapping[str, Any], num_steps: int) -> Trajectory:
    """Return a trajectory that the material point method goes on with; its points are the particles.

    Args:
        past: frames; the last one's velocities are backward differences.
        mpm: settings of the solver, as in conf/data/, with cells as the particles' spacing asks for.
        num_steps: frames to add, as far apart as those of `past`.

    Raises:
        InputError: settings the solver refuses.
        SimulationError: the run became unstable.
    """
    from gns_pl.mpm.stepping import geostatic_stress

    began, points = time.perf_counter(), points_of(past, -1)
    acceleration = past.acceleration()[-1] if past.num_frames > 1 else np.zeros_like(points.velocity)
    # A backward difference is the velocity of half a frame before.
    points = replace(points, velocity=points.velocity + 0.5 * past.dt * acceleration)
    run = stepped_run(past.scene, mpm, points, past.dt)
    load = carried(past, acceleration, float(mpm["cell_size"]))
    run.stress = geostatic_stress(past.scene, points, load)
    frames = [past.position]
    for _ in range(num_steps):
        run.advance()
        frames.append(run.position.astype(np.float32)[None])
    provenance = {
        "solver": "gns_pl.solvers.handover",
        "handed_over_at": (past.num_frames - 1) * past.dt,
        "wall_seconds": float(past.provenance.get("wall_seconds", 0.0)) + time.perf_counter() - began,  # type: ignore[arg-type]
    }
    return replace(past, position=np.concatenate(frames), provenance=provenance)


def carried(trajectory: Trajectory, acceleration: NDArray[np.float64], cell: float) -> NDArray[np.float64]:
    """Return what every particle carries of the material above it in the last frame [N] [Pa].

    The vertical momentum of a column of it: ∫ ρ (g + a_z) dz from the particle upwards.

    Args:
        trajectory: its last frame.
        acceleration: of the particles [N, D] [m/s²].
        cell: of the grid by whose cells it is found [m].
    """
    static = static_of(trajectory)
    density = torch.from_numpy(trajectory.mass) / static.volume
    thickness, momentum, *_ = context_fields(
        torch.from_numpy(trajectory.position[-1]),
        torch.from_numpy(acceleration.astype(np.float32)),
        static.grid(cell),
        static.batch,
        volume=static.volume,
    )
    load: NDArray[np.float64] = (density * (momentum[:, -1] - trajectory.scene.gravity[-1] * thickness)).numpy()
    return load
