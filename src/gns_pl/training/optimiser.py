"""Muon for the matrices, AdamW for everything else, as one optimiser."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import nn
from torch.optim import AdamW, Muon, Optimizer

OPTIMISERS = ("adamw", "muon")


class MuonAndAdamW(Optimizer):
    """Steps every matrix of a module along its orthogonalised momentum, and its vectors as AdamW does.

    Muon (Jordan et al. 2024) takes all singular directions of a matrix alike, where AdamW follows the few that
    dominate. Its update is scaled to the size of AdamW's (Liu et al. 2025), so that one learning rate serves both.

    Args:
        module: the network.
        lr: learning rate of both.
        weight_decay: of both.
    """

    def __init__(self, module: nn.Module, *, lr: float, weight_decay: float) -> None:
        parameters = list(module.parameters())
        matrices = [parameter for parameter in parameters if parameter.ndim == 2]
        others = [parameter for parameter in parameters if parameter.ndim != 2]
        super().__init__(parameters, {"lr": lr})
        self.muon = Muon(matrices, lr=lr, weight_decay=weight_decay, adjust_lr_fn="match_rms_adamw")
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
        self.muon.step()  # type: ignore[no-untyped-call]
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
