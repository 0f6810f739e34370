from __future__ import annotations

import torch

from gns_pl.graph import WindowRandom, coherent_noise, random_walk_noise


def window_random(number: int, *, graphs: int = 1, seed: int = 0) -> WindowRandom:
    return WindowRandom(seed, torch.arange(graphs), torch.arange(graphs).repeat_interleave(number))


def test_random_walk_has_the_stated_deviation() -> None:
    history = torch.zeros(20000, 6, 3)
    noise = random_walk_noise(history, torch.tensor(1e-3), window_random(20000))
    assert torch.equal(noise[:, 0], torch.zeros(20000, 3))
    deviation = noise.diff(dim=1).std(dim=(0, 2))
    expected = 1e-3 * (torch.arange(1, 6) / 5).sqrt()
    torch.testing.assert_close(deviation, expected, rtol=0.02, atol=0)


def test_random_walk_level_per_particle() -> None:
    level = torch.tensor([0.0, 1e-3])[:, None, None]
    noise = random_walk_noise(torch.zeros(2, 6, 3), level, window_random(2))
    assert noise[0].abs().max() == 0 and noise[1].abs().max() > 0


def test_coherent_noise_is_smooth_and_has_the_stated_strain() -> None:
    generator = torch.Generator().manual_seed(1)
    length, step = 0.1, 1e-3
    base = torch.rand(2000, 3, generator=generator)
    strains = []
    for seed in range(40):
        pair = torch.cat([base, base + torch.tensor([step, 0, 0])])
        moved = coherent_noise(pair, window_random(len(pair), seed=seed), strain_std=0.02, length=length)
        strains.append((moved[2000:] - moved[:2000]) / step)
    assert abs(float(torch.stack(strains).std()) / 0.02 - 1) < 0.2


def test_coherent_noise_differs_between_graphs() -> None:
    position = torch.rand(10, 3).repeat(2, 1)
    moved = coherent_noise(position, window_random(10, graphs=2), strain_std=0.02, length=0.1)
    assert not torch.allclose(moved[:10], moved[10:])
