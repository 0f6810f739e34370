"""Made-up settings for the figures of speed against accuracy."""

from __future__ import annotations

import csv
import math
from pathlib import Path

from gns_pl.viz import Mark

CHART = Path(__file__).parents[2] / "docs" / "charts" / "plane" / "chart.csv"

SPACE = """
shallow-k0 shallow 0.2 0.154 0.076
shallow shallow 0.51 0.657 0.288
mpm_5.09 mpm 0.3 0.234 0.096
mpm_5.09_p3 mpm 0.92 0.211 0.095
mpm_5.09_p4 mpm 1.9 0.205 0.094
mpm_7.64 mpm 1.4 0.116 0.046
mpm_7.64_p3 mpm 4.4 0.112 0.044
mpm_7.64_c0.6 mpm 1.39 0.116 0.046
mpm_7.64_c0.3 mpm 2.3 0.115 0.047
mpm_7.64_c0.1 mpm 6.4 0.115 0.047
mpm_10.2 mpm 4.9 0.04 0.035
mpm_10.2_p3 mpm 15.0 0.039 0.034
mpm_12.7 mpm 11.0 0.034 0.024
mpm_15.3 mpm 23.0 0.028 0.021
mpm_20.4 mpm 70.0 0.023 0.017
mpm-retuned-5 retuned 0.32 0.071 0.095
mpm-retuned-7.6 retuned 1.5 0.053 0.034
mpm-retuned-10 retuned 5.1 0.03 0.028
collapse learned 0.82 0.198 0.115
column-fast learned 0.45 0.24 0.14
cube-40ms learned 0.61 0.17 0.13
cube-20ms learned 0.88 0.12 0.11
cube-20ms-wide learned 1.6 0.11 0.1
walls-40ms learned 0.7 0.15 0.12
corrected_5 corrected 0.42 0.09 0.08
corrected_7.6 corrected 1.75 0.035 0.04
collapse_then_mpm hybrid 1.1 0.14 0.09
mpm_then_collapse hybrid 0.95 0.16 0.1
user.Solver other 0.6 0.3 0.2
extrapolated_5.09_7.64 extrapolated 1.7 0.08 inf
extrapolated_7.64_10.2 extrapolated 6.3 0.05 inf
law_lube law 1e-6 0.19 inf
law_fitted law 1e-6 0.02 inf
nothing_moves trivial 0.0031 1.0 0.431
ballistic trivial 0.035 0.993 0.426
"""


NO_FLOW = ("law", "extrapolated")


def on_front(points: list[tuple[str, float, float]]) -> set[str]:
    """Return the names that none as fast or faster is more accurate than."""
    return {
        name
        for name, seconds, error in points
        if math.isfinite(error) and not any(s <= seconds and e < error for _, s, e in points)
    }


def made(rows: list[tuple[str, str, float, dict[str, float]]], scenes: dict[str, str]) -> list[Mark]:
    """Return the marks of names, groups, times and errors."""
    measures = list(rows[0][3])
    fronts = {
        measure: on_front(
            [(name, seconds, errors[measure]) for name, group, seconds, errors in rows if group not in NO_FLOW]
        )
        for measure in measures
    }
    return [
        Mark(
            name=name, group=group, seconds=seconds, low=0.96 * seconds, high=1.05 * seconds, errors=errors,
            label=name + scenes.get(name, ""), whole=name.endswith("_whole"),
            on_fronts=[measure for measure in measures if name in fronts[measure]],
            spent=1000.0 + len(name) ** 2 if group in ("learned", "corrected", "hybrid") else 0.0, pays="never",
        )
        for name, group, seconds, errors in rows
    ]  # fmt: skip


def crowded() -> list[Mark]:
    """Return 35 settings on scenes in space."""
    rows = []
    for line in SPACE.split("\n")[1:-1]:
        name, group, *numbers = line.split()
        seconds, front, volume = map(float, numbers)
        rows.append((name, group, seconds, {"front": front, "map": volume, "worse": max(front, volume)}))
    return made(rows, {"collapse": " (4/6)", "column-fast": " (4/6)"})


def published() -> list[Mark]:
    """Return the settings of a published chart."""
    rows = []
    with CHART.open() as file:
        for row in csv.DictReader(file):
            front = float(row.get("front_error") or row["error"])
            volume = float(row.get("map_error") or row["profile_error"])
            errors = {"front": front, "map": math.inf if math.isnan(volume) else volume}
            name, group = row["name"], row["group"]
            rows.append((name, group, float(row["seconds"]), errors | {"worse": max(errors.values())}))
    return made(rows, {})
