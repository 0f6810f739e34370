"""What weights are chosen by where whole runs are trained on: final deposits from cold starts against fine runs.

Each validation scene is filled several times, as users fill it, and the run is compared with what all points of the
fine run did, as a chart compares solvers (`evaluation.chart`): front and map, and the mean height.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from gns_pl.errors import InputError
from gns_pl.metrics.curves import mobile
from gns_pl.metrics.maps import map_error, volume_map
from gns_pl.metrics.release import front_advance
from gns_pl.solvers.trained import TrainedSolver
from gns_pl.training.outcomes import LEAST_ADVANCE, PERCENT
from gns_pl.training.validation import DEPOSIT
from gns_pl.training.whole_runs import FineRun
from gns_pl.trajectory import Observables, Trajectory


def deposit_errors(run: Trajectory, fine: Observables) -> dict[str, float]:
    """Return the relative errors of a final deposit by their names in `DEPOSIT`; infinite if the run broke.

    Args:
        run: of any points.
        fine: what all points of the fine run did, over the same time.
    """
    flow = mobile(run)
    if not np.isfinite(flow.position[-1]).all():
        return dict.fromkeys(DEPOSIT, math.inf)
    place, mass = flow.position[-1].astype(np.float64), flow.mass.astype(np.float64)
    advance = float(fine.advance()[-1, fine.percents.index(PERCENT)])
    volumes = volume_map(place, flow.volume().astype(np.float64), flow.scene, fine.cell)
    height = float(mass @ place[:, -1] / mass.sum()) - flow.scene.lower[-1]
    return {
        "front": (float(front_advance(flow)[-1]) - advance) / max(advance, LEAST_ADVANCE * fine.cell),
        "map": map_error(volumes, fine.volume_map[-1].astype(np.float64)),
        "height": height / float(fine.mean_height[-1]) - 1,
    }


class Deposits:
    """The validation scenes, each filled several times.

    Args:
        runs: of the validation set.
        placements: fillings of every scene, the same in every validation.
    """

    def __init__(self, runs: Sequence[FineRun], placements: int) -> None:
        self.runs, self.placements = runs, placements

    def squares(self, solver: TrainedSolver, number: int) -> Mapping[str, float]:
        """Return the mean squared errors of a scene as `ValidationTable` takes them.

        Args:
            solver: what is validated.
            number: of the scene.
        """
        run, rows = self.runs[number], []
        for placement in range(self.placements):
            try:
                made = solver.run(run.start.scene, seed=placement, monitor=False)
                errors = deposit_errors(made, run.fine)
            except InputError:  # it broke
                errors = dict.fromkeys(DEPOSIT, math.inf)
            rows.append([errors[name] ** 2 for name in DEPOSIT])
        return dict(zip((f"{name}_square" for name in DEPOSIT), np.mean(rows, axis=0).tolist(), strict=True))
