"""Whether the errors that were measured hold for a scene: what it has in common with the scenes they were measured on.

A record (`choice`) carries the setup of its scene. An error is expected only of a scene whose setup agrees with that of
measured ones; of every other scene it is unmeasured. Training ranges are another question (`training_range`).
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping

from gns_pl.errors import InputError
from gns_pl.scene import Plane, Scene
from gns_pl.scene.extent import characteristic_time, initial_extent
from gns_pl.solvers.measured_ground import GROUND_SPANS, ground_setup
from gns_pl.solvers.reduction import not_plane_reason, to_plane

SPANS: Mapping[str, tuple[str, str, float, float]] = {
    "aspect_ratio": ("aspect ratio", "", 1.03, 1.03),
    "size": ("√(L0 H0)", " m", 1.1, 1.1),
    "width": ("width", " √(L0 H0)", 1.25, 1.25),
    "depth": ("depth of the body", " √(L0 H0)", 1.1, 1.1),
    "room": ("free length in front", " (0.5 + 1.3 a) L0", 1.1, math.inf),
    "duration": ("duration", " √(H0/g)", 1.5, math.inf),
    **GROUND_SPANS,
}
"""Key of a number → its name, unit, and by what factor it may lie below and above all that were measured.

A column of 3/4 the size and a little lower erred by half more with particles of fixed spacing, so the spans are narrow.
With equal material and gravity the size also bounds the compression by own weight, ρ g H / M, and cohesion over weight.
The front rests from 3.5 √(H0/g) on, and 6 are measured, so 4 do as well."""


def setup_of(scene: Scene) -> dict[str, str | float]:
    """Return what decides the error of a solver's runout: texts that must agree, and numbers that span a range.

    A scene in plane strain is described by its slice. The upper x wall is left out, as far as it is (`room`). Several
    bodies, and obstacles, are described by where they are (`_layout`): such a scene is like one of just these places.
    On a terrain other things decide (`measured_ground`).
    """
    if scene.dim == 3 and scene.terrain is not None:
        return ground_setup(scene)
    for axis in (1, 0):
        if scene.dim == 3 and not_plane_reason(scene, axis) is None:
            scene = to_plane(scene, axis).scene
    length, height = initial_extent(scene)
    size = math.sqrt(length * height)
    # (0.5 + 1.3 a) L0 is about the runout of the columns that were measured.
    room = (scene.upper[0] - scene.lower[0] - length) / (0.5 * length + 1.3 * height)
    setup: dict[str, str | float] = {
        "bodies": _bodies(scene),
        "obstacles": f"{len(scene.obstacles) or 'no'} obstacle{'s' * (len(scene.obstacles) > 1)}",
        **_materials(scene),
        "gravity": " ".join(f"{value + 0.0:g}" for value in scene.gravity) + " m/s²",
    }
    setup |= {f"wall {face}": wall.description for face, wall in scene.walls.items() if face not in ("x+", "z+")}
    if scene.terrain is not None:
        setup["terrain"] = scene.terrain.wall.description
    setup |= {"aspect_ratio": height / length, "size": size, "room": room}
    if scene.dim == 3:
        setup["width"] = (scene.upper[1] - scene.lower[1]) / size
        if "narrower" in str(setup["bodies"]):
            setup["depth"] = scene.bodies[0].size[1] / size
    if len(scene.bodies) > 1 or scene.obstacles:
        setup["layout"] = _layout(scene, size)
        setup.pop("room")
        setup.pop("width", None)
    try:
        setup["duration"] = scene.duration / characteristic_time(scene)
    except InputError:  # no gravity, which the text says
        setup["duration"] = 0.0
    return setup


def setup_text(scene: Scene) -> str:
    """Return the setup as it stands in a table of records."""
    rounded = {
        key: float(f"{value:.4g}") if isinstance(value, float) else value for key, value in setup_of(scene).items()
    }
    return json.dumps(rounded, ensure_ascii=False)


def same_kind(scene: Scene, setup: str) -> bool:
    """Return whether a measured setup agrees with a scene's in all but the numbers of `SPANS`.

    Args:
        scene: to be simulated.
        setup: of a record, as `setup_text`.
    """
    own, known = setup_of(scene), json.loads(setup) if setup else {}
    return all(key in SPANS or own.get(key) == known.get(key) for key in {*own, *known})


def unmeasured_reasons(scene: Scene, measured: Iterable[str]) -> list[str]:
    """Return what of a scene differs from all measured ones, in words; nothing where measured errors hold.

    Numbers are compared with those of measured scenes of the same kind alone (`same_kind`), if there are such.

    Args:
        scene: to be simulated.
        measured: setups of records, as `setup_text`.
    """
    texts = set(measured)
    if "" in texts:
        return ["the table of records does not say on which scenes it was measured (write it again: benchmark.py)"]
    alike = {text for text in texts if same_kind(scene, text)}
    own, known = setup_of(scene), [json.loads(text) for text in alike or texts]
    reasons = []
    for key, value in own.items():
        values = [each.get(key) for each in known]
        if key in SPANS:
            reasons += _beyond_span(key, float(value), [float(each) for each in values if each is not None])
        elif value not in values and key != "layout":
            seen = " or ".join(dict.fromkeys(str(each) for each in values if each is not None))
            reasons.append(f"measured with {_named(key, seen)}, here {value}")
    if not alike and not reasons:
        reasons.append("measured with other places of bodies and obstacles, or not with all of this together")
    return reasons


def _beyond_span(key: str, value: float, values: list[float]) -> list[str]:
    name, unit, below, above = SPANS[key]
    low, high = min(values, default=math.nan), max(values, default=math.nan)
    if low / below * (1 - 1e-3) <= value <= high * above * (1 + 1e-3):
        return []
    span = f"{low:.3g}" if math.isclose(low, high) else f"{low:.3g} to {high:.3g}"
    return [f"measured with {name} {span}{unit}, here {value:.3g}"]


def _named(key: str, text: str) -> str:
    return text if key in ("bodies", "obstacles") else f"{key} {text}"


def _bodies(scene: Scene) -> str:
    [body, *others] = scene.bodies
    if others:
        return f"{len(scene.bodies)} bodies"
    near = 1e-6 * min(body.size)
    spans = all(
        abs(body.position[axis] - scene.lower[axis]) < near and abs(body.upper[axis] - scene.upper[axis]) < near
        for axis in range(1, scene.dim - 1)
    )
    at_wall = abs(body.position[0] - scene.lower[0]) < near
    on_floor = abs(body.position[-1] - scene.lower[-1]) < near
    in_corner = any(
        abs(one[axis] - other[axis]) < near
        for axis in range(1, scene.dim - 1)
        for one, other in ((body.position, scene.lower), (body.upper, scene.upper))
    )
    narrower = "narrower than the box and at a side wall" if in_corner else "narrower than the box"
    places = [
        "at the x- wall" if at_wall else "away from the x- wall",
        *([] if on_floor else ["above the floor"]),
        *([] if spans else [narrower]),
        "in motion" if any(body.velocity) else "at rest",
    ]
    return f"one body {', '.join(places)}"


def _layout(scene: Scene, size: float) -> str:
    """Return the edges of box, bodies and obstacles over a length, to a twentieth of it, so that near ones read alike.

    Args:
        scene: box, bodies and obstacles; planes by their normal and distance from the lower corner of the box.
        size: the length [m].
    """

    def rounded(values: Iterable[float]) -> str:
        return ",".join(f"{round(20 * value) / 20 + 0.0:g}" for value in values)

    def over(corner: tuple[float, ...]) -> str:
        return rounded((value - low) / size for value, low in zip(corner, scene.lower, strict=True))

    parts = [f"box {over(scene.upper)}"]
    parts += [
        f"body {over(body.position)} to {over(body.upper)}, {rounded(body.velocity)} m/s" for body in scene.bodies
    ]
    for obstacle in scene.obstacles:
        if isinstance(obstacle, Plane):
            distance = sum(
                n * (p - low) for n, p, low in zip(obstacle.normal, obstacle.point, scene.lower, strict=True)
            )
            place = f"{rounded(obstacle.normal)} at {rounded([distance / size])}"
        else:
            place = f"{over(obstacle.position)} to {over(obstacle.upper)}"
        parts.append(f"{obstacle.kind} {place}, {obstacle.wall.description}")
    return "; ".join(parts)


def _materials(scene: Scene) -> dict[str, str]:
    """Return every property of the bodies' materials; where they differ, all values in the order of the bodies."""
    materials = list(dict.fromkeys(scene.materials[body.material] for body in scene.bodies))
    values = {key: [getattr(each, key) for each in materials] for key in vars(materials[0])}
    return {
        key: " and ".join(f"{value:g}" if isinstance(value, float) else str(value) for value in dict.fromkeys(each))
        for key, each in values.items()
    }
