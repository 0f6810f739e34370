from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gns_pl.convert import convert, inspect_source, sets
from gns_pl.convert.facts import work_out
from gns_pl.convert.formats import open_set
from gns_pl.convert.given import Given
from gns_pl.convert.plan import plan_items
from gns_pl.convert.recordings import Assumed
from gns_pl.data.statistics import RunningStatistics
from gns_pl.errors import InputError
from gns_pl.io import StorageError, read_manifest, read_trajectory, verify_dataset
from gns_pl.metrics.curves import mobile
from gns_pl.metrics.measures import centre_of_mass, kinetic_energy
from gns_pl.metrics.release import front_advance
from tests.commands.in_process import call
from tests.conftest import SAND
from tests.convert.formats import fixtures
from tests.convert.formats.fixtures import falling

ASSUMED = Assumed({**vars(SAND)}, {"condition": "friction", "friction": 0.385})
BOX = {"lower": (0.0, 0.0, 0.0), "upper": (1.0, 1.0, 1.0)}


def converted(source: Path, target: Path, *, to: str = "gns_pl", trust: bool = True, **given: Any) -> Path:
    given = {"material_value": "tan", **given}
    return convert(open_set(source, trust=trust), target, to=to, given=Given(**given), assumed=ASSUMED)


def positions(folder: Path, **options: Any) -> dict[str, list[np.ndarray]]:
    """All positions of a set in any format, by split."""
    found = open_set(folder, trust=True, **options)
    out: dict[str, list[np.ndarray]] = {}
    for number, (split, _) in enumerate(found.names):
        with found.recording(number) as recording:
            out.setdefault(split, []).append(recording.frames(0, recording.num_frames))
    return out


def same(first: dict[str, list[np.ndarray]], second: dict[str, list[np.ndarray]]) -> None:
    assert {split: len(each) for split, each in first.items()} == {split: len(each) for split, each in second.items()}
    for split, each in first.items():
        for one, other in zip(each, second[split], strict=True):
            assert one.dtype == other.dtype == np.float32
            np.testing.assert_array_equal(one, other)


TRUTH = {"train": [falling(8), falling(9, seed=1)], "valid": [falling(8, seed=2)], "test": [falling(7, seed=3)]}
TYPES = np.where(np.arange(64) < 5, 3, 6)


def scripted(position: np.ndarray) -> np.ndarray:
    """The first five particles stand still."""
    position = position.copy()
    position[:, :5] = position[:1, :5]
    return position


SCRIPTED = {split: [scripted(each) for each in all_of] for split, all_of in TRUTH.items()}
EQUAL = {**SCRIPTED, "train": [SCRIPTED["train"][0], scripted(falling(8, seed=1))]}
"""LagrangeBench takes the trajectories of a split to be of one length."""


@pytest.fixture
def geoelements(tmp_path: Path) -> Path:
    return fixtures.write_geoelements(tmp_path / "theirs", SCRIPTED, TYPES, np.float64(0.5))


@pytest.fixture
def equal(tmp_path: Path) -> Path:
    return fixtures.write_geoelements(tmp_path / "theirs", EQUAL, TYPES, np.float64(0.5))


def test_geoelements_becomes_a_data_set_of_ours(geoelements: Path, tmp_path: Path) -> None:
    folder = converted(geoelements, tmp_path / "ours")
    manifest = verify_dataset(folder)
    assert {split: len(names) for split, names in manifest.splits.items()} == {"train": 2, "valid": 1, "test": 1}
    assert manifest.dt == 0.01 and manifest.particle_types == (3, 6)
    assert manifest.spec["gravity"] == pytest.approx(9.81, rel=0.01) and manifest.spec["imported"]["scale"] == 1
    assert manifest.material_features == ("tan_friction_angle",) and manifest.spacing == pytest.approx(0.1, rel=0.25)
    trajectory = read_trajectory(folder / "train_0001.h5")
    np.testing.assert_array_equal(trajectory.position, SCRIPTED["train"][1])
    np.testing.assert_array_equal(trajectory.particle_type, TYPES)
    assert trajectory.scene.gravity[:2] == (0.0, 0.0) and not trajectory.scene.obstacles
    np.testing.assert_allclose(trajectory.mass, 1800 * manifest.spacing**3, rtol=1e-6)
    fall = trajectory.acceleration()[:, 5:]  # from the first frame on, whose velocity no frame before it tells
    np.testing.assert_allclose(fall, np.broadcast_to([0, 0, -9.81], fall.shape), atol=0.05)


