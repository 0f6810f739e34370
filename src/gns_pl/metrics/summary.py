"""One number per question: what a trajectory did (`summarise`), how far off a rollout is (`rollout_errors`).

Pure NumPy, so that training can validate by rollout and evaluate.py judges by the very same numbers.
"""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np

from gns_pl.errors import InputError
from gns_pl.metrics import measures
from gns_pl.metrics.curves import Curves, Quantity, compute_curves, cut, mobile, num_finite_frames
from gns_pl.trajectory import Trajectory, nearest_neighbour_distance

MSE_STEPS = (1, 5, 20, 50, 100)
"""Numbers of steps n for which MSE_n is reported, besides the whole rollout."""

SPACING_FRAMES = 48
"""Nearest neighbours are looked for in at most this many frames, evenly spaced, first and last among them."""

PROFILE_BIN = 2.0
"""Width of a bin of the deposit profile, in particle spacings."""

FINAL = (
    "runout_99",
    "runout_995",
    "runout_max",
    "height_99",
    "height_max",
    "mean_height",
    "centre_of_mass_x",
    "kinetic_energy",
    "potential_energy",
    "dissipated_energy",
    "speed_mean",
    "speed_99",
)
"""Entries of `CURVES` whose last value belongs to the summary, under the same name."""

SUMMARY: tuple[Quantity, ...] = (
    Quantity("runout_99", "L0", "final runout, 99 % of the mass; the one to judge by"),
    Quantity("runout_995", "L0", "final runout, 99.5 % of the mass"),
    Quantity("runout_max", "L0", "final runout of the foremost particle"),
    Quantity("height_99", "L0", "final height, 99 % of the mass"),
    Quantity("height_max", "L0", "final height of the highest particle"),
    Quantity("mean_height", "m", "final mass-weighted mean height over the floor"),
    Quantity("centre_of_mass_x", "m", "final mass-weighted mean distance from the x- wall"),
    Quantity("kinetic_energy", "J", "final kinetic energy"),
    Quantity("potential_energy", "J", "final potential energy"),
    Quantity("dissipated_energy", "J", "kinetic and potential energy lost from start to end"),
    Quantity("speed_mean", "m/s", "final mean speed"),
    Quantity("speed_99", "m/s", "final speed that 99 % of the particles do not exceed"),
    Quantity("kinetic_energy_peak", "J", "largest kinetic energy of any frame"),
    Quantity("speed_peak", "m/s", "largest mean speed of any frame"),
    Quantity("arrest_time", "τc", "time from which on the 99 % front has less than 2 % of its advance left"),
    Quantity("penetration_max", "spacing", "greatest depth of any particle outside the box in any frame"),
    Quantity(
        "penetrating_fraction", "1", "largest share of particles deeper than half a spacing outside, of any frame"
    ),
    Quantity(
        "spacing_1", "spacing", "nearest-neighbour distance that 1 % of the particles fall below, least of frames"
    ),
    Quantity("spacing_min", "spacing", "smallest nearest-neighbour distance of any frame looked at"),
    Quantity("density", "1", "final solid fraction that 75 % of the particles do not exceed; 1 inside a sound body"),
    Quantity("density_max", "1", "the same, largest of the frames looked at; over 1 the material was squeezed"),
)
"""Every key of `summarise`, in order."""

ERRORS: tuple[Quantity, ...] = (
    Quantity("finite_fraction", "1", "share of the reference's frames that the rollout reached with finite positions"),
    Quantity("runout_99_error", "1", "final 99 % runout, relative: (rollout − reference) / |reference|"),
    Quantity("runout_995_error", "1", "final 99.5 % runout, relative"),
    Quantity("runout_max_error", "1", "final runout of the foremost particle, relative"),
    Quantity("runout_99_difference", "L0", "final 99 % runout, rollout − reference; defined if the reference stays"),
    Quantity("height_99_error", "1", "final 99 % height, relative"),
    Quantity("height_max_error", "1", "final maximum height, relative"),
    Quantity("mean_height_error", "1", "final mean height, relative; −1 would be a pancake"),
    Quantity("kinetic_energy_peak_error", "1", "largest kinetic energy of any frame, relative"),
    Quantity("profile_l1", "1", "area between the final deposits' profiles over the area of the reference's"),
    *(
        Quantity(f"mse_{n}", "m²", f"squared position error, mean over frames 1 to {n}, particles and axes")
        for n in MSE_STEPS
    ),
    Quantity("mse_end", "m²", "the same over all frames"),
    Quantity(
        "position_error", "spacing", "root mean square distance of a particle from its reference in the last frame"
    ),
)
"""Every key of `rollout_errors` that compares; the keys of `SUMMARY` follow with the rollout's own values."""

