"""Which recording goes where: its split, and its name in the target."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from gns_pl.errors import InputError
from gns_pl.io import SPLITS


@dataclass(frozen=True)
class Item:
    """A recording of the source on its way.

    Attributes:
        number: in the source.
        source: its name there.
        split: "train", "valid" or "test".
        name: in the target, a word.
    """

    number: int
    source: str
    split: str
    name: str


def plan_items(names: Sequence[tuple[str, str]], *, valid: int, test: int) -> list[Item]:
    """Return the recordings in the order of their splits.

    Where the source has splits they stay, and what is in none is for training. Where it has none, the last recordings
    are held out, as long as one is left for training.

    Args:
        names: split or "", and name of every recording.
        valid: held out for validation.
        test: held out for tests.

    Raises:
        InputError: numbers below zero.
    """
    for name, number in (("valid", valid), ("test", test)):
        if isinstance(number, bool) or not isinstance(number, int) or number < 0:
            raise InputError(f"{name} must be a whole number of trajectories, not {number!r}.")
    splits = [split or "train" for split, _ in names]
    if not any(split for split, _ in names):
        held = min(valid + test, len(names) - 1)
        validating = min(valid, held)
        for place in range(len(names) - held, len(names)):
            splits[place] = "valid" if place < len(names) - held + validating else "test"
    items: list[Item] = []
    for split in SPLITS:
        numbers = [number for number, name in enumerate(splits) if name == split]
        items += [Item(number, names[number][1], split, f"{split}_{k:04d}") for k, number in enumerate(numbers)]
    return items
