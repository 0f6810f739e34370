"""On a GPU many scenes run at once; one that cannot be run takes no other with it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from gns_pl.errors import InputError
from gns_pl.generation import batches, generate_dataset
from gns_pl.generation.batches import group
from gns_pl.io import StorageError, read_trajectory, verify_dataset
from gns_pl.mpm import settings as solver
from gns_pl.scene import Scene
from gns_pl.trajectory import Trajectory
from tests.generation.fake import fake_batch, fake_solver, make_spec, make_thinned_spec
from tests.generation.test_dataset import times


@pytest.fixture
def launches(faked: None, monkeypatch: pytest.MonkeyPatch) -> list[list[str]]:
    """A GPU that runs the fake solver; the names of the scenes of every launch."""
    made: list[list[str]] = []

    def counting(scenes: Sequence[Scene], *arguments: Any, **rest: Any) -> list[Trajectory]:
        made.append([scene.name for scene in scenes])
        return fake_batch(scenes, *arguments, **rest)

    monkeypatch.setattr("numba.cuda.is_available", lambda: True)
    monkeypatch.setattr(solver, "run_batch", counting)
    return made


def on_gpu(root: Path, **changes: Any) -> Path:
    return generate_dataset(make_spec(**changes), root=root, device="cuda", progress=False)


def test_batches_are_neighbours_that_fit() -> None:
    assert group({3: 2, 1: 2, 0: 5, 4: 1, 5: 9, 6: 1}, 5) == [[3, 1], [0], [4], [5], [6]]
    assert group({3: 2, 1: 2, 0: 5}, 100) == [[3, 1, 0]]
    assert group({}, 5) == []


@pytest.mark.parametrize("device", ["cuda", "auto"])
def test_a_set_is_what_the_processor_makes(launches: list[list[str]], tmp_path: Path, device: str) -> None:
    gpu = generate_dataset(make_spec(), root=tmp_path / "gpu", device=device, progress=False)
    assert len(launches) == 1
    assert len(launches[0]) == 8
    cpu = generate_dataset(make_spec(), root=tmp_path / "cpu", num_workers=1, progress=False)
    assert len(launches) == 1
    for name in verify_dataset(gpu).files:
        one, other = read_trajectory(gpu / name), read_trajectory(cpu / name)
        assert (one.position == other.position).all()
        assert one.provenance == {**other.provenance, "device": "cuda"}
        assert other.provenance["device"] == "cpu"
    seconds = [float(line.split(",")[1]) for line in (gpu / "timings.csv").read_text().splitlines()[1:]]
    assert len(seconds) == 8
    assert verify_dataset(gpu).statistics == verify_dataset(cpu).statistics


def test_batches_are_bounded_and_go_on_where_a_killed_run_was(
    launches: list[list[str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    root = on_gpu(tmp_path / "set")
    lost = ["trajectory_0001.h5", "trajectory_0004.h5", "trajectory_0006.h5"]
    for name in ["manifest.json", *lost]:
        (root / name).unlink()
    before, launches[:] = times(root), []
    monkeypatch.setattr(batches, "BATCH_BYTES", 1)
    assert on_gpu(root) == root
    assert sorted(launches) == [["cube_drop_0001"], ["cube_drop_0004"], ["low_0001"]]
    assert times(root).items() >= before.items()
    verify_dataset(root)


def test_every_k_is_stored(launches: list[list[str]], tmp_path: Path) -> None:
    generate_dataset(make_thinned_spec(), root=tmp_path / "set", device="cuda", progress=False)
    assert len(launches) == 1
    for every in (2, 3):
        assert len(verify_dataset(tmp_path / "set" / f"every_{every}").files) == 8


def test_a_scene_that_cannot_be_run_is_lost_alone(
    launches: list[list[str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    used = []

    def failing(scene: Scene, *arguments: Any, **rest: Any) -> Trajectory:
        used.append(rest["device"])
        if scene.name == "cube_drop_0002":
            raise RuntimeError("no longer finite")
        return fake_solver(scene, *arguments, **rest)

    def failing_batch(scenes: Sequence[Scene], *_: Any, **__: Any) -> list[Trajectory]:
        raise RuntimeError("one of them")

    monkeypatch.setattr(solver, "run_solver", failing)
    monkeypatch.setattr(solver, "run_batch", failing_batch)
    with (
        pytest.warns(UserWarning, match=r"8 scenes at once failed on the GPU \(one of them\); they go one by one"),
        pytest.raises(InputError, match=r"1 of 8 trajectories failed \(trajectory_0002.h5; .*no longer finite\)"),
    ):
        on_gpu(tmp_path / "set")
    assert len(times(tmp_path / "set")) == 7
    assert used == ["cuda"] * 8


def test_a_full_disk_ends_it(launches: list[list[str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(path: Path, trajectory: Trajectory) -> None:
        raise StorageError(f"{path}: cannot be written (No space left on device).")

    monkeypatch.setattr("gns_pl.generation.produce.write_trajectory", refuse)
    with pytest.raises(StorageError, match="No space left"):
        on_gpu(tmp_path / "set")


def test_where_it_runs_is_told(launches: list[list[str]], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    generate_dataset(make_spec(), root=tmp_path / "set", device="cuda")
    assert " GB) on the GPU." in capsys.readouterr().err


def test_devices(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("numba.cuda.is_available", lambda: False)
    assert solver.choose_device("auto") == solver.choose_device("cpu") == "cpu"
    with pytest.raises(InputError, match="device=cuda: numba finds no CUDA device here; choose device=cpu, or auto"):
        on_gpu(tmp_path / "set")
    with pytest.raises(InputError, match="device must be one of auto, cpu, cuda, not 'gpu'"):
        generate_dataset(make_spec(), root=tmp_path / "set", device="gpu")
    assert not (tmp_path / "set").exists()
