"""The scenes of the suite: twelve axes along which a run leaves what a method was made for."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from gns_pl.errors import InputError
from gns_pl.scene import Body, Material, Scene, Wall, part_from_dict
from gns_pl.scene.extent import characteristic_time

TRAINING = 8.0
"""Horizon of the training columns [τc]; `horizon` goes on for three of them."""

HEAP_STEPS = 1000
DEPTH = 0.5
"""Width of three-dimensional columns, from wall to wall [m]."""

RATIOS = (0.5, 0.7, 1.0, 1.5, 2.5, 3.5)


@dataclass(frozen=True)
class StressScene:
    """One scene, and what is unusual about its start.

    Attributes:
        axis: along which it is stressed.
        value: how far, in words.
        scene: what is run.
        coarseness: spacing over the usual one.
        by_points: for the material point method, `coarseness` is of the points in a cell and not of the cells.
        jitter: of the filling, in halves of a spacing; None as usual.
        shake: standard deviation of what is added to every particle's velocity [m/s].
        displaced: standard deviation of what is added to every particle's position [spacings].
        settled: seconds that the material point method takes first to settle; the run begins from its deposit, at rest.
    """

    axis: str
    value: str
    scene: Scene
    coarseness: float = 1.0
    by_points: bool = False
    jitter: float | None = None
    shake: float = 0.0
    displaced: float = 0.0
    settled: float = 0.0


@dataclass(frozen=True)
class Sand:
    """What all scenes are made of.

    Attributes:
        dim: D.
        material: the sand.
        gravity: [m/s²].
        walls: of every face.
        interval: time between frames [s]; durations are whole multiples.
    """

    dim: int
    material: Material
    gravity: float
    walls: Mapping[str, Wall] = field(default_factory=dict)
    interval: float = 0.02

    @classmethod
    def of(cls, data: Mapping[str, Any], dim: int, interval: float) -> Sand:
        """Return that of a data set.

        Raises:
            InputError: data that do not say what they are made of.
        """
        families = data.get("families", {}).values()
        walls = data.get("walls") or next((family["walls"] for family in families if "walls" in family), None)
        if walls is None or "material" not in data or "gravity" not in data:
            raise InputError("the stress suite needs data that state their gravity, material and walls.")
        parts = {face: part_from_dict(Wall, f"wall {face}", wall) for face, wall in walls.items()}
        return cls(dim, part_from_dict(Material, "material", data["material"]), float(data["gravity"]), parts, interval)

    def scene(
        self, name: str, bodies: list[Body], box: tuple[float, ...], *, taus: float = TRAINING, tilt: float = 0.0,
        angle: float | None = None,
    ) -> Scene:  # fmt: skip
        """Return a scene of this sand.

        Args:
            name: of the scene.
            bodies: [D] each.
            box: [D] [m].
            taus: duration [τc].
            tilt: of gravity towards x+ [degrees].
            angle: of internal friction [degrees]; None as usual.
        """
        turned, gravity = math.radians(tilt), [0.0] * self.dim
        gravity[0], gravity[-1] = self.gravity * math.sin(turned), -self.gravity * math.cos(turned)
        material = self.material
        if angle is not None:
            material = Material(**{**vars(material), "friction_angle_deg": angle, "dilation_angle_deg": 0.0})
        scene = Scene(
            name=name, lower=(0.0,) * self.dim, upper=box, gravity=tuple(gravity), duration=1.0,
            materials={"sand": material}, bodies=tuple(bodies), walls=self.walls,
        )  # fmt: skip
        frames = math.ceil(taus * characteristic_time(scene) / self.interval - 1e-6)
        return scene.replace(duration=frames * self.interval)

    def body(self, x: float, z: float, length: float, height: float, *speed: float) -> Body:
        """Return a body from wall to wall across the plane; `speed` along x and z [m/s]."""
        across = [(0.0, DEPTH, 0.0)] * (self.dim - 2)
        u, w = speed or (0.0, 0.0)
        return _cuboid((x, length, u), *across, (z, height, w))

    def box(self, length: float, height: float) -> tuple[float, ...]:
        """Return a box of the columns' width."""
        return (length, *(DEPTH,) * (self.dim - 2), height)

    def column(self, name: str, length: float, ratio: float, **other: Any) -> Scene:
        """Return a column against the lower wall, in a box that its front does not cross."""
        height, tilted = length * ratio, other.get("tilt", 0.0) != 0
        box = self.box(max(2.5, length * (1.5 + 3 * ratio)) if not tilted else 8.0, max(1.1, height + 0.2))
        return self.scene(name, [self.body(0.0, 0.0, length, height)], box, **other)


