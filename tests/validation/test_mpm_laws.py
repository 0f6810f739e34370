"""The solver beside published laws of granular collapse, and its energy; docs/reference.md has figure and numbers."""

from __future__ import annotations

import csv
import math
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from benchmarks.mpm_validation import (
    AXISYMMETRIC,
    LAWS,
    angle_of_repose,
    axisymmetric_column,
    column_energy,
    energy_balance,
    lube_height,
    plane_column,
    settings,
)

from gns_pl.metrics.curves import compute_curves
from gns_pl.mpm import simulate
from gns_pl.scene import FACES, Body, Wall, column_collapse
from tests.mpm.conftest import make_box, make_elastic, make_mpm, make_sand

pytestmark = [pytest.mark.slow, pytest.mark.validation]

REFERENCE = Path(__file__).parent / "ref"


@cache
def collapse(aspect_ratio: float) -> dict[str, float]:
    return plane_column(aspect_ratio)


@pytest.mark.parametrize("aspect_ratio", [0.6, 0.8, 1.0, 1.5, 2.0, 4.0])
def test_runout_lies_between_the_published_laws(aspect_ratio: float) -> None:
    laws = [law(aspect_ratio) for law in LAWS]
    assert min(laws) < collapse(aspect_ratio)["runout_99"] < max(laws)


def exponent(front: str, aspect_ratios: tuple[float, ...]) -> float:
    runouts = [collapse(aspect_ratio)[front] for aspect_ratio in aspect_ratios]
    return float(np.polyfit(np.log(aspect_ratios), np.log(runouts), 1)[0])


def test_runout_grows_like_the_aspect_ratio_and_then_more_slowly() -> None:
    """The last per cent of the mass is a longer part of a low deposit, so its 99 % front grows a little faster."""
    assert exponent("runout_max", (0.6, 0.8, 1.0, 1.5)) == pytest.approx(1.0, abs=0.15)
    assert exponent("runout_99", (0.6, 0.8, 1.0, 1.5)) == pytest.approx(1.0, abs=0.2)
    assert exponent("runout_99", (4.0, 6.0)) == pytest.approx(2 / 3, abs=0.12)


@pytest.mark.parametrize("aspect_ratio", [0.6, 1.0, 2.0, 4.0])
def test_the_height_follows_lube(aspect_ratio: float) -> None:
    """The laws give heights within a quarter of each other; ours are lower for tall columns."""
    assert collapse(aspect_ratio)["height_99"] == pytest.approx(lube_height(aspect_ratio), rel=0.3)


@pytest.mark.parametrize("aspect_ratio", [0.6, 1.0, 2.0, 4.0])
def test_the_front_stops_in_time_and_the_deposit_rests(aspect_ratio: float) -> None:
    run = collapse(aspect_ratio)
    assert 2.7 < run["arrest_time"] < 4.2
    assert run["kinetic"] < 1e-4
    assert run["rise"] < 1e-3  # energy of frames, whose kinetic part is of half a frame before


@pytest.mark.parametrize("aspect_ratio", [0.8, 2.0])
def test_65_degrees_of_friction_run_shorter_than_any_law(aspect_ratio: float) -> None:
    assert plane_column(aspect_ratio, 65.0)["runout_99"] < 0.8 * min(law(aspect_ratio) for law in LAWS)


def test_the_steeper_the_angle_of_friction_the_steeper_the_heap() -> None:
    angles = (20.0, 30.0, 40.0)
    slopes = [angle_of_repose(angle) for angle in angles]
    assert slopes[0] < slopes[1] < slopes[2]
    for angle, slope in zip(angles, slopes, strict=True):
        assert 0.75 * angle < slope < angle + 1.0


@pytest.mark.parametrize("aspect_ratio", [0.8, 2.0])
def test_a_quarter_of_a_round_column_spreads_as_published_and_stays_round(aspect_ratio: float) -> None:
    run = axisymmetric_column(aspect_ratio)
    assert run["runout_99"] == pytest.approx(AXISYMMETRIC(aspect_ratio), rel=0.25)
    assert run["anisotropy"] == pytest.approx(1.0, abs=0.08)


def test_the_energy_of_a_column_is_accounted_for() -> None:
    rows = column_energy(2.0, cells=8)
    last = rows[-1]
    for part in ("plastic", "viscous", "walls"):  # what is dissipated never comes back
        values = np.array([row[part] for row in rows])
        assert np.diff(values).min() > -2e-3
    assert last["plastic"] > last["walls"] > 0.02
    assert last["kinetic"] < 1e-3
    assert abs(last["transfer"]) < 0.08
    assert min(row["transfer"] for row in rows) > -0.01


def test_an_elastic_block_that_bounces_has_no_plastic_dissipation() -> None:
    """Where nothing flows the work of the stresses is what they store, so the balance must say so."""
    scene = make_box((0.5, 0.6), Body((0.1, 0.1), (0.25, 0.25), (0.0, 0.0)), duration=0.4, material=make_elastic())
    rows = energy_balance(scene, make_mpm(damping_rate=0.0, bulk_viscosity=0.0, courant=0.1), 1.0)
    assert max(row["stored"] for row in rows) > 1e-3
    assert max(abs(row["plastic"]) for row in rows) < 2e-3
    assert max(abs(row["viscous"]) for row in rows) < 1e-12


def reference(walls: str, aspect_ratio: float) -> dict[str, np.ndarray]:
    path = REFERENCE / f"mpm_{walls}_{aspect_ratio:g}.csv"
    lines = [line for line in path.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    rows = list(csv.DictReader(lines))
    return {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}


@pytest.mark.parametrize(("aspect_ratio", "length"), [(0.8, 0.475), (2.0, 0.3)])
def test_a_grid_of_one_48th_follows_the_converged_curve(aspect_ratio: float, length: float) -> None:
    """Three times coarser than the reference: runout within 6 %, mean height within 3 %, at any time."""
    known = reference("plane", aspect_ratio)
    height = aspect_ratio * length
    scene = column_collapse(
        domain=(2.5, 0.75),
        length=length,
        height=height,
        gravity=9.81,
        duration=8 * math.sqrt(height / 9.81),
        material=make_sand(cohesion=100.0, tension_cutoff=50.0),
        walls=dict.fromkeys(FACES[2], Wall("friction", 0.385)),
    )
    flow = simulate(scene, settings(1 / 48), frame_interval=0.005)
    curves = compute_curves(flow)
    runout = np.interp(known["time_tau"], curves["time_tau"], curves["runout_99"])
    assert np.abs(runout - known["runout_99"]).max() < 0.06 * known["runout_99"][-1]
    mean = np.interp(known["time_tau"], curves["time_tau"], curves["mean_height"] / length)
    assert np.abs(mean / known["mean_height"] - 1).max() < 0.03
