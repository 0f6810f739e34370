"""What a survey of a data set finds, as plain numbers, and the thresholds by which particles count as moving.

Only the record is here: `survey` fills it, `training.advice` judges it.
"""

from __future__ import annotations

from dataclasses import dataclass

from gns_pl.graph.radius import RADIUS

SPEED_AT_REST = 0.01
"""What is slower than this counts as at rest [m/s]."""

MOVING_SHARE = 0.01
"""A frame moves if more than this share of its particles does."""

SPACINGS = (1.5, RADIUS, 2.5, 3.0)
"""Radii in spacings for which neighbours are counted besides the one of the model."""

IMPACT_SHARE = 0.01
"""The share of particles with the largest accelerations that is told apart."""


@dataclass(frozen=True)
class Sizes:
    """How much there is, over all training trajectories.

    Attributes:
        num_trajectories: training trajectories.
        num_valid: validation trajectories.
        num_windows: windows, each once.
        particles_mean: particles per trajectory.
        particles_max: of the largest.
        bytes: of all positions.
    """

    num_trajectories: int
    num_valid: int
    num_windows: int
    particles_mean: float
    particles_max: int
    bytes: int


@dataclass(frozen=True)
class Starts:
    """How the trajectories begin, over the first 400 of them.

    Attributes:
        num_seen: trajectories looked at.
        num_cold: those in which everything begins at rest and stands on the floor.
        num_hung: those in which everything begins at rest in the air.
        body_height: of the highest body [m].
        body_length: along x, of the shortest and the longest body [m].
        domain: edges of the first box [D] [m].
        duration: median length of a trajectory [s].
        aspect_ratio: height over length along x of the bodies: least, median, largest.
        p_wave_speed: of the stiffest material [m/s].
        num_obstacles: trajectories with obstacles.
    """

    num_seen: int
    num_cold: int
    num_hung: int
    body_height: float
    body_length: tuple[float, float]
    domain: tuple[float, ...]
    duration: float
    aspect_ratio: tuple[float, float, float]
    p_wave_speed: float
    num_obstacles: int


@dataclass(frozen=True)
class Density:
    """How close particles lie.

    Attributes:
        spacing: nominal, of the manifest [m].
        measured: edge of the cube that a particle has to itself at the start (`estimators.interior_spacing`) [m].
        nearest: median distance to the nearest neighbour at the start [m].
        nearest_low: distance to the nearest neighbour that 1 % fall short of, in all windows [m].
        end_over_start: median over trajectories of the density inside the material at the end over that at the start.
        radius: for which neighbours are counted [m].
        neighbours: particles closer than the radius: mean, 5 %, 50 %, 95 %, and the most seen.
        isolated: share of particles with no neighbour within the radius.
        by_spacing: radius in nominal spacings → mean number of neighbours.
    """

    spacing: float
    measured: float
    nearest: float
    nearest_low: float
    end_over_start: float
    radius: float
    neighbours: tuple[float, float, float, float, float]
    isolated: float
    by_spacing: dict[str, float]


@dataclass(frozen=True)
class Motion:
    """How particles move; "particle" means one particle in one window.

    Attributes:
        dt: time between frames, of the manifest [s].
        velocity_std: of a component, of the manifest, over all training frames [m/s].
        velocity_std_seen: the same over the sample, the manifest's doubtful where they differ much [m/s].
        acceleration_std: of a component of the one-step target, of the manifest [m/s²].
        step: displacement in one step: 50 %, 99 %, 99.9 %, largest [m].
        moving: share of particles faster than `SPEED_AT_REST`.
        frames_moving: share of frames with more than `MOVING_SHARE` such particles.
        moving_at_end: share of such particles in the last step of a trajectory.
        setting_out: share of frames before a trajectory's largest kinetic energy.
        free_fall: share of particles that fall freely.
        impacts: part of the squared acceleration that `IMPACT_SHARE` of the particles hold.
        gravity: magnitude as free fall shows it, NaN if nothing falls freely [m/s²].
        gravity_stated: that of the scenes [m/s²].
    """

    dt: float
    velocity_std: float
    velocity_std_seen: float
    acceleration_std: float
    step: tuple[float, float, float, float]
    moving: float
    frames_moving: float
    moving_at_end: float
    setting_out: float
    free_fall: float
    impacts: float
    gravity: float
    gravity_stated: float


@dataclass(frozen=True)
class DataErrors:
    """What no sound data set has.

    Attributes:
        not_finite: files with numbers that are not finite in the frames seen.
        outside: share of particles outside their box by more than a spacing.
        extent: largest coordinate seen, as a magnitude [m].
        other_dt: files whose time step is not the manifest's.
    """

    not_finite: tuple[str, ...]
    outside: float
    extent: float
    other_dt: tuple[str, ...]


@dataclass(frozen=True)
class Kept:
    """How well the particles of the files stand for the whole runs that they were kept of, in the last frames.

    Attributes:
        num_seen: trajectories with observables of the whole run, whose front advanced; where it is 0, the rest is NaN.
        front: mean error of the 99 % front's advance, relative: how far one that repeats the data is off.
        front_scatter: its standard deviation over the trajectories.
        map: mean share of the volume in the wrong place.
        stratified: they were drawn in blocks.
    """

    num_seen: int
    front: float
    front_scatter: float
    map: float
    stratified: bool = False


@dataclass(frozen=True)
class Survey:
    """What `survey_dataset` measures.

    Attributes:
        name: of the data set.
        dim: D.
        num_windows_seen: windows in the sample.
        sizes: how much there is.
        starts: how it begins.
        density: how close particles lie.
        motion: how they move.
        kept: how well its particles stand for whole runs.
        data_errors: what should not be.
    """

    name: str
    dim: int
    num_windows_seen: int
    sizes: Sizes
    starts: Starts
    density: Density
    motion: Motion
    kept: Kept
    data_errors: DataErrors
