"""Terrain and releases of a scene file: where their numbers come from, cropped to the box and resampled where asked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

from gns_pl.errors import InputError
from gns_pl.scene.arrays import decoded_array
from gns_pl.scene.boundaries import Wall
from gns_pl.scene.checks import checked_number, checked_numbers
from gns_pl.scene.definition import Body
from gns_pl.scene.parts import part_from_dict
from gns_pl.scene.raster import Raster, read_raster
from gns_pl.scene.release import Release, make_release, read_outline
from gns_pl.scene.shapes import shaped_raster
from gns_pl.scene.terrain import Terrain
from gns_pl.text import did_you_mean

KEYS = ("file", "wall", "corner", "cell", "crs", "resample")
"""What a terrain says that is in a file; one whose heights stand in the scene says the attributes of a `Terrain`."""

RELEASE_KEYS = ("outline", "thickness", "velocity", "material")


def terrain_from_dict(data: Any, folder: Path, lower: Any = None, upper: Any = None) -> Terrain:
    """Return the ground of a scene file.

    Args:
        data: plain values; with "file" the heights are read from there, with "shape" they follow a formula (`shapes`),
            else they are in "heights".
        folder: of the scene file.
        lower: lower corner of the box, to which what is read is cropped [D] [m]; None keeps all.
        upper: its upper corner.

    Raises:
        InputError: unknown or missing keys, or a file that holds no ground.
    """
    if isinstance(data, Mapping) and "shape" in data:
        wall = part_from_dict(Wall, "terrain: wall", data.get("wall"))
        return Terrain.of(shaped_raster({key: value for key, value in data.items() if key != "wall"}), wall)
    if not isinstance(data, Mapping) or "file" not in data:
        parts = dict(data) if isinstance(data, Mapping) else data
        if isinstance(parts, dict):
            parts["heights"] = decoded_array("terrain: heights", parts.get("heights"))
            parts["wall"] = part_from_dict(Wall, "terrain: wall", parts.get("wall"))
        terrain: Terrain = part_from_dict(Terrain, "terrain", parts)
        return terrain
    unknown = [str(key) for key in data if key not in KEYS]
    if unknown:
        meant = did_you_mean(unknown[0], KEYS)
        raise InputError(f"terrain: unknown key {', '.join(unknown)}{meant}; known are {', '.join(KEYS)}.")
    wall = part_from_dict(Wall, "terrain: wall", data.get("wall"))
    raster = _raster("terrain", data, folder)
    resample = data.get("resample")
    if resample is not None:
        resample = checked_number("terrain", "resample", resample, 0.0, above=True)
    if lower is not None and upper is not None:
        margin = max(resample or 0.0, 0.0)  # a mean at the edge of the box is over cells beyond it
        corners = [checked_numbers("scene", name, each)[:-1] for name, each in (("lower", lower), ("upper", upper))]
        raster = raster.cropped([low - margin for low in corners[0]], [high + margin for high in corners[1]])
    ground = Terrain.of(raster, wall)
    return ground if resample is None else ground.resampled(resample)


def bodies_from_list(bodies: Sequence[Any], terrain: Terrain | None, folder: Path) -> tuple[Body, ...]:
    """Return the bodies and releases of a scene; arguments and errors as `terrain_from_dict`."""
    made: list[Body] = []
    for index, data in enumerate(bodies):
        owner = f"body {index}"
        if not isinstance(data, Mapping) or not {"thickness", "outline"} & set(data):
            made.append(part_from_dict(Body, owner, data))
            continue
        if terrain is None:
            raise InputError(f"{owner}: a release lies on a terrain, and the scene has none; give one, or a body.")
        try:
            made.append(_release(owner, dict(data), terrain, folder))
        except InputError as error:
            raise InputError(f"{owner}: {error}") from error
    return tuple(made)


def _release(owner: str, data: dict[str, Any], terrain: Terrain, folder: Path) -> Release:
    if isinstance(data.get("thickness"), str):
        data["thickness"] = read_raster(folder / data["thickness"])
    elif isinstance(data.get("thickness"), Mapping):
        parts = dict(data["thickness"])
        if "file" in parts:
            data["thickness"] = _raster("thickness", parts, folder)
        else:
            parts["values"] = decoded_array("thickness: values", parts.get("values"))
            data["thickness"] = part_from_dict(Raster, "thickness", parts)
    if isinstance(data.get("outline"), str):
        data["outline"] = read_outline(folder / data["outline"])
    if {"position", "size"} & set(data):  # as `Scene.to_dict` writes it
        release: Release = part_from_dict(Release, "a release", data)
        return release
    unknown = [str(key) for key in data if key not in RELEASE_KEYS]
    if unknown:
        meant = did_you_mean(unknown[0], RELEASE_KEYS)
        raise InputError(f"unknown key {', '.join(unknown)}{meant}; a release has {', '.join(RELEASE_KEYS)}.")
    if data.get("thickness") is None:
        raise InputError("a release needs a thickness, a number [m] or a raster.")
    return make_release(terrain, **data)


def _raster(owner: str, data: Mapping[str, Any], folder: Path) -> Raster:
    """Return the raster that "file" names, with what else is said of it."""
    known = {field.name for field in fields(Raster)} & set(data) - {"values"}
    if not isinstance(data["file"], str):
        raise InputError(f"{owner}: file must be the name of a raster, not {data['file']!r}.")
    return read_raster(folder / data["file"], **{key: data[key] for key in known})


def default_box(terrain: Terrain, bodies: Sequence[Body]) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return the box of a scene that says none: the terrain, and a cell of it below the ground and above all."""
    lower, upper = terrain.extent
    highest = max([float(terrain.heights.max()), *(body.upper[-1] for body in bodies)])
    return (*lower, float(terrain.heights.min()) - terrain.cell), (*upper, highest + terrain.cell)