COMPARISON: tuple[Quantity, ...] = (
    *ERRORS,
    Quantity("sinkhorn", "spacing", "transport distance of the final deposits (debiased Sinkhorn), over the spacing"),
)
"""Every key of `compare`, which takes too long for a training's validation."""

FLOW = tuple(
    quantity.name
    for quantity in (*COMPARISON, *SUMMARY)
    if not quantity.name.startswith("mse_") and quantity.name not in ("finite_fraction", "position_error", "sinkhorn")
)
"""Every key of `flow_errors`: what follows no single particle, so that any placement may be judged by it."""

DENSITY_CELL = 2.5
"""Cells of the grid on which the solid fraction is found, in particle spacings."""

MINIMAL_RUNOUT = 1e-3
"""Relative runout errors are NaN where the reference advances by less than this [L0]."""


def summarise(trajectory: Trajectory, curves: Curves | None = None) -> dict[str, float]:
    """Return the entries of `SUMMARY`.

    Args:
        trajectory: finite in every frame.
        curves: its `compute_curves`, if there already.
    """
    flow = mobile(trajectory)
    curves = compute_curves(flow) if curves is None else curves
    spacing = measures.particle_spacing(flow)
    depth = measures.penetration(flow) / spacing
    frames = np.unique(np.linspace(0, flow.num_frames - 1, min(SPACING_FRAMES, flow.num_frames)).round().astype(int))
    near = [nearest_neighbour_distance(flow.position[frame].astype(np.float64)) / spacing for frame in frames]
    dense = [solid_fraction_75(flow, frame) for frame in frames]
    values = {name: float(curves[name][-1]) for name in FINAL}
    return values | {
        "kinetic_energy_peak": float(curves["kinetic_energy"].max()),
        "speed_peak": float(curves["speed_mean"].max()),
        "arrest_time": measures.arrest_time(curves["time_tau"], curves["runout_99"]),
        "penetration_max": float(depth.max()),
        "penetrating_fraction": float((depth > 0.5).mean(axis=1).max()),
        "spacing_1": float(min(np.percentile(distance, 1) for distance in near)),
        "spacing_min": float(min(distance.min() for distance in near)),
        "density": dense[-1],
        "density_max": max(dense),
    }


def solid_fraction_75(flow: Trajectory, frame: int) -> float:
    """Return the solid fraction that 75 % of the particles do not exceed in a frame (`measures.solid_fraction`)."""
    cell = DENSITY_CELL * measures.particle_spacing(flow)
    position, volume = flow.position[frame].astype(np.float64), flow.volume().astype(np.float64)
    return float(np.percentile(measures.solid_fraction(position, volume, flow.scene, cell), 75))


class Measured:
    """A trajectory and what it did, computed when it is first asked for, and once.

    Args:
        trajectory: finite in every frame.
    """

    def __init__(self, trajectory: Trajectory) -> None:
        self.trajectory = trajectory

    @cached_property
    def flow(self) -> Trajectory:
        """The trajectory without kinematic particles."""
        return mobile(self.trajectory)

    @cached_property
    def curves(self) -> Curves:
        """Every entry of `CURVES`."""
        return compute_curves(self.flow)

    @cached_property
    def summary(self) -> dict[str, float]:
        """Every entry of `SUMMARY`."""
        return summarise(self.flow, self.curves)


def compare(
    predicted: Trajectory, reference: Trajectory, whole: Measured | None = None, *, given: int = 1
) -> dict[str, float]:
    """Return `rollout_errors`, and besides the transport distance: the entries of `COMPARISON` and `SUMMARY`."""
    errors = rollout_errors(predicted, reference, whole, given=given)
    distance = math.nan
    if errors["finite_fraction"] == 1:
        flows = [mobile(cut(trajectory, reference.num_frames)).position[-1] for trajectory in (predicted, reference)]
        distance = measures.sinkhorn_distance(*flows) / measures.particle_spacing(mobile(reference))
    return {**errors, "sinkhorn": distance}


