"""What we export, read as its destination reads it, key by key; what their programs ask for is written anew here."""

from __future__ import annotations

import json
import pickletools
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from gns_pl.errors import InputError
from gns_pl.io import read_manifest
from gns_pl.trajectory import Trajectory
from tests.convert.formats import fixtures
from tests.convert.test_convert import converted
from tests.convert.test_own_sets import a_flight, a_scene, metadata_of, write_ours


def texts_in_pickles(archive: Path) -> set[str]:
    """Every text in the pickles of an .npz, the modules and functions that they ask for among them."""
    found: set[str] = set()
    with zipfile.ZipFile(archive) as opened:
        for member in opened.namelist():
            content = opened.read(member)
            start = content.index(b"\n") + 1  # behind the header of the .npy
            found |= {text for _, text, _ in pickletools.genops(content[start:]) if isinstance(text, str)}
    return found


def their_samples(folder: Path, split: str) -> Iterator[tuple[np.ndarray, ...]]:
    """Windows of six frames with types, material values and the next frame, as geoelements/gns takes them."""
    with np.load(folder / f"{split}.npz", allow_pickle=True) as file:
        data = [item for _, item in file.items()]
    has_material = len(data[0]) >= 3
    for trajectory in data:
        position, types, *material = trajectory
        for frame in range(6, len(position)):
            window = np.transpose(position[frame - 6 : frame], (1, 0, 2))
            filled = [np.full(len(window), each, dtype=float) for each in material]
            assert bool(filled) == has_material
            yield window, np.full(len(window), types, dtype=int), *filled, position[frame]


def their_settings(folder: Path, purpose: str) -> dict[str, Any]:
    """What their training ("train") and their rollouts ("rollout") take from metadata.json."""
    content = metadata_of(folder)
    metadata = content.get(purpose, content)
    dim = metadata["dim"]
    widths = {"nnode_in": 37 if dim == 3 else 30, "nedge_in": dim + 1}
    if "nnode_in" in metadata and "nedge_in" in metadata:
        widths = {key: metadata[key] for key in widths}
    return {
        **widths,
        "particle_dimensions": dim,
        "boundaries": np.array(metadata["bounds"]),
        "connectivity_radius": metadata["default_connectivity_radius"],
        "boundary_clamp_limit": metadata.get("boundary_augment", 1.0),
        "nsteps": metadata["sequence_length"] - 6,
        "dt": metadata["dt"],
        **{key: np.array(metadata[key]) for key in ("vel_mean", "vel_std", "acc_mean", "acc_std")},
    }


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("material", [False, True])
def test_geoelements_trains_and_rolls_out(tmp_path: Path, dim: int, material: bool) -> None:
    flights = [a_flight(a_scene(dim), frames) for frames in (12, 9, 10)]
    if not material:
        flights = [replace(each, material=each.material[:, :0], material_features=()) for each in flights]
    source = write_ours(tmp_path / "a", {"train": flights[:1], "valid": flights[1:2], "test": flights[2:]})
    theirs = converted(source, tmp_path / "b", to="geoelements")
    texts = texts_in_pickles(theirs / "train.npz")
    assert {"numpy.core.multiarray _reconstruct", "numpy", "ndarray", "dtype"} <= texts
    assert not any("_core" in text for text in texts), "which NumPy 1 does not have"
    samples = list(their_samples(theirs, "train"))
    assert len(samples) == 12 - 6
    window, types, *values, target = samples[0]
    np.testing.assert_array_equal(window, flights[0].position[:6].transpose(1, 0, 2))
    np.testing.assert_array_equal(target, flights[0].position[6])
    assert (types == 6).all() and target.dtype == np.float32
    if material:
        np.testing.assert_allclose(values[0], np.tan(np.radians(30)), rtol=1e-6)
    settings = their_settings(theirs, "train")
    width = window.shape[1] * dim - dim + 2 * dim + 16 + len(values)
    assert settings["nnode_in"] == width == {2: 30, 3: 37}[dim] + material and settings["nedge_in"] == dim + 1
    assert settings["boundaries"].shape == (dim, 2) and settings["dt"] == 0.01
    assert settings["connectivity_radius"] == pytest.approx(0.21), "off the distances of a lattice"
    rolled = their_settings(theirs, "rollout")
    for split in ("valid", "test"):
        with np.load(theirs / f"{split}.npz", allow_pickle=True) as file:
            frames = [len(item[0]) for item in file.values()]
        assert rolled["nsteps"] <= min(frames) - 6, "no step without a truth"
    assert rolled["nsteps"] == 9 - 6
    step = np.diff(flights[0].position.astype(np.float64), axis=0)
    np.testing.assert_allclose(settings["vel_mean"], step.reshape(-1, dim).mean(axis=0), atol=1e-12)
    np.testing.assert_allclose(settings["acc_std"], np.diff(step, axis=0).reshape(-1, dim).std(axis=0), atol=1e-12)


