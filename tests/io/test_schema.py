"""The format as data: current in the docs, in H5MD's spelling, and a judge of files."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from gns_pl.errors import InputError
from gns_pl.fields import FIELDS
from gns_pl.io import FORMAT_VERSION, read_header, read_trajectory, read_window, render_schema, write_trajectory
from gns_pl.io.schema import ENTRIES, LOCATION, OBSERVABLE_ENTRIES, check_file, h5md_unit
from gns_pl.scene import Scene
from tests.conftest import make_moving

Change = Callable[[Any], object]


@pytest.fixture
def path(drop: Scene, tmp_path: Path) -> Path:
    write_trajectory(tmp_path / "drop.h5", make_moving(drop, frames=4, spacing=0.1))
    return tmp_path / "drop.h5"


def test_document_is_current() -> None:
    document = Path(__file__).parents[2] / "docs" / "SCHEMA.md"
    assert document.read_text(encoding="utf-8") == render_schema(), "write gns_pl.io.render_schema() to docs/SCHEMA.md"


def test_every_field_has_its_place_and_every_unit_h5mds_spelling() -> None:
    paths = [entry.path for entry in ENTRIES]
    assert len(set(paths)) == len(paths)
    assert set(LOCATION) == {field.name for field in FIELDS}
    assert set(LOCATION.values()) <= set(paths)
    assert h5md_unit("m/s") == "m s-1"
    assert h5md_unit("m3") == "m+3"
    for entry in (*ENTRIES, *OBSERVABLE_ENTRIES):
        assert re.fullmatch(r"1|[a-zA-Z]+([+-]\d)?( [a-zA-Z]+-?\d)*", h5md_unit(entry.unit))


def test_a_written_file_fits_and_follows_h5md(path: Path) -> None:
    with h5py.File(path) as file:
        assert check_file(file) == {"2": 2, "T": 4, "N": 27, "D": 3, "K": 1}
        assert list(file["h5md"].attrs["version"]) == [1, 1]
        group = file["particles/all"]
        assert group["position/value"].attrs["unit"] == "m"
        assert group["initial_velocity"].attrs["unit"] == "m s-1"
        assert group["position/step"][()] == 1
        assert group["position/time"][()] == 0.01
        assert list(group["box"].attrs["boundary"]) == ["none"] * 3
        np.testing.assert_array_equal(group["box/edges"], [1, 1, 1])


def replace_with(place: str, value: Any) -> Change:
    def change(file: Any) -> None:
        attributes = dict(file[place].attrs)
        del file[place]
        file[place] = value
        file[place].attrs.update(attributes)

    return change


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda f: f.attrs.__delitem__("format"), "is HDF5, but not a trajectory of gns_pl"),
        (lambda f: f.attrs.__setitem__("format", "other"), "is HDF5, but not a trajectory of gns_pl"),
        (lambda f: f.attrs.__delitem__("format_version"), "is HDF5, but not a trajectory of gns_pl"),
        (lambda f: f.attrs.__setitem__("format_version", FORMAT_VERSION + 1), "newer than the 2 this gns_pl reads"),
        (lambda f: f.__delitem__("particles/all/mass"), "lacks particles/all/mass"),
        (lambda f: f.__delitem__("particles"), "lacks particles/all"),
        (lambda f: f.__delitem__("parameters/scene"), "lacks parameters/scene"),
        (lambda f: f["particles/all/material"].attrs.__delitem__("features"), "lacks particles/all/material@features"),
        (replace_with("particles/all/position/value", np.zeros((4, 27, 3))), "must be of type float32, not float64"),
        (replace_with("particles/all/mass", np.zeros(27, "i4")), "must be of type float32, not int32"),
        (replace_with("parameters/scene", 3), "parameters/scene must be of type string"),
        (replace_with("particles/all/mass", np.zeros((27, 1), "f4")), r"must be of shape \[N\], not \[27, 1\]"),
        (replace_with("particles/all/mass", np.zeros(26, "f4")), "N = 27, not 26"),
        (replace_with("particles/all/initial_velocity", np.zeros((27, 2), "f4")), "D = 3, not 2"),
        (replace_with("particles/all/position/time", 0.0), "position/time must be positive"),
        (replace_with("particles/all/position/time", np.nan), "position/time must be positive"),
        (replace_with("particles/all/position/value", np.zeros((0, 27, 3), "f4")), "holds no frames"),
        (lambda f: f["particles/all/mass"].attrs.__setitem__("unit", "g"), "must be in kg, not in g"),
        (lambda f: f["particles/all/mass"].attrs.__delitem__("unit"), "must be in kg, not in None"),
        (replace_with("parameters/scene", "{"), "truncated or damaged"),
        (replace_with("parameters/scene", '{"name": 1}'), "scene: missing key"),
    ],
)
def test_files_that_differ_are_named_and_not_read(path: Path, change: Change, sentence: str) -> None:
    with h5py.File(path, "r+") as file:
        change(file)
    for read in (read_trajectory, read_header):
        with pytest.raises(InputError, match=rf"drop\.h5: .*{sentence}") as refused:
            read(path)
        assert "\n" not in str(refused.value)
    if "format" in sentence or "newer" in sentence or "not a trajectory" in sentence:
        with pytest.raises(InputError, match=sentence):
            read_window(path, 0, 2)


def test_a_group_in_place_of_an_array_is_named(path: Path) -> None:
    with h5py.File(path, "r+") as file:
        del file["particles/all/mass"]
        file.create_group("particles/all/mass")
    with pytest.raises(InputError, match="must be a data set, not a group"):
        read_trajectory(path)


def test_more_than_the_format_is_allowed(path: Path) -> None:
    with h5py.File(path, "r+") as file:
        file["observables/energy"] = 1.0
    assert read_trajectory(path).num_frames == 4
