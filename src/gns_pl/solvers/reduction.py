"""No more of a scene than it needs: a slice where nothing moves across, half where a mirror gives the other half.

A reduced scene is simulated like any other, and its trajectory lifted back to three dimensions. Where a reduction does
not hold it is refused with the reason. For the material point method both hold exactly but for rounding and the random
places of points; a learned simulator has to know the reduced scene: one of two dimensions, or a slip wall.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from gns_pl.errors import InputError
from gns_pl.scene import FACES, Body, Box, Plane, Scene, Wall
from gns_pl.scene.boundaries import Obstacle
from gns_pl.solvers.similarity import Similarity
from gns_pl.trajectory import Trajectory

HORIZONTAL = "xy"

_NEAR = 1e-9
"""Lengths that differ by less than this part of the box's are equal."""


@dataclass(frozen=True)
class Reduction:
    """A scene in place of another.

    Attributes:
        scene: what is to be simulated.
        lift: makes of its trajectory one of the original scene.
        description: what was done and why it may be; empty if nothing was.
        across: axis that a slice lacks; None if it is none.
        mirrors: axes across the mirrors of a half, in the order in which it was halved.
        similarity: by how much the original scene is larger than what is run.
    """

    scene: Scene
    lift: Callable[[Trajectory], Trajectory]
    description: str
    across: int | None = None
    mirrors: tuple[int, ...] = ()
    similarity: Similarity = field(default_factory=Similarity)

    def of_similar(self, scene: Scene, similarity: Similarity) -> Reduction:
        """Return the reduction from a scene to what is run in the place of its model, of which this one is.

        Args:
            scene: the original one.
            similarity: by which `similarity.model(scene)` is the scene that this was made of.
        """
        if similarity.length == 1:
            return self
        return replace(
            self,
            lift=lambda trajectory: similarity.lift(self.lift(trajectory), scene),
            description="; ".join(filter(None, (similarity.description, self.description))),
            similarity=similarity,
        )

    def project(self, position: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the positions that a slice or a half was run with, of those it was lifted to [T, N, 2 or 3] [m].

        Args:
            position: of all layers, of a half and its images, or of the scene itself [T, M, D] [m].
        """
        position = position / np.float32(self.similarity.length)
        if self.across is None:
            return position[:, : position.shape[1] >> len(self.mirrors)]  # images stand behind (`_both`)
        layers = len(np.unique(position[0, :, self.across]))
        return np.delete(position[:, ::layers], self.across, axis=2)

    def flatten(self, lifted: Trajectory) -> Trajectory:
        """Return the trajectory of the model, or of its slice, again from the lifted one; what came in if none."""
        if self.similarity.length != 1:
            own = replace(self, similarity=Similarity())
            return own.flatten(self.similarity.lower(lifted))
        if self.across is None:
            return lifted
        position = self.project(lifted.position)
        layers = lifted.num_particles // position.shape[1]
        width = lifted.scene.upper[self.across] - lifted.scene.lower[self.across]
        return replace(
            lifted,
            position=position,
            particle_type=lifted.particle_type[::layers],
            material=lifted.material[::layers],
            mass=lifted.mass[::layers] * np.float32(layers / width),
            initial_velocity=np.delete(lifted.initial_velocity[::layers], self.across, axis=1),
            scene=self.scene,
        )


def reduce_scene(scene: Scene) -> Reduction:
    """Return the least scene that gives the whole: in plane strain a slice, else a half for each mirror plane."""
    for axis in (1, 0):
        if scene.dim == 3 and not_plane_reason(scene, axis) is None:
            return to_plane(scene, axis)
    return halve_scene(scene)


def halve_scene(scene: Scene) -> Reduction:
    """Return a half of a scene for each mirror plane, or the scene itself."""
    whole, lifts, words, mirrors = scene, [], [], []
    for axis in range(scene.dim - 1):
        if not_mirror_reason(scene, axis) is None:
            half = to_half(scene, axis)
            scene = half.scene
            lifts.append(half.lift)
            words.append(half.description)
            mirrors.append(axis)

    def lift(trajectory: Trajectory) -> Trajectory:
        for each in reversed(lifts):
            trajectory = each(trajectory)
        return replace(trajectory, scene=whole)

    return Reduction(scene, lift, "; ".join(words), mirrors=tuple(mirrors))


def not_plane_reason(scene: Scene, axis: int = 1) -> str | None:
    """Return why a scene is not in plane strain across a horizontal axis, or None if it is.

    It is where side walls are smooth, bodies and obstacles reach from one to the other, and neither gravity nor an
    initial velocity has a component across.

    Args:
        scene: in three dimensions.
        axis: the one across, 0 (x) or 1 (y).
    """
    if scene.dim != 3:
        return "it has two dimensions already"
    if scene.terrain is not None:
        return "it has a terrain"
    name = HORIZONTAL[axis]
    for face in (f"{name}-", f"{name}+"):
        if scene.walls[face].condition != "slip":
            return f"wall {face} is not slip, so it holds the material back"
    if scene.gravity[axis]:
        return f"gravity acts along {name}"
    for number, body in enumerate(scene.bodies):
        if body.velocity[axis]:
            return f"body {number} moves along {name}"
        if not _spans(scene, axis, body.position[axis], body.upper[axis]):
            return f"body {number} does not reach from wall to wall along {name}"
    for number, obstacle in enumerate(scene.obstacles):
        if isinstance(obstacle, Plane):
            if abs(obstacle.normal[axis]) > _NEAR:
                return f"obstacle {number} is inclined along {name}"
        elif not _spans(scene, axis, obstacle.position[axis], obstacle.upper[axis], beyond=True):
            return f"obstacle {number} does not reach from wall to wall along {name}"
    return None


def to_plane(scene: Scene, axis: int = 1) -> Reduction:
    """Return a scene's slice in two dimensions.

    Its trajectory is lifted to layers across, as far apart as its particles are, each with its part of the mass.

    Args:
        scene: in plane strain.
        axis: the one across, 0 (x) or 1 (y).

    Raises:
        InputError: it is not; with the reason.
    """
    reason = not_plane_reason(scene, axis)
    if reason:
        raise InputError(f"scene {scene.name!r} is not in plane strain: {reason}.")

    def drop(values: tuple[float, ...]) -> tuple[float, ...]:
        return (*values[:axis], *values[axis + 1 :])

    def sliced(obstacle: Obstacle) -> Obstacle:
        if isinstance(obstacle, Plane):
            return Plane(drop(obstacle.point), drop(obstacle.normal), obstacle.wall)
        return Box(drop(obstacle.position), drop(obstacle.size), obstacle.wall)

    kept = HORIZONTAL[1 - axis]
    faces = (f"{kept}-", f"{kept}+", "z-", "z+")
    flat = scene.replace(
        lower=drop(scene.lower),
        upper=drop(scene.upper),
        origin=drop(scene.origin),
        gravity=drop(scene.gravity),
        bodies=tuple(
            Body(drop(each.position), drop(each.size), drop(each.velocity), each.material) for each in scene.bodies
        ),
        walls={face: scene.walls[own] for face, own in zip(FACES[2], faces, strict=True)},
        obstacles=tuple(map(sliced, scene.obstacles)),
    )
    words = f"plane strain: smooth walls at {HORIZONTAL[axis]} = const, bodies from wall to wall, nothing moves across"
    return Reduction(flat, lambda trajectory: _layers(trajectory, scene, axis), words, axis)


def _layers(trajectory: Trajectory, scene: Scene, axis: int) -> Trajectory:
    width = scene.upper[axis] - scene.lower[axis]
    area = sum(math.prod(body.size) for body in trajectory.scene.bodies)
    number = max(1, round(width / math.sqrt(area / trajectory.num_particles)))
    across = scene.lower[axis] + (np.arange(number) + 0.5) * width / number

    def spread(values: np.ndarray) -> np.ndarray:
        return np.repeat(values, number, axis=0)

    position = np.repeat(trajectory.position, number, axis=1)
    places = np.broadcast_to(np.tile(across, trajectory.num_particles), position.shape[:2])
    return replace(
        trajectory,
        position=np.insert(position, axis, places.astype(np.float32), axis=2),
        particle_type=spread(trajectory.particle_type),
        material=spread(trajectory.material),
        mass=spread(trajectory.mass) * np.float32(width / number),
        initial_velocity=np.insert(spread(trajectory.initial_velocity), axis, np.float32(0), axis=1),
        scene=scene,
    )


def not_mirror_reason(scene: Scene, axis: int) -> str | None:
    """Return why a scene is not its own mirror image in the middle of a horizontal axis, or None if it is.

    Args:
        scene: in two or three dimensions.
        axis: the one across the mirror.
    """
    name = HORIZONTAL[axis]
    if scene.terrain is not None:
        return "it has a terrain"
    if scene.walls[f"{name}-"] != scene.walls[f"{name}+"]:
        return f"walls {name}- and {name}+ differ"
    if scene.gravity[axis]:
        return f"gravity acts along {name}"
    middle = scene.lower[axis] + scene.upper[axis]

    def mirrored(body: Body) -> tuple[object, ...]:
        position, velocity = list(body.position), list(body.velocity)
        position[axis], velocity[axis] = middle - body.upper[axis], -velocity[axis]
        return _key(scene, position, body.size, velocity, body.material)

    images = sorted(map(mirrored, scene.bodies), key=str)
    bodies = sorted((_key(scene, b.position, b.size, b.velocity, b.material) for b in scene.bodies), key=str)
    if images != bodies:
        return f"the bodies are not mirrored along {name}"
    for number, obstacle in enumerate(scene.obstacles):
        flat = isinstance(obstacle, Plane) and abs(obstacle.normal[axis]) <= _NEAR
        if not flat and not (
            isinstance(obstacle, Box) and _equal(scene, axis, middle - obstacle.upper[axis], obstacle.position[axis])
        ):
            return f"obstacle {number} is not mirrored along {name}"
    return None


def to_half(scene: Scene, axis: int) -> Reduction:
    """Return the lower half of a scene, with a smooth wall in the place of the mirror.

    Args:
        scene: its own mirror image.
        axis: the one across the mirror, 0 (x) or 1 (y).

    Raises:
        InputError: it is not; with the reason.
    """
    reason = not_mirror_reason(scene, axis)
    if reason:
        raise InputError(f"scene {scene.name!r} has no mirror plane: {reason}.")
    name, middle = HORIZONTAL[axis], (scene.lower[axis] + scene.upper[axis]) / 2

    def cut(values: tuple[float, ...], value: float) -> tuple[float, ...]:
        return (*values[:axis], value, *values[axis + 1 :])

    near = _NEAR * (scene.upper[axis] - scene.lower[axis])
    bodies = tuple(
        replace(body, size=cut(body.size, middle - body.position[axis])) if body.upper[axis] > middle + near else body
        for body in scene.bodies
        if body.position[axis] < middle - near
    )
    half = scene.replace(upper=cut(scene.upper, middle), bodies=bodies, walls={**scene.walls, f"{name}+": Wall("slip")})
    return Reduction(half, lambda trajectory: _both(trajectory, scene, axis), f"mirror plane in the middle of {name}")


def _both(trajectory: Trajectory, scene: Scene, axis: int) -> Trajectory:
    image, velocity = trajectory.position.copy(), trajectory.initial_velocity.copy()
    image[..., axis] = np.float32(scene.lower[axis] + scene.upper[axis]) - image[..., axis]
    velocity[:, axis] *= -1

    def twice(values: np.ndarray) -> np.ndarray:
        return np.concatenate([values, values])

    return replace(
        trajectory,
        position=np.concatenate([trajectory.position, image], axis=1),
        particle_type=twice(trajectory.particle_type),
        material=twice(trajectory.material),
        mass=twice(trajectory.mass),
        initial_velocity=np.concatenate([trajectory.initial_velocity, velocity]),
        scene=scene,
    )


def _equal(scene: Scene, axis: int, one: float, other: float) -> bool:
    return abs(one - other) <= _NEAR * (scene.upper[axis] - scene.lower[axis])


def _spans(scene: Scene, axis: int, low: float, high: float, beyond: bool = False) -> bool:
    if beyond:
        return low <= scene.lower[axis] + _NEAR and high >= scene.upper[axis] - _NEAR
    return _equal(scene, axis, low, scene.lower[axis]) and _equal(scene, axis, high, scene.upper[axis])


def _key(scene: Scene, position: object, size: object, velocity: object, material: str) -> tuple[object, ...]:
    digits = round(-math.log10(_NEAR * max(u - low for u, low in zip(scene.upper, scene.lower, strict=True))))
    rounded = [tuple(round(value, digits) + 0.0 for value in each) for each in (position, size, velocity)]  # type: ignore[attr-defined]
    return (*rounded, material)
