"""A small network that learns from a large one besides the data (Hinton, Vinyals and Dean 2015, for regression)."""

from __future__ import annotations

import copy

import torch
from torch import Tensor

from gns_pl.checkpoint import load_checkpoint
from gns_pl.errors import InputError
from gns_pl.frame_simulator import FrameConfig, FrameSimulator
from gns_pl.graph import Static
from gns_pl.pretrained import find_checkpoint
from gns_pl.simulator import Simulator, SimulatorConfig

SAME = ("dim", "dt", "spacing", "particle_types", "material_features")


class Elder:
    """A trained simulator whose accelerations are a part of another's target.

    The large network sees the state that the small one sees, noise included, and says what it would do; of that the
    chaotic part of the data, which no network can foresee, is averaged out.

    Args:
        simulator: trained.
        share: of the target, 0 to 1; the rest is the data's.
    """

    def __init__(self, simulator: Simulator, share: float) -> None:
        self.simulator, self.share = copy.deepcopy(simulator).eval().requires_grad_(False), share

    @classmethod
    def read(cls, path: str, share: float, config: SimulatorConfig) -> Elder:
        """Return the simulator of a checkpoint.

        Args:
            path: of the checkpoint, or the name of one that comes with the package.
            share: of the target.
            config: of the one that learns.

        Raises:
            InputError: no such checkpoint, or one that steps another kind of scene.
        """
        if not find_checkpoint(path).is_file():
            raise InputError(f"training.distil_from: there is no checkpoint {path}.")
        simulator = load_checkpoint(path).simulator
        if isinstance(simulator, FrameSimulator) or isinstance(config, FrameConfig):
            raise InputError("training.distil_from: simulators in frames give other accelerations, so none has a part.")
        for name in SAME:
            ours, theirs = getattr(config, name), getattr(simulator.config, name)
            if ours != theirs and not (isinstance(ours, float) and abs(ours - theirs) < 1e-6 * ours):
                raise InputError(f"training.distil_from: {path} has {name} {theirs}, and what is to learn has {ours}.")
        if simulator.config.input_sequence_length > config.input_sequence_length:
            raise InputError(
                f"training.distil_from: {path} needs {simulator.config.input_sequence_length} positions, more than "
                f"model.input_sequence_length={config.input_sequence_length}."
            )
        return cls(simulator, share)

    def mixed(self, target: Tensor, history: Tensor, static: Static, scale: Tensor) -> Tensor:
        """Return a target of which a share is this simulator's [N, D], (a − g) / `scale`.

        Args:
            target: of the data, (a − g) / `scale` [N, D].
            history: [N, H, D] [m].
            static: the scenes.
            scale: of the one that learns [] [m/s²].
        """
        self.simulator.to(history.device)
        with torch.no_grad():
            length = self.simulator.config.input_sequence_length
            own = self.simulator.normalised_acceleration(history[:, -length:], static)
        return (1 - self.share) * target + self.share * own * self.simulator.acceleration_scale / scale
