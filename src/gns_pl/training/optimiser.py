"""Muon for the matrices, AdamW for everything else, as one optimiser."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any, cast

import torch
from torch import Tensor, nn
from torch.optim import AdamW, Optimizer

OPTIMISERS = ("adamw", "muon")
MOMENTUM = 0.95


class Muon(Optimizer):
    """Steps every matrix along its orthogonalised Nesterov momentum (Jordan et al. 2024).

    The update is scaled to the size of AdamW's (Liu et al. 2025). `torch.optim.Muon` does the same matrix by matrix in
    bfloat16, which takes 23 ms for the 24 small matrices of a network of two cores, a quarter of a training step; here
    matrices of one shape are handled together in float32, in a millisecond.

    Args:
        matrices: parameters with two axes.
        lr: learning rate.
        weight_decay: as AdamW's.
    """

    def __init__(self, matrices: Iterable[nn.Parameter], *, lr: float, weight_decay: float) -> None:
        super().__init__(matrices, {"lr": lr, "weight_decay": weight_decay})

    @torch.no_grad()
    def step(self, closure: None = None) -> None:  # type: ignore[override]
        """Make one step."""
        for group in self.param_groups:
            shapes: dict[torch.Size, list[Tensor]] = {}
            for matrix in group["params"]:
                if matrix.grad is not None:
                    shapes.setdefault(matrix.shape, []).append(matrix)
            for shape, matrices in shapes.items():
                for matrix in matrices:
                    if "momentum" not in self.state[matrix]:
                        self.state[matrix]["momentum"] = torch.zeros_like(matrix)
                gradients = [cast(Tensor, matrix.grad) for matrix in matrices]
                momenta = [self.state[matrix]["momentum"] for matrix in matrices]
                torch._foreach_lerp_(momenta, gradients, 1 - MOMENTUM)
                update = orthogonalised(torch.stack(torch._foreach_lerp(gradients, momenta, MOMENTUM)))
                torch._foreach_mul_(matrices, 1 - group["lr"] * group["weight_decay"])
                torch._foreach_add_(matrices, list(update.unbind()), alpha=-0.2 * math.sqrt(max(shape)) * group["lr"])


def orthogonalised(matrices: Tensor) -> Tensor:
    """Return matrices with the same singular vectors and singular values of about one [K, A, B].

    Five steps of a quintic Newton–Schulz iteration, with the coefficients of Jordan et al. (2024): values end between
    0.7 and 1.2.

    Args:
        matrices: [K, A, B].
    """
    tall = matrices.shape[1] > matrices.shape[2]
    x = matrices.mT if tall else matrices
    x = x / torch.linalg.matrix_norm(x, keepdim=True).clamp(min=1e-7)
    for _ in range(5):
        gram = x @ x.mT
        x = 3.4445 * x + (-4.7750 * gram + 2.0315 * gram @ gram) @ x
    return cast(Tensor, x.mT if tall else x)


class MuonAndAdamW(Optimizer):
    """`Muon` for a module's matrices, AdamW for its vectors, both with one learning rate.

    Muon takes all singular directions of a matrix alike, where AdamW follows the few that dominate.

    Args:
        module: the network.
        lr: learning rate.
        weight_decay: of both.
    """

    def __init__(self, module: nn.Module, *, lr: float, weight_decay: float) -> None:
        parameters = list(module.parameters())
        super().__init__(parameters, {"lr": lr})
        matrices = [parameter for parameter in parameters if parameter.ndim == 2]
        others = [parameter for parameter in parameters if parameter.ndim != 2]
        self.muon = Muon(matrices, lr=lr, weight_decay=weight_decay)
        self.adamw = AdamW(others, lr=lr, weight_decay=weight_decay, fused=True)
        self._share_groups()

    def _share_groups(self) -> None:
        """Let whoever sets a learning rate here set it there."""
        self.param_groups = self.muon.param_groups + self.adamw.param_groups

    @torch.no_grad()
    def step(self, closure: Callable[[], float] | None = None) -> float | None:  # type: ignore[override]
        """Make one step of both."""
        loss = None
        if closure is not None:
            with torch.enable_grad():
                loss = closure()
        self.muon.step()
        self.adamw.step()
        return loss

    def state_dict(self) -> dict[str, Any]:
        """Return the states of both."""
        return {"muon": self.muon.state_dict(), "adamw": self.adamw.state_dict()}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Take up the states of both."""
        self.muon.load_state_dict(state_dict["muon"])
        self.adamw.load_state_dict(state_dict["adamw"])
        self._share_groups()


def forget(optimizer: Optimizer) -> None:
    """Let an optimiser begin anew, without the momenta and squares of the gradients so far."""
    parts = (optimizer.muon, optimizer.adamw) if isinstance(optimizer, MuonAndAdamW) else (optimizer,)
    for part in parts:
        part.state.clear()
