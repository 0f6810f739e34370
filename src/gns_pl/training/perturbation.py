"""What a training window looks like to the network: noise on the history, and the target that goes with it."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from gns_pl.errors import InputError
from gns_pl.graph import SceneBatch, WindowRandom, coherent_noise, random_walk_noise


@dataclass(frozen=True)
class Perturbation:
    """How histories are perturbed.

    Attributes:
        noise_std: of the latest velocity's random-walk noise times Δt [m].
        noise_free: share of the windows that stay as they are.
        strain_std: largest standard deviation of the strain of the coherent noise, from 0 on uniform [1].
        strain_length: its correlation length [m].
        restore: share κ of the position error that the target undoes in one step. 0 is the correction of
            Sanchez-Gonzalez et al. (2020), after which the velocity is right and the position error stays.

    Raises:
        InputError: a value out of range.
    """

    noise_std: float
    noise_free: float
    strain_std: float
    strain_length: float
    restore: float

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise InputError(f"training.{name} must be a number, not {value!r}.")
        for name in ("noise_std", "strain_std"):
            if not getattr(self, name) >= 0:
                raise InputError(f"training.{name} must not be negative, but is {getattr(self, name)}.")
        for name in ("noise_free", "restore"):
            if not 0 <= getattr(self, name) <= 1:
                raise InputError(f"training.{name} must lie in [0, 1], but is {getattr(self, name)}.")
        if not self.strain_length > 0:
            raise InputError(f"training.strain_length must be positive, but is {self.strain_length}.")

    def __call__(
        self, history: Tensor, next_position: Tensor, scenes: SceneBatch, random: WindowRandom
    ) -> tuple[Tensor, Tensor]:
        """Return the perturbed history [N, H, D] and the next position its target leads to [N, D].

        With the noise n of the latest position, the target leads to x_{t+1} + (1 − κ) n. Kinematic particles stay.

        Args:
            history: [N, H, D] [m].
            next_position: [N, D] [m].
            scenes: those that are stepped.
            random: the windows' random numbers.
        """
        dtype = history.dtype
        noisy = random.uniform("noise free", dtype=dtype) >= self.noise_free
        level = (noisy[scenes.batch] & scenes.moved).to(dtype)[:, None, None]
        noise = random_walk_noise(history, self.noise_std * level, random)
        if self.strain_std:
            moved = coherent_noise(history[:, -1], random, strain_std=self.strain_std, length=self.strain_length)
            # Every scene at a level of its own, so that small and large errors are both seen.
            share = random.uniform("coherent level", dtype=dtype)[scenes.batch]
            noise = noise + level * (share[:, None] * moved)[:, None, :]
        return history + noise, next_position + (1 - self.restore) * noise[:, -1]
