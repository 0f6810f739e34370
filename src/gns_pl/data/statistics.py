"""Mean and standard deviation of more numbers than fit into memory: seen in parts, in any order, and merged."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gns_pl.io import TrajectoryHeader, open_trajectory, read_window

BLOCK_BYTES = 32 * 1024 * 1024
"""Positions measured at a time."""


class RunningStatistics:
    """Count, mean and sum of squared deviations per component, in float64.

    Parts are merged by the pairwise rule of Chan, Golub and LeVeque (Am. Stat. 37, 1983), of which Welford's update is
    the case of one sample; unlike sums of squares it loses no digits where the mean is large.

    | equation | code |
    |---|---|
    | δ = m_B − m_A | `shift` |
    | m = m_A + δ n_B / n | `self.mean` |
    | M₂ = M₂_A + M₂_B + δ² n_A n_B / n | `self._squares` |

    Attributes:
        count: number of samples.
        mean: [D]; zeros before the first sample.
    """

    def __init__(self, dim: int) -> None:
        self.count = 0
        self.mean: NDArray[np.float64] = np.zeros(dim)
        self._squares: NDArray[np.float64] = np.zeros(dim)

    def update(self, samples: NDArray[np.floating]) -> None:
        """Add samples.

        Args:
            samples: [M, D].
        """
        if samples.ndim != 2 or samples.shape[1] != len(self.mean):
            raise ValueError(f"samples must be [M, {len(self.mean)}], not {samples.shape}")
        if len(samples) == 0:
            return
        values = samples.astype(np.float64, copy=False)
        part = RunningStatistics(len(self.mean))
        part.count = len(values)
        part.mean = np.asarray(values.mean(axis=0))
        part._squares = np.asarray(np.square(values - part.mean).sum(axis=0))
        self.merge(part)

    def merge(self, other: RunningStatistics) -> None:
        """Add the samples that `other` has seen."""
        total = self.count + other.count
        if other.count == 0:
            return
        shift = other.mean - self.mean
        self.mean = self.mean + shift * (other.count / total)
        self._squares = self._squares + other._squares + np.square(shift) * (self.count * other.count / total)
        self.count = total

    @property
    def std(self) -> NDArray[np.float64]:
        """Standard deviation of the samples seen [D] (divided by n, not n − 1); zeros before the first."""
        return np.asarray(np.sqrt(self._squares / max(self.count, 1)))

    def to_dict(self) -> dict[str, Any]:
        """Return "count", "mean" and "std" as plain values."""
        return {"count": self.count, "mean": self.mean.tolist(), "std": self.std.tolist()}


def measure_motion(
    path: Path,
    header: TrajectoryHeader,
    initial_velocity: NDArray[np.floating],
    *,
    stride: int = 1,
    moved: NDArray[np.bool_] | None = None,
) -> dict[str, RunningStatistics]:
    """Return the statistics of velocity and acceleration over a file, read block by block.

    They are those of `Trajectory.velocity` and `Trajectory.acceleration` after `Trajectory.every`.

    Args:
        path: of the file.
        header: of the file.
        initial_velocity: in the file [N, D] [m/s].
        stride: frames of the file in a step.
        moved: [N] particles that count; kinematic ones would only tell their script. All if None.

    Returns:
        "velocity" [m/s] and "acceleration" [m/s²].
    """
    dim, dt, steps = header.dim, header.dt * stride, (header.num_frames - 1) // stride
    velocity, acceleration = RunningStatistics(dim), RunningStatistics(dim)
    chosen = slice(None) if moved is None or moved.all() else np.flatnonzero(moved)
    last = initial_velocity.astype(np.float64)[None, chosen]
    velocity.update(last[0])
    block = max(1, BLOCK_BYTES // (8 * dim * header.num_particles * stride))
    with open_trajectory(path) as file:
        for start in range(0, steps, block):
            length = min(block, steps - start)
            position = read_window(file, start * stride, length * stride + 1)[::stride, chosen].astype(np.float64)
            velocities = np.diff(position, axis=0) / dt
            velocity.update(velocities.reshape(-1, dim))
            velocities = np.concatenate([last, velocities])
            acceleration.update((np.diff(velocities, axis=0) / dt).reshape(-1, dim))
            last = velocities[-1:]
    return {"velocity": velocity, "acceleration": acceleration}
