"""A window's random numbers are its own: right in distribution, and the same in whatever company it is met."""

from __future__ import annotations

import pytest
import torch

from gns_pl.graph import WindowRandom
from gns_pl.graph.window_random import split_mix, standard_normal, unit_interval

SIZES = (5, 1, 300)


def window_random(numbers: list[int], sizes: list[int], seed: int = 3) -> WindowRandom:
    return WindowRandom(seed, torch.tensor(numbers), torch.arange(len(sizes)).repeat_interleave(torch.tensor(sizes)))


def test_split_mix_is_the_published_generator() -> None:
    """The first words from the seed 1234567, as the reference implementation in C makes them."""
    words = split_mix(torch.tensor(1234567), torch.arange(5)).tolist()
    assert [word % 2**64 for word in words] == [
        6457827717110365317,
        3203168211198807973,
        9817491932198370423,
        4593380528125082431,
        16408922859458223821,
    ]


def test_a_window_draws_the_same_alone_and_in_a_batch() -> None:
    numbers = [17, 4, 10**12]
    joined = window_random(numbers, list(SIZES))
    offset = 0
    for place, (number, size) in enumerate(zip(numbers, SIZES, strict=True)):
        alone = window_random([number], [size])
        for name in ("uniform", "normal"):
            whole, own = (getattr(d, name)("wave", 4, 3, dtype=torch.float64) for d in (joined, alone))
            torch.testing.assert_close(whole[place], own[0], rtol=1e-6, atol=0)
        whole, own = (d.particle_normal("walk", 5, 3, dtype=torch.float64) for d in (joined, alone))
        torch.testing.assert_close(whole[offset : offset + size], own, rtol=1e-6, atol=0)
        offset += size


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_distributions(dtype: torch.dtype) -> None:
    many = window_random(list(range(2000)), [1] * 2000)
    uniform = many.uniform("u", 100, dtype=dtype)
    assert uniform.dtype == dtype and uniform.min() > 0 and uniform.max() < 1
    counts = torch.histc(uniform.double(), 50, 0, 1)
    assert ((counts - 4000) ** 2 / 4000).sum() < 49 + 4 * 2**0.5 * 49**0.5  # χ², four standard deviations
    normal = window_random([0], [30000]).particle_normal("n", 5, 3, dtype=dtype).double()
    assert normal.isfinite().all() and abs(normal.mean()) < 4 * normal.numel() ** -0.5
    assert abs(normal.var() - 1) < 4 * (2 / normal.numel()) ** 0.5
    assert abs((normal**4).mean() - 3) < 4 * (96 / normal.numel()) ** 0.5


def test_no_word_makes_a_number_that_is_not_finite() -> None:
    """The least and the greatest word: one in ten million, so one in every few hundred steps."""
    words = torch.tensor([0, -1])
    unit, normal = unit_interval(words), standard_normal(words)
    assert unit.dtype == torch.float32 and unit[0] > 0 and unit[1] < 1 and float(unit.sum()) == 1
    assert normal.isfinite().all() and 5.2 < normal[1] < 5.3 and normal[0] == -normal[1]


def test_windows_particles_components_purposes_and_seeds_are_independent() -> None:
    base = window_random([0, 1], [4000, 4000]).particle_normal("n", 3, dtype=torch.float64)
    others = {
        "windows": (base[:4000], base[4000:]),
        "particles": (base[:-1], base[1:]),
        "components": (base[:, :-1], base[:, 1:]),
        "purposes": (base, window_random([0, 1], [4000, 4000]).particle_normal("m", 3, dtype=torch.float64)),
        "seeds": (base, window_random([0, 1], [4000, 4000], seed=4).particle_normal("n", 3, dtype=torch.float64)),
    }
    for name, (one, two) in others.items():
        assert abs((one * two).mean()) < 4 * one.numel() ** -0.5, name


def test_any_seed_is_taken() -> None:
    values = [
        float(window_random([0], [1], seed=seed).uniform("u", dtype=torch.float64))
        for seed in (-1, 0, 2**63, 2**70 + 1)
    ]
    assert len(set(values)) == 4
