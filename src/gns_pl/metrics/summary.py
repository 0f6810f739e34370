"""One number per question: what a trajectory did (`summarise`), how far off a rollout is (`rollout_errors`).

Which numbers there are stands in `quantities`, but for those that follow single particles, which are here. Pure NumPy,
so that training can validate by rollout and `evaluate.py` judges by the very same numbers.
"""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np

from gns_pl.errors import InputError
from gns_pl.metrics import measures
from gns_pl.metrics.curves import Curves, Quantity, compute_curves, cut, mobile, num_finite_frames
from gns_pl.metrics.quantities import COMPARISONS, MINIMAL_RUNOUT, RELATIVE, SUMMARY, profile_l1
from gns_pl.trajectory import Trajectory, nearest_neighbour_distance

__all__ = [
    "COMPARISON",
    "ERRORS",
    "FLOW",
    "MINIMAL_RUNOUT",
    "SUMMARY",
    "Measured",
    "compare",
    "flow_errors",
    "profile_l1",
    "rollout_errors",
    "summarise",
]

MSE_STEPS = (1, 5, 20, 50, 100)
"""Numbers of steps n for which MSE_n is reported, besides the whole rollout."""

SPACING_FRAMES = 48
"""Nearest neighbours are looked for in at most this many frames, evenly spaced, first and last among them."""

DENSITY_CELL = 2.5
"""Cells of the grid on which the solid fraction is found, in particle spacings."""

ERRORS: tuple[Quantity, ...] = (
    Quantity("finite_fraction", "1", "share of the reference's frames that the rollout reached with finite positions"),
    *RELATIVE,
    *COMPARISONS,
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

FLOW = tuple(quantity.name for quantity in (*RELATIVE, *COMPARISONS, *SUMMARY))
"""Every key of `flow_errors`: what follows no single particle, so that any placement may be judged by it."""


def summarise(trajectory: Trajectory, curves: Curves | None = None) -> dict[str, float]:
    """Return the entries of `SUMMARY`.

    Args:
        trajectory: finite in every frame.
        curves: its `compute_curves`, if there already.
    """
    measured = Measured(trajectory)
    if curves is not None:
        measured.curves = curves
    return measured.summary


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
    def spacing(self) -> float:
        """Of the particles [m]."""
        return measures.particle_spacing(self.flow)

    @cached_property
    def penetration(self) -> measures.Floats:
        """Depth of particles outside the box, in spacings [T, N]."""
        return measures.penetration(self.flow) / self.spacing

    @cached_property
    def frames(self) -> list[int]:
        """At most `SPACING_FRAMES` frames, evenly spaced, first and last among them."""
        last = self.flow.num_frames - 1
        evenly = np.linspace(0, last, min(SPACING_FRAMES, last + 1)).round().astype(int)
        return [int(frame) for frame in np.unique(evenly)]

    @cached_property
    def nearest(self) -> list[measures.Floats]:
        """Distance of every particle to its nearest neighbour in `frames`, in spacings [N] each."""
        positions = (self.flow.position[frame].astype(np.float64) for frame in self.frames)
        return [nearest_neighbour_distance(position) / self.spacing for position in positions]

    @cached_property
    def solid_fractions(self) -> list[float]:
        """Solid fraction that 75 % of the particles do not exceed in `frames`."""
        return [solid_fraction_75(self.flow, frame) for frame in self.frames]

    @cached_property
    def summary(self) -> dict[str, float]:
        """Every entry of `SUMMARY`."""
        return {metric.name: metric.compute(self) for metric in SUMMARY}


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
    errors = {f"{metric.name}_error": metric.relative_error(predicted, reference) for metric in SUMMARY if metric.error}
    errors |= {comparison.name: comparison.compare(predicted, reference) for comparison in COMPARISONS}
    return errors | predicted.summary
