"""Our own sets as a source, and sources that say something of a part of them alone: every trajectory keeps its own."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gns_pl.convert import inspect_source
from gns_pl.convert.facts import find_out, work_out
from gns_pl.convert.formats import open_set
from gns_pl.convert.given import Given
from gns_pl.data.statistics import RunningStatistics
from gns_pl.errors import InputError
from gns_pl.io import (
    SPLITS,
    FileRecord,
    Manifest,
    file_sha256,
    read_header,
    read_manifest,
    read_trajectory,
    write_manifest,
    write_trajectory,
)
from gns_pl.scene import FACES, Body, Box, Plane, Scene, Wall
from gns_pl.trajectory import Trajectory
from tests.conftest import SAND, make_start
from tests.convert.formats import fixtures
from tests.convert.test_convert import converted

SPACING, DT = 0.1, 0.01
PLASTIC = replace(SAND, density=900.0, friction_angle_deg=20.0)


def a_scene(dim: int = 3, **changes: Any) -> Scene:
    """A box of 1 m with a body of 0.4 m in the middle."""
    values: dict[str, Any] = {
        "name": "one",
        "lower": (0.0,) * dim,
        "upper": (1.0,) * dim,
        "gravity": (0.0,) * (dim - 1) + (-9.81,),
        "duration": 0.08,
        "materials": {"sand": SAND},
        "bodies": (Body((0.3,) * dim, (0.4,) * dim, (0.1,) * (dim - 1) + (0.0,)),),
        "walls": {face: Wall("friction", 0.385) for face in FACES[dim]},
    }
    return Scene(**values | changes)


def a_flight(scene: Scene, frames: int = 8, dt: float = DT) -> Trajectory:
    start = make_start(scene, SPACING, dt)
    time = dt * np.arange(frames)[:, None, None]
    fall = start.initial_velocity * time + 0.5 * np.array(scene.gravity) * time**2
    position = (start.position[0] + fall).astype(np.float32)
    return replace(start, position=position, provenance={"solver": "made up", "seed": 7})


def write_ours(folder: Path, flights: Mapping[str, Sequence[Trajectory]], **spec: Any) -> Path:
    """A set of ours with its manifest."""
    folder.mkdir()
    files, splits, number = {}, {}, 0
    for split in SPLITS:
        names = []
        for flight in flights.get(split, ()):
            names.append(f"trajectory_{number:04d}.h5")
            write_trajectory(folder / names[-1], flight)
            files[names[-1]] = FileRecord(file_sha256(folder / names[-1]), flight.num_frames, flight.num_particles)
            number += 1
        splits[split] = tuple(names)
    first = next(iter(flights.values()))[0]
    moments = {}
    for quantity in ("velocity", "acceleration"):
        seen = RunningStatistics(first.scene.dim)
        for flight in flights.get("train", ()):
            seen.update(getattr(flight, quantity)().reshape(-1, first.scene.dim))
        moments[quantity] = seen.to_dict()
    walls = {face: vars(Wall("slip")) for face in FACES[first.scene.dim]}
    plain = {"name": "ours", "gravity": 9.81, "material": vars(PLASTIC), "walls": walls, "families": {}, **spec}
    manifest = Manifest(1, "ours", first.dt, first.scene.dim, SPACING, (6,), first.material_features, splits, files,
                        moments, 11, plain)  # fmt: skip
    write_manifest(folder, manifest)
    return folder


def metadata_of(folder: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((folder / "metadata.json").read_text())
    return content


DIFFERENT = {
    "box": a_scene(lower=(-1.0, 0.0, 0.0), upper=(1.0, 1.0, 2.0), name="large"),
    "material": a_scene(materials={"sand": PLASTIC}),
    "gravity": a_scene(gravity=(1.0, 0.0, -3.0)),
    "walls": a_scene(walls={face: Wall("slip") for face in FACES[3]}),
    "obstacles": a_scene(
        obstacles=(
            Plane((0.0, 0.0, 0.1), (0.1, 0.0, 1.0), Wall("stick")),
            Box((0.8, 0.0, 0.0), (0.1,) * 3, Wall("slip")),
        )
    ),
    "two layers": a_scene(
        materials={"sand": SAND, "plastic": PLASTIC},
        bodies=(
            Body((0.3, 0.3, 0.3), (0.4, 0.4, 0.2), (0.0,) * 3),
            Body((0.3, 0.3, 0.5), (0.4, 0.4, 0.2), (0.0,) * 3, "plastic"),
        ),
    ),
}
"""What may differ between trajectories of a set of ours."""


def test_a_copy_keeps_every_scene(tmp_path: Path) -> None:
    flights = [a_flight(a_scene()), *map(a_flight, DIFFERENT.values())]
    source = write_ours(tmp_path / "a", {"train": flights[:-1], "test": flights[-1:]})
    copy = converted(source, tmp_path / "b")
    names = read_manifest(copy).splits
    for name, flight in zip([*names["train"], *names["test"]], flights, strict=True):
        found = read_trajectory(copy / name)
        assert found.scene == flight.scene
        for array in ("position", "particle_type", "material", "mass", "initial_velocity"):
            np.testing.assert_array_equal(getattr(found, array), getattr(flight, array))
        np.testing.assert_array_equal(found.volume(), flight.volume())
        assert found.provenance["original"] == flight.provenance
    manifest = read_manifest(copy)
    assert manifest.spec["walls"]["x-"]["condition"] == "slip" and manifest.spec["material"]["density"] == 900
    assert manifest.seed == 11 and manifest.spec["imported"]["specification"]["name"] == "ours"


def test_one_trajectory_of_ours_says_all_of_itself(tmp_path: Path) -> None:
    flight = a_flight(DIFFERENT["material"])
    write_trajectory(tmp_path / "one.h5", flight)
    manifest = read_manifest(converted(tmp_path / "one.h5", tmp_path / "b"))
    assert manifest.spacing == pytest.approx(SPACING, rel=1e-6)
    assert manifest.spec["material"] == vars(PLASTIC)
    assert manifest.spec["walls"] == {face: vars(Wall("friction", 0.385)) for face in FACES[3]}
    assert read_trajectory(tmp_path / "b/train_0000.h5").scene == flight.scene


def test_a_folder_of_sets_names_them(tmp_path: Path) -> None:
    """Sets of every k-th point lie in folders of one that has no manifest itself."""
    (tmp_path / "a").mkdir()
    write_ours(tmp_path / "a/every_3", {"train": [a_flight(a_scene())]})
    with pytest.raises(InputError, match=r"of a data set of gns_pl, of which .*a has 1; name one: .*every_3"):
        open_set(tmp_path / "a")
    assert len(open_set(tmp_path / "a/every_3").names) == 1


def test_a_report_says_what_differs(tmp_path: Path) -> None:
    flights = {"train": [a_flight(each) for each in (a_scene(), DIFFERENT["box"], DIFFERENT["gravity"])]}
    lines = inspect_source(open_set(write_ours(tmp_path / "a", flights)), Given())
    assert "  note: trajectories differ in box, gravity; what is shown here is that of the first" in lines


def test_another_unit_and_other_axes_take_the_scene_along(tmp_path: Path) -> None:
    """z of the source becomes our y, and a unit of it is 2 m."""
    scene = DIFFERENT["obstacles"].replace(
        upper=(1.0, 2.0, 3.0), walls={**DIFFERENT["walls"].walls, "x-": Wall("stick"), "z+": Wall("friction", 0.2)}
    )
    flight = a_flight(scene)
    source = write_ours(tmp_path / "a", {"train": [flight]})
    copy = converted(source, tmp_path / "b", scale=2.0, gravity_axis="x")
    found = read_trajectory(copy / "train_0000.h5")
    axes = [1, 2, 0]
    np.testing.assert_allclose(found.position, 2 * flight.position[:, :, axes], rtol=1e-6)
    new = found.scene
    assert new.upper == (4.0, 6.0, 2.0) and new.gravity == tuple(2 * scene.gravity[axis] for axis in axes)
    assert new.bodies[0].size == (0.8,) * 3 and new.bodies[0].velocity == (0.2, 0.0, 0.2)
    assert new.walls["y+"] == Wall("friction", 0.2) and new.walls["z-"] == Wall("stick")
    plane, box = new.obstacles
    assert isinstance(plane, Plane) and isinstance(box, Box)
    np.testing.assert_allclose(plane.normal, np.array(scene.obstacles[0].normal)[axes])  # type: ignore[union-attr]
    assert plane.point == (0.0, 0.2, 0.0) and box.position == (0.0, 0.0, 1.6) and box.size == (0.2,) * 3
    np.testing.assert_allclose(found.volume(), 8 * flight.volume(), rtol=1e-6)
    imported = read_manifest(copy).spec["imported"]
    assert imported["scale"] == 2 and imported["axes"] == axes
    again = read_manifest(converted(copy, tmp_path / "c", scale=3.0, gravity_axis="x")).spec["imported"]
    assert again["scale"] == 6 and again["axes"] == [2, 0, 1], "which lead to where the first set came from"


@pytest.mark.parametrize("to", ["geoelements", "lagrangebench"])
@pytest.mark.parametrize(
    ("other", "sentence"),
    [
        (
            a_flight(DIFFERENT["box"]),
            r"its box is \[\[-1\.0, 1\.0\], .*that of trajectories before it \[\[0\.0, 1\.0\]",
        ),
        (a_flight(a_scene(), dt=0.02), r"its frames are 0\.02 s apart, those before it 0\.01 s"),
        (a_flight(DIFFERENT["obstacles"]), "its scene has 2 obstacles, and .* has no place for them"),
    ],
)
def test_what_would_be_false_there_is_told(tmp_path: Path, to: str, other: Trajectory, sentence: str) -> None:
    source = write_ours(tmp_path / "a", {"train": [a_flight(a_scene()), other]})
    with pytest.raises(InputError, match=rf"trajectory_0001\.h5: {sentence}"):
        converted(source, tmp_path / "b", to=to)
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_one_box_for_all_may_be_given(tmp_path: Path) -> None:
    source = write_ours(tmp_path / "a", {"train": [a_flight(a_scene()), a_flight(DIFFERENT["box"])]})
    box = {"lower": (-1.0, 0.0, 0.0), "upper": (1.0, 1.0, 2.0)}
    metadata = metadata_of(converted(source, tmp_path / "b", to="geoelements", **box))
    assert metadata["bounds"] == [[-1.0, 1.0], [0.0, 1.0], [0.0, 2.0]]
    copy = converted(source, tmp_path / "c", **box)
    assert {read_header(path).scene.upper for path in copy.glob("*.h5")} == {(1.0, 1.0, 2.0)}


def test_two_time_steps_are_no_set_of_ours(tmp_path: Path) -> None:
    source = write_ours(tmp_path / "a", {"train": [a_flight(a_scene()), a_flight(a_scene(), dt=0.02)]})
    with pytest.raises(InputError, match=r"frames are 0\.01 s apart in some trajectories and 0\.02 s in"):
        converted(source, tmp_path / "b")
    assert read_manifest(converted(source, tmp_path / "c", dt=0.01)).dt == 0.01


def test_a_box_of_the_tests_alone_has_a_part_of_its_own(tmp_path: Path) -> None:
    """geoelements/gns reads "train" in training and "rollout" in rollouts; so do we."""
    flights = {"train": [a_flight(a_scene(), 12), a_flight(a_scene(), 10)], "test": [a_flight(DIFFERENT["box"], 9)]}
    theirs = converted(write_ours(tmp_path / "a", flights), tmp_path / "b", to="geoelements")
    metadata = metadata_of(theirs)
    assert set(metadata) == {"train", "rollout"}
    assert metadata["train"]["bounds"] == [[0.0, 1.0]] * 3 and metadata["train"]["sequence_length"] == 10
    assert metadata["rollout"]["bounds"] == [[-1.0, 1.0], [0.0, 1.0], [0.0, 2.0]]
    assert metadata["rollout"]["sequence_length"] == 9
    for key in ("vel_mean", "acc_std", "default_connectivity_radius", "nnode_in"):
        assert metadata["train"][key] == metadata["rollout"][key], "what the network is trained with"
    back = converted(theirs, tmp_path / "c")
    assert [read_header(back / f"{name}_0000.h5").scene.lower[0] for name in ("train", "test")] == [0.0, -1.0]


def test_parts_of_metadata_go_to_their_splits(tmp_path: Path) -> None:
    position = fixtures.falling(8)
    theirs = fixtures.write_geoelements(tmp_path / "a", {split: [position] for split in SPLITS})
    common = metadata_of(theirs)
    small, large = [[0.0, 1.0]] * 3, [[-1.0, 3.0], [0.0, 1.0], [0.0, 2.0]]
    parts = {"train": {**common, "bounds": small}, "rollout": {**common, "bounds": large}}
    (theirs / "metadata.json").write_text(json.dumps(parts))
    ours = converted(theirs, tmp_path / "b")
    scenes = {split: read_header(ours / f"{split}_0000.h5").scene for split in SPLITS}
    for split, box in {"train": small, "valid": small, "test": large}.items():
        assert [list(pair) for pair in zip(scenes[split].lower, scenes[split].upper, strict=True)] == box
    parts["rollout"]["dt"] = 0.02
    (theirs / "metadata.json").write_text(json.dumps(parts))
    with pytest.raises(InputError, match=r"0\.01 s apart in some trajectories and 0\.02 s in test\.npz"):
        converted(theirs, tmp_path / "c")
    forth = metadata_of(converted(theirs, tmp_path / "d", to="geoelements"))
    assert [forth[part]["dt"] for part in ("train", "rollout")] == [0.01, 0.02]
    (theirs / "metadata.json").write_text(json.dumps({"rollout": parts["rollout"]}))
    assert open_set(theirs, trust=True).stated.dt == 0.02, "the only part there is"


def test_what_has_no_place_and_differs_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    flights = [a_flight(a_scene()), a_flight(DIFFERENT["gravity"]), a_flight(DIFFERENT["material"])]
    source = write_ours(tmp_path / "a", {"train": flights})
    theirs = converted(source, tmp_path / "b", to="geoelements")
    assert "no place for gravity, density, which differ" in capsys.readouterr().out
    found = open_set(theirs, trust=True)
    for number, flight in enumerate(flights):
        with found.recording(number) as recording:
            np.testing.assert_array_equal(recording.material, flight.material)
    converted(source, tmp_path / "c", to="lagrangebench")
    assert "no place for gravity, density, friction, which differ" in capsys.readouterr().out
    more = [*flights, a_flight(DIFFERENT["box"]), a_flight(DIFFERENT["obstacles"])]
    shown = converted(write_ours(tmp_path / "d", {"train": more}), tmp_path / "e", to="vtk")
    assert "no place for gravity, boxes, obstacles, density, which differ" in capsys.readouterr().out
    found = open_set(shown)
    for number, flight in enumerate(more):
        with found.recording(number) as recording:
            assert recording.mass is not None
            np.testing.assert_array_equal(recording.mass, flight.mass)
            np.testing.assert_array_equal(recording.material, flight.material)
    same = write_ours(tmp_path / "f", {"train": flights[:1], "test": flights[:1]})
    for to in ("geoelements", "lagrangebench", "vtk"):
        converted(same, tmp_path / f"g_{to}", to=to)
    assert "Warning" not in capsys.readouterr().out


@pytest.mark.parametrize("gravity", [(0.0, 0.0, 0.0), (5.0, 0.0, -1.0), (0.0, -9.81, 0.0), (0.0, 0.0, 9.81)])
def test_axes_of_ours_are_never_turned(tmp_path: Path, gravity: tuple[float, ...]) -> None:
    flight = a_flight(a_scene(gravity=gravity))
    source = write_ours(tmp_path / "a", {"train": [flight]})
    facts = work_out(open_set(source), Given())
    assert facts.axes == (0, 1, 2) and facts.gravity == gravity
    theirs = converted(source, tmp_path / "b", to="geoelements")
    with open_set(theirs, trust=True).recording(0) as recording:
        np.testing.assert_array_equal(recording.frames(0, 8), flight.position)


def test_no_gravity_turns_nothing(tmp_path: Path) -> None:
    """Said by the user, or by a deck."""
    np.save(tmp_path / "a.npy", fixtures.falling(8, gravity=0.0))
    given = {"dt": 0.01, "lower": (0.0,) * 3, "upper": (1.0,) * 3, "gravity": 0}
    assert find_out(open_set(tmp_path / "a.npy"), Given(**given)).asks == (
        "the unit of length is not stated and nothing falls freely: give scale=1, its length in metres",
    )
    facts = work_out(open_set(tmp_path / "a.npy"), Given(**given, scale=0.5))
    assert facts.axes == (0, 1, 2) and facts.gravity == (0.0, 0.0, 0.0)
    run = tmp_path / "run"
    fixtures.write_cb_geo(run, fixtures.falling(6, gravity=0.0).astype(np.float64))
    fixtures.write_deck(run)
    deck = json.loads((run / "mpm.json").read_text())
    deck["external_loading_conditions"]["gravity"] = [0.0, 0.0, 0.0]
    (run / "mpm.json").write_text(json.dumps(deck))
    assert work_out(open_set(run), Given()).axes == (0, 1, 2)
    deck["external_loading_conditions"]["gravity"] = [0.0, -9.81, 0.5]
    (run / "mpm.json").write_text(json.dumps(deck))
    facts = work_out(open_set(run), Given(gravity=2 * float(np.hypot(9.81, 0.5))))
    assert facts.axes == (2, 0, 1)
    np.testing.assert_allclose(facts.gravity, [1.0, 0.0, -19.62])
