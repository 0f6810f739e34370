"""The scales of a scene: its bodies' length and height, the time of a collapse, and compression by own weight."""

from __future__ import annotations

import math

from gns_pl.errors import InputError
from gns_pl.scene.definition import Body, Scene
from gns_pl.scene.release import Release


def initial_extent(scene: Scene) -> tuple[float, float]:
    """Return the initial length L0 along x and height H0 along the last axis of all bodies together [m].

    For a column against the x = lower wall these are its edges, and H0 / L0 its aspect ratio a. H0 of releases, which
    follow their ground, is their largest thickness.
    """
    extent = [
        max(body.upper[axis] for body in scene.bodies) - min(body.position[axis] for body in scene.bodies)
        for axis in (0, scene.dim - 1)
    ]
    if any(isinstance(body, Release) for body in scene.bodies):
        extent[1] = max(body.height for body in scene.bodies)
    return extent[0], extent[1]


def touching_bodies(scene: Scene) -> list[tuple[Body, ...]]:
    """Return the bodies in groups of those that touch each other, over others of the group if need be."""
    near = 1e-9 * max(high - low for low, high in zip(scene.lower, scene.upper, strict=True))

    def touch(one: Body, other: Body) -> bool:
        edges = zip(one.position, one.upper, other.position, other.upper, strict=True)
        return all(low <= other_high + near and other_low <= high + near for low, high, other_low, other_high in edges)

    groups: list[tuple[Body, ...]] = []
    for body in scene.bodies:
        joined = [group for group in groups if any(touch(body, other) for other in group)]
        groups = [group for group in groups if group not in joined] + [
            (*(member for group in joined for member in group), body)
        ]
    return groups


def characteristic_time(scene: Scene) -> float:
    """Return τc = √(H0 / g) [s], the time scale of a collapse (Lube et al. 2005; Lajeunesse et al. 2005).

    Raises:
        InputError: a scene without gravity.
    """
    gravity = math.hypot(*scene.gravity)
    if gravity == 0:
        raise InputError(f"scene {scene.name!r}: it has no gravity, so a collapse has no characteristic time.")
    return math.sqrt(initial_extent(scene)[1] / gravity)


FRAME_INTERVAL = 0.01
"""Least time between frames where nobody asks for another [s]: that of scenes of a laboratory's size."""

FRAMES, FRAMES_PER_TIME = 200, 20
"""Frames of a run on a terrain, and frames in a √(H0/g), that are enough where `FRAME_INTERVAL` gives more."""


def check_frame_interval(interval: float) -> None:
    """Refuse a time between frames that is no positive number [s]."""
    if not (math.isfinite(interval) and interval > 0):
        raise InputError(f"frame_interval, the time between frames, must be a positive number, not {interval}.")


def num_frames(scene: Scene, interval: float) -> int:
    """Return how many frames a run has, the start and the end among them: round(duration / interval) + 1, at least 2.

    Args:
        scene: that is run over its duration.
        interval: time between frames [s].

    Raises:
        InputError: an interval that is not positive, or longer than the scene, which would leave the start alone.
    """
    check_frame_interval(interval)
    if interval > scene.duration * (1 + 1e-9):
        raise InputError(
            f"scene {scene.name!r}: frames {interval:g} s apart leave no frame but its start, since it lasts "
            f"{scene.duration:g} s; choose a frame_interval of {scene.duration:g} s or less, or a longer duration."
        )
    return round(scene.duration / interval) + 1


def frame_interval_of(scene: Scene, given: float | None = None) -> float:
    """Return the time between frames [s]: what is given, and where nobody says `FRAME_INTERVAL`, or more.

    More, 1, 2 or 5 times a power of ten, where that is too fine for the size of a scene or the time of a slide; never
    more than the scene lasts.
    """
    if given is not None:
        return given
    wanted = FRAME_INTERVAL
    if any(scene.gravity):
        wanted = max(wanted, characteristic_time(scene) / FRAMES_PER_TIME)
    if scene.terrain is not None:
        wanted = max(wanted, scene.duration / FRAMES)
    power = 10.0 ** math.floor(math.log10(wanted) + 1e-9)
    factor = max(each for each in (1, 2, 5) if each * power <= wanted * (1 + 1e-9))
    return min(scene.duration, round(factor * power, 12))


COMPRESSION_LIMIT = 0.02
"""From this elastic strain by own weight on, a solver's user is told that the stiffness is too low for the height."""


def own_weight_strain(scene: Scene, number: int) -> float:
    """Return by what part of its height a body is compressed by its own weight and by what stands above it.

    ε = (q + ρ g h / 2) / M: the mean vertical strain of an elastic layer of height h that cannot spread sideways, with
    M the oedometric modulus and q = Σ ρ g h the weight per area of the bodies above. For one body, ε = ρ g H / (2 M).

    Args:
        scene: the bodies, their materials and gravity, of which the vertical component counts.
        number: index of the body.
    """
    gravity, body = abs(scene.gravity[-1]), scene.bodies[number]

    def weight(other: Body) -> float:
        return scene.materials[other.material].density * gravity * other.height

    def stands_above(other: Body) -> bool:
        overlaps = all(
            low < other_high and other_low < high
            for low, high, other_low, other_high in zip(
                body.position[:-1], body.upper[:-1], other.position[:-1], other.upper[:-1], strict=True
            )
        )
        return overlaps and other.position[-1] >= body.upper[-1] - 1e-9 * body.size[-1]

    load = sum(weight(other) for other in scene.bodies if stands_above(other))
    return (load + weight(body) / 2) / scene.materials[body.material].oedometric_modulus


def largest_own_weight_strain(scene: Scene) -> float:
    """Return the `own_weight_strain` of the body that is compressed most."""
    return max(own_weight_strain(scene, number) for number in range(len(scene.bodies)))


def compression_notice(scene: Scene) -> str | None:
    """Return one sentence about a body that its weight compresses by more than `COMPRESSION_LIMIT`, None if none is."""
    strains = [own_weight_strain(scene, number) for number in range(len(scene.bodies))]
    strain = max(strains)
    if strain <= COMPRESSION_LIMIT:
        return None
    body = scene.bodies[strains.index(strain)]
    modulus = scene.materials[body.material].youngs_modulus * strain / COMPRESSION_LIMIT
    step = 10.0 ** (math.floor(math.log10(modulus)) - 1)
    return (
        f"scene {scene.name!r}: weight alone compresses {body.material!r}, {body.height:.3g} m high, by "
        f"{100 * strain:.2g} % of its height (ρ g H / (2 M), with what stands on it), so its heights and runouts "
        f"are off; set its youngs_modulus to {math.ceil(modulus / step - 1e-9) * step:.2g} Pa or more for "
        f"{100 * COMPRESSION_LIMIT:g} %"
    )
