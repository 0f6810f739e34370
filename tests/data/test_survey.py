"""Surveys of made-up sets: what is measured is what was put in."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from gns_pl.data import survey as surveying
from gns_pl.data.survey import survey_dataset
from gns_pl.data.survey_record import Survey
from gns_pl.errors import InputError
from gns_pl.fields import ParticleType
from gns_pl.io.schema import LOCATION
from gns_pl.metrics.observables import compute_observables
from tests.conftest import make_start
from tests.data.sets import DT, SPACING, make_flight, make_scene, moved, write_set

FLIGHTS = [make_flight(make_scene(velocity=(0.4 * k, -0.2, 0.5)), 20) for k in range(3)]


def survey_of(folder: Path, trajectories: list[Any], **data_errors: Any) -> Survey:
    manifest = write_set(folder, trajectories, **data_errors)
    return survey_dataset(folder, manifest, manifest.splits["train"], radius=0.11)


def test_free_fall(tmp_path: Path) -> None:
    found = survey_of(tmp_path, FLIGHTS)
    motion, density = found.motion, found.density
    assert motion.gravity == pytest.approx(9.81, rel=2e-3) and motion.gravity_stated == pytest.approx(9.81)
    assert motion.free_fall == 1.0 and motion.moving == 1.0 and motion.frames_moving == 1.0
    assert density.measured == pytest.approx(SPACING, rel=0.02) and density.nearest == pytest.approx(SPACING, rel=1e-3)
    assert density.end_over_start == pytest.approx(1.0, abs=0.02) and density.isolated == 0
    # The 6³ lattice at 2.2 spacings: n² + m² + k² ≤ 4, cut off at the surface of the cube.
    places = np.stack(np.meshgrid(*[np.arange(6)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    squares = np.square(places[:, None] - places[None]).sum(axis=2)
    assert density.neighbours[0] == pytest.approx(((squares > 0) & (squares <= 4)).sum() / 216, rel=1e-6)
    assert density.neighbours[4] == 32
    assert density.by_spacing["1.5"] == pytest.approx(((squares > 0) & (squares <= 2)).sum() / 216, rel=1e-6)
    assert found.data_errors == replace(found.data_errors, not_finite=(), outside=0.0, other_dt=())


def test_sizes_and_steps(tmp_path: Path) -> None:
    found = survey_of(tmp_path, [*FLIGHTS, make_flight(make_scene(), 3)], valid=1)
    sizes = found.sizes
    assert (sizes.num_trajectories, sizes.num_valid, sizes.num_windows) == (3, 1, 57)
    assert found.motion.setting_out == pytest.approx(18 / 19)  # they fall, so the last step is the fastest
    assert sizes.bytes == 3 * 20 * 216 * 3 * 4 and sizes.particles_max == 216
    # Window k holds the step from k − 1 to k, in whose middle v0 + g t is exact; all windows are seen, up to k = 18.
    largest = DT * np.array([0.4 * 2, -0.2, 0.5 - 9.81 * 17.5 * DT])
    assert found.num_windows_seen == 57
    assert found.motion.step[3] == pytest.approx(np.linalg.norm(largest), rel=1e-4)
    assert found.motion.velocity_std_seen == pytest.approx(found.motion.velocity_std, rel=0.1)


@pytest.mark.parametrize(("scale", "dt_factor", "ratio"), [(80.0, 1.0, 80.0), (1.0, 2.0, 0.25), (0.5, 1.0, 0.5)])
def test_wrong_units_show_in_gravity_and_spacing(tmp_path: Path, scale: float, dt_factor: float, ratio: float) -> None:
    found = survey_of(tmp_path, FLIGHTS, scale=scale, dt_factor=dt_factor)
    assert found.motion.gravity == pytest.approx(9.81 * ratio, rel=5e-3)
    assert found.density.measured == pytest.approx(SPACING * scale, rel=0.03)
    assert (found.data_errors.outside > 0.5) == (scale == 80.0)


def test_half_of_the_particles_move_half_of_the_time(tmp_path: Path) -> None:
    scene = make_scene(position=(0.0, 0.3, 0.0))
    number = make_start(scene, SPACING, DT).num_particles
    moving = (np.arange(number) % 2 == 0)[:, None]

    def slide(t: float) -> np.ndarray:
        return moving * np.array([0.5 * min(t, 0.5), 0.0, 0.0])

    found = survey_of(tmp_path, [moved(scene, slide, 101)] * 2)
    assert found.sizes.num_windows == 100 and found.num_windows_seen == 100
    assert found.motion.moving == pytest.approx(0.25, abs=1e-9)
    assert found.motion.frames_moving == pytest.approx(0.5, abs=1e-9)
    assert found.motion.moving_at_end == 0
    assert math.isnan(found.motion.gravity) and found.motion.free_fall == 0


def test_starts(tmp_path: Path) -> None:
    cold = make_flight(make_scene(position=(0, 0, 0), size=(0.2, 0.3, 0.6)), 4)
    hung = make_flight(make_scene(), 4)
    starts = survey_of(tmp_path, [cold, cold, hung, FLIGHTS[0], hung]).starts
    assert (starts.num_seen, starts.num_cold, starts.num_hung) == (4, 2, 1)
    assert starts.aspect_ratio == pytest.approx((1.0, 2.0, 3.0))
    assert starts.body_height == pytest.approx(0.6) and starts.body_length == pytest.approx((0.2, 0.3))


def test_impacts_are_told_apart(tmp_path: Path) -> None:
    """One particle of 216 is knocked in every window; it holds nearly all of the squared acceleration."""
    scene = make_scene(velocity=(0.1, 0.0, 0.0))
    kick = np.zeros((216, 1))
    kick[100] = 1.0

    def knocked(t: float) -> np.ndarray:
        return np.array([0.1, 0.0, 0.0]) * t + kick * 0.01 * (round(t / DT) % 2)

    assert survey_of(tmp_path, [moved(scene, knocked, 20)] * 2).motion.impacts > 0.999


def test_volume_that_is_lost(tmp_path: Path) -> None:
    """A body that shrinks by a tenth along every axis ends 1.37 times as dense."""
    scene = make_scene(position=(0.3, 0.3, 0.3))
    first = make_start(scene, SPACING, DT).position[0].astype(np.float64)
    found = survey_of(tmp_path, [moved(scene, lambda t: -0.1 * t / (19 * DT) * (first - 0.45), 20)] * 2)
    assert found.density.end_over_start == pytest.approx(0.9**-3, rel=0.01)


def test_numbers_that_are_not_finite_are_named_and_left_out(tmp_path: Path) -> None:
    manifest = write_set(tmp_path, FLIGHTS)
    with h5py.File(tmp_path / "trajectory_0001.h5", "r+") as file:
        file[LOCATION["position"]][12:] = np.nan
    found = survey_dataset(tmp_path, manifest, manifest.splits["train"], radius=0.11)
    assert found.data_errors.not_finite == ("trajectory_0001.h5",)
    assert found.motion.gravity == pytest.approx(9.81, rel=2e-3)
    with pytest.raises(InputError, match=r"not finite: trajectory_0001\.h5"):
        survey_dataset(tmp_path, manifest, ["trajectory_0001.h5"], radius=0.11)


def test_kinematic_particles_do_not_count(tmp_path: Path) -> None:
    scene = make_scene(velocity=(0.0, 0.0, -0.5))
    fixed = np.arange(216) < 100
    flight = moved(scene, lambda t: ~fixed[:, None] * np.array([0.0, 0.0, -0.5 * t - 0.5 * 9.81 * t**2]), 20)
    types = np.where(fixed, int(ParticleType.KINEMATIC), int(ParticleType.SAND))
    found = survey_of(tmp_path, [replace(flight, particle_type=types)] * 2)
    assert found.motion.moving == 1.0 and found.motion.moving_at_end == 1.0


def test_little_is_read_of_a_large_set(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    read: list[int] = []
    whole = surveying.read_window

    def counted(source: Any, start: int, length: int) -> Any:
        read.append(length)
        return whole(source, start, length)

    monkeypatch.setattr(surveying, "read_window", counted)
    survey_of(tmp_path, [make_flight(make_scene(), 300)] * 41)
    assert sum(read) <= 40 * 2 + 20 * (3 + 10 * 4)


def test_a_folder_without_training_trajectories(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no training trajectory"):
        survey_of(tmp_path, FLIGHTS, valid=3)


def test_kept_points_are_compared_with_the_whole_runs_they_are_of(tmp_path: Path) -> None:
    """The whole run's front advances by 0.25 and 0.2 m where that of the files' particles does by 0.2 m."""
    scene = make_scene(position=(0.0, 0.0, 0.0), size=(0.3, 1.0, 0.3))
    slide = moved(scene, lambda t: np.array([t, 0.0, 0.0]), 21)
    observed = compute_observables(slide, 2 * SPACING)
    farther = replace(observed, front=observed.front * np.float32(1.25))
    plain = survey_of(tmp_path / "plain", [slide, slide]).kept
    assert plain.num_seen == 0 and math.isnan(plain.front)
    at_rest = moved(scene, lambda t: np.zeros(3), 21)
    sets = [
        replace(slide, observables=observed),
        replace(slide, observables=farther),
        slide,
        replace(at_rest, observables=compute_observables(at_rest, 0.1)),
        slide,
    ]
    kept = survey_of(tmp_path / "set", sets).kept
    assert kept.num_seen == 2
    assert kept.front == pytest.approx((0 - 0.2) / 2, abs=1e-5)
    assert kept.front_scatter == pytest.approx(0.1, abs=1e-5)
    assert kept.map == pytest.approx(0, abs=1e-6)
