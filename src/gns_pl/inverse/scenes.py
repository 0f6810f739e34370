"""The scenes to which coarse MPM is fitted, from the short form of conf/fit.yaml."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from gns_pl.errors import InputError
from gns_pl.scene import Scene, scene_from_dict
from gns_pl.scene.checks import checked_number
from gns_pl.scene.extent import initial_extent

KEYS = ("domain", "bodies", "obstacles", "slope_deg", "walls")
"""What the short form of a scene may hold."""


def short_scene(
    name: str,
    parts: Mapping[str, Any],
    *,
    material: Mapping[str, Any],
    walls: Mapping[str, Any],
    gravity: float,
    duration_tau: float,
) -> Scene:
    """Return a scene from its short form.

    Args:
        name: of the scene.
        parts: `domain` [3] [m]; `bodies`, each with `size` and, unless zero, `position` [m] and `velocity` [m/s];
            `obstacles`, as in a scene file, with the floor's wall unless they name another; `slope_deg` by which
            the box is inclined along x [degrees]; `walls`, face → wall, in the place of the common ones.
        material: of all bodies, as in a scene file.
        walls: face → wall, likewise, of all scenes.
        gravity: magnitude [m/s²].
        duration_tau: simulated time, in √(H0/g).

    Raises:
        InputError: a key that a short scene does not have, or what a `Scene` refuses.
    """
    owner = f"scenes.{name}"
    if not isinstance(parts, Mapping) or not {"domain", "bodies"} <= set(parts) <= set(KEYS):
        raise InputError(f"{owner}: needs domain and bodies, and may have {', '.join(KEYS[2:])}, not {parts!r}.")
    walls = {**walls, **parts.get("walls", {})}
    zero = [0.0] * len(parts["domain"])
    slope = math.radians(checked_number(owner, "slope_deg", parts.get("slope_deg", 0.0), 0.0))
    scene = scene_from_dict(
        {
            "name": name,
            "lower": zero,
            "upper": parts["domain"],
            "gravity": [gravity * math.sin(slope), *zero[1:-1], -gravity * math.cos(slope)],
            "duration": 1.0,
            "materials": {"sand": material},
            "bodies": [{"position": zero, "velocity": zero, **body} for body in parts["bodies"]],
            "walls": walls,
            "obstacles": [{"wall": walls["z-"], **obstacle} for obstacle in parts.get("obstacles", ())],
        }
    )
    return scene.replace(duration=duration_tau * math.sqrt(initial_extent(scene)[1] / gravity))
