"""Runs of CB-Geo MPM as others have them: a deck for each, resumed, injected, packed, in their authors' folders."""

from __future__ import annotations

import gzip
import shutil
from pathlib import Path

import numpy as np
import pytest

from gns_pl.convert.formats import open_set
from gns_pl.errors import InputError
from tests.convert.formats import fixtures
from tests.convert.formats.fixtures import falling
from tests.convert.formats.test_readers import everything

DEEP = falling(4, side=3).astype(np.float64)


def test_each_run_has_the_deck_that_is_nearest(tmp_path: Path) -> None:
    for name, gravity, friction, size in (("a", 9.81, 30, 1.0), ("b", 1.62, 40, 2.0)):
        fixtures.write_cb_geo(tmp_path / name, DEEP)
        fixtures.write_deck(tmp_path / name, gravity=gravity, frictions={0: friction}, size=size)
    found = open_set(tmp_path)
    for number, (gravity, friction, size) in enumerate(((9.81, 30, 1.0), (1.62, 40, 2.0))):
        with found.recording(number) as recording:
            own = recording.stated
            assert own is not None and own.gravity == (0, 0, -gravity) and own.upper == (size,) * 3
            assert own.friction_angle_deg == friction
            np.testing.assert_allclose(recording.material, np.tan(np.radians(friction)), rtol=1e-6)
    assert found.stated.upper == (2.0,) * 3 and found.stated.dt == pytest.approx(0.01)
    assert any("box, gravity, angle of friction; each keeps its own" in note for note in found.stated.notes)


def test_decks_with_other_times_between_frames_are_told(tmp_path: Path) -> None:
    for name, dt in (("a", 0.001), ("b", 0.002)):
        fixtures.write_cb_geo(tmp_path / name, DEEP)
        fixtures.write_deck(tmp_path / name, dt=dt)
    with pytest.raises(InputError, match=r"different times between frames, a 0\.01 s and b 0\.02 s; convert them one"):
        open_set(tmp_path)


def test_one_deck_for_several_runs_is_told_or_refused(tmp_path: Path) -> None:
    for name in ("a", "b"):
        fixtures.write_cb_geo(tmp_path / "runs" / name, DEEP)
    fixtures.write_deck(tmp_path)
    found = open_set(tmp_path / "runs")
    assert "mpm.json is the deck of all of these, there being no other: a, b" in found.stated.notes[0]
    assert found.stated.dt == pytest.approx(0.01)
    fixtures.write_deck(tmp_path / "runs/a", dt=0.005)
    with pytest.raises(InputError, match="b: has no deck of its own, as a has"):
        open_set(tmp_path / "runs")
    (tmp_path / "mpm.json").unlink()
    with pytest.raises(InputError, match="b: has no deck of its own, as a has"):
        open_set(tmp_path / "runs")
    named = open_set(tmp_path / "runs", deck=tmp_path / "runs/a/mpm.json")
    assert named.stated.dt == pytest.approx(0.05) and "taken for all 2 runs" in named.stated.notes[0]


def test_of_several_decks_the_one_that_names_the_run(tmp_path: Path) -> None:
    for name, dt in (("one", 0.001), ("two", 0.001)):
        fixtures.write_cb_geo(tmp_path / "results" / name, DEEP)
        fixtures.write_deck(tmp_path, dt=dt, name=f"{name}.json", uuid=name, gravity=5.0 if name == "two" else 9.81)
    found = open_set(tmp_path)
    with found.recording(1) as recording:
        assert recording.stated is not None and recording.stated.gravity == (0, 0, -5.0)
    shutil.move(tmp_path / "results/one", tmp_path / "results/three")
    with pytest.raises(InputError, match=r"has 2 different decks for it; say which one: deck="):
        open_set(tmp_path)


def test_a_deck_and_the_one_it_was_resumed_by_are_one(tmp_path: Path) -> None:
    fixtures.write_cb_geo(tmp_path / "results/sand", DEEP)
    for name in ("mpm_input.json", "mpm_input_resume.json"):
        fixtures.write_deck(tmp_path, name=name, uuid="sand")
    assert open_set(tmp_path).stated.dt == pytest.approx(0.01)