def stress_scenes(sand: Sand, seed: int) -> Iterator[StressScene]:
    """Yield the scenes, those of an axis one after the other.

    Which these are depends on the seed and the dimension alone, so that all models see the same.

    Args:
        sand: what they are made of.
        seed: of the sizes and places that are drawn.
    """
    for axis in AXES:
        draw = np.random.default_rng([seed, AXES.index(axis)])
        for number, settings in enumerate(_MAKERS[axis](sand, draw)):
            yield StressScene(axis=axis, **{**settings, "scene": settings["scene"].replace(name=f"{axis}_{number}")})


Made = Iterator[dict[str, Any]]


def _horizon(sand: Sand, draw: np.random.Generator) -> Made:
    for ratio in RATIOS:
        length = draw.uniform(0.3, 0.42) if ratio < 2 else draw.uniform(0.22, 0.26)
        yield {"value": f"a = {ratio:g}", "scene": sand.column("x", length, ratio, taus=3 * TRAINING)}
    for ratio in (0.55, 0.65, 1.4, 1.6):
        length = draw.uniform(0.22, 0.28)
        body = _block(sand, draw.uniform(0.1, 0.6), 0.0, length, length * ratio)
        yield {"value": f"block, {ratio:g}", "scene": sand.scene("x", [body], _room(sand), taus=3 * TRAINING)}
    for _ in range(2):
        side, x, z = draw.uniform(0.26, 0.35), draw.uniform(0.1, 0.6), draw.uniform(0.05, 0.19)
        body = _block(sand, x, z, side, side, draw.uniform(-0.9, 0.9), draw.uniform(-0.9, 0.9))
        yield {"value": "drop", "scene": sand.scene("x", [body], _room(sand), taus=3 * TRAINING)}


def _room(sand: Sand) -> tuple[float, ...]:
    """Return the box of drops and blocks."""
    return (1.0, *(1.0,) * (sand.dim - 2), 1.0)


def _block(sand: Sand, x: float, z: float, length: float, height: float, *speed: float) -> Body:
    """Return a body in the middle of the room's width, as wide as long; `speed` along x and z."""
    u, w = speed or (0.0, 0.0)
    across = [((1 - length) / 2, length, 0.0)] * (sand.dim - 2)
    return _cuboid((x, length, u), *across, (z, height, w))


def _cuboid(*axes: tuple[float, float, float]) -> Body:
    """Return a body from its lower end, length and velocity along each axis."""
    position, size, velocity = zip(*axes, strict=True)
    return Body(position, size, velocity)


def _aspect(sand: Sand, draw: np.random.Generator) -> Made:
    for ratio in (0.4, 0.5, 0.8, 1.2, 2.0, 3.0, 4.0, 4.5, 5.0, 6.0):
        length = draw.uniform(0.3, 0.42) if ratio < 2 else draw.uniform(0.2, 0.24)
        yield {"value": f"{ratio:g}", "scene": sand.column("x", length, ratio)}


def _size(sand: Sand, draw: np.random.Generator) -> Made:
    for ratio, length in ((0.8, 0.4), (2.0, 0.3)):
        for factor in (0.5, 0.71, 1.41, 2.0):
            yield {"value": f"x {factor:g}", "scene": sand.column("x", length * factor, ratio)}


def _count(sand: Sand, draw: np.random.Generator) -> Made:
    for ratio, length in ((0.8, 0.4), (2.0, 0.3)):
        for factor in (0.25, 0.5, 2.0, 4.0):
            coarse = factor ** (-1 / sand.dim)
            scene = sand.column("x", length, ratio)
            yield {"value": f"x {factor:g}", "scene": scene, "coarseness": coarse, "by_points": True}


def _spacing(sand: Sand, draw: np.random.Generator) -> Made:
    for ratio, length in ((0.8, 0.4), (2.0, 0.3)):
        for factor in (0.8, 0.9, 1.1, 1.2):
            yield {"value": f"x {factor:g}", "scene": sand.column("x", length, ratio), "coarseness": factor}


