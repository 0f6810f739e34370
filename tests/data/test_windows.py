"""Windows are slices of the stored trajectories, with a ballistic pre-history, in memory or read from files."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch
from torch_geometric.loader import DataLoader

from gns_pl.data.windows import WindowDataset
from gns_pl.errors import InputError
from gns_pl.io import write_trajectory
from gns_pl.scene import Plane, Scene, Wall
from gns_pl.trajectory import Trajectory
from tests.conftest import make_moving


@pytest.fixture
def two(drop: Scene, column: Scene) -> list[Trajectory]:
    return [make_moving(drop, frames=9, spacing=0.1), make_moving(column, frames=5, spacing=0.1)]


@pytest.fixture
def paths(two: list[Trajectory], tmp_path: Path) -> list[Path]:
    for index, trajectory in enumerate(two):
        write_trajectory(tmp_path / f"{index}.h5", trajectory)
    return [tmp_path / "0.h5", tmp_path / "1.h5"]


@pytest.mark.parametrize("in_memory", [True, False])
@pytest.mark.parametrize(("stride", "num_targets"), [(1, 1), (1, 3), (2, 2)])
def test_every_window_is_a_slice(
    two: list[Trajectory], paths: list[Path], in_memory: bool, stride: int, num_targets: int
) -> None:
    windows = WindowDataset(
        paths, input_sequence_length=4, num_targets=num_targets, stride=stride, start_repeats=1, in_memory=in_memory
    )
    expected_frames = [(w, k) for w in (0, 1) for k in range(two[w].num_frames - stride * num_targets)]
    assert len(windows) == len(expected_frames)
    for index, (which, frame) in enumerate(expected_frames):
        trajectory = two[which]
        position = windows[index].position.numpy()
        assert position.shape == (trajectory.num_particles, 4 + num_targets, 3)
        for place in range(4 + num_targets):
            wanted = frame + stride * (place - 3)
            if wanted >= 0:
                expected = trajectory.position[wanted]
            else:
                expected = trajectory.position[0] + wanted * trajectory.dt * trajectory.initial_velocity
            np.testing.assert_allclose(position[:, place], expected, atol=1e-7)
        assert windows[index].num_nodes == trajectory.num_particles
    with pytest.raises(IndexError):
        windows[len(expected_frames)]


@pytest.mark.parametrize("num_workers", [0, 2])
def test_batches_keep_scenes_apart(two: list[Trajectory], paths: list[Path], num_workers: int) -> None:
    windows = WindowDataset(paths, input_sequence_length=3, num_targets=1, stride=1, start_repeats=1, in_memory=False)
    batch = next(iter(DataLoader(windows, batch_sampler=[[2, 9]], num_workers=num_workers)))
    counts = [trajectory.num_particles for trajectory in two]
    assert torch.bincount(batch.batch).tolist() == counts
    assert batch.lower.shape == batch.gravity.shape == (2, 3)
    assert batch.upper.tolist()[1] == pytest.approx([1.5, 0.5, 0.7])
    torch.testing.assert_close(batch.position[: counts[0]], windows[2].position)
    torch.testing.assert_close(batch.position[counts[0] :], windows[9].position)


def test_windows_at_the_start_can_be_repeated(paths: list[Path]) -> None:
    windows = WindowDataset(
        paths[:1], input_sequence_length=4, num_targets=1, stride=1, start_repeats=3, in_memory=True
    )
    assert [frame for _, frame in windows.index] == [0, 0, 0, 1, 1, 1, 2, 2, 2, 3, 4, 5, 6, 7]


def test_refusals(tmp_path: Path, drop: Scene) -> None:
    with pytest.raises(InputError, match="no trajectory"):
        WindowDataset([], input_sequence_length=3, num_targets=1, stride=1, start_repeats=1, in_memory=True)
    write_trajectory(tmp_path / "short.h5", make_moving(drop, frames=1, spacing=0.1))
    with pytest.raises(InputError, match=r"short\.h5"):
        WindowDataset(
            [tmp_path / "short.h5"], input_sequence_length=3, num_targets=1, stride=1, start_repeats=1, in_memory=True
        )
    slope = Plane((0, 0, 0.1), (1, 0, 3), Wall("slip"))
    write_trajectory(tmp_path / "slope.h5", make_moving(drop.replace(obstacles=(slope,)), frames=3, spacing=0.1))
    with pytest.raises(InputError, match=r"slope\.h5: its scene has obstacles"):
        WindowDataset(
            [tmp_path / "slope.h5"], input_sequence_length=3, num_targets=1, stride=1, start_repeats=1, in_memory=True
        )


def test_windows_in_which_something_moves_can_be_repeated(two: list[Trajectory], tmp_path: Path) -> None:
    """What moves behind the latest frame counts: a body let go moves, one that has just stopped does not."""
    position = np.repeat(two[0].position[:1], 9, axis=0)
    position[4:] += np.float32(0.02 * two[0].dt)  # all particles, between frames 3 and 4
    few = len(position[0]) // 100
    position[7:, :few] += np.float32(1.0 * two[0].dt)
    path = tmp_path / "moves.h5"
    write_trajectory(path, dataclasses.replace(two[0], position=position, initial_velocity=two[0].initial_velocity * 0))
    for in_memory in (True, False):
        settings = {"input_sequence_length": 2, "num_targets": 1, "stride": 1, "in_memory": in_memory}
        windows = WindowDataset([path], **settings, start_repeats=2, moving_repeats=3)
        frames = [frame for _, frame in windows.index]
        # Nothing is faster than between frames 3 and 4: until there it sets out.
        assert [frames.count(frame) for frame in range(8)] == [2, 2, 2, 3, 1, 1, 1, 1]
