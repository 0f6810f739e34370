"""Coulomb's law of particles at surfaces: in torch, and on a CPU in compiled loops, there and back by velocities."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from gns_pl.graph.surface_loops import surface
from gns_pl.machine import compile_function

STRAIGHT = 0.5
"""A surface that bends by more than 60° within half a step counts as one that bends so much."""


def coulomb(velocity: Tensor, normal: Tensor, soon: Tensor, grip: Tensor) -> Tensor:
    """Return what contacts add to velocities [N, S, D]: p n − min(1, μ p / |w|) w, w = u + p n, if u would go in.

    The pressure p along n turns u into the tangent half a step ahead, so that a bend costs no speed but by friction.

    Args:
        velocity: u [N, 1, D] [m/s].
        normal: n, out of the surfaces [N, S, D].
        soon: those half a step ahead [N, S, D].
        grip: s = μ / (1 + μ) of them [N or 1, S].
    """
    into = (velocity * soon).sum(dim=2, keepdim=True)
    press = (-into).clamp_min(0) / (normal * soon).sum(dim=2, keepdim=True).clamp_min(STRAIGHT)
    sliding = velocity + press * normal
    speed = (sliding.square().sum(dim=2, keepdim=True) + 1e-12).sqrt()
    friction = (grip / (1 - grip).clamp_min(1e-3))[..., None]
    return press * normal - (friction * press / speed).clamp_max(1) * sliding


def contacts_in_loops(velocity: Tensor, place: Any, batch: Any, rest: tuple[Any, ...]) -> Tensor:
    """Return what `Surfaces.contacts` does, of places that nothing is derived by.

    Args:
        velocity: [N, D] [m/s].
        place: [N, D] [m].
        batch: scene of every particle [N].
        rest: further arguments of `throw_back`.
    """
    return cast(Tensor, _Contacts.apply(velocity, place, batch, rest))  # type: ignore[no-untyped-call]


@compile_function
def pressure(velocity: Any, normal: Any, soon: Any, sliding: Any) -> Any:
    """Return what presses, p [m/s], 0 for what leaves, its derivative by u · soon, and |w|; fill in w = u + p n [D]."""
    dim, into, straight = len(velocity), np.float32(0), np.float32(0)
    for axis in range(dim):
        into += velocity[axis] * soon[axis]
        straight += normal[axis] * soon[axis]
    by_into = -np.float32(1) / max(straight, np.float32(STRAIGHT))
    press, square = into * by_into if into < 0 else np.float32(0), np.float32(1e-12)
    for axis in range(dim):
        sliding[axis] = velocity[axis] + press * normal[axis]
        square += sliding[axis] * sliding[axis]
    return press, by_into, np.sqrt(square)


@compile_function
def add_contact(velocity: Any, normal: Any, soon: Any, grip: Any, weight: Any, sliding: Any, contact: Any) -> None:
    """Add what a contact adds to a velocity [D], times a weight, as `coulomb` does; `sliding` is room [D]."""
    press, _, speed = pressure(velocity, normal, soon, sliding)
    if press <= 0:
        return
    share = min(grip / max(np.float32(1) - grip, np.float32(1e-3)) * press / speed, np.float32(1))
    for axis in range(len(velocity)):
        contact[axis] += weight * (press * normal[axis] - share * sliding[axis])


@compile_function
def contact_backward(
    above: Any, velocity: Any, normal: Any, soon: Any, grip: Any, weight: Any, sliding: Any, given: Any
) -> None:
    """Add to the gradient by a velocity that by what `add_contact` added [D], each [D]."""
    press, by_into, speed = pressure(velocity, normal, soon, sliding)
    if press <= 0:
        return
    dim, friction = len(velocity), grip / max(np.float32(1) - grip, np.float32(1e-3))
    share = friction * press / speed
    if share >= 1:  # it sticks: all of the velocity is taken away
        for axis in range(dim):
            given[axis] -= weight * above[axis]
        return
    up, along, straight = np.float32(0), np.float32(0), np.float32(0)
    for axis in range(dim):
        up += above[axis] * normal[axis]
        along += above[axis] * sliding[axis] / speed
        straight += normal[axis] * sliding[axis] / speed
    by_press = up - friction * along - share * (up - along * straight)
    for axis in range(dim):
        across = above[axis] - along * sliding[axis] / speed
        given[axis] += weight * (by_press * by_into * soon[axis] - share * across)


@compile_function
def throw_back(
    place: Any, batch: Any, velocity: Any, ahead: Any, radius: Any, touching: Any,
    planes: Any, offset: Any, plane_grip: Any, lower: Any, upper: Any, cuboid_grip: Any,
    heights: Any, first: Any, shape: Any, corner: Any, cell: Any, ground_grip: Any,
) -> Any:  # fmt: skip
    """Return `Surfaces.contacts` [N, D]; arguments as of it and of `see`."""
    number, dim = place.shape
    added, normal, work = np.zeros((number, dim), np.float32), np.zeros(dim, np.float32), np.zeros((4, 3), np.float32)
    soon, sliding = np.zeros(dim, np.float32), np.zeros(dim, np.float32)
    for i in range(number):
        for s in range(planes.shape[1] + lower.shape[1] + 1):
            distance, grip, _ = surface(
                s, place[i], batch[i], planes, offset, plane_grip, lower, upper, cuboid_grip,
                heights, first, shape, corner, cell, ground_grip, work, normal,
            )  # fmt: skip
            share = min((radius - distance) / (radius - touching), np.float32(1))
            if share > 0:
                surface(
                    s, place[i] + ahead * velocity[i], batch[i], planes, offset, plane_grip, lower, upper, cuboid_grip,
                    heights, first, shape, corner, cell, ground_grip, work, soon,
                )  # fmt: skip
                add_contact(velocity[i], normal, soon, grip, share, sliding, added[i])
    return added


@compile_function
def throw_back_backward(
    above: Any, place: Any, batch: Any, velocity: Any, ahead: Any, radius: Any, touching: Any,
    planes: Any, offset: Any, plane_grip: Any, lower: Any, upper: Any, cuboid_grip: Any,
    heights: Any, first: Any, shape: Any, corner: Any, cell: Any, ground_grip: Any,
) -> Any:  # fmt: skip
    """Return the gradient by velocities [N, D] from that by `throw_back` [N, D], whose arguments follow."""
    number, dim = place.shape
    given, normal, work = np.zeros((number, dim), np.float32), np.zeros(dim, np.float32), np.zeros((4, 3), np.float32)
    soon, sliding = np.zeros(dim, np.float32), np.zeros(dim, np.float32)
    for i in range(number):
        for s in range(planes.shape[1] + lower.shape[1] + 1):
            distance, grip, _ = surface(
                s, place[i], batch[i], planes, offset, plane_grip, lower, upper, cuboid_grip,
                heights, first, shape, corner, cell, ground_grip, work, normal,
            )  # fmt: skip
            share = min((radius - distance) / (radius - touching), np.float32(1))
            if share > 0:
                surface(
                    s, place[i] + ahead * velocity[i], batch[i], planes, offset, plane_grip, lower, upper, cuboid_grip,
                    heights, first, shape, corner, cell, ground_grip, work, soon,
                )  # fmt: skip
                contact_backward(above[i], velocity[i], normal, soon, grip, share, sliding, given[i])
    return given


class _Contacts(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, speed: Tensor, place: Any, batch: Any, rest: tuple[Any, ...]) -> Tensor:
        ctx.given = (place, batch, speed.detach().contiguous().numpy(), *rest)
        return torch.from_numpy(throw_back(*ctx.given))

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, above: Tensor) -> tuple[Tensor, None, None, None]:
        return torch.from_numpy(throw_back_backward(above.contiguous().numpy(), *ctx.given)), None, None, None
