"""The data module of a small set: whose windows, whose statistics, whose share, and where it goes on."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from gns_pl.data import statistics
from gns_pl.data.datamodule import TrajectoryDataModule, TrajectoryDataset
from gns_pl.errors import InputError
from gns_pl.fields import ParticleType
from gns_pl.io import read_trajectory
from gns_pl.scene import Plane, Wall
from gns_pl.trajectory import Trajectory
from tests.data.sets import make_flight, make_scene, write_set

FRAMES = (9, 7, 8, 6)
"""Of the trajectories of the set; the last one is held out."""


def flights(frames: tuple[int, ...] = FRAMES) -> list[Trajectory]:
    scenes = [make_scene(velocity=(0.1 * index, -0.2, 0.3)) for index in range(1, len(frames) + 1)]
    return [make_flight(scene, number) for scene, number in zip(scenes, frames, strict=True)]


def module(folder: Path, **changes: Any) -> TrajectoryDataModule:
    settings: dict[str, Any] = {
        "batch_size": 4,
        "num_steps": 10,
        "input_sequence_length": 3,
        "num_targets": 1,
        "stride": 1,
        "start_repeats": 1,
        "moving_repeats": 1,
        "num_workers": 0,
        "memory_limit": 1e9,
        "num_train": None,
        "seed": 5,
    }
    made = TrajectoryDataModule(folder, **(settings | changes))
    made.setup("fit")
    return made


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_set(tmp_path / "set", flights())
    return tmp_path / "set"


def test_windows_are_of_the_training_trajectories_alone(folder: Path) -> None:
    whole, two = module(folder), module(folder, num_train=2)
    assert len(whole.train_set) == (9 - 1) + (7 - 1) + (8 - 1)
    assert len(two.train_set) == (9 - 1) + (7 - 1) and two.train_names == whole.train_names[:2]
    assert whole.valid_names == ("trajectory_0003.h5",)


@pytest.mark.parametrize("number", [0, 4, -1])
def test_more_trajectories_than_there_are_cannot_be_asked_for(folder: Path, number: int) -> None:
    with pytest.raises(InputError, match=rf"training.num_train is {number}, but the set has 3 training trajectories"):
        module(folder, num_train=number)


def test_a_set_is_kept_in_memory_up_to_the_limit_and_is_the_same_from_files(folder: Path) -> None:
    manifest = module(folder).manifest
    names = manifest.splits["train"]
    size = sum(4 * 3 * manifest.files[name].num_frames * manifest.files[name].num_particles for name in names)
    inside, outside = module(folder, memory_limit=size), module(folder, memory_limit=size - 1)
    assert inside.in_memory and not outside.in_memory
    for index in (0, 8, 20):
        assert torch.equal(inside.train_set[index].position, outside.train_set[index].position)


@pytest.mark.parametrize("stride", [1, 2])
@pytest.mark.parametrize("block_bytes", [1, 10**8])
def test_statistics_are_those_of_all_training_frames(
    folder: Path, stride: int, block_bytes: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whether a file is read at once or frame by frame."""
    monkeypatch.setattr(statistics, "BLOCK_BYTES", block_bytes)
    measured = module(folder, stride=stride).statistics()
    trajectories = [read_trajectory(folder / f"trajectory_000{index}.h5").every(stride) for index in range(3)]
    for name in ("velocity", "acceleration"):
        values = np.concatenate([getattr(each, name)().reshape(-1, 3) for each in trajectories]).astype(np.float64)
        assert measured[name].count == len(values)
        np.testing.assert_allclose(measured[name].mean, values.mean(axis=0), atol=1e-4)
        np.testing.assert_allclose(measured[name].std, values.std(axis=0), atol=1e-3)


def test_kinematic_particles_have_no_part_in_statistics(tmp_path: Path) -> None:
    """A third stands still for ever; the others fall by gravity to the last digit."""
    mixed = []
    for flight in flights():
        position, types, velocity = flight.position.copy(), flight.particle_type.copy(), flight.initial_velocity.copy()
        types[::3], velocity[::3] = int(ParticleType.KINEMATIC), 0.0
        position[:, ::3] = position[:1, ::3]
        mixed.append(replace(flight, position=position, particle_type=types, initial_velocity=velocity))
    write_set(tmp_path / "set", mixed)
    acceleration = module(tmp_path / "set").statistics()["acceleration"]
    np.testing.assert_allclose(acceleration.mean[:2], 0.0, atol=0.02)
    assert -9.81 <= acceleration.mean[2] < -8.5  # the first step has only half of it


