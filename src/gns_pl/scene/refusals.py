"""Sentences of those who know no terrain and no obstacles."""

from __future__ import annotations

from typing import TYPE_CHECKING

from gns_pl.errors import InputError

if TYPE_CHECKING:
    from gns_pl.scene.definition import Scene


SEE_SURFACES = "set model.walls=contacts"
"""What whoever trains on such scenes has to do."""


def refused_terrain(owner: str, what: str) -> str:
    """Return the sentence with which those who know no terrain refuse a scene that has one.

    Args:
        owner: the scene, as "scene 'hill'".
        what: who refuses, as "a learned simulator".
    """
    return f"{owner} has a terrain, which {what} does not take; use solver=ground, mpm or shallow."


def check_bare(
    owner: str, scene: Scene, what: str = "a simulator of bare boxes", cure: str = "use solver=ground or mpm"
) -> None:
    """Raise an `InputError` with what to do where a scene has obstacles or a terrain; as `refused_terrain`."""
    if scene.obstacles:
        raise InputError(f"{owner} has obstacles, which {what} does not know; {cure}.")
    if scene.terrain is not None:
        raise InputError(f"{owner} has a terrain, which {what} does not take; {cure}.")