def test_the_authors_folders_from_every_level(tmp_path: Path) -> None:
    for number in range(2):
        simulation = tmp_path / f"sims/sand{number}"
        fixtures.write_cb_geo(simulation / "results/uuid", DEEP + number)
        fixtures.write_deck(simulation, name="mpm_input.json", size=2.0, frictions={0: 20 + number})
        (simulation / "entity_sets.json").write_text("{}")
        np.savez(simulation / f"sand{number}.npz", a=DEEP)  # what their script makes of it
    for source in ("sims/sand1", "sims/sand1/results", "sims/sand1/results/uuid"):
        found = open_set(tmp_path / source)
        assert found.kind == "CB-Geo MPM" and found.stated.friction_angle_deg == 21, source
        np.testing.assert_array_equal(everything(found), DEEP + 1)
    both = open_set(tmp_path / "sims")
    assert [name for _, name in both.names] == ["sand0/results/uuid", "sand1/results/uuid"]
    with both.recording(0) as recording:
        assert recording.stated is not None and recording.stated.friction_angle_deg == 20


def test_a_source_in_other_words(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fixtures.write_cb_geo(tmp_path / "sim/results/uuid", DEEP)
    deck = fixtures.write_deck(tmp_path / "sim")
    mesh = deck.with_name("mesh.txt")
    mesh.write_text("! elementShape hexahedron\n" + mesh.read_text())  # a comment of CB-Geo's
    (tmp_path / "elsewhere").mkdir()
    fixtures.write_deck(tmp_path / "elsewhere", dt=7.0)
    for here, source in (("sim/results/uuid", "."), ("elsewhere", "../sim/results")):
        monkeypatch.chdir(tmp_path / here)
        found = open_set(source)
        assert found.stated.dt == pytest.approx(0.01) and found.names[0][1] == "uuid", source
        assert found.stated.upper == (1.0,) * 3
    with pytest.raises(InputError, match="is one step of a run of CB-Geo MPM, if of any; name the folder"):
        open_set(tmp_path / "sim/results/uuid/particles00000.h5")


def test_folders_of_splits_are_the_splits(tmp_path: Path) -> None:
    for split in ("train", "test"):
        fixtures.write_cb_geo(tmp_path / split / "sim/results/uuid", DEEP)
    fixtures.write_deck(tmp_path)
    assert [split for split, _ in open_set(tmp_path).names] == ["test", "train"]


def thrown(folder: Path, displacement: float) -> None:
    """Two cubes held by velocity constraints: they have velocities, and displacements that say nothing of them."""
    velocity = np.where(np.arange(27) < 13, 1.5, -0.5)
    columns = {"velocity_x": velocity, "velocity_z": -0.25}
    fixtures.write_cb_geo(folder, DEEP, columns={**columns, **{f"displacement_{axis}": displacement for axis in "xyz"}})
    fixtures.write_deck(folder)


@pytest.mark.parametrize("displacement", [0.0, -9.81e-6, 3.0])
def test_a_resumed_run_keeps_the_velocity_of_its_first_file(tmp_path: Path, displacement: float) -> None:
    """Displacements are none, those of one step of gravity, or all of the time before."""
    thrown(tmp_path, displacement)
    with open_set(tmp_path).recording(0) as recording:
        assert recording.initial_velocity is not None
        np.testing.assert_array_equal(recording.initial_velocity[:, 0], np.where(np.arange(27) < 13, 1.5, -0.5))
        np.testing.assert_array_equal(recording.initial_velocity[:, 2], -0.25)
        assert any("velocity_* of the first file" in note for note in recording.notes)


def test_velocities_that_agree_leave_it_to_the_displacement(tmp_path: Path) -> None:
    fixtures.write_cb_geo(tmp_path, DEEP, columns={"velocity_x": 1.01, "velocity_y": 2.0, "velocity_z": 3.0})
    fixtures.write_deck(tmp_path)
    with open_set(tmp_path).recording(0) as recording:
        np.testing.assert_allclose(recording.initial_velocity, np.tile([1.0, 2.0, 3.0], (27, 1)), rtol=1e-12)


def test_two_materials_by_their_ids(tmp_path: Path) -> None:
    numbers = np.where(np.arange(27) < 9, 1, 4)
    fixtures.write_cb_geo(
        tmp_path, DEEP, ranks=2, columns={"material_id": numbers, "mass": np.where(numbers == 1, 2, 1)}
    )
    fixtures.write_deck(tmp_path, frictions={1: 20, 4: 45})
    found = open_set(tmp_path)
    with found.recording(0) as recording:
        truth = np.tan(np.radians(np.where(numbers == 1, 20, 45)))
        np.testing.assert_allclose(recording.material[:, 0], truth, rtol=1e-6)
    fixtures.write_deck(tmp_path, frictions={1: 20, 2: 45})
    with pytest.raises(InputError, match=r"of material_id 4, which .*mpm\.json lacks"):
        everything(open_set(tmp_path))
    fixtures.write_deck(tmp_path, frictions={1: 20, 4: 95})
    with pytest.raises(InputError, match="friction of material 4 must be degrees from 0 to below 90"):
        open_set(tmp_path)


@pytest.mark.parametrize(("dim", "volume"), [(3, 1e-3), (2, 1e-2)])
def test_spacing_is_that_of_the_volume(tmp_path: Path, dim: int, volume: float) -> None:
    position = falling(3, dim=dim).astype(np.float64)
    position = np.concatenate([position, np.zeros((*position.shape[:2], 3 - dim))], axis=2)
    fixtures.write_cb_geo(tmp_path, position, columns={"volume": volume})
    assert open_set(tmp_path).stated.spacing == pytest.approx(0.1, rel=1e-6)


def test_packed_files_are_read(tmp_path: Path) -> None:
    fixtures.write_cb_geo(tmp_path, DEEP, ranks=2)
    for path in sorted(tmp_path.glob("particles*.h5"))[1:6]:
        path.with_name(path.name + ".gz").write_bytes(gzip.compress(path.read_bytes()))
        if "00020" not in path.name:  # one lies there both ways
            path.unlink()
    np.testing.assert_array_equal(everything(open_set(tmp_path)), DEEP)


def test_a_packed_file_that_is_cut_off_or_too_large(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fixtures.write_cb_geo(tmp_path, DEEP)
    path = tmp_path / "particles00010.h5"
    packed = gzip.compress(path.read_bytes())
    path.unlink()
    path.with_name(path.name + ".gz").write_bytes(packed[:-20])
    with pytest.raises(InputError, match=r"particles00010\.h5\.gz: is truncated"):
        everything(open_set(tmp_path))
    path.with_name(path.name + ".gz").write_bytes(gzip.compress(bytes(30_000_000)))
    monkeypatch.setattr("gns_pl.convert.formats.limits.free_memory", lambda: 40_000_000)
    with pytest.raises(InputError, match="the unpacked file needs"):
        everything(open_set(tmp_path))


def test_other_packed_data_are_told(tmp_path: Path) -> None:
    for name in ("a.npy", "b.npy"):
        (tmp_path / name).write_bytes(fixtures.npy_bytes(falling()))
    (tmp_path / "b.npy.gz").write_bytes(b"")
    assert len(open_set(tmp_path).names) == 2
    (tmp_path / "c.npz.xz").write_bytes(b"")
    with pytest.raises(InputError, match=r"c\.npz\.xz is packed and would be left out"):
        open_set(tmp_path)


def test_particles_that_come_later(tmp_path: Path) -> None:
    fixtures.write_cb_geo(tmp_path, DEEP, late=range(20, 27))
    with pytest.raises(InputError, match=r": 7 particles appear after the first frame, .*lost=drop the 20 that are"):
        everything(open_set(tmp_path))
    found = open_set(tmp_path, lost="drop")
    np.testing.assert_array_equal(everything(found), DEEP[:, :20])
    with found.recording(0) as recording:
        assert recording.notes[0].startswith("7 particles appear after the first frame; these are left out")


def test_particles_that_come_and_particles_that_leave(tmp_path: Path) -> None:
    """As many come as leave, and none of them is in both the first and the last file."""
    fixtures.write_cb_geo(tmp_path, DEEP, late=[3, 4], lost=[9, 10])
    with pytest.raises(InputError, match="2 of 25 particles left the mesh and 2 particles appear after the first"):
        everything(open_set(tmp_path))
    kept = np.delete(np.arange(27), [3, 4, 9, 10])
    np.testing.assert_array_equal(everything(open_set(tmp_path, lost="drop")), DEEP[:, kept])


@pytest.mark.parametrize("lacking", [[20], [20, 30]])
def test_missing_steps_are_named(tmp_path: Path, lacking: list[int]) -> None:
    fixtures.write_cb_geo(tmp_path, falling(6, side=2).astype(np.float64))
    for step in lacking:
        (tmp_path / f"particles{step:05d}.h5").unlink()
    words = ", ".join(map(str, lacking)) + (" is" if len(lacking) == 1 else " are")
    with pytest.raises(InputError, match=f"do not follow evenly by 10: {words} missing"):
        open_set(tmp_path)


def test_runs_saved_at_other_steps_have_no_common_time(tmp_path: Path) -> None:
    for name, steps in (("a", 10), ("b", 20)):
        fixtures.write_cb_geo(tmp_path / name, DEEP, steps=steps)
    with pytest.raises(InputError, match="not all the same; convert them one by one"):
        open_set(tmp_path)
