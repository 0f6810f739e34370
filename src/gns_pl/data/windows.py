"""Windows of trajectories: H positions and those that follow, with what stays constant.

A window may begin before the first frame; the missing positions are ballistic (x0 − k v0 Δt), just as they are when a
rollout starts from a scene alone. Noise is added later, on the device, never to what is stored.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch.utils.data import Dataset
from torch_geometric.data import Data

from gns_pl.data.solids import surfaces_of
from gns_pl.data.survey_record import MOVING_SHARE, SPEED_AT_REST
from gns_pl.errors import InputError
from gns_pl.fields import ParticleType
from gns_pl.io import read_header, read_trajectory, read_window
from gns_pl.scene.refusals import SEE_SURFACES, check_bare
from gns_pl.trajectory import Trajectory, ballistic_history


class WindowDataset(Dataset[Data]):
    """Every window of a list of trajectory files.

    A trajectory has a window for every frame k = 0 … T − 1 − s U, which holds the latest history position; with a
    stride s the frames before it and the U targets behind it are s frames apart. How a scene sets out takes few frames
    but decides the rest, and in many sets half of the frames are at rest, which is soon learned; so the windows while a
    scene sets out, and those in which something is about to move, can be listed several times.

    Args:
        paths: trajectory files.
        input_sequence_length: H.
        num_targets: U, frames behind the history.
        stride: s, frames of the files in a step.
        start_repeats: how often windows are listed while the scene sets out: whose history begins before the first
            frame or that lie before the largest kinetic energy.
        moving_repeats: how often windows are listed in whose next frame more than `MOVING_SHARE` of the particles have
            moved faster than `SPEED_AT_REST`; with those at the start it is the product of both.
        in_memory: keep all positions in memory; otherwise each window is read from its file.
        cell: of the ground, for a simulator that sees surfaces (`data.solids`) [m]; None for one of bare boxes.

    Raises:
        InputError: no file, one with fewer than s U + 1 frames, or, without a `cell`, one whose scene is not bare.
    """

    def __init__(
        self,
        paths: Sequence[Path],
        *,
        input_sequence_length: int,
        num_targets: int,
        stride: int,
        start_repeats: int,
        moving_repeats: int = 1,
        in_memory: bool,
        cell: float | None = None,
    ) -> None:
        if not paths:
            raise InputError("there is no trajectory to train on; give the split at least one.")
        self.stride = stride
        self.before, self.behind = stride * (input_sequence_length - 1), stride * num_targets  # frames of the files
        self.paths = list(paths)
        self.constant: list[dict[str, Any]] = []
        self._position: list[NDArray[np.float32] | None] = []
        self._pre_history: list[NDArray[np.float32]] = []
        self.index: list[tuple[int, int]] = []
        for which, path in enumerate(self.paths):
            # Without memory for all frames only the first one is read here, which the pre-history needs.
            num_frames = read_header(path).num_frames
            trajectory = read_trajectory(path, num_frames=None if in_memory else 1)
            if num_frames <= self.behind:
                raise InputError(f"{path}: has {num_frames} frames; a window needs at least {self.behind + 1}.")
            if cell is None:
                check_bare(f"{path}: its scene", trajectory.scene, cure=SEE_SURFACES)
            repeats = np.ones(num_frames - 1, dtype=int)
            if start_repeats > 1 or moving_repeats > 1:
                speeds = _speeds(trajectory if in_memory else read_trajectory(path))
                repeats[: max(self.before, int(np.square(speeds).mean(axis=1).argmax()))] *= start_repeats
                repeats[(speeds > SPEED_AT_REST).mean(axis=1) > MOVING_SHARE] *= moving_repeats
            for frame in range(num_frames - self.behind):
                self.index += [(which, frame)] * int(repeats[frame])
            past = ballistic_history(
                trajectory.position[0], trajectory.initial_velocity, trajectory.dt, self.before + 1
            )
            self._pre_history.append(past[:-1].astype(np.float32))
            self.constant.append(_constant(trajectory, cell))
            self._position.append(trajectory.position if in_memory else None)

    def __len__(self) -> int:
        return len(self.index)

    def __getitem__(self, drawn: int | tuple[int, int]) -> Data:
        """Return a PyG `Data`: `position` [N, H + U, D], the fields of a `SceneBatch` of one scene, `number` [1].

        Args:
            drawn: index of the window, and the number it has in a training (`StepSampler`); without one, that is 0.
        """
        index, number = (drawn, 0) if isinstance(drawn, int) else drawn
        which, frame = self.index[index]
        first = max(0, frame - self.before)
        stored = self._position[which]
        frames = frame + self.behind + 1 - first
        window = stored[first : first + frames] if stored is not None else read_window(self.paths[which], first, frames)
        missing = self.before + self.behind + 1 - frames
        if missing:
            window = np.concatenate([self._pre_history[which][-missing:], window])
        window = window[:: self.stride]
        position = torch.from_numpy(np.ascontiguousarray(window.transpose(1, 0, 2)))
        return Data(position=position, number=torch.tensor([number]), num_nodes=len(position), **self.constant[which])

    def mean_moved_particles(self) -> float:
        """Return how many particles that a simulator moves a window has in the mean."""
        moved = [int((c["particle_type"] != int(ParticleType.KINEMATIC)).sum()) for c in self.constant]
        return sum(moved[which] for which, _ in self.index) / len(self.index)


def _speeds(trajectory: Trajectory) -> NDArray[Any]:
    """Return every particle's speed between each frame and the next [T − 1, N] [m/s]."""
    pairs = zip(trajectory.position[:-1], trajectory.position[1:], strict=True)
    return np.stack([np.linalg.norm(after - before, axis=1) for before, after in pairs]) / np.float32(trajectory.dt)


def _constant(trajectory: Trajectory, cell: float | None) -> dict[str, Any]:
    scene = trajectory.scene
    surfaces = {} if cell is None else {"surfaces": surfaces_of(scene, cell)}
    return {
        **surfaces,
        "particle_type": torch.from_numpy(trajectory.particle_type),
        "material": torch.from_numpy(trajectory.material),
        "volume": torch.from_numpy(trajectory.volume()),
        "lower": torch.tensor([scene.lower], dtype=torch.float32),
        "upper": torch.tensor([scene.upper], dtype=torch.float32),
        "gravity": torch.tensor([scene.gravity], dtype=torch.float32),
    }
