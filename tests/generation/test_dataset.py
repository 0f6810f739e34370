"""A data set is complete, described truly, recognised when finished, and never mixed with another."""

from __future__ import annotations

import errno
import json
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from gns_pl.errors import InputError
from gns_pl.generation import generate_dataset
from gns_pl.generation.progress import readable_time
from gns_pl.generation.records import first_difference
from gns_pl.io import StorageError, file_sha256, read_manifest, read_trajectory, verify_dataset
from gns_pl.io.lock import locked
from gns_pl.mpm import settings as solver
from gns_pl.scene import Scene
from gns_pl.trajectory import Trajectory
from tests.generation.fake import DROPS, MPM, fake_solver, make_spec


def sums(root: Path) -> dict[str, str]:
    return {path.name: file_sha256(path) for path in sorted(root.glob("*.h5"))} | {
        "manifest": file_sha256(root / "manifest.json")
    }


def times(root: Path) -> dict[str, int]:
    return {path.name: path.stat().st_mtime_ns for path in root.glob("*.h5")}


@pytest.fixture
def root(faked: None, tmp_path: Path) -> Path:
    return generate_dataset(make_spec(), root=tmp_path / "set", num_workers=1, progress=False)


def test_the_manifest_describes_the_files(root: Path) -> None:
    manifest = verify_dataset(root)
    assert (manifest.name, manifest.seed, manifest.dim, manifest.dt, manifest.spacing) == ("small", 7, 3, 0.01, 0.125)
    assert manifest.particle_types == (6,)
    assert manifest.material_features == ("tan_friction_angle",)
    assert {split: len(names) for split, names in manifest.splits.items()} == {"train": 5, "valid": 2, "test": 1}
    assert manifest.spec == make_spec()
    for name, record in manifest.files.items():
        trajectory = read_trajectory(root / name)
        assert (record.num_frames, record.num_particles) == trajectory.position.shape[:2] != (0, 0)
        assert trajectory.provenance["dataset"] == "small"
        assert trajectory.provenance["solver_version"] == solver.solver_version()
        assert trajectory.provenance["device"] == "cpu"
    kept = {path.name for path in root.iterdir()}
    assert kept == {*manifest.files, "manifest.json", "generation.json", "timings.csv", ".lock"}
    assert len((root / "timings.csv").read_text().splitlines()) == 9


@pytest.mark.parametrize("block_bytes", [1, 3000, 10**8])
def test_statistics_are_those_of_all_training_frames(
    faked: None, tmp_path: Path, block_bytes: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("gns_pl.data.statistics.BLOCK_BYTES", block_bytes)
    root = generate_dataset(make_spec(), root=tmp_path / "set", num_workers=1, progress=False)
    manifest = read_manifest(root)
    trajectories = [read_trajectory(root / name) for name in manifest.splits["train"]]
    for quantity in ("velocity", "acceleration"):
        everything = np.concatenate([getattr(t, quantity)().reshape(-1, 3) for t in trajectories])
        stated = manifest.statistics[quantity]
        assert stated["count"] == len(everything)
        np.testing.assert_allclose(stated["mean"], everything.mean(axis=0), rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(stated["std"], everything.std(axis=0), rtol=1e-9)


def test_a_finished_set_is_left_alone(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any, **__: Any) -> Any:
        pytest.fail("was drawn again")

    before = times(root)
    monkeypatch.setattr("gns_pl.generation.dataset.draw_plan", refuse)
    (root / ".lock").unlink()
    assert generate_dataset({**make_spec(), "root": str(root)}) == root
    assert times(root) == before
    assert not (root / ".lock").exists()  # not even that: the folder may be read-only


def test_a_lost_file_is_made_again_and_is_the_same(root: Path) -> None:
    before, written = sums(root), times(root)
    (root / "trajectory_0003.h5").unlink()
    generate_dataset(make_spec(), root=root, num_workers=1, progress=False)
    assert sums(root) == before
    assert {name for name, when in times(root).items() if when != written[name]} == {"trajectory_0003.h5"}


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"seed": 8}, r"seed is 7 there and 8 is asked for"),
        ({"families": {"cube_drop": DROPS}}, r"families\.low is only there"),
        ({"mpm": {**MPM, "allow_large_courant": False}}, r"mpm\.allow_large_courant is only asked for"),
    ],
)
@pytest.mark.parametrize("finished", [True, False])
def test_another_specification_is_refused(root: Path, changes: dict[str, Any], sentence: str, finished: bool) -> None:
    if not finished:
        (root / "manifest.json").unlink()
    before = times(root)
    with pytest.raises(InputError, match=f"set: holds another data set \\({sentence}\\)"):
        generate_dataset(make_spec(**changes), root=root, num_workers=1, progress=False)
    assert times(root) == before