def test_lagrangebench_opens_and_pads(tmp_path: Path) -> None:
    large = a_scene(bodies=(replace(a_scene().bodies[0], size=(0.5, 0.4, 0.4)),))
    flights = {
        "train": [a_flight(a_scene()), a_flight(large)],
        "valid": [a_flight(a_scene())],
        "test": [a_flight(large)],
    }
    theirs = converted(write_ours(tmp_path / "a", flights), tmp_path / "b", to="lagrangebench")
    metadata = metadata_of(theirs)
    for split, of_split in flights.items():
        with h5py.File(theirs / f"{split}.h5") as file:
            assert list(file) == [f"{number:05d}" for number in range(len(of_split))]
            length = file["00000/position"].shape[0]
            for name, flight in zip(file, of_split, strict=True):
                position, types = file[f"{name}/position"], file[f"{name}/particle_type"]
                assert position.dtype == np.float32 and types.dtype == np.int32 and len(position) == length
                np.testing.assert_array_equal(position, flight.position)
                assert metadata["num_particles_max"] - position.shape[1] >= 0
    assert metadata["num_particles_max"] == 5 * 4 * 4
    for key in ("vel_mean", "vel_std", "acc_mean", "acc_std", "periodic_boundary_conditions"):
        assert len(metadata[key]) == 3
    assert np.array(metadata["bounds"]).shape == (3, 2) and metadata["dim"] == 3
    assert metadata["dt"] * metadata["write_every"] == 0.01 and metadata["dx"] == 0.1
    assert metadata["default_connectivity_radius"] == pytest.approx(0.21)


def test_lagrangebench_takes_one_length_of_a_split(tmp_path: Path) -> None:
    flights = {"train": [a_flight(a_scene()), a_flight(a_scene())], "test": [a_flight(a_scene(), 7)]}
    assert converted(write_ours(tmp_path / "a", flights), tmp_path / "b", to="lagrangebench").is_dir()
    flights["train"].append(a_flight(a_scene(), 9))
    source = write_ours(tmp_path / "c", flights)
    with pytest.raises(InputError, match=r"trajectory_0002\.h5: it has 9 frames, those before it 8, and LagrangeBench"):
        converted(source, tmp_path / "d", to="lagrangebench")
    assert not (tmp_path / "d").exists() and not (tmp_path / ".d.converting").exists()


@pytest.mark.parametrize("to", ["geoelements", "lagrangebench"])
def test_a_history_and_a_frame_are_needed_there(tmp_path: Path, to: str) -> None:
    source = write_ours(tmp_path / "a", {"train": [a_flight(a_scene(), 7)], "test": [a_flight(a_scene(), 6)]})
    with pytest.raises(InputError, match=r"trajectory_0001\.h5: it has 6 frames, and .* rolls out 7 or more"):
        converted(source, tmp_path / "b", to=to)


def without_material(flight: Trajectory) -> Trajectory:
    return replace(flight, material=flight.material[:, :0], material_features=())


@pytest.mark.parametrize("to", ["geoelements", "lagrangebench"])
def test_tests_alone_have_statistics_of_their_own(tmp_path: Path, to: str) -> None:
    flight = a_flight(a_scene(), 9)
    theirs = converted(write_ours(tmp_path / "a", {"test": [flight]}), tmp_path / "b", to=to)
    metadata = metadata_of(theirs)
    step = np.diff(flight.position.astype(np.float64), axis=0).reshape(-1, 3)
    np.testing.assert_allclose(metadata["vel_mean"], step.mean(axis=0), atol=1e-12)
    assert metadata["sequence_length"] == 9 and metadata["bounds"] == [[0.0, 1.0]] * 3


def test_a_material_value_is_of_all_or_none(tmp_path: Path) -> None:
    flights = [a_flight(a_scene()), without_material(a_flight(a_scene()))]
    source = write_ours(tmp_path / "a", {"train": flights})
    with pytest.raises(InputError, match=r"trajectory_0001\.h5: has 0 material values, those before it 1, and geo"):
        converted(source, tmp_path / "b", to="geoelements")


@pytest.mark.parametrize("to", ["geoelements", "lagrangebench"])
def test_radius_and_clip_of_the_source_stay(tmp_path: Path, to: str) -> None:
    """Through a set of ours and in another unit of length."""
    theirs = fixtures.write_geoelements(tmp_path / "a", {split: [fixtures.falling(8)] for split in ("train", "test")})
    metadata = metadata_of(theirs)
    (theirs / "metadata.json").write_text(json.dumps({**metadata, "boundary_augment": 1.5}))
    ours = converted(theirs, tmp_path / "b", scale=2.0)
    assert read_manifest(ours).spec["imported"]["connectivity_radius"] == 0.3
    copy = converted(ours, tmp_path / "c", scale=0.5)
    for source, radius in ((theirs, 0.15), (ours, 0.3), (copy, 0.15)):
        back = metadata_of(converted(source, tmp_path / f"{source.name}_back", to=to, scale=1.0))
        assert back["default_connectivity_radius"] == radius
        if to == "geoelements":
            assert back["boundary_augment"] == 1.5
