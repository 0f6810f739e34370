"""Whether particles lie where a scene says: in its box, with neighbours within the radius, and not too far from zero.

What is refused here would train or be judged without a word, on particles that the walls hold elsewhere, that feel no
other, or whose motion float32 has lost.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gns_pl.data.estimators import neighbour_counts
from gns_pl.errors import InputError
from gns_pl.fields import ParticleType
from gns_pl.graph.radius import advised_radius
from gns_pl.io import read_header, read_static, read_window
from gns_pl.scene import Scene
from gns_pl.scene.origin import check_coarseness
from gns_pl.trajectory import Trajectory

OUTSIDE = 0.01
"""Share of particles that may be outside their box by more than a spacing. Penetrated walls and rounding are below a
spacing, and of sound data some grains in a thousand escape; a box that does not belong to them leaves out many more."""

NEIGHBOURS = (1.0, 1000.0)
"""Least and largest mean number of neighbours that is trained with; a usual radius has about 10 in the plane, 30 in
space. Beyond these the radius or the unit of length is a mistake: no forces, or more edges than any memory holds."""

MOST_FILES, MOST_QUERIES = 200, 100
"""Trajectories that are looked at, and particles of a frame whose neighbours are counted."""


@dataclass
class OutsideCounter:
    """Counts particles outside a box, frames at a time.

    Attributes:
        lower: lower corner of the box [D].
        upper: upper corner of the box [D].
        margin: particles outside by less are not counted.
        seen: particles in all frames counted.
        outside: those outside.
        worst: number outside and number of particles in the frame with most outside.
        least: smallest coordinates [D].
        largest: largest coordinates [D].
    """

    lower: Sequence[float]
    upper: Sequence[float]
    margin: float
    seen: int = 0
    outside: int = 0
    worst: tuple[int, int] = (0, 0)
    least: NDArray[np.float64] = field(default_factory=lambda: np.array(math.inf))
    largest: NDArray[np.float64] = field(default_factory=lambda: np.array(-math.inf))

    def count(self, position: NDArray[np.floating]) -> None:
        """Count the particles of frames [F, N, D], in the unit of the box."""
        if not position.size:
            return
        low, high = np.array(self.lower) - self.margin, np.array(self.upper) + self.margin
        number = ((position < low) | (position > high)).any(axis=2).sum(axis=1)
        self.seen += position.shape[0] * position.shape[1]
        self.outside += int(number.sum())
        self.worst = max(self.worst, (int(number.max()), position.shape[1]))
        self.least = np.minimum(self.least, position.min(axis=(0, 1)))
        self.largest = np.maximum(self.largest, position.max(axis=(0, 1)))

    def message(self) -> str:
        """Return how many are outside where most are, in words; empty if none is."""
        number, among = self.worst
        if not number:
            return ""
        box = f"{[float(x) for x in self.lower]} to {[float(x) for x in self.upper]}"
        return (
            f"{number:,} of {among:,} particles ({100 * number / among:.3g} %) lie outside the box {box} by more than "
            "a spacing"
        )

    def check(self) -> None:
        """Raise an `InputError` where more than stragglers are outside."""
        if self.outside > OUTSIDE * self.seen:
            raise InputError(self.message())


def check_inside(
    frames: Iterable[NDArray[np.floating]], lower: Sequence[float], upper: Sequence[float], *, margin: float
) -> str:
    """Return a sentence about stragglers outside a box, empty if there is none.

    Args:
        frames: of particles, each [F, N, D], in the unit of the box.
        lower: lower corner of the box [D].
        upper: upper corner of the box [D].
        margin: particles outside by less are not counted, a spacing.

    Raises:
        InputError: more than stragglers; a clause that leaves naming the source to the caller.
    """
    inside = OutsideCounter(lower, upper, margin)
    for positions in frames:
        inside.count(positions)
    inside.check()
    return inside.message()


def check_neighbours(mean: float, *, radius: float, spacing: float) -> None:
    """Raise an `InputError` where particles have no neighbours in the mean, or far too many.

    Args:
        mean: number of neighbours.
        radius: connectivity radius [m].
        spacing: of the particles [m].
    """
    (least, most), advised = NEIGHBOURS, f"model.connectivity_radius={advised_radius(spacing):g}"
    if least <= mean <= most:
        return
    raise InputError(
        f"a particle has {mean:.3g} neighbours in the mean within model.connectivity_radius = {radius:g} m, and "
        f"the data have a spacing of {spacing:.3g} m; take {advised}"
    )


def check_reach(start: Trajectory, radius: float) -> None:
    """Raise an `InputError` where a simulator's radius is below the spacing of a start, so that nobody has neighbours.

    The spacing is that of the volumes that particles stand for, not of who is near: grains that are strewn may fall
    alone.

    Args:
        start: its first frame is looked at.
        radius: connectivity radius of the simulator [m].
    """
    spacing = start.spacing
    if radius < spacing:
        raise InputError(
            f"scene {start.scene.name!r}: its particles stand for {spacing:.3g} m each way, and the simulator's radius "
            f"is {radius:g} m, so that none has a neighbour; take a simulator that was trained at this spacing."
        )


def check_frames(
    owner: str,
    position: NDArray[np.float32],
    particle_type: NDArray[np.int64],
    scene: Scene,
    spacing: float,
) -> None:
    """Raise an `InputError` where moved particles are outside the box, or too far from zero for float32.

    Args:
        owner: whose particles these are, for the message.
        position: of some frames [F, N, D] [m].
        particle_type: [N].
        scene: for the box.
        spacing: of the particles [m].
    """
    moved = position[:, particle_type != int(ParticleType.KINEMATIC)]
    try:
        check_inside([moved], scene.lower, scene.upper, margin=spacing)
    except InputError as error:
        hint = "give it a box that holds them (of imported data: convert again with lower=… upper=…)"
        raise InputError(f"{owner}: {error}; {hint}.") from error
    extent = max(map(abs, (*scene.lower, *scene.upper)))
    check_coarseness(owner, extent, spacing, "make or convert it again, which takes the origin off (Scene.origin)")


def check_set(train: Sequence[Path], valid: Sequence[Path], *, radius: float, spacing: float) -> None:
    """Raise an `InputError` where a training would learn nothing from where particles are, before its first step.

    Three frames of every trajectory are looked at, of at most `MOST_FILES` for training.

    Args:
        train: trajectory files.
        valid: those that are rolled out for validation.
        radius: connectivity radius of the model [m].
        spacing: of the set [m].
    """
    counts = []
    for path in [*train[:: -(-len(train) // MOST_FILES)], *valid]:
        header, types = read_header(path), read_static(path)["particle_type"]
        places = sorted({0, (header.num_frames - 1) // 2, header.num_frames - 1})
        position = np.concatenate([read_window(path, place, 1) for place in places])
        if not np.isfinite(position).all():
            continue  # which is told when the frame is read
        check_frames(str(path), position, types, header.scene, spacing)
        moved = np.flatnonzero(types != int(ParticleType.KINEMATIC))
        queries = moved[:: max(1, len(moved) // MOST_QUERIES)]
        counts += [neighbour_counts(frame, np.array([radius]), queries) for frame in position if len(queries)]
    if counts:
        check_neighbours(float(np.concatenate(counts).mean()), radius=radius, spacing=spacing)
