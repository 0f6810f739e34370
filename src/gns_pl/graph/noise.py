"""Training noise: what a rollout's own errors look like, drawn in advance."""

from __future__ import annotations

import torch
from torch import Tensor


def random_walk_noise(history: Tensor, noise_std: Tensor, generator: torch.Generator | None = None) -> Tensor:
    """Return the position noise of a random walk in velocity (Sanchez-Gonzalez et al. 2020, appendix B).

    Every velocity of the history gets an independent increment; the latest velocity's noise has the standard deviation
    `noise_std / Δt`, and the first position none.

    Args:
        history: [N, H, D] [m].
        noise_std: standard deviation of the latest velocity's noise times Δt, broadcast to [N, 1, 1] [m].
        generator: source of randomness.

    Returns:
        [N, H, D] [m], to be added to the history.
    """
    steps = history.shape[1] - 1
    shape = (history.shape[0], steps, history.shape[2])
    increment = torch.randn(shape, generator=generator, device=history.device, dtype=history.dtype)
    velocity = (increment * noise_std / steps**0.5).cumsum(dim=1)
    return torch.nn.functional.pad(velocity.cumsum(dim=1), (0, 0, 1, 0))


def coherent_noise(
    position: Tensor,
    batch: Tensor,
    num_graphs: int,
    *,
    strain_std: float,
    length: float,
    generator: torch.Generator | None = None,
) -> Tensor:
    """Return a smooth displacement of whole regions: sunk, squeezed or sheared a little, as rollouts become.

    A sum of random Fourier modes with wavelengths of about 2π `length`, so that its gradient has the standard
    deviation `strain_std`. Independent noise averages out over a region; this one does not, and a network that is
    asked to undo part of it learns to hold the density.

    Args:
        position: [N, D] [m].
        batch: [N] graph of every particle.
        num_graphs: B; every graph gets its own field.
        strain_std: standard deviation of the entries of the displacement gradient.
        length: correlation length [m].
        generator: source of randomness.

    Returns:
        [N, D] [m].
    """
    modes, dim = 4, position.shape[1]
    device, dtype = position.device, position.dtype
    wave = torch.randn((num_graphs, modes, dim), generator=generator, device=device, dtype=dtype) / length
    phase = 2 * torch.pi * torch.rand((num_graphs, modes), generator=generator, device=device, dtype=dtype)
    amplitude = torch.randn((num_graphs, modes, dim), generator=generator, device=device, dtype=dtype)
    amplitude = amplitude * (strain_std * length * (2 / modes) ** 0.5)
    angle = (position[:, None, :] * wave[batch]).sum(dim=2) + phase[batch]
    field: Tensor = (angle.sin()[:, :, None] * amplitude[batch]).sum(dim=1)
    return field
