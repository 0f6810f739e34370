"""Sentences of those who know no terrain and no obstacles."""

from __future__ import annotations

from typing import TYPE_CHECKING

from gns_pl.errors import InputError

if TYPE_CHECKING:
    from gns_pl.scene.definition import Scene


def refused_terrain(owner: str, what: str) -> str:
    """Return the sentence with which those who know no terrain refuse a scene that has one.

    Args:
        owner: the scene, as "scene 'hill'".
        what: who refuses, as "a learned simulator".
    """
    return f"{owner} has a terrain, which {what} does not take; use solver=mpm or shallow."


def check_bare(owner: str, scene: Scene, what: str = "a learned simulator") -> None:
    """Raise an `InputError` where a scene has obstacles or a terrain; arguments as `refused_terrain`."""
    if scene.obstacles:
        raise InputError(f"{owner} has obstacles, and a learned simulator knows no obstacles yet.")
    if scene.terrain is not None:
        raise InputError(refused_terrain(owner, what))
