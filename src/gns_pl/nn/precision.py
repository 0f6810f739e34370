"""Networks are made in single precision, whatever precision the program around them has chosen for its own tensors."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import ParamSpec, TypeVar

import torch

P = ParamSpec("P")
R = TypeVar("R")


def in_float32(function: Callable[P, R]) -> Callable[P, R]:
    """Return a function that runs with single precision as torch's default.

    Checkpoints, data and compiled loops are in single precision. Under `torch.set_default_dtype(torch.float64)` the
    weights alone would be in double precision, and no product of theirs with anything possible.

    Args:
        function: such as the `__init__` of a module; `module.double()` changes the precision afterwards.
    """

    @functools.wraps(function)
    def run(*args: P.args, **kwargs: P.kwargs) -> R:
        before = torch.get_default_dtype()
        torch.set_default_dtype(torch.float32)
        try:
            return function(*args, **kwargs)
        finally:
            torch.set_default_dtype(before)

    return run