def test_going_on_gives_the_batches_that_were_left(folder: Path) -> None:
    whole = [batch.position for batch in module(folder).train_dataloader()]
    assert len(whole) == 10
    later = module(folder)
    later.load_state_dict({"steps_made": 6})
    assert later.state_dict() == {"steps_made": 6}
    rest = [batch.position for batch in later.train_dataloader()]
    assert len(rest) == 4 and all(torch.equal(one, other) for one, other in zip(rest, whole[6:], strict=True))


def test_processes_share_every_batch_without_a_rest(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    alone = [batch.position for batch in module(folder).train_dataloader()]
    shares = []
    for rank in range(2):
        part = module(folder)
        monkeypatch.setattr(part, "_processes", lambda rank=rank: (rank, 2))
        shares.append([batch.position for batch in part.train_dataloader()])
    for both, one, other in zip(alone, *shares, strict=True):
        assert torch.equal(torch.cat([one, other]), both)


@pytest.mark.parametrize("ranks", [1, 2, 3, 5])
def test_every_validation_trajectory_is_had_once_and_all_processes_have_as_many(
    tmp_path: Path, ranks: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_set(tmp_path / "set", flights((5, 6, 7, 8)), valid=3)
    counts, seen = [], []
    for rank in range(ranks):
        part = module(tmp_path / "set")
        monkeypatch.setattr(part, "_processes", lambda rank=rank: (rank, ranks))
        trajectories = list(part.val_dataloader())
        counts.append(len(trajectories))
        seen += [trajectory.num_frames for trajectory in trajectories if trajectory is not None]
    assert len(set(counts)) == 1 and sorted(seen) == [6, 7, 8]


def test_a_window_of_a_step_says_where_it_is_from(folder: Path) -> None:
    data = module(folder)
    windows = data.windows_of_step(3)
    [batch] = [batch for step, batch in enumerate(data.train_dataloader()) if step == 3]
    assert torch.equal(torch.cat([window["position"] for window in windows]), batch.position)
    assert [window["number"] for window in windows] == [12, 13, 14, 15]
    for window in windows:
        trajectory = read_trajectory(folder / window["trajectory"])
        np.testing.assert_array_equal(window["position"][:, -1].numpy(), trajectory.position[window["frame"] + 1])


def test_trajectories_are_read_in_the_steps_of_the_model(folder: Path) -> None:
    first, nothing = TrajectoryDataset([folder / "trajectory_0000.h5", None], stride=4)
    stored = read_trajectory(folder / "trajectory_0000.h5")
    assert nothing is None and first.num_frames == 3 and first.dt == pytest.approx(4 * stored.dt)
    np.testing.assert_array_equal(first.position, stored.position[::4])


def test_validation_leaves_out_what_is_too_short_for_a_step_and_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_set(tmp_path / "set", flights((9, 3, 8)), valid=2)
    data = module(tmp_path / "set", stride=3)
    data.check_validation()
    assert data.valid_names == ("trajectory_0002.h5",)
    said = capsys.readouterr().out
    assert "1 of 2 validation trajectories have fewer than the 4 frames" in said and "trajectory_0001.h5" in said
    data = module(tmp_path / "set", stride=8)
    with pytest.raises(InputError, match=r"no validation trajectory has the 9 frames of a step .*limit_val_batches=0"):
        data.check_validation()


def test_validation_with_an_obstacle_is_refused(tmp_path: Path) -> None:
    slope = Plane((0, 0, 0.1), (1, 0, 3), Wall("slip"))
    plain, other = flights((6, 6))
    write_set(tmp_path / "set", [plain, replace(other, scene=other.scene.replace(obstacles=(slope,)))])
    with pytest.raises(InputError, match=r"trajectory_0001\.h5: its scene has obstacles"):
        module(tmp_path / "set").check_validation()


def test_a_radius_that_reaches_nobody_is_refused_before_a_training(folder: Path) -> None:
    data = module(folder)
    data.check_places(0.11)
    with pytest.raises(InputError):
        data.check_places(0.01)
