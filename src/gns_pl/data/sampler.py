"""The order of training windows as a function of the seed and the step alone, so that a resumed run goes on exactly."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import torch
from torch.utils.data import Sampler

POOL = 32
"""Training steps from one visit to a window to the next, where windows are visited several times."""


class Drawn(NamedTuple):
    """A window in a batch.

    Attributes:
        window: its place in the set, as it is at the first visit.
        number: of the window in the training, the same at all its visits.
        visit: how often it has been visited before.
    """

    window: int
    number: int
    visit: int


class StepSampler(Sampler[list[Drawn]]):
    """One batch per training step, from `first_step` to `num_steps`: this process's share of the joined batch.

    The windows are gone through in a random order, drawn anew for every pass from the seed and the number of the pass.
    Window k of the training is the k-th of them; whatever is random about it depends on the seed and k, so the joined
    batch is the same for any number of processes.

    With one visit to each, slot j of step s holds window s `batch_size` + j. With V visits, `POOL` batches of windows
    are under way at the same time; each of their places holds a window for V visits, `POOL` steps apart, then the next
    one. Places change windows at different times, so that there are always young and old ones. A window is always met
    by the same process.

    Args:
        num_windows: size of the set.
        batch_size: windows per step, of all processes together; a multiple of their number.
        num_steps: steps of the whole training.
        seed: of the orders.
        first_step: steps made before.
        visits: V.
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
        visits: int = 1,
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
        self.visits = visits
        self.rank = rank
        self.num_ranks = num_ranks
        self._drawn: tuple[int, torch.Tensor] | None = None

    def __len__(self) -> int:
        return self.num_steps

    def __iter__(self) -> Iterator[list[Drawn]]:
        share = self.batch_size // self.num_ranks
        for step in range(self.first_step, self.num_steps):
            yield self.joined_batch(step)[self.rank * share : (self.rank + 1) * share]

    def joined_batch(self, step: int) -> list[Drawn]:
        """Return every window of a step, those of all processes."""
        return [self._window(slot) for slot in range(step * self.batch_size, (step + 1) * self.batch_size)]

    def rank_of(self, number: int) -> int:
        """Return the process that meets a window."""
        return number % self.batch_size * self.num_ranks // self.batch_size

    def _window(self, slot: int) -> Drawn:
        places = POOL * self.batch_size
        turn, place = divmod(slot, places)
        generation, visit = divmod(turn + place // self.batch_size % self.visits, self.visits)
        number = generation * places + place
        return Drawn(int(self._order(number // self.num_windows)[number % self.num_windows]), number, visit)

    def _order(self, passed: int) -> torch.Tensor:
        if self._drawn is None or self._drawn[0] != passed:
            generator = torch.Generator().manual_seed(self.seed * 1_000_003 + passed)
            self._drawn = passed, torch.randperm(self.num_windows, generator=generator)
        return self._drawn[1]
