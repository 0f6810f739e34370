"""Coarse MPM whose friction, cohesion and damping were fitted to fine MPM, as solvers of their own (docs/retuned.md).

Coarse cells err in a way that a slightly different material makes up for. What that material is depends on the cells
over the bodies' size, so that a fit holds for one such number; `inverse.retuning` finds it.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import yaml

from gns_pl.errors import InputError
from gns_pl.io.atomic import write_atomically
from gns_pl.models.shipped import find_retuned
from gns_pl.mpm.settings import solver_config
from gns_pl.scene import Scene, Wall, part_from_dict
from gns_pl.scene.boundaries import Obstacle
from gns_pl.scene.checks import checked_number
from gns_pl.scene.definition import Material
from gns_pl.scene.extent import initial_extent
from gns_pl.solvers.mpm import MPMSolver
from gns_pl.solvers.reduction import Reduction
from gns_pl.solvers.solver import characteristic_size, hashed

KEYS = ("cells", "mpm", "factors", "range", "fitted")
"""What the file of a retuned solver holds."""

SPANS = {
    "size": ("√(L0 H0)", " m"),
    "aspect_ratio": ("aspect ratios", ""),
    "bodies": ("numbers of bodies", ""),
    "obstacles": ("numbers of obstacles", ""),
    "slope_deg": ("slopes", "°"),
    "speed": ("initial speeds", " m/s"),
    "drop": ("drops", " m"),
    "gravity": ("gravity", " m/s²"),
}
"""Number that describes a scene → what it is called, and its unit."""


@dataclass(frozen=True)
class Factors:
    """By what coarse MPM changes a scene and its own damping.

    Attributes:
        wall_friction: on the coefficients of Coulomb friction of all walls and obstacles.
        internal_friction: on tan φ of all materials; the dilation angle stays, but never above φ.
        cohesion: on the cohesion of all materials.
        damping_rate: on the solver's damping rate.

    Raises:
        InputError: a factor that is not positive.
    """

    wall_friction: float = 1.0
    internal_friction: float = 1.0
    cohesion: float = 1.0
    damping_rate: float = 1.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            object.__setattr__(self, name, checked_number("factors", name, value, 0.0, above=True))

    def material(self, material: Material) -> Material:
        """Return a material as coarse MPM takes it."""
        angle = math.degrees(math.atan(self.internal_friction * material.tan_friction_angle))
        return replace(
            material,
            friction_angle_deg=angle,
            dilation_angle_deg=min(material.dilation_angle_deg, angle),
            cohesion=self.cohesion * material.cohesion,
        )

    def wall(self, wall: Wall) -> Wall:
        """Return a wall likewise."""
        return replace(wall, friction=self.wall_friction * wall.friction)

    def obstacle(self, obstacle: Obstacle) -> Obstacle:
        """Return an obstacle likewise."""
        return replace(obstacle, wall=self.wall(obstacle.wall))

    def scene(self, scene: Scene) -> Scene:
        """Return a scene likewise."""
        return scene.replace(
            materials={name: self.material(each) for name, each in scene.materials.items()},
            walls={face: self.wall(each) for face, each in scene.walls.items()},
            obstacles=tuple(map(self.obstacle, scene.obstacles)),
        )

    def settings(self, mpm: Mapping[str, Any]) -> dict[str, Any]:
        """Return the method's settings likewise."""
        return {**mpm, "damping_rate": self.damping_rate * mpm["damping_rate"]}


@dataclass(frozen=True)
class RetunedMPMSolver(MPMSolver):
    """The material point method with fitted factors; all that MPM runs it runs, slices and halves among it.

    Attributes:
        factors: that were fitted, for these cells over √(L0 H0).
        fitted_range: of the scenes that they were fitted to (`range_of`).
        path: of the file it was read from.
    """

    factors: Factors = field(default_factory=Factors)
    fitted_range: Mapping[str, Any] = field(default_factory=dict)
    path: Path | None = None
    group: str = field(default="retuned", init=False)

    def identity(self) -> str:
        """Return a hash of all that decides what a run gives."""
        return hashed([super().identity(), vars(self.factors)])

    def facts(self, scene: Scene) -> dict[str, object]:
        """Return name, version, settings and factors."""
        return {**super().facts(scene), "factors": dict(vars(self.factors))}

    def reduced(self, scene: Scene) -> Reduction:
        """Return the scene's slice or half with the material and walls that are run; what is lifted has its own."""
        reduction = super().reduced(scene)

        def lift(trajectory: Any) -> Any:
            return replace(reduction.lift(replace(trajectory, scene=reduction.scene)), scene=scene)

        return replace(reduction, scene=self.factors.scene(reduction.scene), lift=lift)

    def settings_of(self, scene: Scene) -> dict[str, Any]:
        """Return the method's settings for a scene."""
        return self.factors.settings(super().settings_of(scene))

    def out_of_range_reason(self, scene: Scene) -> str | None:
        """Return what of a scene is outside the range of the scenes it was fitted to, or None."""
        return "; ".join(beyond(scene, self.fitted_range)) or None

    def file(self) -> Path | None:
        """Return the file it was read from."""
        return self.path


