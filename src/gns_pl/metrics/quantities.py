"""The entries of a summary and of a comparison. One entry here is all that a number needs to be reported everywhere.

It is computed for every run, stands in metrics.json, in logs of trainings and in W&B, and, with a label, in the tables.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from gns_pl.metrics import measures
from gns_pl.metrics.curves import Quantity
from gns_pl.trajectory import Trajectory

if TYPE_CHECKING:
    from gns_pl.metrics.summary import Measured

PROFILE_BIN = 2.0
"""Width of a bin of the deposit profile, in particle spacings."""

MINIMAL_RUNOUT = 1e-3
"""Relative runout errors are NaN where the reference advances by less than this [L0]."""


@dataclass(frozen=True)
class Metric(Quantity):
    """A number about one run.

    Attributes:
        compute: of the run.
        label: of its row in tables, without the unit; "" for no row.
        error: meaning of `NAME_error`, its relative difference from a reference; "" if there is no such error.
        least: of the reference's size, above which that error is defined.
    """

    compute: Callable[[Measured], float]
    label: str = ""
    error: str = ""
    least: float = 0.0

    def relative_error(self, predicted: Measured, reference: Measured) -> float:
        """Return (predicted − reference) / |reference|, NaN where it is not defined."""
        value, truth = predicted.summary[self.name], reference.summary[self.name]
        return (value - truth) / abs(truth) if abs(truth) > self.least else math.nan


@dataclass(frozen=True)
class Comparison(Quantity):
    """A number about a run and its reference, which may have different particles.

    Attributes:
        compare: (run, reference) → the number.
        label: of its row in tables, without the unit; "" for no row.
    """

    compare: Callable[[Measured, Measured], float]
    label: str = ""


def final(name: str) -> Callable[[Measured], float]:
    """Return what takes the last value of a curve (`CURVES`)."""
    return lambda run: float(run.curves[name][-1])


def largest(name: str) -> Callable[[Measured], float]:
    """Return what takes the largest value of a curve."""
    return lambda run: float(run.curves[name].max())


def profile_l1(predicted: Trajectory, reference: Trajectory) -> float:
    """Return ∫ |h − h_reference| dx / ∫ h_reference dx of the last frames (`measures.deposit_profile`)."""
    width = PROFILE_BIN * max(measures.particle_spacing(each) for each in (predicted, reference))
    heights = [
        measures.deposit_profile(
            flow.position[-1].astype(np.float64), flow.mass.astype(np.float64), reference.scene, width
        )[1]
        for flow in (predicted, reference)
    ]
    return float(np.abs(heights[0] - heights[1]).sum() / heights[1].sum())


SUMMARY: tuple[Metric, ...] = (
    Metric(
        "runout_99",
        "L0",
        "final runout, 99 % of the mass; the one to judge by",
        final("runout_99"),
        label="runout, 99 % of the mass",
        error="final 99 % runout, relative: (rollout − reference) / |reference|",
        least=MINIMAL_RUNOUT,
    ),
    Metric(
        "runout_995",
        "L0",
        "final runout, 99.5 % of the mass",
        final("runout_995"),
        label="runout, 99.5 %",
        error="final 99.5 % runout, relative",
        least=MINIMAL_RUNOUT,
    ),
    Metric(
        "runout_max",
        "L0",
        "final runout of the foremost particle",
        final("runout_max"),
        label="runout, maximum",
        error="final runout of the foremost particle, relative",
        least=MINIMAL_RUNOUT,
    ),
    Metric(
        "height_99",
        "L0",
        "final height, 99 % of the mass",
        final("height_99"),
        label="height, 99 %",
        error="final 99 % height, relative",
    ),
    Metric(
        "height_max",
        "L0",
        "final height of the highest particle",
        final("height_max"),
        label="height, maximum",
        error="final maximum height, relative",
    ),
    Metric(
        "mean_height",
        "m",
        "final mass-weighted mean height over the floor",
        final("mean_height"),
        label="mean height",
        error="final mean height, relative; −1 would be a pancake",
    ),
    Metric("centre_of_mass_x", "m", "final mass-weighted mean distance from the x- wall", final("centre_of_mass_x")),
    Metric("kinetic_energy", "J", "final kinetic energy", final("kinetic_energy")),
    Metric("potential_energy", "J", "final potential energy", final("potential_energy")),
    Metric("dissipated_energy", "J", "kinetic and potential energy lost from start to end", final("dissipated_energy")),
    Metric(
        "arrest_time",
        "τc",
        "time from which on the 99 % front has less than 2 % of its advance left",
        lambda run: measures.arrest_time(run.curves["time_tau"], run.curves["runout_99"]),
        label="front at rest",
    ),
    Metric(
        "kinetic_energy_peak",
        "J",
        "largest kinetic energy of any frame",
        largest("kinetic_energy"),
        label="peak kinetic energy",
        error="largest kinetic energy of any frame, relative",
    ),
    Metric("speed_mean", "m/s", "final mean speed", final("speed_mean"), label="final mean speed"),
    Metric("speed_99", "m/s", "final speed that 99 % of the particles do not exceed", final("speed_99")),
    Metric("speed_peak", "m/s", "largest mean speed of any frame", largest("speed_mean")),
    Metric(
        "penetration_max",
        "spacing",
        "greatest depth of any particle outside the box in any frame",
        lambda run: float(run.penetration.max()),
        label="deepest penetration",
    ),
    Metric(
        "penetrating_fraction",
        "1",
        "largest share of particles deeper than half a spacing outside, of any frame",
        lambda run: float((run.penetration > 0.5).mean(axis=1).max()),
    ),
    Metric(
        "spacing_1",
        "spacing",
        "nearest-neighbour distance that 1 % of the particles fall below, least of frames",
        lambda run: float(min(np.percentile(distance, 1) for distance in run.nearest)),
        label="nearest other, 1 %",
    ),
    Metric(
        "spacing_min",
        "spacing",
        "smallest nearest-neighbour distance of any frame looked at",
        lambda run: float(min(distance.min() for distance in run.nearest)),
    ),
    Metric(
        "density",
        "1",
        "final solid fraction that 75 % of the particles do not exceed; 1 inside a sound body",
        lambda run: run.solid_fractions[-1],
        label="solid fraction inside",
    ),
    Metric(
        "density_max",
        "1",
        "the same, largest of the frames looked at; over 1 the material was squeezed",
        lambda run: max(run.solid_fractions),
    ),
)
"""Every number about one run, in order."""

COMPARISONS: tuple[Comparison, ...] = (
    Comparison(
        "runout_99_difference",
        "L0",
        "final 99 % runout, rollout − reference; defined if the reference stays",
        lambda run, reference: run.summary["runout_99"] - reference.summary["runout_99"],
    ),
    Comparison(
        "profile_l1",
        "1",
        "area between the final deposits' profiles over the area of the reference's",
        lambda run, reference: profile_l1(run.flow, reference.flow),
        label="deposit profile, L1 over area",
    ),
)
"""Every number about a run and its reference that follows no single particle, besides the relative errors."""

RELATIVE = tuple(Quantity(f"{metric.name}_error", "1", metric.error) for metric in SUMMARY if metric.error)
"""The relative errors."""
