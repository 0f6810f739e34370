"""Layers on prescribed beds, and scenes, that the depth-averaged solver's tests share."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gns_pl.scene import FACES, Body, Material, Scene, Wall
from gns_pl.shallow.plan import Grid, Ground
from gns_pl.shallow.solver import Layer

Floats = NDArray[np.float64]
Field = Callable[[Floats, Floats], Any]

GRAVITY = 9.81


def zero(x: Floats, y: Floats) -> Floats:
    return np.zeros_like(x)


def make_layer(
    counts: tuple[int, int],
    lengths: tuple[float, float],
    thickness: Field,
    *,
    bed: Field = zero,
    velocity: Field = zero,
    friction: float = 0.0,
    gravity: float = GRAVITY,
    samples: int = 1,
) -> Layer:
    """A layer on a box with its lower corner at the origin; `thickness` is averaged over `samples`² points a cell."""
    sizes = (lengths[0] / counts[0], lengths[1] / counts[1])
    grid = Grid((np.linspace(0, lengths[0], counts[0] + 1), np.linspace(0, lengths[1], counts[1] + 1)))
    x, y = grid.centres
    offsets = (np.arange(samples) + 0.5) / samples - 0.5
    h = sum(thickness(x + a * sizes[0], y + b * sizes[1]) for a in offsets for b in offsets) / samples**2
    height = bed(x, y)
    ground = Ground(height, height, np.full(len(x), gravity), np.full(len(x), friction))
    return Layer(grid, ground, h, np.stack([h * velocity(x, y), np.zeros(len(x))]))


def volume(layer: Layer) -> float:
    return float((layer.thickness + layer.falling).sum() * layer.grid.sizes[0] * layer.grid.sizes[1])


def make_sand(**changes: Any) -> Material:
    values: dict[str, Any] = {"density": 1800.0, "youngs_modulus": 2e6, "poisson_ratio": 0.3}
    return Material(**(values | {"friction_angle_deg": 30.0} | changes))


def make_scene(
    domain: tuple[float, ...], *bodies: Body, floor: Wall | None = None, walls: Wall | None = None, **changes: Any
) -> Scene:
    """A box at the origin with a floor of tan δ = 0.385 and slip walls unless said."""
    dim = len(domain)
    values: dict[str, Any] = {
        "name": "box",
        "lower": (0.0,) * dim,
        "upper": domain,
        "gravity": (0.0,) * (dim - 1) + (-GRAVITY,),
        "duration": 1.0,
        "materials": {"sand": make_sand()},
        "bodies": bodies,
        "walls": dict.fromkeys(FACES[dim], walls or Wall("slip")) | {"z-": floor or Wall("friction", 0.385)},
    }
    return Scene(**(values | changes))


def make_column(dim: int, length: float = 0.475, height: float = 0.38, width: float = 0.5, **changes: Any) -> Scene:
    """A column against the x- wall from side to side, the paper's a = 0.8 unless said."""
    across = () if dim == 2 else (width,)
    body = Body((0.0,) * dim, (length, *across, height), (0.0,) * dim)
    return make_scene((1.5, *across, 0.7), body, **({"duration": 1.2} | changes))
