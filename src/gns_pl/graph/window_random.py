"""Random numbers as a function of a window's number, whatever batch, step or process the window is met in."""

from __future__ import annotations

import math
import zlib

import torch
from torch import Tensor

_WORD = 1 << 64
_BITS = 23
"""Random bits of a number; with the half added to them, a float32 holds no more."""


def _signed(value: int) -> int:
    """Return the 64-bit two's complement of an integer, as torch's int64 has it."""
    return (value + _WORD // 2) % _WORD - _WORD // 2


_STRIDE = _signed(0x9E3779B97F4A7C15)
_FIRST = _signed(0xBF58476D1CE4E5B9)
_SECOND = _signed(0x94D049BB133111EB)


def _shifted(word: Tensor, by: int) -> Tensor:
    shifted = word >> by
    shifted &= (1 << (64 - by)) - 1  # torch shifts the sign in
    return shifted


def _mixed(word: Tensor) -> Tensor:
    word = word ^ _shifted(word, 30)
    word *= _FIRST
    word ^= _shifted(word, 27)
    word *= _SECOND
    word ^= _shifted(word, 31)
    return word


def split_mix(key: Tensor, place: Tensor) -> Tensor:
    """Return the words number `place` of the sequences that begin with `key`: SplitMix64 (Steele et al., 2014).

    A sequence of that generator is a counter that is mixed, so any word is had without those before it: no state, no
    loop, the same bits on every device, and nothing that a compiler could not fuse.

    Args:
        key: int64 words.
        place: int64 from 0 on, broadcast against the keys.
    """
    return _mixed(key + (place + 1) * _STRIDE)


class WindowRandom:
    """The random numbers of a batch of B windows with N particles in all.

    Each window has its own, which depend on the seed, its number and the purpose alone. So a batch may be spread over
    processes in any way, or met again by a resumed run, and its noise is the same.

    Args:
        seed: of the run.
        number: number of every window [B] int64.
        batch: window of every particle [N], ascending.
    """

    def __init__(self, seed: int, number: Tensor, batch: Tensor) -> None:
        self.number = number
        self.batch = batch
        start = torch.tensor(_signed(seed), dtype=torch.int64, device=number.device)
        self._key = split_mix(_mixed(start), number)
        first = torch.searchsorted(batch, torch.arange(len(number), device=batch.device))
        self._place = torch.arange(len(batch), device=batch.device) - first[batch]

    @property
    def num_graphs(self) -> int:
        """B."""
        return len(self.number)

    def uniform(self, purpose: str, *shape: int, dtype: torch.dtype) -> Tensor:
        """Return numbers in the open interval (0, 1) for every window [B, *shape]; other purposes draw others."""
        return unit_interval(self._words(purpose, shape, self._key, None)).to(dtype)

    def normal(self, purpose: str, *shape: int, dtype: torch.dtype) -> Tensor:
        """Return standard normal numbers for every window [B, *shape]."""
        return standard_normal(self._words(purpose, shape, self._key, None)).to(dtype)

    def particle_normal(self, purpose: str, *shape: int, dtype: torch.dtype) -> Tensor:
        """Return standard normal numbers for every particle [N, *shape]."""
        return standard_normal(self._words(purpose, shape, self._key[self.batch], self._place)).to(dtype)

    def _words(self, purpose: str, shape: tuple[int, ...], key: Tensor, particle: Tensor | None) -> Tensor:
        key = _mixed(key ^ (zlib.crc32(purpose.encode()) << 16))[:, None]
        size = math.prod(shape)
        place = torch.arange(size, device=key.device)
        if particle is not None:
            place = particle[:, None] * size + place
        return split_mix(key, place).view(-1, *shape)


def unit_interval(word: Tensor) -> Tensor:
    """Return the first bits of 64-bit words as float32 in the open interval (0, 1), symmetric about the middle."""
    unit: Tensor = (_shifted(word, 64 - _BITS).to(torch.float32) + 0.5) / 2**_BITS
    return unit


def standard_normal(word: Tensor) -> Tensor:
    """Return 64-bit words as standard normal float32, at most 5.3 in size."""
    normal: Tensor = torch.erfinv(2 * unit_interval(word) - 1) * math.sqrt(2)
    return normal
