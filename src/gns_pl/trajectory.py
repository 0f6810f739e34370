"""A `Trajectory`: what a simulation, true or learned, leaves behind. Arrays in frames of one fixed time step."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gns_pl.errors import InputError
from gns_pl.fields import FIELDS, MATERIAL_FEATURES, OBSERVED
from gns_pl.scene import Particles, Scene


@dataclass(frozen=True)
class Observables:
    """What all points of a run did, in every frame: a trajectory may hold few of them (`metrics.observables`).

    Attributes:
        percents: of the mass, Q of them, each with its front.
        cell: wanted distance of the map's nodes [m], from which `metrics.maps.volume_map` finds the same grid.
        front: [T, Q] [m] distance from the release behind which so much of the mass lies (`metrics.release`).
        volume_map: volume at every node, [T, X + 1, Y + 1], or [T, X + 1] in two dimensions [m^D].
        mean_height: mass-weighted mean height over the floor [T] [m].
        kinetic_energy: ½ Σ m v² [T] [J], v by backward differences.
    """

    percents: tuple[float, ...]
    cell: float
    front: NDArray[np.float32]
    volume_map: NDArray[np.float32]
    mean_height: NDArray[np.float32]
    kinetic_energy: NDArray[np.float32]

    def every(self, stride: int) -> Observables:
        """Return every `stride`-th frame."""
        arrays = {field.name: getattr(self, field.name)[::stride] for field in OBSERVED}
        return replace(self, **arrays)

    def advance(self) -> NDArray[np.float32]:
        """Return how far every front has gone since frame 0 [T, Q] [m]."""
        return np.asarray(self.front - self.front[0])


@dataclass(frozen=True, repr=False)
class Trajectory:
    """Positions of N particles in T frames, and what does not change with time.

    Arrays, lists and tensors of other types become arrays of the types of `fields`, in which they are stored; only
    positions in double precision stay so until then.

    Attributes:
        position: [T, N, D] [m], float32; frame k is at time k · dt.
        particle_type: [N] `ParticleType`.
        material: [N, K] material features.
        material_features: names of the K features.
        mass: [N] [kg] (per metre of depth in two dimensions).
        initial_velocity: [N, D] [m/s] at frame 0.
        dt: time between frames [s].
        scene: what was simulated.
        provenance: how it was made: solver, its settings, versions, seed; plain JSON values.
        observables: of the whole run that it is part of; None where they are not known or were not asked for.

    Raises:
        InputError: shapes that do not fit together, or a time step that is not positive.
    """

    position: NDArray[np.float32]
    particle_type: NDArray[np.int64]
    material: NDArray[np.float32]
    material_features: tuple[str, ...]
    mass: NDArray[np.float32]
    initial_velocity: NDArray[np.float32]
    dt: float
    scene: Scene
    provenance: dict[str, object]
    observables: Observables | None = None

    def __post_init__(self) -> None:
        for field in FIELDS:
            array = np.asarray(getattr(self, field.name))
            # Positions in double precision are measured in it; simulators and files take single precision.
            exact = field.name == "position" and array.dtype == np.float64
            object.__setattr__(self, field.name, array if exact else array.astype(field.dtype, copy=False))
        object.__setattr__(self, "dt", float(self.dt))
        if self.position.ndim != 3 or self.position.shape[2] != self.scene.dim:
            raise InputError(f"trajectory: position must be [T, N, {self.scene.dim}], not {self.position.shape}.")
        number = self.position.shape[1]
        shapes: dict[str, tuple[NDArray[np.generic], tuple[int, ...]]] = {
            "particle_type": (self.particle_type, (number,)),
            "material": (self.material, (number, len(self.material_features))),
            "mass": (self.mass, (number,)),
            "initial_velocity": (self.initial_velocity, (number, self.scene.dim)),
        }
        for name, (array, shape) in shapes.items():
            if array.shape != shape:
                raise InputError(f"trajectory: {name} must be {shape}, not {array.shape}.")
        if not self.dt > 0:
            raise InputError(f"trajectory: dt must be positive, not {self.dt}.")
        if self.observables is not None and len(self.observables.front) != self.num_frames:
            number = len(self.observables.front)
            raise InputError(f"trajectory: observables must be of {self.num_frames} frames, not {number}.")

    def __repr__(self) -> str:
        solver = self.provenance.get("solver", "unknown")
        return (
            f"Trajectory of {self.scene.name!r}: {self.num_frames} frames of {self.num_particles:,} particles in "
            f"{self.scene.dim} dimensions, every {self.dt:g} s to {self.dt * (self.num_frames - 1):g} s\n"
            f"  position {list(self.position.shape)} m, mass {self.mass.sum():.4g} kg, solver: {solver}"
        )

    @property
    def num_frames(self) -> int:
        """T."""
        return int(self.position.shape[0])

    @property
    def num_particles(self) -> int:
        """N."""
        return int(self.position.shape[1])

    @property
    def time(self) -> NDArray[np.float64]:
        """Time of every frame [T] [s]."""
        return np.arange(self.num_frames, dtype=np.float64) * np.float64(self.dt)

    def every(self, stride: int) -> Trajectory:
        """Return every `stride`-th frame, the first among them, with the time step that goes with it."""
        if stride == 1:
            return self
        observables = self.observables and self.observables.every(stride)
        return replace(self, position=self.position[::stride], dt=self.dt * stride, observables=observables)

    def resampled(self, interval: float, duration: float | None = None) -> Trajectory:
        """Return frames at another interval, between those there are by monotone cubics, behind the last at rest.

        No coordinate leaves the range of its two frames (Fritsch and Butland 1984), so nothing overshoots a wall.

        Args:
            interval: time between frames [s].
            duration: to the last frame, rounded to whole intervals [s]; that of this trajectory if None.

        Raises:
            InputError: an interval that is not positive.
        """
        if not interval > 0:
            raise InputError(f"trajectory: the interval between frames must be positive, not {interval}.")
        end = self.dt * (self.num_frames - 1)
        number = round((end if duration is None else duration) / interval) + 1
        if self.num_frames == 1:
            return replace(self, position=np.repeat(self.position, number, axis=0), dt=interval, observables=None)
        from scipy.interpolate import PchipInterpolator

        times = np.minimum(np.arange(number) * interval, end)
        nearest = np.rint(times / self.dt).astype(np.int64)
        exact = np.abs(times - nearest * self.dt) < 1e-6 * self.dt
        position = np.empty((number, *self.position.shape[1:]), dtype=np.float32)
        position[exact] = self.position[nearest[exact]]
        if not exact.all():
            position[~exact] = PchipInterpolator(self.time, self.position.astype(np.float64))(times[~exact])
        return replace(self, position=position, dt=interval, observables=None)

    @property
    def spacing(self) -> float:
        """(V / N)^(1/D) [m], with V the volume that the N particles stand for: of all bodies they fill."""
        return float((self.volume().sum(dtype=np.float64) / self.num_particles) ** (1 / self.scene.dim))

    def volume(self) -> NDArray[np.float32]:
        """Volume that every particle stands for: its mass over the density of the body it starts in [N] [m^D].

        Raises:
            InputError: a particle that starts in no body, where the scene has several densities.
        """
        density = [self.scene.materials[body.material].density for body in self.scene.bodies]
        if len(set(density)) == 1:
            return np.asarray(self.mass / density[0], dtype=np.float32)
        of_particle = np.full(self.num_particles, np.nan)
        for body, value in zip(self.scene.bodies, density, strict=True):
            start = self.position[0]
            of_particle[((start >= body.position) & (start <= body.upper)).all(axis=1)] = value
        if np.isnan(of_particle).any():
            raise InputError(
                f"scene {self.scene.name!r}: a particle starts outside every body, so its density is open."
            )
        return np.asarray(self.mass / of_particle, dtype=np.float32)

    def velocity(self) -> NDArray[np.float64]:
        """Backward differences (x_k − x_{k−1}) / dt, with the initial velocity in frame 0 [T, N, D] [m/s]."""
        backward = np.diff(self.position.astype(np.float64), axis=0) / self.dt
        return np.concatenate([self.initial_velocity[None], backward], dtype=np.float64)

    def acceleration(self) -> NDArray[np.float64]:
        """(v_{k+1} − v_k) / dt with `velocity`'s v, what semi-implicit Euler needs in frame k [T − 1, N, D] [m/s²]."""
        return np.asarray(np.diff(self.velocity(), axis=0) / self.dt)


