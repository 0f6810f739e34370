"""A whole rollout as one operation for autograd: there without gradients, back with each step made a second time.

Backpropagation through T steps would keep every edge state of every step. Here only the positions are kept, and each
step is computed a second time when its gradient is due (Griewank and Walther 2000), so memory grows with T · N and not
with T · E · L. On the way there a CPU has its compiled loops, which know no derivatives.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, cast

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from gns_pl.graph import SceneBatch
from gns_pl.rollout.stepper import Stepper


def all_frames(step: Callable[[Tensor], Tensor], history: Tensor, num_steps: int) -> Tensor:
    """Return the frames that follow [T, N, D] [m]; one that is not finite is the last.

    Args:
        step: makes the next positions of a history.
        history: [N, H, D] [m].
        num_steps: frames to make, at least 1.
    """
    frames: list[Tensor] = []
    while len(frames) < num_steps:
        frame = step(history)
        frames.append(frame)
        if not bool(torch.isfinite(frame.detach()).all()):
            break  # no neighbours can be found of what is nowhere
        history = torch.cat([history[:, 1:], frame[:, None]], dim=1)
    return torch.stack(frames)


def recomputed_frames(
    stepper: Stepper, weights: list[Tensor], history: Tensor, scenes: SceneBatch, num_steps: int
) -> Tensor:
    """Return `all_frames` with derivatives by the history, `scenes.material` and weights, whichever want one.

    Args:
        stepper: makes one step, with derivatives where they are wanted.
        weights: of the stepper.
        history: [N, H, D] [m].
        scenes: those that are stepped.
        num_steps: frames to make.
    """
    return cast(Tensor, _Frames.apply(stepper, scenes, num_steps, history, scenes.material, *weights))  # type: ignore[no-untyped-call]


class _Frames(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, stepper: Stepper, scenes: SceneBatch, num_steps: int, history: Tensor, *inputs: Tensor
    ) -> Tensor:
        if inputs[0].requires_grad:  # compiled loops take nothing that wants a derivative
            scenes = replace(scenes, material=inputs[0].detach())
        frames = all_frames(lambda positions: stepper(positions, scenes), history.detach(), num_steps)
        kind = history.device.type
        ctx.precision = (kind, torch.get_autocast_dtype(kind), torch.is_autocast_enabled(kind))
        ctx.stepper, ctx.scenes = stepper, scenes
        ctx.save_for_backward(history, frames, *inputs)
        return frames

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, above: Tensor) -> tuple[Tensor | None, ...]:
        history, frames, *inputs = ctx.saved_tensors
        needed = [number for number, needs in enumerate(ctx.needs_input_grad[4:]) if needs]
        scenes: SceneBatch = ctx.scenes
        if 0 in needed:  # the material stands in the scenes, whose other tensors have no derivative
            inputs[0] = inputs[0].detach().requires_grad_()
            scenes = replace(scenes, material=inputs[0])
        leaves = [inputs[number] for number in needed]
        length, sums = history.shape[1], [torch.zeros_like(leaf) for leaf in leaves]
        positions = torch.cat([history.transpose(0, 1), frames])
        due = torch.cat([torch.zeros_like(positions[:length]), above])
        for first in reversed(range(len(frames))):
            window = positions[first : first + length].transpose(0, 1).contiguous().requires_grad_()
            with torch.enable_grad(), torch.autocast(*ctx.precision):
                frame = ctx.stepper(window, scenes)
            to_window, *found = torch.autograd.grad(frame, [window, *leaves], due[first + length], allow_unused=True)
            due[first : first + length] += to_window.transpose(0, 1)
            used = [(total, part) for total, part in zip(sums, found, strict=True) if part is not None]
            if used:  # nothing is where all sleep
                torch._foreach_add_(*map(list, zip(*used, strict=True)))
        gradients: list[Tensor | None] = [None] * len(inputs)
        for number, total in zip(needed, sums, strict=True):
            gradients[number] = total
        return None, None, None, due[:length].transpose(0, 1), *gradients
