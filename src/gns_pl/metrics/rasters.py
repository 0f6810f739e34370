"""Rasters of a run for whoever reads maps: largest thickness and velocity, deposit, and when the flow arrived.

Particles carry their volume onto square cells seen from above. Each is spread over a pyramid whose half-width is a
cell, or `WIDTH` particle spacings where cells are finer, so that a layer of evenly spaced particles has one thickness.
No volume is lost: what would reach over the edge of the grid is mirrored back. Thickness is vertical, volume is bulk
volume at the density of the start, and velocity is the mean over the thickness.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gns_pl.errors import InputError
from gns_pl.metrics.measures import Floats
from gns_pl.scene import Raster, Scene
from gns_pl.scene.arrays import decoded_array
from gns_pl.trajectory import Trajectory

WIDTH = 2.0
"""Half-width of the pyramid over which a particle is spread, and cells where a scene has none, in particle spacings."""

REACHED = 0.5
"""Thickness from which on a cell counts as reached if nobody says, in particle spacings."""

QUANTITIES = {
    "max_thickness": "m",
    "max_velocity": "m/s",
    "deposit": "m",
    "arrival_time": "s",
}
"""The rasters of a run → their unit."""


@dataclass(frozen=True)
class MapGrid:
    """Square cells seen from above. Arrays of them are [X, Y], x from west to east and y from south to north.

    Attributes:
        lower: lower corner of the first cell in the scene's coordinates, x and y [m].
        cell: edge of a cell [m].
        shape: number of cells along x and y.
    """

    lower: tuple[float, float]
    cell: float
    shape: tuple[int, int]

    @property
    def centres(self) -> tuple[Floats, Floats]:
        """Middles of the cells along x [X] and y [Y] [m]."""
        x, y = (np.arange(number, dtype=np.float64) + 0.5 for number in self.shape)
        return self.lower[0] + self.cell * x, self.lower[1] + self.cell * y

    def raster(self, values: Floats, origin: Sequence[float] = (0.0, 0.0), crs: str = "") -> Raster:
        """Return values [X, Y] of the cells as a raster.

        Args:
            values: NaN where there are none.
            origin: where the scene's zero lies in the coordinates of the map, x and y [m]; added in float64.
            crs: coordinate reference system of the map as text.
        """
        x, y = (zero + low + self.cell / 2 for zero, low in zip(origin, self.lower, strict=False))
        return Raster(values, (x, y), self.cell, crs)

    def spread(self, position: Floats, weights: Floats, spacing: float) -> Floats:
        """Return what particles carry, on the cells [K, X, Y]; every sum is that of the weights.

        Args:
            position: [N, D] [m]; what lies outside the grid counts at its edge.
            weights: K quantities of every particle [K, N].
            spacing: of the particles [m].
        """
        place = (position[:, :2] - self.lower) / self.cell - 0.5
        place = np.clip(place, 0.0, np.array(self.shape) - 1.0)
        node = np.minimum(place.astype(np.int64), np.maximum(np.array(self.shape) - 2, 0))
        share = place - node
        total = np.zeros((len(weights), math.prod(self.shape)))
        for corner in product((0, 1), repeat=2):
            weight = np.prod(np.where(corner, share, 1 - share), axis=1)
            index = np.ravel_multi_index(np.minimum(node + corner, np.array(self.shape) - 1).T, self.shape)
            for row, carried in zip(total, weights, strict=True):
                row += np.bincount(index, weights=weight * carried, minlength=total.shape[1])
        return self._widened(total.reshape(-1, *self.shape), spacing)

    def _widened(self, values: Floats, spacing: float) -> Floats:
        """Return values of cells spread over a pyramid of `WIDTH` spacings, where that is more than a cell."""
        number = math.ceil(WIDTH * spacing / self.cell - 1e-6)
        if number <= 1:
            return values
        from scipy.ndimage import convolve1d

        hat = (number - np.abs(np.arange(1 - number, number))) / number**2
        for axis in (1, 2):
            values = convolve1d(values, hat, axis=axis, mode="reflect")
        return values


@dataclass(frozen=True)
class FlowMaps:
    """Rasters of a run, each [X, Y].

    Attributes:
        grid: the cells.
        reached: thickness from which on a cell counts as reached [m].
        release: thickness at the start [m].
        max_thickness: largest thickness in any frame [m].
        max_velocity: largest mean velocity over the thickness, of frames in which the cell is reached [m/s]; 0 if none.
            Of a run whose particles do not move as the material does that of the layer they show, if it is known.
        deposit: thickness in the last frame [m].
        arrival_time: when the cell was first reached, between frames by a straight line [s]; NaN where it never was.
    """

    grid: MapGrid
    reached: float
    release: Floats
    max_thickness: Floats
    max_velocity: Floats | None
    deposit: Floats
    arrival_time: Floats

    def rasters(self) -> dict[str, Floats]:
        """Return the rasters that are written, by their names in `QUANTITIES`."""
        rasters = {name: getattr(self, name) for name in QUANTITIES}
        return {name: values for name, values in rasters.items() if values is not None}

    def area(self) -> float:
        """Return the area of all cells that were reached [m²]."""
        return float((self.max_thickness >= self.reached).sum() * self.grid.cell**2)


def map_grid(scene: Scene, spacing: float) -> MapGrid:
    """Return the cells of a scene's maps: those of its terrain that the box touches.

    Without terrain they are about `WIDTH` particle spacings, so that they divide the shorter side of the box.

    Args:
        scene: for the box.
        spacing: of the particles [m].

    Raises:
        InputError: a scene in two dimensions, which has a profile and no map.
    """
    check_mappable(scene)
    if scene.terrain is not None:
        raster = scene.terrain.raster.cropped(scene.lower[:2], scene.upper[:2])
        (x, y), _ = raster.extent
        return MapGrid((x, y), raster.cell, (raster.values.shape[0], raster.values.shape[1]))
    extent = np.array(scene.upper[:2]) - np.array(scene.lower[:2])
    cell = float(extent.min() / max(1, round(extent.min() / (WIDTH * spacing))))
    columns, rows = (max(1, math.ceil(edge / cell - 1e-6)) for edge in extent)
    return MapGrid((scene.lower[0], scene.lower[1]), cell, (columns, rows))


def check_mappable(scene: Scene) -> None:
    """Raise an `InputError` where a scene has no map."""
    if scene.dim != 3:
        raise InputError(f"scene {scene.name!r} has two dimensions, so it has no map; leave maps= out.")


def shows_motion(trajectory: Trajectory) -> bool:
    """Return whether particles move as the material does.

    Those of depth-averaged flow show its layer in every frame, and are placed anew in each (`shallow.particles`).
    """
    provenance = trajectory.provenance
    return "shallow" not in provenance and provenance.get("solver") != "gns_pl.shallow"


def layer_velocity(trajectory: Trajectory, grid: MapGrid) -> Floats | None:
    """Return the largest velocity of the layer that particles show [X, Y] [m/s], None if the run does not say it.

    Args:
        trajectory: by depth-averaged flow, whose provenance has it on the flow's own cells.
        grid: each of its cells takes that of the flow's cell at its middle.
    """
    known: Any = trajectory.provenance.get("largest_velocity")
    if known is None:
        return None
    values = decoded_array("largest_velocity", known["values"])
    places = [
        np.clip(np.floor((middle - low) / size).astype(np.int64), 0, number - 1)
        for middle, low, size, number in zip(grid.centres, known["lower"], known["sizes"], values.shape, strict=True)
    ]
    return np.asarray(values[np.ix_(*places)])


class Mapper:
    """Makes the maps of a run of its frames as they come.

    Args:
        start: the run or its first frame, for all that does not change; without kinematic particles.
        grid: the cells; None for those of `map_grid`.
        reached: thickness from which on a cell counts as reached [m]; None for `REACHED` spacings.
    """

    def __init__(self, start: Trajectory, grid: MapGrid | None = None, reached: float | None = None) -> None:
        self.start, self.spacing = start, start.spacing
        self.grid = grid or map_grid(start.scene, self.spacing)
        self.reached = REACHED * self.spacing if reached is None else reached
        self.volume = start.volume().astype(np.float64)
        self.before: Floats | None = None
        self.num_frames = 0
        empty = np.zeros(self.grid.shape)
        self.release = self.thickness = self.max_thickness = self.max_velocity = empty
        self.arrival_time = np.full(self.grid.shape, np.nan)

    def add(self, frame: NDArray[np.floating]) -> None:
        """Add the next frame [N, D] [m]."""
        position, dt = frame.astype(np.float64), self.start.dt
        velocity = self.start.initial_velocity if self.before is None else (position - self.before) / dt
        carried = np.concatenate([self.volume[None], self.volume * velocity.T.astype(np.float64)])
        volume, *flux = self.grid.spread(position, carried, self.spacing)
        thickness = volume / self.grid.cell**2
        there = thickness >= self.reached
        speed = np.sqrt(np.square(flux).sum(axis=0)) / np.where(there, volume, 1.0)
        self.max_velocity = np.where(there, np.maximum(self.max_velocity, speed), self.max_velocity)
        new = there & np.isnan(self.arrival_time)
        if self.before is None:
            self.release = thickness
            self.arrival_time[new] = 0.0
        else:
            rise = (thickness - self.thickness)[new]
            part = (self.reached - self.thickness[new]) / np.where(rise > 0, rise, 1.0)
            self.arrival_time[new] = (self.num_frames - 1 + np.clip(part, 0.0, 1.0)) * dt
        self.max_thickness = np.maximum(self.max_thickness, thickness)
        self.thickness, self.before = thickness, position
        self.num_frames += 1

    def maps(self) -> FlowMaps:
        """Return the maps of all frames."""
        velocity = self.max_velocity if shows_motion(self.start) else layer_velocity(self.start, self.grid)
        if velocity is not None:
            velocity = np.where(self.max_thickness >= self.reached, velocity, 0.0)
        return FlowMaps(
            self.grid,
            self.reached,
            release=self.release,
            max_thickness=self.max_thickness,
            max_velocity=velocity,
            deposit=self.thickness,
            arrival_time=self.arrival_time,
        )


def compute_maps(
    start: Trajectory,
    frames: Iterable[NDArray[np.floating]] | None = None,
    grid: MapGrid | None = None,
    reached: float | None = None,
) -> FlowMaps:
    """Return the maps of a run; frames from the first on that is not finite are left out.

    Args:
        start: as of `Mapper`.
        frames: positions [N, D] [m] of every frame; None for those of `start`.
        grid: as of `Mapper`.
        reached: likewise.
    """
    mapper = Mapper(start, grid, reached)
    for frame in start.position if frames is None else frames:
        if not np.isfinite(frame).all():
            break
        mapper.add(frame)
    return mapper.maps()
