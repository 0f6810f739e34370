"""How far a run is from what all points of a fine run did, with derivatives: the errors that training on runs adds up.

What is compared are observables of the whole run (`metrics.observables`), not single points: which point of a fine run
goes where says little, and the points that a data set keeps are few.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from gns_pl.rollout.gradient import differentiable_distance, differentiable_front, differentiable_volume_map
from gns_pl.trajectory import Observables, Trajectory

ERRORS = ("map", "height", "front", "energy", "rise")
"""Volume map, mean height, advance of the 99 % front, kinetic energy, rises of the energy of motion and height."""

COMPARED = 10
"""So many frames of a whole run are compared, evenly spaced, and the last one of a shorter run."""

PERCENT = 99.0
"""Of the mass, behind the front that is compared."""

LEAST_ADVANCE = 2.0
"""Errors of the front are over the advance of the whole run, or so many cells of the map if that is less."""

STILL = 1e-6
"""Share of the largest kinetic energy that counts as none."""


def compared_frames(whole: int, last: int) -> list[int]:
    """Return the frames of a run that are compared, rising, the last one among them.

    Args:
        whole: number of the last frame of a whole run.
        last: of the frame at which this one ends, at least 1.
    """
    evenly = {max(1, round(whole * share / COMPARED)) for share in range(1, COMPARED + 1)}
    return sorted({frame for frame in evenly if frame < last} | {last})


def outcome_errors(frames: Tensor, start: Trajectory, fine: Observables, compared: Sequence[int]) -> Tensor:
    """Return the errors of a run, relative and but for "rise" squared, means over the frames compared [len(ERRORS)].

    With V the volume of every node, h the mean height over the floor, z the advance of the front, E the kinetic energy
    and f the fine run:

    - map: Σ (V − V_f)² / Σ V_f²
    - height: (h − h_f)² / h_f²
    - front: (z − z_f)² / Z², with Z the advance of the fine run at its end (`LEAST_ADVANCE`)
    - energy: (√E − √E_f)² / max E_f in the second half of the fine run, 0 before. Of speeds: what creeps where all is
      at rest is not lost in the peak. Early, when all accelerates, displacements over different intervals are not the
      same speeds.
    - rise: Σ max(0, E' − E'_before) / max E_f over all steps, E' the energy of motion and height in the middle of a
      step, which free fall keeps. Runs of users are held wherever it rises (`rollout.stabilise`).

    Args:
        frames: positions of the run [T, N, D] [m], one step of the simulator apart.
        start: its first frame, for scene, masses and spacing.
        fine: of the whole fine run, in the same frames.
        compared: numbers of frames.
    """
    scene, kind, device = start.scene, frames.dtype, frames.device
    volume, mass = (torch.from_numpy(array).to(device, kind) for array in (start.volume(), start.mass))
    advance = fine.advance()[:, fine.percents.index(PERCENT)]
    reach = max(float(advance[-1]), LEAST_ADVANCE * fine.cell)
    most = float(fine.kinetic_energy.max()) or 1.0
    still = STILL * most

    def front(frame: Tensor) -> Tensor:
        return differentiable_front(differentiable_distance(frame, scene), mass, PERCENT, start.spacing)

    first, errors = front(frames[0]), []
    for number in compared:
        frame = frames[number]
        wanted = torch.from_numpy(fine.volume_map[number]).to(device, kind)
        volumes = differentiable_volume_map(frame, volume, scene, fine.cell)
        height = (mass * frame[:, -1]).sum() / mass.sum() - scene.lower[-1]
        velocity = (frame - frames[number - 1]) / start.dt
        energy = 0.5 * (mass * velocity.square().sum(dim=1)).sum()
        speed, fine_speed = (energy + still).sqrt(), (float(fine.kinetic_energy[number]) + still) ** 0.5
        parts = [
            (volumes - wanted).square().sum() / wanted.square().sum(),
            (height / float(fine.mean_height[number]) - 1).square(),
            ((front(frame) - first - float(advance[number])) / reach).square(),
            (speed - fine_speed).square() / most * (2 * number >= len(fine.kinetic_energy)),
        ]
        errors.append(torch.stack(parts))
    rise = _rises(frames[: compared[-1] + 1], start, mass).sum() / most
    return torch.cat([torch.stack(errors).mean(dim=0), rise[None]])


def _rises(frames: Tensor, start: Trajectory, mass: Tensor) -> Tensor:
    """Return by how much every step raises the energy of motion and height [T - 1] [J]."""
    velocity = frames.diff(dim=0) / start.dt
    released = torch.from_numpy(start.initial_velocity).to(velocity)
    velocity = torch.cat([released[None], velocity])
    middle = torch.cat([frames[:1] - released * start.dt / 2, (frames[1:] + frames[:-1]) / 2])
    gravity = velocity.new_tensor(start.scene.gravity)
    energy = ((velocity.square() / 2 - gravity * middle).sum(dim=2) * mass).sum(dim=1)
    return energy.diff().clamp_min(0)
