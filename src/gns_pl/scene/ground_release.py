"""Blocks released on ground of random shape and friction: inclines that run out, hills, steps and barriers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gns_pl.errors import InputError
from gns_pl.scene.boundaries import Box, Obstacle, Wall
from gns_pl.scene.catalogue import checked_range
from gns_pl.scene.checks import checked_number, checked_numbers
from gns_pl.scene.definition import Body, Material, Scene
from gns_pl.scene.release import make_release
from gns_pl.scene.terrain import Terrain

CELL = 0.025
"""Distance of the heights [m]."""

HILLS = (0.1, 0.25)
"""Shortest and longest standard deviation of round hills [m]."""

CURVE = (0.03, 0.12)
"""Sharpest and widest curve at the foot of an incline where a family names none [m]."""

BASE = 0.02
"""Height of the lowest ground over the lower face of the box [m]."""


def sample_ground_release(
    generator: np.random.Generator,
    *,
    domain: Sequence[float],
    length: Sequence[float],
    height: Sequence[float],
    duration: float,
    incline_deg: Sequence[float],
    friction: Sequence[float],
    gravity: float,
    material: Material,
    walls: Mapping[str, Wall],
    hill: float = 0.0,
    step: float = 0.0,
    barrier: float = 0.0,
    curve: Sequence[float] = CURVE,
    layer: float = 0.0,
    far_incline_deg: Sequence[float] = (0.0, 0.0),
    name: str = "ground_release",
) -> Scene:
    """Draw a block at the upper end of an incline that runs out on level ground, with its top level.

    The ground falls along x, turned by up to 45°, in the half of the box in which the block stands, and is curved where
    it runs out. Side walls slip, or are as rough as the ground is; one draw holds for all of them.

    Args:
        generator: source of randomness.
        domain: edge lengths of the box [3] [m].
        length: smallest and largest horizontal edge of the block [m].
        height: smallest and largest height of the block over the highest ground below it [m].
        duration: simulated time [s].
        incline_deg: flattest and steepest incline [degrees].
        friction: smallest and largest coefficient of the ground.
        gravity: magnitude [m/s²].
        material: of the block.
        walls: face → wall; those of the faces at the sides are drawn anew.
        hill: largest height or depth of the three round hills or hollows that are added [m].
        step: probability of a step below the block in the place of an incline, a twentieth to a fifth of a metre high.
        barrier: probability of a cuboid in the way, up to two tenths of a metre high.
        curve: sharpest and widest curve at the foot of an incline [m].
        layer: probability of a release as thick everywhere as the block's height, its top as sloped as the ground.
        far_incline_deg: flattest and steepest incline up which the far quarter of the box rises again [degrees].
        name: name of the scene.

    Raises:
        InputError: ranges that do not fit the domain.
    """
    owner = "ground releases"
    domain = checked_numbers(owner, "domain", domain, 3)
    low, high = checked_range(owner, "length", length)
    inclines = checked_numbers(owner, "incline_deg", incline_deg, 2)
    curves = checked_range(owner, "curve", curve)
    far = checked_numbers(owner, "far_incline_deg", far_incline_deg, 2)
    hill = checked_number(owner, "hill", hill, 0.0)
    if high >= min(domain[:2]) or not all(0 <= flat <= steep < 60 for flat, steep in (inclines, far)):
        raise InputError(
            f"{owner}: lengths must fit the domain {list(domain)} m, and inclines lie between 0 and 60°, the flatter "
            f"first, not {[low, high]} m, {list(inclines)}° and {list(far)}°."
        )
    edges = generator.uniform(low, high, 2)
    rise = generator.uniform(*checked_range(owner, "height", height))
    coefficient = generator.uniform(*checked_range(owner, "friction", friction))
    ground = Wall("friction", round(coefficient, 3))
    sides = ground if generator.uniform() < 0.5 else Wall("slip")
    stepped, barred = generator.uniform() < step, generator.uniform() < barrier
    incline = 0.0 if stepped else np.tan(np.radians(generator.uniform(inclines[0], inclines[1])))
    turn = np.radians(generator.uniform(-45, 45)) * (generator.uniform() < 0.5)
    width = generator.uniform(*curves)
    across = generator.choice([0.0, 0.5, 1.0]) if generator.uniform() < 0.6 else generator.uniform()
    place = np.array([generator.uniform(0, 0.15) * (generator.uniform() < 0.5), across * (domain[1] - edges[1])])
    foot = max(0.5 * domain[0], place[0] + edges[0] + 0.1)
    hills = [
        (generator.uniform(0, domain[:2]), generator.uniform(*HILLS), generator.uniform(-hill, hill)) for _ in "123"
    ]

    rest = generator.spawn(1)[0]  # so that these change nothing of what else is drawn
    layered, far_rise = rest.uniform() < layer, np.tan(np.radians(rest.uniform(far[0], far[1])))

    def shape(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        along = (foot - x) * np.cos(turn) + (0.5 * domain[1] - y) * np.sin(turn)
        beyond = x - 0.75 * domain[0]
        heights: NDArray[np.float64] = incline * width * np.logaddexp(0, along / width)
        heights = heights + far_rise * width * np.logaddexp(0, beyond / width)
        for (at_x, at_y), reach, size in hills:
            heights = heights + size * np.exp(-((x - at_x) ** 2 + (y - at_y) ** 2) / (2 * reach**2))
        return heights

    numbers = [int(np.ceil(extent / CELL)) + 1 for extent in domain[:2]]
    heights = shape(*np.meshgrid(*(CELL * np.arange(number) for number in numbers), indexing="ij"))
    heights += BASE - heights.min()
    terrain = Terrain(heights, (0.0, 0.0), CELL, ground)
    below = terrain.height(place + edges * (np.indices((9, 9)).reshape(2, -1).T / 8))
    bottom, obstacles = float(below.min()), []
    raised = generator.uniform(0.05, 0.2) if stepped else 0.0
    if stepped:  # a cuboid from wall to wall, on whose edge the block stands or nearly so
        edge = place[0] + edges[0] + generator.uniform(0.0, 0.2)
        obstacles.append(Box((0.0, 0.0, 0.0), (edge, domain[1], float(below.max()) + raised), ground))
        bottom = float(below.max()) + raised
    if barred:
        size = np.array([generator.uniform(0.08, 0.2), generator.uniform(0.25, 0.6) * domain[1]])
        begin = place[0] + edges[0] + generator.uniform(0.1, 0.3)
        side = generator.choice([0.0, 1.0]) if generator.uniform() < 0.5 else generator.uniform()
        at = np.array([min(begin, domain[0] - size[0] - 0.05), side * (domain[1] - size[1])])
        top = float(terrain.height(at + size * (np.indices((5, 5)).reshape(2, -1).T / 4)).max())
        top += generator.uniform(0.06, 0.2)
        obstacles.append(Box((*at, 0.0), (*size, top), ground))
    highest = float(below.max()) + raised + rise
    if highest > domain[2]:
        raise InputError(f"{owner}: the block reaches up to {highest:.3g} m, above the domain {list(domain)} m.")
    body = Body((*place, bottom), (*edges, highest - bottom), (0.0, 0.0, 0.0))
    if layered and not stepped:
        corners = [place + edges * corner for corner in ((0, 0), (1, 0), (1, 1), (0, 1))]
        body = make_release(terrain, thickness=rise, outline=[[corner.tolist() for corner in corners]])
    return Scene(
        name=name,
        lower=(0.0, 0.0, 0.0),
        upper=domain,
        gravity=(0.0, 0.0, -gravity),
        duration=duration,
        materials={"sand": material},
        bodies=(body,),
        walls={**walls, **dict.fromkeys(("x-", "x+", "y-", "y+"), sides)},
        obstacles=tuple[Obstacle, ...](obstacles),
        terrain=terrain,
    )


def ground_limits(family: Mapping[str, Any]) -> tuple[float, float]:
    """Return the steepest ground of a family of such scenes [degrees], and its largest change of slope [1/m].

    Args:
        family: keywords of `sample_ground_release`.
    """
    inclines = [family["incline_deg"][1], family.get("far_incline_deg", (0.0, 0.0))[1]]
    incline, hill = math.tan(math.radians(max(inclines))), family.get("hill", 0.0)
    steepest = incline + hill * math.exp(-0.5) / HILLS[0]
    return math.degrees(math.atan(steepest)), incline / (4 * family.get("curve", CURVE)[0]) + hill / HILLS[0] ** 2
