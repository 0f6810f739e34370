"""A scene of another size run at the size of what was learned: Froude similarity.

With lengths over s, times and velocities over √s and stresses over s, a scene under the same gravity obeys the same
equations as before: the balance of momentum, and friction by Coulomb's law, in which only ratios of stresses stand
(Iverson 2015, Geomorphology 244, 9). So a slide of many metres and a heap of centimetres are run by a simulator that
learned in a box of one metre, which has particles of one spacing alone. What has a size of its own (grains, rates,
pore water) is in none of the solvers.

s is a power of two, by which single precision multiplies and divides exactly: a run that is gone on with from its file
is the same to the bit.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gns_pl.scene import Body, Plane, Raster, Release, Scene, Terrain
from gns_pl.scene.boundaries import Obstacle
from gns_pl.trajectory import Trajectory

BEYOND = 3.0
"""A scene is run at another size where its own is so many times beyond the sizes learned from. Nearer ones are run as
they are: they are as finely resolved as the data, or finer."""

TIMES = ("at_rest_from", "failed_at", "handed_over_at")
"""What a provenance says in seconds of the run."""


@dataclass(frozen=True)
class Similarity:
    """By how much a scene is larger than the one that is run in its place.

    Attributes:
        length: s, a power of two; 1 where the scene itself is run.
    """

    length: float = 1.0

    @classmethod
    def of(cls, size: float, learned: tuple[float, float] | None) -> Similarity:
        """Return what brings a scene near the largest size that was learned from, where its own is far beyond all.

        The cells of the material point method that taught resolve the largest scenes best.

        Args:
            size: of the scene (`solver.characteristic_size`) [m].
            learned: the least and the largest of the data [m]; None where these do not say.
        """
        if learned is None or learned[0] / BEYOND <= size <= BEYOND * learned[1]:
            return cls()
        return cls(2.0 ** round(math.log2(size / learned[1])))

    @property
    def time(self) -> float:
        """√s, by which times and velocities are larger."""
        return math.sqrt(self.length)

    @property
    def description(self) -> str:
        """What is done, in words; empty where nothing is."""
        return "" if self.length == 1 else f"run at {self._size} (Froude similarity: times over {self.time:.3g})"

    @property
    def _size(self) -> str:
        return f"1/{self.length:g} of its size" if self.length > 1 else f"{1 / self.length:g} times its size"

    def model(self, scene: Scene) -> Scene:
        """Return the scene that is run."""
        return scene if self.length == 1 else resized(scene, 1 / self.length)

    def lift(self, run: Trajectory, scene: Scene) -> Trajectory:
        """Return a run of `model(scene)` as one of the scene."""
        if self.length == 1:
            return run
        return replace(
            run,
            position=run.position * np.float32(self.length),
            mass=run.mass * np.float32(self.length**scene.dim),
            initial_velocity=run.initial_velocity * np.float32(self.time),
            dt=run.dt * self.time,
            scene=scene,
            provenance=self.ending(run.provenance),
            observables=None,
        )

    def lower(self, run: Trajectory) -> Trajectory:
        """Return a run of a scene as one of `model(scene)`: the inverse of `lift`."""
        return Similarity(1 / self.length).lift(run, self.model(run.scene))

    def ending(self, provenance: Mapping[str, object]) -> dict[str, object]:
        """Return a provenance with the times of the run as those of the scene, and what was done named."""
        told = dict(provenance)
        if self.length == 1:
            return told
        for name in TIMES:
            if isinstance(time := told.get(name), float):
                told[name] = time * self.time
        if "failure" in told:
            told["failure"] = self.told(str(told["failure"]))
        return told | {"length_scale": self.length}

    def told(self, text: str) -> str:
        """Return a text about the run, with a word that its numbers are not those of the scene."""
        return text if self.length == 1 else f"{text} at {self._size}"


def resized(scene: Scene, factor: float) -> Scene:
    """Return the similar scene whose lengths are so many times as large, near zero wherever it lies on a map.

    Lengths, elastic moduli, cohesion and tension go by the factor, times and velocities by its root; angles,
    coefficients of friction, density and gravity stay.
    """

    def place(values: tuple[float, ...]) -> tuple[float, ...]:
        return tuple(factor * value for value in values)

    def obstacle(each: Obstacle) -> Obstacle:
        if isinstance(each, Plane):
            return replace(each, point=place(each.point))
        return replace(each, position=place(each.position), size=place(each.size))

    def body(each: Body) -> Body:
        changes: dict[str, Any] = {name: place(getattr(each, name)) for name in ("position", "size")}
        changes["velocity"] = tuple(math.sqrt(factor) * component for component in each.velocity)
        if isinstance(each, Release):
            changes["outline"] = tuple(tuple(place(corner) for corner in ring) for ring in each.outline)
            layer = each.thickness
            changes["thickness"] = _raster(layer, factor) if isinstance(layer, Raster) else factor * layer
        return replace(each, **changes)

    ground = scene.terrain
    return scene.replace(
        lower=place(scene.lower),
        upper=place(scene.upper),
        origin=(),
        duration=math.sqrt(factor) * scene.duration,
        materials={
            name: replace(
                each,
                youngs_modulus=factor * each.youngs_modulus,
                cohesion=factor * each.cohesion,
                tension_cutoff=factor * each.tension_cutoff,
            )
            for name, each in scene.materials.items()
        },
        bodies=tuple(map(body, scene.bodies)),
        obstacles=tuple(map(obstacle, scene.obstacles)),
        terrain=None if ground is None else Terrain.of(_raster(ground.raster, factor), ground.wall),
    )


def _raster(raster: Raster, factor: float) -> Raster:
    """Return a raster of lengths, so many times as large."""
    corner = tuple(factor * value for value in raster.corner)
    return replace(raster, values=factor * raster.values, corner=corner, cell=factor * raster.cell, crs="")