def _speed(sand: Sand, draw: np.random.Generator) -> Made:
    for speed in (1.2, 1.2, 1.6, 1.6, 2.0, 2.0, 2.0, 2.0, 3.0, 4.0):
        side, x, z = draw.uniform(0.26, 0.38), draw.uniform(0.1, 0.5), draw.uniform(0.0, 0.2)
        turn = draw.uniform(0, 2 * math.pi)
        body = _block(sand, x, z, side, side, speed * math.cos(turn), speed * math.sin(turn))
        yield {"value": f"{speed:g} m/s", "scene": sand.scene("x", [body], _room(sand))}


def _tilt(sand: Sand, draw: np.random.Generator) -> Made:
    for tilt in (-30, -20, -10, -5, 5, 10, 15, 20, 25, 30):
        scene = sand.column("x", draw.uniform(0.25, 0.35), draw.uniform(0.8, 2.0), tilt=float(tilt))
        yield {"value": f"{tilt:g} deg", "scene": scene}


def _friction(sand: Sand, draw: np.random.Generator) -> Made:
    for angle in (15, 20, 25, 28, 32, 35, 40, 45):
        scene = sand.column("x", draw.uniform(0.25, 0.35), draw.uniform(0.8, 2.0), angle=float(angle))
        yield {"value": f"{angle:g} deg", "scene": scene}


def _collision(sand: Sand, draw: np.random.Generator) -> Made:
    for number in range(10):
        speed, flying = 0.5 + 0.5 * (number // 2), number % 2 == 1
        side, gap, z = draw.uniform(0.2, 0.26), draw.uniform(0.06, 0.12), draw.uniform(0.3, 0.5) if flying else 0.0
        left = sand.body(0.35, z, side, side, speed, 0.0)
        right = sand.body(0.35 + side + gap, z + (draw.uniform(0, 0.05) if flying else 0.0), side, side, -speed, 0.0)
        value = f"{speed:g} m/s, {'in the air' if flying else 'on the floor'}"
        yield {"value": value, "scene": sand.scene("x", [left, right], sand.box(1.5, 1.0))}


def _corner(sand: Sand, draw: np.random.Generator) -> Made:
    for gap in (0.05, 0.1, 0.2, 0.4):
        length = draw.uniform(0.25, 0.35)
        body = sand.body(0.0, 0.0, length, length * draw.uniform(1, 2))
        scene = sand.scene("x", [body], sand.box(length + gap, 1.1))
        yield {"value": f"wall {gap:g} m ahead", "scene": scene}
    for speed in (1.0, 1.4, 2.0, 2.8):
        side = draw.uniform(0.25, 0.35)
        across = [(0.02, side, -speed / 2)] * (sand.dim - 2)
        body = _cuboid((0.03, side, -speed / 2), *across, (0.03, side, -speed / 2))
        yield {"value": f"thrown into it at {speed:g} m/s", "scene": sand.scene("x", [body], _room(sand))}


def _heap(sand: Sand, draw: np.random.Generator) -> Made:
    seconds = HEAP_STEPS * sand.interval
    for height in (0.1, 0.25):
        box = sand.box(1.5, 0.7)
        scene = sand.scene("x", [sand.body(0.0, 0.0, 1.5, height)], box).replace(duration=seconds)
        yield {"value": f"bed, {height:g} m", "scene": scene}
    for ratio in RATIOS:
        length = draw.uniform(0.3, 0.42) if ratio < 2 else draw.uniform(0.22, 0.26)
        scene = sand.column("x", length, ratio)
        settled = 1.5 * scene.duration
        scene = scene.replace(duration=seconds)
        yield {"value": f"deposit of a = {ratio:g}", "scene": scene, "settled": settled}


def _start(sand: Sand, draw: np.random.Generator) -> Made:
    changes = ({"jitter": 0.0}, {"jitter": 0.5}, {"jitter": 0.99}, {"shake": 0.1}, {"shake": 0.3}, {"shake": 1.0})
    for change in (*changes, {"displaced": 0.1}, {"displaced": 0.25}):
        (what, amount), *_ = change.items()
        yield {"value": f"{what} {amount:g}", "scene": sand.column("x", 0.35, draw.uniform(0.8, 2.0)), **change}


_MAKERS = {
    "horizon": _horizon, "aspect_ratio": _aspect, "size": _size, "count": _count, "spacing": _spacing, "speed": _speed,
    "tilt": _tilt, "friction": _friction, "collision": _collision, "corner": _corner, "heap": _heap, "start": _start,
}  # fmt: skip

AXES = tuple(_MAKERS)
"""Names of the axes, in their order."""
