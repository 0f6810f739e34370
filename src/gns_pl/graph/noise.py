"""Training noise: what a rollout's own errors look like, drawn in advance."""

from __future__ import annotations

import torch
from torch import Tensor

from gns_pl.graph.window_random import WindowRandom


def random_walk_noise(history: Tensor, noise_std: Tensor, random: WindowRandom) -> Tensor:
    """Return the position noise of a random walk in velocity (Sanchez-Gonzalez et al. 2020, appendix B).

    Every velocity of the history gets an independent increment; the latest velocity's noise has the standard deviation
    `noise_std / Δt`, and the first position none.

    Args:
        history: [N, H, D] [m].
        noise_std: standard deviation of the latest velocity's noise times Δt, broadcast to [N, 1, 1] [m].
        random: the windows' random numbers.

    Returns:
        [N, H, D] [m], to be added to the history.
    """
    steps = history.shape[1] - 1
    increment = random.particle_normal("random walk", steps, history.shape[2], dtype=history.dtype)
    velocity = (increment * noise_std / steps**0.5).cumsum(dim=1)
    return torch.nn.functional.pad(velocity.cumsum(dim=1), (0, 0, 1, 0))


def coherent_noise(position: Tensor, random: WindowRandom, *, strain_std: float, length: float) -> Tensor:
    """Return a smooth displacement of whole regions: sunk, squeezed or sheared a little, as rollouts become.

    A sum of random Fourier modes with wavelengths of about 2π `length`, so that its gradient has the standard
    deviation `strain_std`. Independent noise averages out over a region; this one does not, and a network that is
    asked to undo part of it learns to hold the density.

    Args:
        position: [N, D] [m].
        random: the windows' random numbers; every window gets its own field.
        strain_std: standard deviation of the entries of the displacement gradient.
        length: correlation length [m].

    Returns:
        [N, D] [m].
    """
    modes, dim, dtype, batch = 4, position.shape[1], position.dtype, random.batch
    wave = random.normal("coherent wave", modes, dim, dtype=dtype) / length
    phase = 2 * torch.pi * random.uniform("coherent phase", modes, dtype=dtype)
    amplitude = random.normal("coherent amplitude", modes, dim, dtype=dtype)
    amplitude = amplitude * (strain_std * length * (2 / modes) ** 0.5)
    angle = (position[:, None, :] * wave[batch]).sum(dim=2) + phase[batch]
    field: Tensor = (angle.sin()[:, :, None] * amplitude[batch]).sum(dim=1)
    return field
