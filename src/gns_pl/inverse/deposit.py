"""A deposit as a smooth function of final positions: how thick the sand lies, whichever particle lies there."""

from __future__ import annotations

import math

import torch
from torch import Tensor


def deposit_thickness(
    position: Tensor, volume: Tensor, places: Tensor, width: float, walls: tuple[float, float]
) -> Tensor:
    """Return the thickness h(x) of sand over places on the floor, every particle smeared by a Gaussian.

    h(x) = Σ V_i K(x − x_i), with K of standard deviation w and its images in both walls, so that ∫ h dx over the box is
    the volume. It does not depend on the number of particles but through their spacing, which should be below w.

    Args:
        position: in plane strain [N, 2] [m].
        volume: that every particle stands for [N] [m²].
        places: along the floor [P] [m].
        width: standard deviation w [m].
        walls: x of the lower and of the upper wall [m].

    Returns:
        [P] [m].
    """
    along, (lower, upper) = position[:, 0], walls
    thickness = torch.zeros_like(places)
    for image in (along, 2 * lower - along, 2 * upper - along):
        kernel = torch.exp(-0.5 * ((places[:, None] - image[None]) / width) ** 2)
        thickness = thickness + kernel @ volume
    return thickness / (width * math.sqrt(2 * math.pi))


def deposit_misfit(thickness: Tensor, observed: Tensor) -> Tensor:
    """Return Σ (h − h_obs)² / Σ h_obs² [], the squared share of the deposit that lies elsewhere.

    Args:
        thickness: [P] [m].
        observed: [P] [m].
    """
    return ((thickness - observed) ** 2).sum() / (observed**2).sum()
