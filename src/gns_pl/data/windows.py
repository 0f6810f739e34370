"""Windows of trajectories: H positions and the one that follows, with what stays constant.

A window may begin before the first frame; the missing positions are ballistic (x0 − k v0 Δt), just as they are when a
rollout starts from a scene alone. Noise is added later, on the device, never to what is stored.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch.utils.data import Dataset
from torch_geometric.data import Data

from gns_pl.errors import InputError
from gns_pl.fields import ParticleType
from gns_pl.io import read_header, read_trajectory, read_window
from gns_pl.trajectory import Trajectory, ballistic_history


class WindowDataset(Dataset[Data]):
    """Every window of a list of trajectory files.

    A trajectory has a window for every frame k = 0 … T − 2, which holds the latest history position; the target is in
    frame k + 1. Windows whose history begins before the first frame are rare but decide how a scene sets out, so they
    can be listed several times.

    Args:
        paths: trajectory files.
        input_sequence_length: H.
        start_repeats: how often windows are listed whose history begins before the first frame.
        in_memory: keep all positions in memory; otherwise each window is read from its file.

    Raises:
        InputError: no file, one with fewer than two frames, or one whose scene has obstacles.
    """

    def __init__(
        self, paths: Sequence[Path], *, input_sequence_length: int, start_repeats: int, in_memory: bool
    ) -> None:
        if not paths:
            raise InputError("there is no trajectory to train on; give the split at least one.")
        self.length = input_sequence_length
        self.paths = list(paths)
        self.constant: list[dict[str, torch.Tensor]] = []
        self._position: list[NDArray[np.float32] | None] = []
        self._pre_history: list[NDArray[np.float32]] = []
        self.index: list[tuple[int, int]] = []
        for which, path in enumerate(self.paths):
            # Without memory for all frames only the first one is read here, which the pre-history needs.
            num_frames = read_header(path).num_frames
            trajectory = read_trajectory(path, num_frames=None if in_memory else 1)
            if num_frames < 2:
                raise InputError(f"{path}: has {num_frames} frame; a window needs at least two.")
            if trajectory.scene.obstacles:
                raise InputError(f"{path}: its scene has obstacles, and a learned simulator knows no obstacles yet.")
            for frame in range(num_frames - 1):
                self.index += [(which, frame)] * (start_repeats if frame < input_sequence_length - 1 else 1)
            past = ballistic_history(
                trajectory.position[0], trajectory.initial_velocity, trajectory.dt, input_sequence_length
            )
            self._pre_history.append(past[:-1].astype(np.float32))
            self.constant.append(_constant(trajectory))
            self._position.append(trajectory.position if in_memory else None)

    def __len__(self) -> int:
        return len(self.index)

    def __getitem__(self, drawn: int | tuple[int, int]) -> Data:
        """Return a PyG `Data`: `position` [N, H + 1, D], the fields of `graph.Static` for one scene, and `number` [1].

        Args:
            drawn: index of the window, and the number it has in a training (`StepSampler`); without one, that is 0.
        """
        index, number = (drawn, 0) if isinstance(drawn, int) else drawn
        which, frame = self.index[index]
        first = max(0, frame - self.length + 1)
        stored = self._position[which]
        frames = frame + 2 - first
        window = stored[first : first + frames] if stored is not None else read_window(self.paths[which], first, frames)
        missing = self.length + 1 - frames
        if missing:
            window = np.concatenate([self._pre_history[which][-missing:], window])
        position = torch.from_numpy(np.ascontiguousarray(window.transpose(1, 0, 2)))
        return Data(position=position, number=torch.tensor([number]), num_nodes=len(position), **self.constant[which])

    def mean_moved_particles(self) -> float:
        """Return how many particles that a simulator moves a window has in the mean."""
        moved = [int((c["particle_type"] != int(ParticleType.KINEMATIC)).sum()) for c in self.constant]
        return sum(moved[which] for which, _ in self.index) / len(self.index)


def _constant(trajectory: Trajectory) -> dict[str, torch.Tensor]:
    scene = trajectory.scene
    return {
        "particle_type": torch.from_numpy(trajectory.particle_type),
        "material": torch.from_numpy(trajectory.material),
        "volume": torch.from_numpy(trajectory.volume()),
        "lower": torch.tensor([scene.lower], dtype=torch.float32),
        "upper": torch.tensor([scene.upper], dtype=torch.float32),
        "gravity": torch.tensor([scene.gravity], dtype=torch.float32),
    }
