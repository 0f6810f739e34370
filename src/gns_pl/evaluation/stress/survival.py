"""How long runs go on without a failure."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gns_pl.evaluation.stress.runs import Row


def survival(rows: Sequence[Row]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the share of runs without a failure over time, runs that ended earlier taken as not known since.

    S(t) = Π (1 − d_i / n_i) over the times t_i ≤ t of failures, d_i of them at t_i and n_i runs still going (Kaplan and
    Meier 1958).

    Args:
        rows: of the runs; at least one.

    Returns:
        Times at which it steps, from 0 to the end of the longest run [τc], and the share from each on.
    """
    failed = np.array([bool(row.kind) for row in rows])
    ended = np.array([row.failed_at if row.kind else row.duration for row in rows])
    times, shares = [0.0], [1.0]
    for time in np.unique(ended[failed]):
        going = int((ended >= time).sum())
        times.append(float(time))
        shares.append(shares[-1] * (1 - int((ended[failed] == time).sum()) / going))
    times.append(float(ended.max()))
    shares.append(shares[-1])
    return np.array(times), np.array(shares)
