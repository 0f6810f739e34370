"""The order of training windows as a function of the seed and the step alone, so that a resumed run goes on exactly."""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch.utils.data import Sampler


class StepSampler(Sampler[list[tuple[int, int]]]):
    """One batch per training step, from `first_step` to `num_steps`: this process's share of the joined batch.

    The windows are gone through in a random order, drawn anew for every pass from the seed and the number of the pass.
    Slot k of step s has the number s `batch_size` + k, whichever process it falls to; whatever is random about a window
    depends on that number, so the joined batch is the same for any number of processes.

    Args:
        num_windows: size of the set.
        batch_size: windows per step, of all processes together; a multiple of their number.
        num_steps: steps of the whole training.
        seed: of the orders.
        first_step: steps made before.
        rank: this process.
        num_ranks: processes.
    """

    def __init__(
        self,
        *,
        num_windows: int,
        batch_size: int,
        num_steps: int,
        seed: int,
        first_step: int = 0,
        rank: int = 0,
        num_ranks: int = 1,
    ) -> None:
        if batch_size % num_ranks:
            raise ValueError(f"{batch_size} windows cannot be shared by {num_ranks} processes alike")
        self.num_windows = num_windows
        self.batch_size = batch_size
        self.num_steps = num_steps
        self.seed = seed
        self.first_step = first_step
        self.rank = rank
        self.num_ranks = num_ranks
        self._drawn: tuple[int, torch.Tensor] | None = None

    def __len__(self) -> int:
        return self.num_steps

    def __iter__(self) -> Iterator[list[tuple[int, int]]]:
        share = self.batch_size // self.num_ranks
        for step in range(self.first_step, self.num_steps):
            yield self.joined_batch(step)[self.rank * share : (self.rank + 1) * share]

    def joined_batch(self, step: int) -> list[tuple[int, int]]:
        """Return index and number of every window of a step, those of all processes."""
        numbers = range(step * self.batch_size, (step + 1) * self.batch_size)
        return [(int(self._order(number // self.num_windows)[number % self.num_windows]), number) for number in numbers]

    def _order(self, passed: int) -> torch.Tensor:
        if self._drawn is None or self._drawn[0] != passed:
            generator = torch.Generator().manual_seed(self.seed * 1_000_003 + passed)
            self._drawn = passed, torch.randperm(self.num_windows, generator=generator)
        return self._drawn[1]
