"""What is measured on a trajectory: pure functions of arrays, in SI units unless a docstring says otherwise.

No file and no figure belongs here. `curves` applies these to every frame, `metrics` to a whole trajectory.

A particle of a set with spacing s stands for a cube of edge s around its position (`particle_spacing`). Fronts and
heights are those of the cubes and not of their centres, so that a column filled with a lattice has exactly the length
and the height of its body, whatever the resolution.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gns_pl.errors import InputError
from gns_pl.scene import Scene
from gns_pl.trajectory import Trajectory, nearest_neighbour_distance

Floats = NDArray[np.float64]

ARREST_TOLERANCE = 0.02
"""A front is at rest once less than this share of its whole advance is left."""


def particle_spacing(trajectory: Trajectory) -> float:
    """Return s = (V / N)^(1/D) [m], with V the volume that the N particles stand for: of all bodies they fill."""
    return trajectory.spacing


def percentile_front(coordinate: Floats, mass: Floats, percents: Sequence[float], width: float) -> Floats:
    """Return the coordinate behind which q % of the mass lies, in every frame, for every q.

    The mass of a particle is spread evenly over `width` along the coordinate, so that
    F(z) = Σ m_i clip((z − x_i) / w + 1/2, 0, 1) is continuous, and z_q is the least z with F(z) ≥ q/100 Σ m_i. For a
    column of length L filled with a lattice of spacing w, z_q = q/100 L exactly; z_100 = max x_i + w/2 always.

    Args:
        coordinate: distance from the wall [T, N] [m].
        mass: [N] [kg].
        percents: the values of q, up to 100.
        width: particle spacing w [m].

    Returns:
        [len(percents), T] [m].
    """
    coordinate = np.asarray(coordinate, dtype=np.float64)
    targets = np.asarray(percents, dtype=np.float64) / 100 * np.sum(mass, dtype=np.float64)
    fronts = np.empty((len(percents), len(coordinate)))
    for frame, values in enumerate(coordinate):
        order = np.argsort(values)
        lower, weight = values[order] - width / 2, np.asarray(mass, dtype=np.float64)[order]
        breaks = np.sort(np.concatenate([lower, lower + width]))
        started = np.searchsorted(lower, breaks, side="right")
        ended = np.searchsorted(lower + width, breaks, side="right")
        total = np.concatenate([[0.0], np.cumsum(weight)])
        moment = np.concatenate([[0.0], np.cumsum(weight * lower)])
        partial = breaks * (total[started] - total[ended]) - (moment[started] - moment[ended])
        behind = np.maximum.accumulate(total[ended] + partial / width)
        upper = np.clip(np.searchsorted(behind, targets * (1 - 1e-12)), 1, len(breaks) - 1)
        rise = behind[upper] - behind[upper - 1]
        share = np.clip((targets - behind[upper - 1]) / np.where(rise > 0, rise, 1.0), 0, 1)
        fronts[:, frame] = breaks[upper - 1] + share * (breaks[upper] - breaks[upper - 1])
    fronts[np.asarray(percents) == 100] = coordinate.max(axis=1) + width / 2
    return fronts


def centre_of_mass(trajectory: Trajectory) -> Floats:
    """Return the mass-weighted mean position, measured from the lower corner of the box [T, D] [m].

    Its last component is the mean height over the floor: H0/2 for a standing column, lower for a heap. A learned
    simulator that loses volume shows here and hardly in the runout.
    """
    mass = trajectory.mass.astype(np.float64)
    mean = np.einsum("tnd,n->td", trajectory.position.astype(np.float64), mass) / mass.sum()
    return np.asarray(mean - np.array(trajectory.scene.lower))


def speeds(trajectory: Trajectory) -> Floats:
    """Return the magnitude of `Trajectory.velocity`, backward differences [T, N] [m/s]."""
    return np.asarray(np.linalg.norm(trajectory.velocity(), axis=2))


def kinetic_energy(trajectory: Trajectory) -> Floats:
    """Return ½ Σ m v² with backward differences for v, so the value of frame k belongs to t_k − dt/2 [T] [J]."""
    return np.asarray(0.5 * speeds(trajectory) ** 2 @ trajectory.mass.astype(np.float64))


def potential_energy(trajectory: Trajectory) -> Floats:
    """Return −Σ m g · (x − lower corner of the box) [T] [J]; with gravity along z, Σ m g z over the floor."""
    total = float(np.sum(trajectory.mass, dtype=np.float64))
    return np.asarray(-total * centre_of_mass(trajectory) @ np.array(trajectory.scene.gravity))


def penetration(trajectory: Trajectory) -> Floats:
    """Return how far each particle's position lies outside the box, 0 inside [T, N] [m]."""
    scene, position = trajectory.scene, trajectory.position.astype(np.float64)
    beyond = np.maximum(np.array(scene.lower) - position, position - np.array(scene.upper)).max(axis=2)
    return np.asarray(np.maximum(beyond, 0.0))


def arrest_time(time: Floats, front: Floats) -> float:
    """Return the first time from which on the front stays within `ARREST_TOLERANCE` of its whole advance of its end.

    A front that creeps to the end of the run therefore arrests at the end, one that never advances not at all (NaN).

    Args:
        time: [T] [s].
        front: [T], in any unit of length.
    """
    advance = front[-1] - front[0]
    if not advance > 0:
        return math.nan
    away = np.flatnonzero(np.abs(front - front[-1]) > ARREST_TOLERANCE * advance)
    return float(time[away[-1] + 1])