def ballistic_history(
    position: NDArray[np.floating], velocity: NDArray[np.floating], dt: float, length: int
) -> NDArray[np.float64]:
    """Return `length` positions that end in `position` and move there at constant `velocity`.

    A simulation thus starts from a scene alone: x_{−k} = x_0 − k v_0 dt.

    Args:
        position: [N, D] [m] at time 0.
        velocity: [N, D] [m/s] at time 0.
        dt: time between frames [s].
        length: number of positions, the last one at time 0.

    Returns:
        [length, N, D] [m].
    """
    steps = np.arange(length - 1, -1, -1, dtype=np.float64)
    moved = steps[:, None, None] * (velocity.astype(np.float64) * dt)[None]
    return np.asarray(position.astype(np.float64)[None] - moved)


def start_trajectory(scene: Scene, particles: Particles, dt: float, provenance: dict[str, object]) -> Trajectory:
    """Return the one-frame trajectory from which a simulation of `scene` starts.

    Args:
        scene: what is to be simulated.
        particles: its filling, from `fill_scene`.
        dt: time between frames [s].
        provenance: how the filling was made.
    """
    return Trajectory(
        position=particles.position[None].astype(np.float32),
        particle_type=particles.particle_type,
        material=particles.material,
        material_features=MATERIAL_FEATURES,
        mass=particles.mass.astype(np.float32),
        initial_velocity=particles.velocity.astype(np.float32),
        dt=dt,
        scene=scene,
        provenance=provenance,
    )


def nearest_neighbour_distance(position: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return every particle's distance to the nearest other one, exactly (k-d tree) [N] [m].

    Args:
        position: [N, D] [m], N ≥ 2.
    """
    from scipy.spatial import cKDTree

    distance, _ = cKDTree(position).query(position, k=2)
    return np.asarray(distance[:, 1])
