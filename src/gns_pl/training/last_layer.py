"""The last layer of a corrector, fitted without a derivative of the solver: by differences of whole runs.

With the placement of the points kept, what a run answers to another last layer is smooth: finite differences scatter by
few per cent (docs/reductions.md). So a Gauss–Newton step in few numbers needs one run of each scene for each of them.
These numbers are weights of the principal components of what the last layer sees. A ridge keeps small what the scenes
do not tell.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from gns_pl.metrics.maps import volume_map
from gns_pl.models.corrector import Corrector
from gns_pl.rollout import static_of
from gns_pl.solvers.correction import CoarseStart, corrected_run
from gns_pl.training.deposits import deposit_errors
from gns_pl.training.whole_runs import FineRun

Floats = NDArray[np.float64]

OUTPUT = 0.3
"""Root mean square of the last layer's output that is a number's unit; tanh follows."""

DIFFERENCE = 0.5
"""Of a number, from the run before to the run that is compared with it."""

NOISE, PRIOR = 0.03, 1.0
"""Expected errors that no last layer mends, and size of the numbers: the ridge is the square of their quotient."""

MAP_SHARE = 3.0
"""Of the residuals of single nodes, whose squares are few beside the sum of magnitudes that a map's error is."""

SHOWN = 8
"""So many scenes show what the last layer sees."""


def fit_last_layer(corrector: Corrector, runs: Sequence[FineRun], *, num_directions: int, seed: int) -> None:
    """Make a Gauss–Newton step of the last layer's weights.

    Args:
        corrector: whose last layer is changed, in place.
        runs: fine ones, each of which is run `num_directions` + 1 times.
        num_directions: numbers that are fitted.
        seed: of the first placement.

    Raises:
        SimulationError: a run became unstable.
    """
    last = cast(nn.Linear, corrector.network.decoder[-1])
    starts = [CoarseStart.retuned(corrector.config, run.start.scene, seed + i, {}) for i, run in enumerate(runs)]
    directions = principal_directions(seen_by_last(corrector, runs[:SHOWN], starts), num_directions)
    weight, bias = last.weight.detach().clone(), last.bias.detach().clone()

    def put(numbers: Floats) -> None:
        change = torch.from_numpy(numbers @ directions).to(weight.dtype)
        with torch.no_grad():
            last.weight.copy_(weight + change[:-1])
            last.bias.copy_(bias + change[-1])

    def residuals() -> Floats:
        return np.concatenate([residual(corrector, run, start) for run, start in zip(runs, starts, strict=True)])

    before, columns = residuals(), []
    for number in range(num_directions):
        put(DIFFERENCE * np.eye(num_directions)[number])
        columns.append((residuals() - before) / DIFFERENCE)
    put(ridge_step(np.stack(columns, axis=1), before))


def seen_by_last(corrector: Corrector, runs: Sequence[FineRun], starts: Sequence[CoarseStart]) -> Floats:
    """Return what the last layer sees of the points of corrected runs, and ones [M, width + 1]."""
    seen: list[Floats] = []
    layer = corrector.network.decoder[-1]
    for run, start in zip(runs, starts, strict=False):
        frames = torch.from_numpy(corrected_run(corrector, start, run.last).position)
        static = static_of(start.first)
        hook = layer.register_forward_pre_hook(lambda _, given: seen.append(given[0].detach().double().numpy()))
        for number in range(2, run.last, 4):  # with gradients: loops that are compiled do not call the layer
            corrector(*frames[number - 2 : number + 1], static, start.unit)
        hook.remove()
    rows = np.concatenate(seen)
    return np.concatenate([rows, np.ones((len(rows), 1))], axis=1)


def principal_directions(seen: Floats, number: int) -> Floats:
    """Return changes of a last layer whose outputs are independent and of one size [number, width + 1].

    Args:
        seen: by the last layer, and ones [M, width + 1].
        number: of changes, those first of which the inputs have most.
    """
    _, _, components = np.linalg.svd(seen, full_matrices=False)
    chosen = components[:number]
    return np.asarray(OUTPUT * chosen / np.sqrt(np.square(seen @ chosen.T).mean(axis=0))[:, None])


def residual(corrector: Corrector, fine: FineRun, start: CoarseStart) -> Floats:
    """Return the error of the front and those of all nodes of the map, at the end of a corrected run."""
    run = start.reduction.lift(corrected_run(corrector, start, fine.last))
    wanted = fine.fine.volume_map[-1].astype(np.float64)
    place, volume = run.position[-1].astype(np.float64), run.volume().astype(np.float64)
    volumes = volume_map(place, volume, run.scene, fine.fine.cell)
    front = deposit_errors(run.every(fine.last), fine.fine)["front"]
    return np.array([front, *(MAP_SHARE * (volumes - wanted) / (2 * wanted.sum())).ravel()])


def ridge_step(jacobian: Floats, residuals: Floats) -> Floats:
    """Return the numbers that make Σ r² / NOISE² + Σ c² / PRIOR² least, r = residuals + jacobian c [K]."""
    ridge = (NOISE / PRIOR) ** 2 * np.eye(jacobian.shape[1])
    return np.asarray(-np.linalg.solve(jacobian.T @ jacobian + ridge, jacobian.T @ residuals))