def test_another_version_of_the_solver_may_not_go_on(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gns_pl.generation.records.solver_version", lambda mpm: "9.9")
    assert generate_dataset(make_spec(), root=root) == root  # but a finished set is one
    (root / "manifest.json").unlink()
    with pytest.raises(InputError, match="begun with another version of the solver"):
        generate_dataset(make_spec(), root=root)


def test_folders_that_hold_something_else_are_refused(faked: None, tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").touch()
    with pytest.raises(InputError, match="not empty and not a data set"):
        generate_dataset(make_spec(), root=tmp_path)
    with pytest.raises(InputError, match="is a file, not a folder"):
        generate_dataset(make_spec(), root=tmp_path / "thesis.tex")
    with pytest.raises(StorageError, match="cannot be made"):
        generate_dataset(make_spec(), root=tmp_path / "thesis.tex" / "set")
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


def test_a_specification_without_a_folder_is_refused() -> None:
    with pytest.raises(InputError, match="root must name the folder"):
        generate_dataset(make_spec())


def test_a_damaged_record_is_named(root: Path) -> None:
    (root / "manifest.json").unlink()
    (root / "generation.json").write_text("{")
    with pytest.raises(InputError, match=r"generation\.json: is damaged"):
        generate_dataset(make_spec(), root=root)


def test_half_a_copy_of_a_set_is_named(root: Path) -> None:
    (root / "generation.json").unlink()
    assert generate_dataset(make_spec(), root=root) == root
    (root / "trajectory_0001.h5").unlink()
    with pytest.raises(InputError, match=r"lacks files of its manifest and generation\.json"):
        generate_dataset(make_spec(), root=root)


def test_a_foreign_file_in_a_planned_place_is_named_and_kept(faked: None, root: Path) -> None:
    (root / "manifest.json").unlink()
    (root / "trajectory_0001.h5").write_bytes((root / "trajectory_0002.h5").read_bytes())
    (root / "trajectory_0004.h5").write_bytes(b"half a file")
    before = times(root)
    with pytest.raises(InputError, match=r"2 of 8 trajectories failed \(trajectory_0001.h5, trajectory_0004.h5; "):
        generate_dataset(make_spec(), root=root, num_workers=1, progress=False)
    assert times(root) == before
    log = (root / "failures.log").read_text()
    assert "holds another scene" in log
    assert "is not an HDF5 file" in log


def test_failed_trajectories_are_named_others_go_on_and_only_they_are_tried_again(
    faked: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def failing(scene: Scene, *arguments: Any, **rest: Any) -> Trajectory:
        if scene.name == "cube_drop_0002":
            raise RuntimeError("no longer finite")
        return fake_solver(scene, *arguments, **rest)

    root = tmp_path / "set"
    monkeypatch.setattr(solver, "run_solver", failing)
    with pytest.raises(InputError, match=r"1 of 8 trajectories failed \(trajectory_0002.h5; .*no longer finite\)"):
        generate_dataset(make_spec(), root=root, num_workers=1)
    assert "trajectory_0002.h5 failed: RuntimeError: no longer finite" in capsys.readouterr().err
    assert "Traceback" in (root / "failures.log").read_text()
    before = times(root)
    assert len(before) == 7
    assert not (root / "manifest.json").exists()
    monkeypatch.setattr(solver, "run_solver", fake_solver)
    generate_dataset(make_spec(), root=root, num_workers=1, progress=False)
    assert times(root).items() >= before.items()
    assert not (root / "failures.log").exists()
    verify_dataset(root)


def test_a_full_disk_stops_at_once(faked: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    root = tmp_path / "set"
    monkeypatch.setattr("shutil.disk_usage", lambda _: type("Usage", (), {"free": 1000}))
    with pytest.raises(StorageError, match=r"set: needs about .* GB, and only .* GB are free"):
        generate_dataset(make_spec(), root=root, num_workers=1, progress=False)
    assert not list(root.glob("*.h5"))


def test_what_is_coming_is_told(
    faked: None, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a clock on which a simulation takes a second per particle and nothing else takes any time."""
    now = [0.0]

    def ticking(scene: Scene, *arguments: Any, **rest: Any) -> Trajectory:
        trajectory = fake_solver(scene, *arguments, **rest)
        now[0] += trajectory.num_particles
        return trajectory

    def compiling(*_: Any, **__: Any) -> None:
        now[0] += 5000  # is done once, so it says nothing about the time left

    monkeypatch.setattr("gns_pl.generation.progress.time", SimpleNamespace(monotonic=lambda: now[0]))
    monkeypatch.setattr(solver, "run_solver", ticking)
    monkeypatch.setattr(solver, "compile_solver", compiling)
    root = generate_dataset(make_spec(), root=tmp_path / "set", num_workers=1)
    sizes = [record.num_particles for record in read_manifest(root).files.values()]
    told = capsys.readouterr().err
    assert f"small: 8 trajectories, {sum(sizes)} particles in all, into {root}; 8 to simulate" in told
    assert f"small: 7 trajectories left, about {readable_time(sum(sizes) - max(sizes))}." in told
    assert f"small: 8 trajectories are in {root}." in told


def test_sand_that_sinks_by_its_own_weight_is_told_once(
    faked: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    spec = make_spec()
    soft = spec | {"material": spec["material"] | {"youngs_modulus": 2e4}}
    generate_dataset(soft, root=tmp_path / "set", num_workers=1)
    said = capsys.readouterr().err
    assert said.count("weight alone compresses 'sand'") == 1 and "set its youngs_modulus to" in said


def test_two_processes_take_turns(faked: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    root = tmp_path / "set"
    root.mkdir()
    done: list[Path] = []
    thread = threading.Thread(target=lambda: done.append(generate_dataset(make_spec(), root=root, num_workers=1)))
    with locked(root / ".lock"):
        thread.start()
        thread.join(0.5)
        assert thread.is_alive()
        assert not (root / "generation.json").exists()
    thread.join()
    assert done == [root]
    assert f"{root}: another process is generating it; waiting for it." in capsys.readouterr().err


def test_differences_are_found_by_their_key() -> None:
    assert first_difference({"a": {"b": [1, 2]}}, {"a": {"b": [1, 2.0]}}) is None
    assert first_difference({"a": {"b": 1}}, {"a": {"b": 2}}) == "a.b is 1 there and 2 is asked for"
    assert first_difference({"a": 1, "b": 1}, {"a": 1}) == "b is only there"
    assert first_difference({"a": {"b": 1}}, {"a": 3}) == "a is {'b': 1} there and 3 is asked for"


def test_two_workers_and_the_real_solver_give_what_one_worker_gives(tmp_path: Path) -> None:
    spec = make_spec(families={"cube_drop": {**DROPS, "count": 4, "duration": 0.03}})
    one = generate_dataset(spec, root=tmp_path / "one", num_workers=1, progress=False)
    two = generate_dataset(json.loads(json.dumps(spec)), root=tmp_path / "two", num_workers=2, progress=False)
    assert sums(one) == sums(two)
    assert read_trajectory(one / "trajectory_0000.h5").provenance["solver"] == "gns_pl.mpm"


def test_a_file_system_without_locks_and_sync_takes_the_same_set(
    root: Path, faked: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """What another process may be writing there is left alone, for nobody can tell whether it is at work."""

    def refuse(*args: object) -> None:
        raise OSError(errno.ENOSYS, "Function not implemented")

    for name in ("os.fsync", "fcntl.flock", "fcntl.lockf"):
        monkeypatch.setattr(name, refuse)
    other = tmp_path / "other"
    other.mkdir()
    part = other / ".trajectory_0000.h5.1-abcd.part"
    part.touch()
    capsys.readouterr()
    generate_dataset(make_spec(), root=other, num_workers=1, progress=False)
    assert sums(other) == sums(root) and part.exists()
    assert capsys.readouterr().err == (
        f"{other}: its file system has no locks (Function not implemented); let one process at a time write there.\n"
    )
