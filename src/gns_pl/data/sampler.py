"""The order of training windows as a function of the seed and the step alone, so that a resumed run goes on exactly."""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch.utils.data import Sampler


class StepSampler(Sampler[list[int]]):
    """One batch of window indices per training step, from `first_step` to `num_steps`.

    The windows are gone through in a random order, drawn anew for every pass from the seed and the number of the pass.

    Args:
        num_windows: size of the set.
        batch_size: indices per batch.
        num_steps: steps of the whole training.
        seed: of the orders.
        first_step: steps made before.
    """

    def __init__(self, *, num_windows: int, batch_size: int, num_steps: int, seed: int, first_step: int = 0) -> None:
        self.num_windows = num_windows
        self.batch_size = batch_size
        self.num_steps = num_steps
        self.seed = seed
        self.first_step = first_step

    def __len__(self) -> int:
        return self.num_steps

    def __iter__(self) -> Iterator[list[int]]:
        drawn, order = -1, torch.empty(0)
        for step in range(self.first_step, self.num_steps):
            batch = []
            for position in range(step * self.batch_size, (step + 1) * self.batch_size):
                passed, place = divmod(position, self.num_windows)
                if passed != drawn:
                    generator = torch.Generator().manual_seed(self.seed * 1_000_003 + passed)
                    drawn, order = passed, torch.randperm(self.num_windows, generator=generator)
                batch.append(int(order[place]))
            yield batch
