"""Page and figure of `inverse.py`, from its tables: every number of docs/inverse.md comes from there."""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import Any

import numpy as np

METHODS = {
    "gradient": "learned simulator, gradient through the rollout, L-BFGS-B",
    "gradient, Adam": "the same, Adam, 40 steps",
    "differences": "learned simulator, central differences, five rollouts stepped together, L-BFGS-B",
    "least squares": "learned simulator, forward differences, least squares",
    "MPM 1/24 m": "MPM on cells of 1/24 m, forward differences, least squares",
    "MPM 1/36 m": "MPM on cells of 1/36 m, likewise",
    "MPM 1/48 m": "MPM on the cells of the observation, likewise",
    "gradient, twin": "gradient, where the simulator itself made the observation",
}
"""Name in the table → what it is."""


def read_text(path: Path) -> list[dict[str, str]]:
    """Return a table's rows as they are written."""
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def read_rows(path: Path) -> list[dict[str, Any]]:
    """Return a table's rows, numbers as such."""
    return [{key: text if key == "method" else float(text) for key, text in row.items()} for row in read_text(path)]


def errors(rows: list[dict[str, Any]], method: str) -> tuple[np.ndarray, np.ndarray]:
    """Return by how much a method is off in φ [degrees] and in u [m/s], of every truth."""
    chosen = [row for row in rows if row["method"] == method]
    angle = np.array([row["found_angle_deg"] - row["angle_deg"] for row in chosen])
    return angle, np.array([row["found_speed"] - row["speed"] for row in chosen])


def mean(rows: list[dict[str, Any]], method: str, key: str) -> float:
    """Return the mean of a column over the truths of a method."""
    return float(np.mean([row[key] for row in rows if row["method"] == method]))


def write_figure(folder: Path) -> None:
    """Draw what was found over what was hidden, and how the gradient fares over the horizon."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    rows, slopes = read_rows(folder / "inverse.csv"), read_rows(folder / "inverse_gradients.csv")
    figure, (angle, speed, slope) = plt.subplots(1, 3, figsize=(12, 3.9), layout="constrained")
    for method, marker in zip(METHODS, "ov+xsD^.", strict=True):
        chosen = [row for row in rows if row["method"] == method]
        kwargs = {"marker": marker, "ls": "", "label": method, "alpha": 0.8}
        angle.plot([r["angle_deg"] for r in chosen], [r["found_angle_deg"] for r in chosen], **kwargs)
        speed.plot([r["speed"] for r in chosen], [r["found_speed"] for r in chosen], **kwargs)
    for axes, title, ends in ((angle, "friction angle [°]", (20, 45)), (speed, "initial velocity [m/s]", (0, 1.4))):
        axes.plot(ends, ends, color="grey", lw=0.8)
        axes.set(xlabel=f"hidden {title}", ylabel="found")
    angle.legend(fontsize=7, frameon=False)
    for number in sorted({row["truth"] for row in slopes}):
        chosen = [row for row in slopes if row["truth"] == number]
        steps = [row["steps"] for row in chosen]
        slope.semilogy(
            steps, [row["to_narrow"] for row in chosen], "C0o-", label="narrow, float64" if not number else None
        )
        slope.semilogy(
            steps,
            [row["float32_to_float64"] for row in chosen],
            "C1s-",
            label="float32 to float64" if not number else None,
        )
        slope.semilogy(
            steps, [row["to_wide"] for row in chosen], "C2^-", label="wide, 10 % of range" if not number else None
        )
    slope.set(xlabel="steps of 20 ms", ylabel="gradient against differences [relative]")
    slope.legend(fontsize=7, frameon=False)
    figure.savefig(folder / "inverse.png", dpi=110)
    plt.close(figure)


INTRODUCTION = """\
# What was it that left this deposit?

Written by `examples/inverse.py` from `inverse.csv` and `inverse_gradients.csv`; one thread.

A square of sand, 0.32 m, is thrown along a floor of friction 0.385 from 3 cm above it. Hidden: its angle φ of friction
(23° to 42°) and its horizontal velocity u (0.2 to 1.3 m/s), {number} draws. Observed: the thickness of the deposit
along the floor after 1.2 s, smeared by 5 cm, as fine MPM (cells of 1/48 m) leaves it. Misfit:
Σ (h − h_obs)² / Σ h_obs². All begin at φ = 32.5°, u = 0 and know the bounds, 20° to 45° and ± 1.5 m/s. The
learned simulator is `friction_plane`: 100 particles, 60 steps. Errors are those of φ [°] and u [m/s], over the draws.

| method | φ, absolute | φ, mean | φ, largest | u, absolute | misfit | runs | seconds | seconds of a core |
|---|---|---|---|---|---|---|---|---|
"""

BETWEEN = """
A run of the gradient is one there and back. Seconds are those of a busy machine, those of a core what the process
computed; means over the draws, without compilation. Data and training of the simulator are not counted (see its card).

![found over hidden, and gradients against differences](inverse.png)

"""

HORIZON = """
## How long a gradient is one

Half-way from the guess to the truth, misfit of the frame after so many steps, in units of the range; means over
{number} draws. Narrow: central differences of 1e-7 in float64. Wide: ± 5 % of the range in float32, what a search would
want to know. The last columns are of the slope in φ alone.

