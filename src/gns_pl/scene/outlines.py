"""Whether the rings of a release are an outline: rings that cross have no inside that is meant."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from gns_pl.errors import InputError

if TYPE_CHECKING:
    from gns_pl.scene.release import Release

PLACES = 128
"""Along each edge of the rectangle around an outline, at which is asked what is inside."""

TOLERANCE = 0.2
"""Relative difference of two areas up to which they are one: places see a narrow outline by so much at worst."""


def check_outline(owner: str, release: Release) -> None:
    """Raise an `InputError` where the area inside a release's rings is not what the rings themselves add up to."""
    if not release.outline:
        return
    shares = (np.indices((PLACES, PLACES)).reshape(2, -1).T + 0.5) / PLACES
    inside = release.depth(np.array(release.position[:2]) + shares * release.size[:2]) > 0
    seen = float(inside.mean()) * release.size[0] * release.size[1] * release.height
    if not abs(release.volume - seen) < TOLERANCE * seen:
        raise InputError(
            f"{owner}: its outline crosses itself, or its rings overlap, or nothing is inside; merge rings that "
            "overlap (dissolve), and let only holes lie inside of others."
        )