def read_retuned(path: str | Path) -> RetunedMPMSolver:
    """Return the solver of a file, by the file's name.

    Args:
        path: the file, or the name of one that comes with the package, as "mpm-retuned-5".

    Raises:
        InputError: no such file, or it holds something else.
    """
    path = find_retuned(path)
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}).") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: is not YAML; python fit.py writes such files.") from error
    if not isinstance(content, Mapping) or not set(KEYS) <= set(content):
        raise InputError(f"{path}: is no retuned solver, which has {', '.join(KEYS)}; python fit.py writes such files.")
    try:
        cells = checked_number("retuned MPM", "cells", content["cells"], 0.0, above=True)
        solver_config({**content["mpm"], "cell_size": 1.0})
        factors = part_from_dict(Factors, "factors", content["factors"])
    except (InputError, TypeError) as error:
        raise InputError(f"{path}: {error}") from error
    solver = RetunedMPMSolver(path.stem, cells, content["mpm"], factors=factors, path=path)
    return replace(solver, fitted_range=content["range"])


def write_retuned(path: Path, solver: RetunedMPMSolver, fitted: Mapping[str, Any]) -> None:
    """Write a solver's file.

    Args:
        path: whose stem is the solver's name.
        solver: that was fitted.
        fitted: how: the provenance, as plain values.

    Raises:
        StorageError: the disk refuses.
    """
    content = {
        "cells": solver.cells,
        "mpm": dict(solver.settings),
        "factors": dict(vars(solver.factors)),
        "range": dict(solver.fitted_range),
        "fitted": dict(fitted),
    }
    write_atomically(
        path, yaml.safe_dump(content, sort_keys=False, default_flow_style=None, allow_unicode=True, width=120).encode()
    )


def range_of(scenes: Sequence[Scene]) -> dict[str, Any]:
    """Return what scenes span, as plain values: smallest and largest of `SPANS`, and all materials and walls."""
    numbers = [_numbers(scene) for scene in scenes]
    materials = {material for scene in scenes for material in _materials(scene)}
    walls = {description for scene in scenes for description in _walls(scene)}
    return {
        **{key: [float(f"{pick(each[key] for each in numbers):.6g}") for pick in (min, max)] for key in SPANS},
        "materials": [dataclasses.asdict(material) for material in sorted(materials, key=str)],
        "walls": sorted(walls),
    }


def beyond(scene: Scene, span: Mapping[str, Any]) -> Iterator[str]:
    """Yield what of a scene is outside a range of `range_of`, in words; an empty range refuses nothing."""
    for key, value in _numbers(scene).items():
        low, high = span.get(key, (-math.inf, math.inf))
        if not low - 0.01 * abs(low) - 1e-9 <= value <= high + 0.01 * abs(high) + 1e-9:
            name, unit = SPANS[key]
            yield f"fitted to {name} of {low:.3g} to {high:.3g}{unit}, here {value:.3g}"
    if "materials" in span and not {tuple(vars(each).items()) for each in _materials(scene)} <= {
        tuple(each.items()) for each in span["materials"]
    }:
        yield "fitted to another material"
    unknown = _walls(scene) - set(span.get("walls", _walls(scene)))
    if unknown:
        yield f"fitted with other walls ({' or '.join(span['walls'])}, here {' and '.join(sorted(unknown))})"


def _materials(scene: Scene) -> set[Material]:
    return {scene.materials[body.material] for body in scene.bodies}


def _walls(scene: Scene) -> set[str]:
    """Return the walls that material may reach, in words; nothing rises to the lid."""
    walls = [wall for face, wall in scene.walls.items() if face != "z+"]
    return {wall.description for wall in (*walls, *(obstacle.wall for obstacle in scene.obstacles))}


def _numbers(scene: Scene) -> dict[str, float]:
    length, height = initial_extent(scene)
    return {
        "size": characteristic_size(scene),
        "aspect_ratio": height / length,
        "bodies": len(scene.bodies),
        "obstacles": len(scene.obstacles),
        "slope_deg": math.degrees(math.atan2(math.hypot(*scene.gravity[:-1]), -scene.gravity[-1])),
        "speed": max(math.hypot(*body.velocity) for body in scene.bodies),
        "drop": max(body.position[-1] for body in scene.bodies) - scene.lower[-1],
        "gravity": math.hypot(*scene.gravity),
    }