def deposit_profile(position: Floats, mass: Floats, scene: Scene, bin_width: float) -> tuple[Floats, Floats]:
    """Return the height h(x) of the deposit in equal bins along x over the box: twice the mean height of a bin's mass.

    That is the surface of a bin filled evenly from the floor. Unlike the volume per area it sees a deposit that the
    simulator has squeezed, and unlike the highest particle it does not depend on stragglers. Empty bins have h = 0.

    Args:
        position: [N, D] [m].
        mass: [N] [kg].
        scene: for the box.
        bin_width: wanted width of a bin [m]; the box is split into the nearest whole number of bins.

    Returns:
        Middles of the bins [B] [m], measured from the lower wall, and h [B] [m].
    """
    length = scene.upper[0] - scene.lower[0]
    number = max(1, round(length / bin_width))
    x = position[:, 0] - scene.lower[0]
    index = np.clip(x / length * number, 0, number - 1).astype(np.int64)
    weight = np.bincount(index, weights=mass, minlength=number)
    moment = np.bincount(index, weights=mass * (position[:, -1] - scene.lower[-1]), minlength=number)
    height = 2 * np.divide(moment, weight, out=np.zeros(number), where=weight > 0)
    return (np.arange(number) + 0.5) * length / number, height


def position_mse(predicted: Trajectory, reference: Trajectory) -> Floats:
    """Return the squared position error averaged over particles and axes, in the frames both have [T] [m²].

    Raises:
        InputError: different particles or time steps.
    """
    if predicted.position.shape[1:] != reference.position.shape[1:]:
        raise InputError(
            f"trajectories of {predicted.num_particles} and {reference.num_particles} particles in "
            f"{predicted.scene.dim} and {reference.scene.dim} dimensions cannot be compared particle by particle."
        )
    if not math.isclose(predicted.dt, reference.dt, rel_tol=1e-6):
        raise InputError(f"trajectories with time steps of {predicted.dt:g} s and {reference.dt:g} s differ in time.")
    frames = min(predicted.num_frames, reference.num_frames)
    difference = predicted.position[:frames].astype(np.float64) - reference.position[:frames]
    return np.asarray(np.mean(difference**2, axis=(1, 2)))


def rollout_mse(squared_error: Floats, num_steps: int) -> float:
    """Return MSE_n: the mean of `position_mse` over frames 1 to n [m²]; NaN if there are fewer frames.

    The average over time, particles and axes is that of Sanchez-Gonzalez et al. 2020 (rollout MSE), cut after n steps.
    Frame 0, where both start, does not count.
    """
    if not 0 < num_steps < len(squared_error):
        return math.nan
    return float(np.mean(squared_error[1 : num_steps + 1]))


def solid_fraction(position: Floats, volume: Floats, scene: Scene, cell: float) -> Floats:
    """Return the share of space that is filled around every particle: 1 inside a body, more where it is squeezed [N].

    That of the network's context features (`graph.context`). At a surface the mean includes what is empty.

    Args:
        position: [N, D] [m].
        volume: of each particle [N] [m^D].
        scene: for the box.
        cell: wanted edge of the grid's cells, some spacings [m].
    """
    import torch

    from gns_pl.graph.context import ContextGrid, context_fields

    lower, upper = (torch.tensor([corner], dtype=torch.float64) for corner in (scene.lower, scene.upper))
    grid, place = ContextGrid.of(lower, upper, cell), torch.from_numpy(position)
    batch = torch.zeros(len(position), dtype=torch.int64)
    *_, fraction = context_fields(place, torch.zeros_like(place), grid, batch, volume=torch.from_numpy(volume))
    return np.asarray(fraction.numpy())


def sinkhorn_distance(first: Floats, second: Floats, num_points: int = 200) -> float:
    """Return √S of two clouds of points, S the debiased entropic transport of squared distances [m].

    S = OT_ε(a, b) − OT_ε(a, a) / 2 − OT_ε(b, b) / 2 (Genevay, Peyré and Cuturi 2018) by POT, ε the squared spacing of
    the points that are compared. It asks where the material is, not which particle is where; of a rigid shift it is
    the length.

    Args:
        first: [N, D] [m].
        second: [M, D] [m].
        num_points: at most so many of each, evenly chosen by number, are compared.
    """
    import os

    for backend in ("PYTORCH", "TENSORFLOW", "JAX", "CUPY"):  # which POT would import, seconds for nothing
        os.environ.setdefault(f"POT_BACKEND_DISABLE_{backend}", "1")
    from ot.bregman import empirical_sinkhorn_divergence

    clouds = []
    for cloud in (first, second):
        number = min(num_points, len(cloud))
        clouds.append(np.asarray(cloud, dtype=np.float64)[np.linspace(0, len(cloud) - 1, number).astype(np.int64)])
    spacing = float(np.median(nearest_neighbour_distance(clouds[1])))
    means = [cloud.mean(axis=0) / spacing for cloud in clouds]
    # Of squared distances the shift of the means adds its square, exactly; without it 100 iterations are enough.
    centred = [cloud / spacing - mean for cloud, mean in zip(clouds, means, strict=True)]
    settings = {"method": "sinkhorn_log", "numIterMax": 100, "stopThr": 1e-4, "warn": False}
    divergence = max(0.0, float(empirical_sinkhorn_divergence(*centred, reg=1.0, **settings)))
    return spacing * math.sqrt(divergence + float(np.square(means[0] - means[1]).sum()))