def test_observables_are_those_of_what_moves(geoelements: Path, tmp_path: Path) -> None:
    folder = converted(geoelements, tmp_path / "ours")
    for name in read_manifest(folder).files:
        trajectory = read_trajectory(folder / name, observables=True)
        found = trajectory.observables
        assert found is not None and found.cell == pytest.approx(2 * read_manifest(folder).spacing)
        moved = mobile(trajectory)
        assert moved.num_particles == trajectory.num_particles - 5
        np.testing.assert_allclose(found.mean_height, centre_of_mass(moved)[:, -1], rtol=1e-6)
        np.testing.assert_allclose(found.kinetic_energy, kinetic_energy(moved), rtol=1e-5)
        np.testing.assert_allclose(found.advance()[:, found.percents.index(99)], front_advance(moved), atol=1e-6)
        np.testing.assert_allclose(found.volume_map.sum(axis=(1, 2)), moved.volume().sum(), rtol=1e-5)


def test_statistics_are_those_of_what_moves(geoelements: Path, tmp_path: Path) -> None:
    folder = converted(geoelements, tmp_path / "ours")
    statistics = read_manifest(folder).statistics
    velocity, acceleration = RunningStatistics(3), RunningStatistics(3)
    for number in range(2):
        trajectory = read_trajectory(folder / f"train_{number:04d}.h5")
        velocity.update(trajectory.velocity()[:, 5:].reshape(-1, 3))
        acceleration.update(trajectory.acceleration()[:, 5:].reshape(-1, 3))
    for quantity, truth in (("velocity", velocity), ("acceleration", acceleration)):
        assert statistics[quantity]["count"] == truth.count
        np.testing.assert_allclose(statistics[quantity]["mean"], truth.mean, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(statistics[quantity]["std"], truth.std, rtol=1e-9)
    assert statistics["acceleration"]["mean"][2] == pytest.approx(-9.81, abs=0.01)


@pytest.mark.parametrize("to", ["geoelements", "lagrangebench", "vtk"])
def test_round_trips_keep_every_bit(tmp_path: Path, to: str) -> None:
    truth = EQUAL if to == "lagrangebench" else SCRIPTED
    ours = converted(fixtures.write_geoelements(tmp_path / "theirs", truth, TYPES, np.float64(0.5)), tmp_path / "ours")
    theirs = converted(ours, tmp_path / "exported", to=to)
    back = converted(theirs, tmp_path / "back", **({**BOX} if to == "vtk" else {}))
    same(positions(ours), truth)
    same(positions(theirs), truth)
    same(positions(back), truth)
    for path in sorted(ours.glob("*.h5")):
        first, second = read_trajectory(path), read_trajectory(back / path.name)
        assert first.dt == pytest.approx(second.dt, rel=1e-9)
        np.testing.assert_array_equal(first.particle_type == 3, second.particle_type == 3)
        if to != "lagrangebench":
            np.testing.assert_array_equal(first.particle_type, second.particle_type)
            np.testing.assert_array_equal(first.material, second.material)


@pytest.mark.parametrize("dim", [2, 3])
def test_vtk_in_two_and_three_dimensions(tmp_path: Path, dim: int) -> None:
    (tmp_path / "plain").mkdir()
    for number in range(3):
        np.save(tmp_path / f"plain/{number}.npy", falling(5, dim=dim, seed=number))
    box = {"lower": (0.0,) * dim, "upper": (1.0,) * dim}
    ours = converted(tmp_path / "plain", tmp_path / "ours", dt=0.01, **box)
    back = converted(converted(ours, tmp_path / "vtk", to="vtk"), tmp_path / "back", **box)
    same(positions(back), positions(ours))
    for path in back.glob("*.h5"):
        first, second = read_trajectory(ours / path.name), read_trajectory(path)
        np.testing.assert_array_equal(first.initial_velocity, second.initial_velocity)
        np.testing.assert_array_equal(first.mass, second.mass)


def test_exported_metadata_say_what_the_data_are(equal: Path, tmp_path: Path) -> None:
    theirs = converted(equal, tmp_path / "exported", to="lagrangebench")
    metadata = json.loads((theirs / "metadata.json").read_text())
    steps = np.concatenate([np.diff(each.astype(float), axis=0)[:, 5:].reshape(-1, 3) for each in EQUAL["train"]])
    second = np.concatenate([np.diff(e.astype(float), n=2, axis=0)[:, 5:].reshape(-1, 3) for e in EQUAL["train"]])
    for key, values in (("vel", steps), ("acc", second)):
        np.testing.assert_allclose(metadata[f"{key}_mean"], values.mean(axis=0), rtol=1e-9, atol=1e-15)
        np.testing.assert_allclose(metadata[f"{key}_std"], values.std(axis=0), rtol=1e-9)
    assert metadata["dt"] * metadata["write_every"] == 0.01 and metadata["sequence_length"] == 7
    assert metadata["default_connectivity_radius"] == 0.15 and metadata["num_trajs_train"] == 2


def test_blocks_make_no_difference(equal: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for to in ("gns_pl", "lagrangebench"):
        whole = converted(equal, tmp_path / f"whole_{to}", to=to)
        monkeypatch.setattr("gns_pl.convert.recordings.BLOCK_BYTES", 8 * 64 * 3 * 2)  # two frames
        parts = converted(equal, tmp_path / f"parts_{to}", to=to)
        monkeypatch.undo()
        same(positions(whole), positions(parts))
    first, second = (
        json.loads((tmp_path / f"{w}_lagrangebench/metadata.json").read_text()) for w in ("whole", "parts")
    )
    np.testing.assert_allclose(first["acc_std"], second["acc_std"], rtol=1e-12)


@pytest.mark.parametrize("factor", [80.0, 1000.0])
def test_any_unit_of_length(tmp_path: Path, factor: float) -> None:
    """Positions in 0–80 are the same set as in metres, once it is said how long a unit is, which free fall tells."""
    (tmp_path / "plain").mkdir()
    for number in range(3):
        np.save(tmp_path / f"plain/{number}.npy", (falling(6, seed=number) * factor).astype(np.float32))
    box = {"lower": (0.0,) * 3, "upper": (factor,) * 3}
    with pytest.raises(InputError, match=rf"the unit of length is not the metre: give scale={1 / factor:g} "):
        converted(tmp_path / "plain", tmp_path / "ours", dt=0.01, **box)
    assert not (tmp_path / "ours").exists()
    ours = converted(tmp_path / "plain", tmp_path / "ours", dt=0.01, scale=1 / factor, **box)
    np.testing.assert_allclose(positions(ours)["train"][0], falling(6), rtol=1e-6)
    manifest = read_manifest(ours)
    assert manifest.spacing == pytest.approx(0.1, rel=0.25) and manifest.spec["gravity"] == pytest.approx(
        9.81, rel=0.01
    )
    kept = converted(tmp_path / "plain", tmp_path / "kept", dt=0.01, scale=1, **box)
    assert read_manifest(kept).spec["gravity"] == pytest.approx(9.81 * factor, rel=0.01)


@pytest.mark.parametrize(("dim", "vertical"), [(3, 0), (3, 1), (3, 2), (2, 0), (2, 1)])
def test_any_axis_may_be_the_vertical_one(tmp_path: Path, dim: int, vertical: int) -> None:
    position = np.roll(falling(6, dim=dim, side=5), vertical + 1, axis=2)
    np.save(tmp_path / "a.npy", position)
    box = {"lower": (-1.0,) * dim, "upper": tuple(1.0 + k for k in range(dim))}
    ours = converted(tmp_path / "a.npy", tmp_path / "ours", dt=0.01, **box)
    manifest, trajectory = read_manifest(ours), read_trajectory(ours / "train_0000.h5")
    axes = manifest.spec["imported"]["axes"]
    assert axes[-1] == vertical and trajectory.scene.gravity[-1] == pytest.approx(-9.81, rel=0.01)
    np.testing.assert_array_equal(trajectory.position, position[:, :, axes])
    assert trajectory.scene.upper == tuple(1.0 + k for k in axes)
    if dim == 3:
        assert np.linalg.det(np.eye(3)[axes]) == pytest.approx(1), "nothing is mirrored"


@pytest.mark.parametrize("dim", [2, 3])
def test_spacing_is_seen(tmp_path: Path, dim: int) -> None:
    np.save(tmp_path / "a.npy", falling(6, dim=dim, side=9))
    facts = work_out(open_set(tmp_path), Given(dt=0.01, lower=(0.0,) * dim, upper=(2.0,) * dim))
    assert facts.spacing == pytest.approx(0.1, rel=0.05)


def test_what_is_missing_is_asked_for_at_once(tmp_path: Path) -> None:
    still = np.repeat(falling(1), 6, axis=0)
    np.save(tmp_path / "a.npy", still)
    with pytest.raises(InputError, match=r"give dt=0\.0025.*give lower=… upper=…"):
        converted(tmp_path / "a.npy", tmp_path / "ours")
    with pytest.raises(InputError, match=r"nothing falls freely: give gravity_axis=z gravity=9\.81 scale=1"):
        converted(tmp_path / "a.npy", tmp_path / "ours", dt=0.01, **BOX)
    more = {"gravity": 9.81, "gravity_axis": "z", "scale": 1}
    ours = converted(tmp_path / "a.npy", tmp_path / "ours", dt=0.01, **BOX, **more)
    assert read_trajectory(ours / "train_0000.h5").scene.gravity == (0.0, 0.0, -9.81)


def test_gravity_upwards_and_periodic_boxes_are_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", -falling())
    with pytest.raises(InputError, match="particles fall upwards"):
        converted(tmp_path / "a.npy", tmp_path / "ours", dt=0.01, **BOX)
    fixtures.write_lagrangebench(tmp_path / "lb", {"train": [falling()]}, np.zeros(64, dtype=int))
    fixtures.write_metadata(tmp_path / "lb", periodic_boundary_conditions=[True, False, False])
    with pytest.raises(InputError, match="periodic along an axis"):
        converted(tmp_path / "lb", tmp_path / "ours")


def _broken(position: np.ndarray) -> np.ndarray:
    position = position.copy()
    position[4, 7, 1] = np.nan
    return position


@pytest.mark.parametrize("to", ["gns_pl", "geoelements", "lagrangebench", "vtk"])
@pytest.mark.parametrize(
    ("spoil", "sentence"),
    [
        (lambda each: _broken(each), "not finite from frame 4 on"),
        (lambda each: each.astype(np.int64), "must be floating-point numbers, not int64"),
        (lambda each: each[:, :, :2], "has 2 dimensions|in two and in three"),
        (lambda each: [frame[: 60 + k] for k, frame in enumerate(each)], "number of particles must not change"),
    ],
)
def test_a_spoilt_trajectory_leaves_nothing_behind(
    tmp_path: Path, to: str, spoil: Callable[[np.ndarray], Any], sentence: str
) -> None:
    """The last of six is spoilt, and all before it are written by then."""
    sound = [falling(8, seed=number) for number in range(6)]
    members = {}
    for number, each in enumerate(sound):
        row = fixtures.objects(each if number < 5 else spoil(each), TYPES)
        members[f"t{number}"] = fixtures.pickled_npy(row, row.shape)
    (tmp_path / "theirs").mkdir()
    fixtures.write_zip(tmp_path / "theirs/train.npz", members)
    fixtures.write_metadata(tmp_path / "theirs")
    with pytest.raises(InputError, match=sentence) as caught:
        converted(tmp_path / "theirs", tmp_path / "ours", to=to)
    assert "t5" in str(caught.value) or "in two and in three" in str(caught.value)
    assert [path.name for path in tmp_path.iterdir()] == ["theirs"]


def test_a_target_that_is_there_is_left_alone(geoelements: Path, tmp_path: Path) -> None:
    (tmp_path / "ours").mkdir()
    with pytest.raises(InputError, match="exists already"):
        converted(geoelements, tmp_path / "ours")
    with pytest.raises(InputError, match="lies in the source"):
        converted(geoelements, geoelements / "ours")


def test_a_broken_off_conversion_goes_on(geoelements: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    writes: list[str] = []
    original = sets._write

    def write(path: Path, *arguments: Any) -> None:
        if len(writes) == 2:
            raise KeyboardInterrupt
        writes.append(path.name)
        original(path, *arguments)

    monkeypatch.setattr(sets, "_write", write)
    with pytest.raises(KeyboardInterrupt):
        converted(geoelements, tmp_path / "ours")
    assert not (tmp_path / "ours").exists()
    part = tmp_path / ".ours.converting"
    stamps = {path.name: path.stat().st_mtime_ns for path in part.glob("*.h5")}
    assert sorted(stamps) == ["train_0000.h5", "train_0001.h5"]
    monkeypatch.setattr(sets, "_write", original)
    ours = converted(geoelements, tmp_path / "ours")
    assert {name: (ours / name).stat().st_mtime_ns for name in stamps} == stamps
    same(positions(ours), SCRIPTED)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["ours", "theirs"]
    assert sorted(path.suffix for path in ours.iterdir()) == [".h5"] * 4 + [".json"]


@pytest.mark.parametrize("to", ["gns_pl", "geoelements", "lagrangebench"])
def test_a_full_disk_is_one_sentence(equal: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, to: str) -> None:
    def full(*arguments: Any, **options: Any) -> None:
        raise OSError(28, "No space left on device")

    for place in (
        "gns_pl.io.stream.h5py.File.flush",
        "gns_pl.convert.formats.geoelements.write_pickle",
        "h5py.Group.create_group",
    ):
        monkeypatch.setattr(place, full)
    with pytest.raises(StorageError, match="cannot be written"):
        converted(equal, tmp_path / "ours", to=to)
    monkeypatch.undo()
    assert (tmp_path / ".ours.converting").is_dir() and not (tmp_path / "ours").exists()
    converted(equal, tmp_path / "ours", to=to)


def test_other_settings_begin_anew(geoelements: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sets, "write_manifest", lambda *arguments: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        converted(geoelements, tmp_path / "ours")
    monkeypatch.undo()
    ours = converted(geoelements, tmp_path / "ours", types={6: 5})
    assert read_manifest(ours).particle_types == (3, 5)


def test_splits_are_kept_or_made() -> None:
    def splits(names: list[tuple[str, str]], **counts: int) -> list[str]:
        items = plan_items(names, **{"valid": 1, "test": 1, **counts})
        return [item.split for item in sorted(items, key=lambda item: item.number)]

    none = [("", str(number)) for number in range(4)]
    assert splits(none) == ["train", "train", "valid", "test"]
    assert splits(none[:1]) == ["train"] and splits(none[:2]) == ["train", "valid"]
    assert splits(none, valid=0, test=0) == ["train"] * 4 and splits(none, valid=9) == ["train"] + ["valid"] * 3
    assert splits([("test", "a"), ("train", "b")]) == ["test", "train"]


def test_cb_geo_with_its_deck_needs_nothing_else(tmp_path: Path) -> None:
    for number in range(3):
        position = falling(6, seed=number).astype(np.float64)
        fixtures.write_cb_geo(tmp_path / f"runs/{number}", position, ranks=2)
    fixtures.write_deck(tmp_path / "runs")
    ours = converted(tmp_path / "runs", tmp_path / "ours")
    trajectory = read_trajectory(ours / "train_0000.h5")
    np.testing.assert_array_equal(trajectory.position, falling(6))
    assert trajectory.dt == pytest.approx(0.01) and trajectory.mass[0] == np.float32(1.8)
    np.testing.assert_allclose(trajectory.initial_velocity[0], [1, 2, 3], rtol=1e-6)
    assert trajectory.scene.materials["sand"].friction_angle_deg == pytest.approx(30)


def test_the_report_says_what_a_source_is(geoelements: Path, tmp_path: Path) -> None:
    text = "\n".join(inspect_source(open_set(geoelements, trust=True), Given(material_value="tan")))
    for part in ("geoelements/gns", "4 (2 train, 1 valid, 1 test)", "T = 7 to 9 frames, N = 64", "unit of length: 1 m",
                 "3 (20 particles), 6 (236 particles)", "tan_friction_angle", "neighbours within 0.15 (stated)",
                 "nothing is missing"):  # fmt: skip
        assert part in text, part
    np.save(tmp_path / "a.npy", falling().astype(np.float64))
    text = "\n".join(inspect_source(open_set(tmp_path / "a.npy"), Given()))
    assert "float64; stored here as float32" in text and "missing: the time between frames" in text


def test_the_command(geoelements: Path, tmp_path: Path) -> None:
    root, typed = Path(__file__).parents[2], partial(call, tmp_path, "convert.py")
    refused = typed("source=theirs", "target=datasets/ours")
    assert refused.returncode == 2 and "trust=true" in refused.stderr and "Traceback" not in refused.stderr
    inspected = typed("source=theirs", "inspect=true", "trust=true", "material_value=tan")
    assert inspected.returncode == 0 and "nothing is missing" in inspected.stdout
    assert not (tmp_path / "datasets").exists()
    asked = ["source=theirs", "target=datasets/ours", "trust=true", "types={6:5}", "name=mine", "spacing=0.1"]
    asked.append("material_value=tan")
    command = [sys.executable, str(root / "convert.py"), *asked]
    made = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert made.returncode == 0, made.stderr
    manifest = read_manifest(tmp_path / "datasets/ours")
    assert manifest.particle_types == (3, 5) and manifest.name == "mine" and manifest.spacing == 0.1
    assert "python train.py data=datasets/ours model.connectivity_radius=0.15" in made.stdout
    same(positions(tmp_path / "datasets/ours"), SCRIPTED)
