"""What a data set is like, measured on a sample of its frames, so that a large one is never read whole.

The sample: the first and last frames of all training trajectories (some hundreds at most), and windows of four frames
spread over some twenty of them. Particles enter alike, kinematic ones not at all. Nothing here knows of a network or
judges anything; `training.advice` does.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gns_pl.data import estimators
from gns_pl.data.kept import kept_errors
from gns_pl.data.survey_record import (
    IMPACT_SHARE,
    MOVING_SHARE,
    SPACINGS,
    SPEED_AT_REST,
    DataErrors,
    Density,
    Kept,
    Motion,
    Sizes,
    Starts,
    Survey,
)
from gns_pl.errors import InputError
from gns_pl.fields import ParticleType
from gns_pl.io import Manifest, TrajectoryHeader, open_trajectory, read_header, read_static, read_window
from gns_pl.trajectory import ballistic_history

MAX_FILES, MAX_TRAJECTORIES, MAX_WINDOWS = 400, 20, 200
MAX_PARTICLES, MAX_QUERIES = 2000, 300
"""Per window: particles that enter statistics, and those whose neighbours are counted."""


def survey_dataset(directory: Path, manifest: Manifest, names: Sequence[str], *, radius: float) -> Survey:
    """Measure the training trajectories of a data set on a sample.

    Args:
        directory: its folder.
        manifest: of the folder.
        names: training files.
        radius: for which neighbours are counted [m].

    Raises:
        InputError: no file, a file that cannot be read, or no window in any of them.
    """
    if not names:
        raise InputError(f"{directory}: has no training trajectory, so there is nothing to advise on.")
    sample = _Sample(manifest, radius, np.random.default_rng(0))
    for name in _spread(names, MAX_FILES):
        sample.add_start(directory / name)
    chosen = _spread(names, MAX_TRAJECTORIES)
    for name in chosen:
        sample.add_windows(directory / name, MAX_WINDOWS // len(chosen))
    lengths = [manifest.files[name].num_frames - 1 for name in names]
    particles = [manifest.files[name].num_particles for name in names]
    sizes = Sizes(
        num_trajectories=len(names),
        num_valid=len(manifest.splits["valid"]),
        num_windows=sum(lengths),
        particles_mean=float(np.mean(particles)),
        particles_max=max(particles),
        bytes=sum(4 * (t + 1) * n * manifest.dim for t, n in zip(lengths, particles, strict=True)),
    )
    return sample.survey(sizes)


def _spread(names: Sequence[str], number: int) -> list[str]:
    """Return at most `number` of the names, evenly spread, since families follow one another."""
    places = np.unique(np.linspace(0, len(names) - 1, min(number, len(names))).round().astype(int))
    return [names[place] for place in places]


def _median(values: NDArray[np.float64]) -> float:
    """Return the median of what is not NaN; NaN if nothing is."""
    known = values[~np.isnan(values)]
    return float(np.median(known)) if len(known) else float("nan")


class _Sample:
    """Numbers collected over files, in the order in which they are read."""

    def __init__(self, manifest: Manifest, radius: float, generator: np.random.Generator) -> None:
        self.manifest, self.radius, self.generator = manifest, radius, generator
        self.headers: dict[str, TrajectoryHeader] = {}
        self.cold = self.hung = 0
        self.bad: dict[str, None] = {}  # an ordered set
        self.outside: list[float] = []
        self.extent = 0.0
        self.seen: dict[str, list[Any]] = {}

    def _note(self, **values: Any) -> None:
        for key, value in values.items():
            self.seen.setdefault(key, []).append(value)

    def _pool(self, key: str) -> NDArray[np.float64]:
        return np.concatenate([np.atleast_1d(value) for value in self.seen.get(key, [])] or [np.full(1, np.nan)])

    def _choose(self, among: NDArray[np.int64], number: int) -> NDArray[np.int64]:
        return among if len(among) <= number else self.generator.choice(among, number, replace=False)

    def _is_sound(self, name: str, frames: NDArray[np.float32], header: TrajectoryHeader) -> bool:
        """Note what is wrong with frames [F, N, D]; return whether they can be measured."""
        if not np.isfinite(frames).all():
            self.bad[name] = None
            return False
        lower, upper = np.array(header.scene.lower), np.array(header.scene.upper)
        gap = self.manifest.spacing
        self.outside.append(float(((frames < lower - gap) | (frames > upper + gap)).any(axis=2).mean()))
        self.extent = max(self.extent, float(np.abs(frames).max()))
        return True

    def add_start(self, path: Path) -> None:
        """Look at how a trajectory begins and whether its ends are finite."""
        header, static = read_header(path), read_static(path)
        self.headers[path.name] = header
        first = read_window(path, 0, 1)
        ends = np.concatenate([first, read_window(path, header.num_frames - 1, 1)])
        if not self._is_sound(path.name, ends, header):
            return
        errors = kept_errors(path, header, ends, least=self.manifest.spacing)
        if errors is not None:
            self._note(kept=errors)
        if np.linalg.norm(static["initial_velocity"], axis=1).max() < SPEED_AT_REST:
            stands = float(first[0, :, -1].min()) - header.scene.lower[-1] < 1.5 * self.manifest.spacing
            self.cold, self.hung = self.cold + stands, self.hung + (not stands)

    def add_windows(self, path: Path, number: int) -> None:
        """Measure `number` windows spread over a trajectory, and its two ends."""
        header, static = read_header(path), read_static(path)
        moved = np.flatnonzero(static["particle_type"] != int(ParticleType.KINEMATIC))
        length = header.num_frames - 1
        if length < 1 or len(moved) == 0:
            return
        edges = np.linspace(0, length, min(number, length) + 1)
        frames = np.unique(self.generator.uniform(edges[:-1], edges[1:]).astype(int))
        with open_trajectory(path) as file:
            first, end = read_window(file, 0, 1), read_window(file, length - 1, 2)
            if not self._is_sound(path.name, np.concatenate([first, end]), header):
                return
            self._add_ends(header, first[0], end, moved)
            past = ballistic_history(first[0], static["initial_velocity"], header.dt, 3)[:-1].astype(np.float32)
            energies = {}
            for frame in frames:
                start = max(0, int(frame) - 2)
                window = read_window(file, start, int(frame) + 2 - start)
                if self._is_sound(path.name, window, header):
                    energies[int(frame)] = float(np.square(window[-1, moved] - window[-2, moved]).sum())
                    self._add_window(header, np.concatenate([past[len(window) - 2 :], window])[-4:], moved, frame >= 2)
        if energies:
            self._note(setting_out=max(energies, key=lambda frame: energies[frame]) / length)

    def _add_ends(
        self, header: TrajectoryHeader, first: NDArray[np.float32], end: NDArray[np.float32], moved: NDArray[np.int64]
    ) -> None:
        lower, upper = np.array(header.scene.lower), np.array(header.scene.upper)
        queries = self._choose(moved, MAX_QUERIES)
        spacings = [
            estimators.interior_spacing(frame, lower, upper, queries, margin=3 * self.manifest.spacing)
            for frame in (first, end[1])
        ]
        speed = np.linalg.norm(end[1, moved] - end[0, moved], axis=1) / header.dt
        self._note(
            interior=spacings[0],
            density=(spacings[0] / spacings[1]) ** header.dim,
            nearest_start=estimators.nearest_distance(first, queries),
            moving_at_end=float((speed > SPEED_AT_REST).mean()),
        )

    def _add_window(
        self, header: TrajectoryHeader, window: NDArray[np.float32], moved: NDArray[np.int64], whole: bool
    ) -> None:
        """Add the frames k − 2 … k + 1 [4, N, D]; `whole` if none of them lies before the first."""
        chosen = self._choose(moved, MAX_PARTICLES)
        steps = np.diff(window[:, chosen].astype(np.float64), axis=0)  # of which float32 would lose digits
        acceleration = np.diff(steps, axis=0) / header.dt**2
        size = np.linalg.norm(steps[1], axis=1)
        moving = float((size > SPEED_AT_REST * header.dt).mean())
        queries = self._choose(moved, MAX_QUERIES)
        radii = np.array([self.radius, *(factor * self.manifest.spacing for factor in SPACINGS)])
        self._note(
            velocity=steps[1] / header.dt,
            target=acceleration[1],
            step=size,
            largest=float(np.linalg.norm(window[2, moved] - window[1, moved], axis=1).max()),
            moving=moving,
            nearest=estimators.nearest_distance(window[2], queries),
            counts=estimators.neighbour_counts(window[2], radii, queries),
        )
        if whole:  # the ballistic past knows no gravity
            self._note(flight=acceleration[1], before=acceleration[0])

    def survey(self, sizes: Sizes) -> Survey:
        """Return what was collected."""
        if "velocity" not in self.seen:
            where = f" (not finite: {', '.join(self.bad)})" if self.bad else ""
            raise InputError(f"data set {self.manifest.name!r}: none of the frames seen makes a window{where}.")
        return Survey(
            name=self.manifest.name,
            dim=self.manifest.dim,
            num_windows_seen=len(self.seen["velocity"]),
            sizes=sizes,
            starts=self._starts(),
            density=self._density(),
            motion=self._motion(),
            kept=self._kept(),
            data_errors=DataErrors(
                not_finite=tuple(self.bad),
                outside=float(np.mean(self.outside)),
                extent=self.extent,
                other_dt=tuple(
                    name
                    for name, header in self.headers.items()
                    if not np.isclose(header.dt, self.manifest.dt, rtol=1e-6, atol=0)
                ),
            ),
        )

    def _starts(self) -> Starts:
        scenes = [header.scene for header in self.headers.values()]
        bodies = [body for scene in scenes for body in scene.bodies]
        ratios = np.array([body.size[-1] / body.size[0] for body in bodies])
        return Starts(
            num_seen=len(scenes),
            num_cold=self.cold,
            num_hung=self.hung,
            body_height=max(body.size[-1] for body in bodies),
            body_length=(min(body.size[0] for body in bodies), max(body.size[0] for body in bodies)),
            domain=tuple(high - low for low, high in zip(scenes[0].lower, scenes[0].upper, strict=True)),
            duration=float(np.median([(header.num_frames - 1) * header.dt for header in self.headers.values()])),
            aspect_ratio=(float(ratios.min()), float(np.median(ratios)), float(ratios.max())),
            p_wave_speed=max(material.p_wave_speed for scene in scenes for material in scene.materials.values()),
            num_obstacles=sum(bool(scene.obstacles) for scene in scenes),
        )

    def _density(self) -> Density:
        counts = np.concatenate(self.seen["counts"])
        within = counts[:, 0]
        low, median, high = (float(value) for value in np.percentile(within, [5, 50, 95]))
        return Density(
            spacing=self.manifest.spacing,
            measured=_median(self._pool("interior")),
            nearest=float(np.median(self._pool("nearest_start"))),
            nearest_low=float(np.percentile(self._pool("nearest"), 1)),
            end_over_start=_median(self._pool("density")),
            radius=self.radius,
            neighbours=(float(within.mean()), low, median, high, float(within.max())),
            isolated=float((within == 0).mean()),
            by_spacing={f"{factor:g}": float(counts[:, 1 + k].mean()) for k, factor in enumerate(SPACINGS)},
        )

    def _kept(self) -> Kept:
        errors = np.array(self.seen.get("kept", np.full((1, 2), np.nan)))
        return Kept(
            num_seen=len(self.seen.get("kept", ())),
            front=float(errors[:, 0].mean()),
            front_scatter=float(errors[:, 0].std()),
            map=float(errors[:, 1].mean()),
            stratified=self.manifest.spec.get("sampling") == "stratified",
        )

    def _std_of_all(self, quantity: str) -> float:
        """Return the root mean variance of a component over all training frames, as the manifest has it."""
        if quantity not in self.manifest.statistics:
            raise InputError(f"data set {self.manifest.name!r}: its manifest has no statistics of the {quantity}.")
        return float(np.sqrt(np.square(self.manifest.statistics[quantity]["std"]).mean()))

    def _motion(self) -> Motion:
        velocity, target, step = (self._pool(key) for key in ("velocity", "target", "step"))
        # float32 positions: half a unit in the last place each, in a difference of 1, −2, 1
        rounding = 1.5 * float(np.spacing(np.float32(self.extent))) / self.manifest.dt**2
        gravity, falling = float("nan"), np.zeros(0, dtype=bool)
        if "flight" in self.seen:
            gravity, falling = estimators.measure_gravity(self._pool("flight"), self._pool("before"), rounding)
        percentiles = [float(value) for value in np.percentile(step, [50, 99, 99.9])]
        return Motion(
            dt=self.manifest.dt,
            velocity_std=self._std_of_all("velocity"),
            velocity_std_seen=float(np.sqrt(velocity.var(axis=0).mean())),
            acceleration_std=self._std_of_all("acceleration"),
            step=(percentiles[0], percentiles[1], percentiles[2], max(self.seen["largest"])),
            moving=float(np.mean(self.seen["moving"])),
            frames_moving=float(np.mean(np.array(self.seen["moving"]) > MOVING_SHARE)),
            moving_at_end=float(np.mean(self.seen["moving_at_end"])),
            setting_out=float(np.mean(self.seen["setting_out"])),
            free_fall=float(falling.mean()) if len(falling) else 0.0,
            impacts=estimators.top_share(np.square(target).sum(axis=1), IMPACT_SHARE),
            gravity=gravity,
            gravity_stated=float(np.median([np.linalg.norm(header.scene.gravity) for header in self.headers.values()])),
        )
