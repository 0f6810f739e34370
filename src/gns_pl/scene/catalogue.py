"""The standard scenes and their random families; the numbers come from the caller (conf/), the geometry is here."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from gns_pl.errors import InputError
from gns_pl.scene.boundaries import Wall
from gns_pl.scene.checks import checked_number, checked_numbers
from gns_pl.scene.definition import Body, Material, Scene


def cube_drop(
    *,
    domain: Sequence[float],
    side: float,
    position: Sequence[float],
    velocity: Sequence[float],
    gravity: float,
    duration: float,
    material: Material,
    walls: Mapping[str, Wall],
    name: str = "cube_drop",
) -> Scene:
    """Return a box with its corner at the origin in which one cube (square if D = 2) starts with a velocity.

    Args:
        domain: edge lengths of the box [D] [m].
        side: edge of the cube [m].
        position: lower corner of the cube [D] [m].
        velocity: initial velocity of the cube [D] [m/s].
        gravity: magnitude [m/s²], acting along the last axis.
        duration: simulated time [s].
        material: what the cube is made of.
        walls: face → wall, every face.
        name: name of the scene.
    """
    dim = len(domain)
    body = Body(tuple(position), (side,) * dim, tuple(velocity))
    return _box(name, domain, gravity, duration, material, walls, body)


def column_collapse(
    *,
    domain: Sequence[float],
    length: float,
    height: float,
    gravity: float,
    duration: float,
    material: Material,
    walls: Mapping[str, Wall],
    name: str = "column_collapse",
) -> Scene:
    """Return a column at rest against the x = 0 wall that spans the whole width (Lube et al. 2005, plane channel).

    Args:
        domain: edge lengths of the box [D] [m].
        length: L0 along x [m].
        height: H0 [m]; the aspect ratio is `height / length`.
        gravity: magnitude [m/s²], acting along the last axis.
        duration: simulated time [s].
        material: what the column is made of.
        walls: face → wall, every face.
        name: name of the scene.
    """
    dim = len(domain)
    size = (length, *tuple(domain)[1:-1], height)
    return _box(name, domain, gravity, duration, material, walls, Body((0.0,) * dim, size, (0.0,) * dim))


def block_release(
    *,
    domain: Sequence[float],
    size: Sequence[float],
    position: Sequence[float],
    gravity: float,
    duration: float,
    material: Material,
    walls: Mapping[str, Wall],
    name: str = "block_release",
) -> Scene:
    """Return a cuboid that stands on the floor at rest and is let go: what a drop never shows, a start from rest.

    Args:
        domain: edge lengths of the box [D] [m].
        size: edge lengths of the block [D] [m].
        position: its lower corner on the floor, without the last axis [D − 1] [m].
        gravity: magnitude [m/s²], acting along the last axis.
        duration: simulated time [s].
        material: what the block is made of.
        walls: face → wall, every face.
        name: name of the scene.
    """
    dim = len(domain)
    body = Body((*tuple(position), 0.0), tuple(size), (0.0,) * dim)
    return _box(name, domain, gravity, duration, material, walls, body)


def sample_cube_drop(
    generator: np.random.Generator,
    *,
    domain: Sequence[float],
    side: Sequence[float],
    speed: float,
    max_drop: float,
    **rest: object,
) -> Scene:
    """Draw a `cube_drop`: side, position and velocity uniform in their ranges.

    Args:
        generator: source of randomness.
        domain: edge lengths of the box [D] [m].
        side: smallest and largest edge of the cube [m].
        speed: each component of the velocity lies in ± `speed` [m/s].
        max_drop: greatest height of the cube's lower face over the floor [m]. A cube that hits too fast spreads into
            a layer thinner than a grid cell, which no grid method resolves.
        **rest: what `cube_drop` needs besides.

    Raises:
        InputError: ranges that do not fit the domain.
    """
    low, high = checked_range("cube drops", "side", side)
    domain = checked_numbers("cube drops", "domain", domain)
    speed = checked_number("cube drops", "speed", speed, 0.0)
    max_drop = checked_number("cube drops", "max_drop", max_drop, 0.0)
    if high >= min(domain):
        raise InputError(f"cube drops: a side of {high:g} m does not fit a domain of {list(domain)} m.")
    edge = generator.uniform(low, high)
    room = np.array(domain) - edge
    room[-1] = min(room[-1], max_drop)
    return cube_drop(
        domain=domain,
        side=edge,
        position=tuple(generator.uniform(0, room)),
        velocity=tuple(generator.uniform(-speed, speed, len(domain))),
        **rest,  # type: ignore[arg-type]
    )


def sample_block_release(
    generator: np.random.Generator,
    *,
    domain: Sequence[float],
    length: Sequence[float],
    aspect_ratio: Sequence[float],
    at_wall: float,
    **rest: object,
) -> Scene:
    """Draw a `block_release`: horizontal edges, height over the x edge, and place uniform in their ranges.

    Args:
        generator: source of randomness.
        domain: edge lengths of the box [D] [m].
        length: smallest and largest horizontal edge [m].
        aspect_ratio: smallest and largest height over x edge; heights are cut to the box.
        at_wall: probability that the block touches a random wall, per horizontal axis.
        **rest: what `block_release` needs besides.

    Raises:
        InputError: ranges that do not fit the domain.
    """
    low, high = checked_range("block releases", "length", length)
    low_ratio, high_ratio = checked_range("block releases", "aspect_ratio", aspect_ratio)
    domain = checked_numbers("block releases", "domain", domain)
    if not 0 <= checked_number("block releases", "at_wall", at_wall) <= 1:
        raise InputError(f"block releases: at_wall is a probability between 0 and 1, not {at_wall}.")
    horizontal = np.array(domain[:-1])
    if high >= horizontal.min():
        raise InputError(f"block releases: a length of {high:g} m does not fit a domain of {list(domain)} m.")
    edges = generator.uniform(low, high, len(horizontal))
    height = min(edges[0] * generator.uniform(low_ratio, high_ratio), 0.9 * domain[-1])
    place = generator.uniform(0, 1, len(horizontal))
    place = np.where(generator.uniform(0, 1, len(horizontal)) < at_wall, np.round(place), place)
    return block_release(
        domain=domain,
        size=(*edges, height),
        position=tuple(place * (horizontal - edges)),
        **rest,  # type: ignore[arg-type]
    )


def sample_pair_release(
    generator: np.random.Generator,
    *,
    domain: Sequence[float],
    length: Sequence[float],
    aspect_ratio: Sequence[float],
    at_wall: float,
    speed: float,
    gravity: float,
    duration: float,
    material: Material,
    walls: Mapping[str, Wall],
    name: str = "pair_release",
) -> Scene:
    """Draw two blocks on the floor that run into each other, each in its half of the box along x.

    Args:
        generator: source of randomness.
        domain: edge lengths of the box [D] [m].
        length: smallest and largest horizontal edge of either [m].
        aspect_ratio: smallest and largest height over x edge; heights are cut to the box.
        at_wall: probability that a block touches the wall behind it, and a random one of the other axis.
        speed: each begins with up to so much towards the other [m/s].
        gravity: magnitude [m/s²].
        duration: simulated time [s].
        material: what both are made of.
        walls: face → wall, every face.
        name: name of the scene.

    Raises:
        InputError: ranges that do not fit the domain.
    """
    speed = checked_number("pair releases", "speed", speed, 0.0)
    domain = checked_numbers("pair releases", "domain", domain)
    half, bodies = (0.5 * domain[0], *domain[1:]), []
    for side in (0, 1):
        drawn = sample_block_release(
            generator,
            domain=half,
            length=length,
            aspect_ratio=aspect_ratio,
            at_wall=at_wall,
            gravity=gravity,
            duration=duration,
            material=material,
            walls=walls,
        )
        [block] = drawn.bodies
        # A block at a wall of its half along x may stand in the middle of the box; the one behind it is meant.
        room = half[0] - block.size[0]
        place = side * room if block.position[0] in (0.0, room) else block.position[0]
        towards = generator.uniform(0, speed) * (1 - 2 * side)
        position = (side * half[0] + place, *block.position[1:])
        bodies.append(Body(position, block.size, (towards, *(0.0,) * (len(domain) - 1))))
    return _box(name, domain, gravity, duration, material, walls, *bodies)


def sample_column_collapse(
    generator: np.random.Generator,
    *,
    domain: Sequence[float],
    length: Sequence[float],
    aspect_ratio: Sequence[float],
    duration_tau: float,
    gravity: float,
    **rest: object,
) -> Scene:
    """Draw a `column_collapse`: length and height over length uniform in their ranges.

    Args:
        generator: source of randomness.
        domain: edge lengths of the box [D] [m].
        length: smallest and largest L0 [m].
        aspect_ratio: smallest and largest H0 / L0.
        duration_tau: simulated time, in units of √(H0/g).
        gravity: magnitude [m/s²].
        **rest: what `column_collapse` needs besides.

    Raises:
        InputError: ranges whose largest column does not fit the domain; cutting it would change its aspect ratio.
    """
    low, high = checked_range("column collapses", "length", length)
    low_ratio, high_ratio = checked_range("column collapses", "aspect_ratio", aspect_ratio)
    domain = checked_numbers("column collapses", "domain", domain)
    duration_tau = checked_number("column collapses", "duration_tau", duration_tau, 0.0, above=True)
    if high >= domain[0] or high * high_ratio > domain[-1]:
        raise InputError(
            f"column collapses: a length of {high:g} m with an aspect ratio of {high_ratio:g} does not fit a domain of "
            f"{list(domain)} m."
        )
    drawn = generator.uniform(low, high)
    height = drawn * generator.uniform(low_ratio, high_ratio)
    return column_collapse(
        domain=domain,
        length=drawn,
        height=height,
        gravity=gravity,
        duration=duration_tau * math.sqrt(height / gravity),
        **rest,  # type: ignore[arg-type]
    )


def checked_range(owner: str, name: str, values: Sequence[float]) -> tuple[float, float]:
    """Return `values` as two positive numbers, the smaller first, or raise an `InputError` that names the field."""
    numbers = checked_numbers(owner, name, values)
    if len(numbers) != 2 or not 0 < numbers[0] <= numbers[1]:
        raise InputError(f"{owner}: {name} must be two positive numbers, the smaller first, not {list(numbers)}.")
    return numbers[0], numbers[1]


def _box(
    name: str,
    domain: Sequence[float],
    gravity: float,
    duration: float,
    material: Material,
    walls: Mapping[str, Wall],
    *bodies: Body,
) -> Scene:
    dim = len(domain)
    return Scene(
        name=name,
        lower=(0.0,) * dim,
        upper=tuple(domain),
        gravity=(*(0.0,) * (dim - 1), -gravity),
        duration=duration,
        materials={"sand": material},
        bodies=bodies,
        walls=dict(walls),
    )
