"""The manifest comes back as it was, and finds what was changed."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from gns_pl.errors import InputError
from gns_pl.io import FileRecord, Manifest, file_sha256, manifest_sha256, read_manifest, verify_dataset, write_manifest


@pytest.fixture
def manifest(tmp_path: Path) -> Manifest:
    names = ["a.h5", "b.h5", "c.h5"]
    for name in names:
        (tmp_path / name).write_bytes(name.encode() * 1000)
    return Manifest(
        format_version=1,
        name="small",
        dt=0.01,
        dim=3,
        spacing=1 / 24,
        particle_types=(6,),
        material_features=("tan_friction_angle",),
        splits={"train": ("a.h5", "c.h5"), "valid": ("b.h5",), "test": ()},
        files={name: FileRecord(file_sha256(tmp_path / name), 100, 12) for name in names},
        statistics={"velocity": {"mean": [0.1, 0.2, 1 / 3], "std": [1.0, 1.0, 1.0], "count": 7}},
        seed=5,
        spec={"families": {"cube_drop": {"count": 3}}},
    )


def test_round_trip(manifest: Manifest, tmp_path: Path) -> None:
    write_manifest(tmp_path, manifest)
    assert read_manifest(tmp_path) == manifest
    assert verify_dataset(tmp_path) == manifest
    assert manifest_sha256(tmp_path) == file_sha256(tmp_path / "manifest.json")
    before = manifest_sha256(tmp_path)
    write_manifest(tmp_path, replace(manifest, seed=6))
    assert manifest_sha256(tmp_path) != before


def test_changed_and_missing_files_are_found(manifest: Manifest, tmp_path: Path) -> None:
    write_manifest(tmp_path, manifest)
    content = bytearray((tmp_path / "b.h5").read_bytes())
    content[1234] ^= 1
    (tmp_path / "b.h5").write_bytes(content)
    with pytest.raises(InputError, match=r"b\.h5: has changed"):
        verify_dataset(tmp_path)
    (tmp_path / "b.h5").unlink()
    with pytest.raises(InputError, match=r"b\.h5: is in the manifest, but missing"):
        verify_dataset(tmp_path)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"format_version": 2}, "is in version 2, newer than 1"),
        ({"format_version": "x"}, "is damaged or not a manifest"),
        ({"seed": ...}, "is damaged or not a manifest"),
        ({"colour": 1}, "is damaged or not a manifest"),
        ({"files": {"a.h5": {"sha256": "0"}}}, "is damaged or not a manifest"),
        ({"files": []}, "is damaged or not a manifest"),
        ({"splits": {"train": ["a.h5", "c.h5"], "valid": ["b.h5"]}}, "splits must be train, valid, test"),
        ({"splits": {"train": ["a.h5", "c.h5"], "valid": [], "test": []}}, "every file must stand in one split"),
        ({"splits": {"train": ["a.h5"], "valid": ["a.h5"], "test": []}}, "every file must stand in one split"),
    ],
)
def test_foreign_manifests_are_named(
    manifest: Manifest, tmp_path: Path, changes: dict[str, Any], sentence: str
) -> None:
    write_manifest(tmp_path, manifest)
    path = tmp_path / "manifest.json"
    data = json.loads(path.read_text())
    for key, value in changes.items():
        if value is ...:
            del data[key]
        else:
            data[key] = value
    path.write_text(json.dumps(data))
    with pytest.raises(InputError, match=rf"manifest\.json: .*{sentence}"):
        read_manifest(tmp_path)


@pytest.mark.parametrize("content", ["", "{", "[]", "3", '{"a": 1}'])
def test_files_that_are_no_manifests_are_named(tmp_path: Path, content: str) -> None:
    (tmp_path / "manifest.json").write_text(content)
    with pytest.raises(InputError, match=r"manifest\.json: is damaged or not a manifest"):
        read_manifest(tmp_path)


def test_folders_without_one_are_named(tmp_path: Path) -> None:
    for read in (read_manifest, verify_dataset, manifest_sha256):
        with pytest.raises(InputError, match="holds no data set"):
            read(tmp_path)


def test_names_that_leave_the_folder_are_refused(manifest: Manifest) -> None:
    record = manifest.files["a.h5"]
    with pytest.raises(InputError, match="is not a plain file name"):
        replace(manifest, files={"../a.h5": record}, splits={"train": ("../a.h5",), "valid": (), "test": ()})