def compare_runs(predicted: Trajectory, reference: Trajectory) -> dict[str, float]:
    """Compare what two runs of a scene did as a whole; their particles and time steps may differ.

    Args:
        predicted: what is judged.
        reference: what it should be.

    Returns:
        The entries of `ERRORS` that follow no single particle, as "runout_99_error" (relative), then the `SUMMARY` of
        `predicted`; NaN where it ended before the reference, or is not finite.

    Raises:
        InputError: runs in different dimensions.
    """
    if predicted.scene.dim != reference.scene.dim:
        dims = f"{predicted.scene.dim} and {reference.scene.dim}"
        raise InputError(f"runs in {dims} dimensions cannot be compared; run both in the same.")
    end = reference.dt * (reference.num_frames - 1)
    if predicted.dt * (predicted.num_frames - 1) < end * (1 - 1e-6) or not np.isfinite(predicted.position).all():
        names = flow_errors(Measured(reference), Measured(reference))
        return dict.fromkeys(names, math.nan)
    same_times = predicted.resampled(reference.dt, end)
    return flow_errors(Measured(cut(same_times, reference.num_frames)), Measured(reference))


def rollout_errors(
    predicted: Trajectory, reference: Trajectory, whole: Measured | None = None, *, given: int = 1
) -> dict[str, float]:
    """Compare a rollout with its reference, particle by particle and as a whole.

    Both are judged at the reference's last frame; a longer rollout is cut. A rollout that ends earlier, or is not
    finite there, has failed: everything but `finite_fraction` and those MSE_n that it reached is NaN.

    Args:
        predicted: the rollout, from the reference's first frame.
        reference: the same particles.
        whole: all points of the run of which `reference` holds some. Fronts, heights, profiles and energies are
            compared with these, since the front of some points is not that of all. None: `reference` holds all.
        given: first frames that the rollout took from the reference; MSE_n counts its own frames from there on.

    Returns:
        The entries of `ERRORS`, then the rollout's own `SUMMARY`.

    Raises:
        InputError: different particles or time steps, or a reference of one frame, which no rollout can miss.
    """
    if reference.num_frames < 2:
        raise InputError(f"{reference.scene.name}: has one frame, so there is no step to judge; choose longer ones.")
    finite = min(num_finite_frames(predicted), reference.num_frames)
    own = cut(predicted, finite)
    errors = dict.fromkeys((quantity.name for quantity in (*ERRORS, *SUMMARY)), math.nan)
    errors["finite_fraction"] = finite / reference.num_frames
    squared = measures.position_mse(mobile(own), mobile(reference))[given - 1 :]
    errors |= {f"mse_{n}": measures.rollout_mse(squared, n) for n in MSE_STEPS}
    if finite < reference.num_frames:
        return errors
    errors["mse_end"] = measures.rollout_mse(squared, len(squared) - 1)
    spacing = measures.particle_spacing(mobile(reference))
    errors["position_error"] = math.sqrt(squared[-1] * reference.scene.dim) / spacing
    return errors | flow_errors(Measured(own), Measured(reference) if whole is None else whole)


def flow_errors(predicted: Measured, reference: Measured) -> dict[str, float]:
    """Compare what two runs of a scene did as a whole; they may have different particles.

    Args:
        predicted: what is judged, finite up to the reference's last frame.
        reference: what it should be, with as many frames.

    Returns:
        The entries of `ERRORS` that follow no single particle, then the `SUMMARY` of `predicted`.
    """
    got, truth = predicted.summary, reference.summary
    errors = {"runout_99_difference": got["runout_99"] - truth["runout_99"]}
    for name in ("runout_99", "runout_995", "runout_max"):
        errors[f"{name}_error"] = _relative(got[name], truth[name], MINIMAL_RUNOUT)
    for name in ("height_99", "height_max", "mean_height", "kinetic_energy_peak"):
        errors[f"{name}_error"] = _relative(got[name], truth[name], 0.0)
    errors["profile_l1"] = profile_l1(predicted.flow, reference.flow)
    return errors | got


def profile_l1(predicted: Trajectory, reference: Trajectory) -> float:
    """Return ∫ |h − h_reference| dx / ∫ h_reference dx of the last frames (`measures.deposit_profile`)."""
    width = PROFILE_BIN * max(measures.particle_spacing(trajectory) for trajectory in (predicted, reference))
    heights = [
        measures.deposit_profile(
            flow.position[-1].astype(np.float64), flow.mass.astype(np.float64), reference.scene, width
        )[1]
        for flow in (predicted, reference)
    ]
    return float(np.abs(heights[0] - heights[1]).sum() / heights[1].sum())


def _relative(value: float, truth: float, least: float) -> float:
    return (value - truth) / abs(truth) if abs(truth) > least else math.nan
