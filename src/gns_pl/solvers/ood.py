"""How far a run is from what its network saw in training: over time, in one early number, and in words.

It is judged by a run's own states (`graph.TrainingDistribution`) and by its scene (`training_range.out_of_range`),
since neither shows all: no state shows the floor's friction, and no scene that a heap falls apart.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from gns_pl.io import read_header, read_trajectory
from gns_pl.models.checkpoint import Checkpoint
from gns_pl.rollout.static import static_of
from gns_pl.solvers.reduction import Reduction
from gns_pl.solvers.training_range import out_of_range
from gns_pl.trajectory import Trajectory, ballistic_history

LIMIT = 0.1
"""A frame is out of the training range when a larger share of its particles is farther off than 99 % of those in
training were. That share is one in a hundred in the mean of training, up to a tenth while a scene strikes."""


@dataclass(frozen=True)
class OutOfDistribution:
    """How far off the frames of a run are.

    Attributes:
        time: [T] [s].
        mean: mean distance of the particles [T], 1 where one in a hundred of training is farther.
        far: the distance that 99 % of the particles do not exceed [T].
        share: share of the particles farther off than 1 [T].
        outside: share of the particles with each feature outside its range, over the run's worst frame [F].
        names: of the F features.
        reasons: what of the scene is beyond the data, in words.
    """

    time: NDArray[np.float64]
    mean: NDArray[np.float64]
    far: NDArray[np.float64]
    share: NDArray[np.float64]
    outside: NDArray[np.float64]
    names: tuple[str, ...]
    reasons: tuple[str, ...]

    @property
    def exit_time(self) -> float | None:
        """Time of the first frame out of the training range [s]; None if there is none."""
        found = np.flatnonzero(self.share > LIMIT)
        return float(self.time[found[0]]) if len(found) else None

    def early_score(self, until: float) -> float:
        """Return the largest mean distance of the frames up to a time.

        Args:
            until: [s]; docs/trust.md takes √(H0/g).
        """
        return float(self.mean[self.time <= until + 1e-9].max())

    def message(self) -> str | None:
        """Return when the run left the training range and in what, and what of the scene is beyond; None if nothing."""
        parts = []
        if self.exit_time is not None:
            worst = np.argsort(-self.outside, kind="stable")
            names = list(dict.fromkeys(self.names[place] for place in worst if self.outside[place] > LIMIT))[:3]
            in_what = f" ({', '.join(names)})" if names else ""
            parts.append(f"left the training range at {self.exit_time:.3g} s{in_what}")
        if self.reasons:
            parts.append(f"scene outside the training data ({self.reasons[0]})")
        return "; ".join(parts) or None


FRAMES, NUMBERS = 40, 100_000_000
"""Of a run in a file so many frames are looked at, and at none if it holds more coordinates than so many."""


def ood_message(checkpoint: Checkpoint, path: Path, reduction: Reduction | None = None) -> str | None:
    """Return the message about a run in a file; None if there is nothing to tell, or nothing by which to tell.

    Args:
        checkpoint: simulator, data and what it saw.
        path: of the run.
        reduction: from the scene of the file to the one that was run; None if they are the same.
    """
    header = read_header(path)
    if checkpoint.distribution is None or header.num_frames * header.num_particles * header.dim > NUMBERS:
        return None
    run = read_trajectory(path)
    run = run if reduction is None else reduction.flatten(run)
    found = compute_ood(checkpoint, run, every=max(1, header.num_frames // FRAMES))
    message = None if found is None else found.message()
    return message if message is None or reduction is None else reduction.similarity.told(message)


def compute_ood(checkpoint: Checkpoint, run: Trajectory, *, every: int = 1) -> OutOfDistribution | None:
    """Follow a run from what its network saw.

    Args:
        checkpoint: simulator, data and what it saw.
        run: a rollout at the simulator's time step, or any trajectory to be looked at as one.
        every: look at every so many frames only.

    Returns:
        None if the checkpoint does not say what its network saw, as those of before this was measured
        (`training.distribution.add_distribution`).
    """
    seen, simulator = checkpoint.distribution, checkpoint.simulator
    if seen is None:
        return None
    config, device = simulator.config, simulator.velocity_scale.device
    length, static = config.input_sequence_length, static_of(run, config=config).to(device)
    before = ballistic_history(run.position[0], run.initial_velocity, config.dt, length)[:-1]
    position = np.concatenate([before.astype(np.float32), run.position])
    frames = range(0, run.num_frames, every)
    mean, far, share, outside = [], [], [], []
    with torch.inference_mode():
        for frame in frames:
            window = np.ascontiguousarray(position[frame : frame + length].transpose(1, 0, 2))
            state = simulator.state(torch.from_numpy(window).to(device), static)[static.moved]
            distance = seen.distance(state)
            mean.append(float(distance.mean()))
            far.append(float(torch.quantile(distance, 0.99)))
            share.append(float((distance > 1).float().mean()))
            outside.append(seen.outside(state).float().mean(dim=0).cpu().numpy())
    worst = int(np.argmax(share))
    return OutOfDistribution(
        time=np.array(frames) * config.dt,
        mean=np.array(mean),
        far=np.array(far),
        share=np.array(share),
        outside=np.asarray(outside[worst], dtype=np.float64),
        names=seen.names,
        reasons=tuple(out_of_range(run.scene, checkpoint.data)),
    )