| steps | length | to narrow | float32 to 64 | to wide | φ's share | φ, to narrow | φ, to wide (median) | same sign |
|---|---|---|---|---|---|---|---|---|
"""


def write_page(folder: Path) -> None:
    """Write docs/inverse.md."""
    rows, slopes = read_rows(folder / "inverse.csv"), read_rows(folder / "inverse_gradients.csv")
    page = INTRODUCTION.format(number=len({row["truth"] for row in rows}))
    for method, text in METHODS.items():
        angle, speed = errors(rows, method)
        page += f"| {text} | {np.abs(angle).mean():.1f} | {angle.mean():+.1f} | {np.abs(angle).max():.1f} "
        page += (
            f"| {np.abs(speed).mean():.3f} | {mean(rows, method, 'misfit'):.1e} | {mean(rows, method, 'rollouts'):.0f} "
        )
        page += f"| {mean(rows, method, 'seconds'):.0f} | {mean(rows, method, 'cpu_seconds'):.1f} |\n"
    page += BETWEEN + verdict(rows, slopes) + HORIZON.format(number=len({row["truth"] for row in slopes}))
    for steps in sorted({row["steps"] for row in slopes}):
        chosen = [row for row in slopes if row["steps"] == steps]
        value = {key: np.mean([row[key] for row in chosen]) for key in chosen[0]}
        page += f"| {steps:.0f} | {value['size']:.2g} | {value['to_narrow']:.0e} | {value['float32_to_float64']:.0e} "
        wide = np.median([row["friction_to_wide"] for row in chosen])
        page += f"| {value['to_wide']:.2f} | {value['friction_share']:.2f} | {value['friction_to_narrow']:.0e} "
        page += f"| {wide:.2f} "
        page += f"| {sum(row['friction_same_sign'] for row in chosen):.0f} of {len(chosen)} |\n"
    (folder / "inverse.md").write_text(page, encoding="utf-8")


def verdict(rows: list[dict[str, Any]], slopes: list[dict[str, Any]]) -> str:
    """Return what the tables say."""
    learned, by_mpm = ["gradient", "gradient, Adam", "differences", "least squares"], ["MPM 1/24 m", "MPM 1/36 m"]
    best = min([*learned, *by_mpm], key=lambda method: float(np.abs(errors(rows, method)[0]).mean()))
    quickest = min([*learned, *by_mpm], key=lambda method: mean(rows, method, "cpu_seconds"))
    each = {method: mean(rows, method, "cpu_seconds") / mean(rows, method, "evaluations") for method in METHODS}
    forward = each["least squares"]
    enough = max(1, math.ceil((each["gradient"] / forward - 1) / 2))
    last = [row for row in slopes if row["steps"] == max(other["steps"] for other in slopes)]
    after, narrow = last[0]["steps"], max(row["to_narrow"] for row in last)
    same = sum(row["friction_same_sign"] for row in last)
    reached = [np.array([row["misfit"] for row in rows if row["method"] == method]) for method in learned]
    stalled = int((reached[0] > 1.1 * np.min(reached[1:], axis=0)).sum())
    twin, off = (np.abs(errors(rows, method)[0]) for method in ("gradient, twin", "gradient"))
    lowest = min(learned, key=lambda method: mean(rows, method, "misfit"))
    still = np.abs(errors(rows, lowest)[0]).mean()
    quick = np.array([row["speed"] for row in rows if row["method"] == "gradient"]) > 0.8
    fast, slow = (float(np.mean(off[those])) if those.any() else math.nan for those in (quick, ~quick))
    return (
        f"- **Who wins**: of the methods with the learned simulator and coarser MPM, *{best}* comes nearest in φ,\n"
        f"  and *{quickest}* is the cheapest.\n"
        f"- **What a gradient costs**: {each['gradient']:.2f} s of a core through all steps; central differences of\n"
        f"  two unknowns, stepped together, {each['differences']:.2f} s; a rollout alone {forward:.2f} s; MPM on\n"
        f"  1/24 m {each[by_mpm[0]]:.2f} s a run, on 1/36 m {each[by_mpm[1]]:.2f} s. Against rollouts one by one a\n"
        f"  gradient is cheaper from {enough} unknown on, against rollouts stepped together later.\n"
        f"- **It is exact to the end, and still not always a help**: after {after:.0f} steps it differs from\n"
        f"  narrow differences by {narrow:.0e} at most. But its slope in φ has the sign of the wide one in\n"
        f"  {same:.0f} of {len(last)} draws: the misfit is rough on a small scale. In {stalled} of {len(off)}\n"
        "  draws L-BFGS-B with the gradient ended more than a tenth above the misfit that another method with the\n"
        "  simulator reached.\n"
        f"- **Where the simulator made the deposit itself** the gradient finds φ to {np.median(twin):.2f}° in the\n"
        f"  median and {twin.max():.1f}° at worst: that is left to the optimiser. From MPM's deposits even the method\n"
        f"  with the least misfit (*{lowest}*) is off by {still:.1f}°: that is the simulator's error.\n"
        f"- **The faster, the worse**: by the gradient φ is off by {slow:.1f}° where u is below 0.8 m/s, and by\n"
        f"  {fast:.1f}° above.\n"
        "- **What favours MPM here**: the deposit is MPM's own, on finer cells but with the same law, floor and\n"
        "  damping. A laboratory's would not be. Two unknowns favour differences; a gradient costs the same for many.\n"
    )
