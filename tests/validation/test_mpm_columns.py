"""The column collapse of the solver beside published runouts and CB-Geo's curves; docs/reference.md has the numbers."""

from __future__ import annotations

import csv
import math
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from gns_pl.mpm import simulate
from gns_pl.scene import FACES, Wall, column_collapse
from gns_pl.trajectory import Trajectory
from tests.mpm.conftest import make_mpm, make_sand, swelling

pytestmark = [pytest.mark.slow, pytest.mark.validation]

LENGTH = {0.8: 0.475, 2.0: 0.3}
"""L0 [m] of the two columns."""

BAND = {0.8: (0.96, 1.82), 2.0: (2.4, 4.56)}
"""Smallest and largest published runout in a plane channel: Lube et al. 2005 and Dunatunga & Kamrin 2015."""

REFERENCE = Path(__file__).parent / "ref" / "cbgeo_columns.csv"


def front(run: Trajectory, length: float, percent: str, frame: int = -1) -> float:
    """Runout (L − L0) / L0 of the front behind which `percent` of the mass lies, or of the farthest point."""
    x = run.position[frame][:, 0].astype(np.float64)
    place = x.max() if percent == "max" else np.quantile(x, float(percent) / 100)
    return float(place - length) / length


@cache
def plane_column(aspect_ratio: float, friction_angle_deg: float, cells_per_metre: int) -> Trajectory:
    """A column without cohesion in the plane, which is a channel with slip walls, over 6 √(H0 / g)."""
    length = LENGTH[aspect_ratio]
    height = aspect_ratio * length
    walls = dict.fromkeys(FACES[2], Wall("slip"))
    walls["z-"] = Wall("friction", math.tan(math.radians(friction_angle_deg)))
    scene = column_collapse(
        domain=(2.5, 0.7),
        length=length,
        height=height,
        gravity=9.81,
        duration=6 * math.sqrt(height / 9.81),
        material=make_sand(friction_angle_deg=friction_angle_deg),
        walls=walls,
    )
    return simulate(scene, make_mpm(cell_size=1 / cells_per_metre, points_per_direction=2), frame_interval=0.01)


@cache
def paper_column(aspect_ratio: float) -> Trajectory:
    """The paper's column at the paper's resolution, with its material and walls."""
    length = LENGTH[aspect_ratio]
    height = aspect_ratio * length
    scene = column_collapse(
        domain=(1.5, 0.5, 0.7),
        length=length,
        height=height,
        gravity=9.81,
        duration=6 * math.sqrt(height / 9.81),
        material=make_sand(cohesion=100.0, tension_cutoff=50.0),
        walls=dict.fromkeys(FACES[3], Wall("friction", 0.385)),
    )
    return simulate(scene, make_mpm(jitter=0.7), frame_interval=0.0025)


@pytest.mark.parametrize("aspect_ratio", BAND)
@pytest.mark.parametrize("percent", ["99", "max"])
def test_runout_lies_in_the_published_band(aspect_ratio: float, percent: str) -> None:
    low, high = BAND[aspect_ratio]
    assert low < front(plane_column(aspect_ratio, 30.0, 48), LENGTH[aspect_ratio], percent) < high


@pytest.mark.parametrize("aspect_ratio", BAND)
@pytest.mark.parametrize("percent", ["99", "max"])
def test_a_friction_angle_of_65_degrees_does_not(aspect_ratio: float, percent: str) -> None:
    assert front(plane_column(aspect_ratio, 65.0, 48), LENGTH[aspect_ratio], percent) < 0.8 * BAND[aspect_ratio][0]


@pytest.mark.parametrize("aspect_ratio", BAND)
def test_runout_grows_with_resolution_and_settles(aspect_ratio: float) -> None:
    coarse, middle, fine = (
        front(plane_column(aspect_ratio, 30.0, cells), LENGTH[aspect_ratio], "99") for cells in (12, 24, 48)
    )
    assert coarse < middle < fine
    assert fine - middle < 1.2 * (middle - coarse)


@pytest.mark.parametrize("aspect_ratio", BAND)
def test_the_deposit_keeps_its_volume_and_comes_to_rest(aspect_ratio: float) -> None:
    run = plane_column(aspect_ratio, 30.0, 24)
    assert swelling(run, 1 / 24) == pytest.approx(1, abs=0.1)
    kinetic = 0.5 * (run.mass[:, None] * run.velocity()[-1] ** 2).sum()
    height = aspect_ratio * LENGTH[aspect_ratio]
    assert kinetic < 1e-4 * run.mass.sum() * 9.81 * height / 2


def reference() -> list[dict[str, str]]:
    lines = [line for line in REFERENCE.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    return list(csv.DictReader(lines))


def tolerance(row: dict[str, str]) -> float:
    """How far from CB-Geo: 5 % early, 12 % when the front is fast, 15 % for the 99 % front at the end.

    The last stragglers (99.9 %, maximum) and the final height differ for reasons told in docs/reference.md: CB-Geo's
    front is drawn out by nearly empty cells, and its columns first fall into the gap of their outer layer.
    """
    if row["quantity"] == "height":
        return 0.06 if row["t_over_tau"] != "end" else 0.2
    if row["t_over_tau"] == "end":
        return {"99": 0.15, "99.5": 0.15, "99.9": 0.2, "max": 0.25}[row["front"]]
    return 0.06 if row["t_over_tau"] == "1.0" else 0.15


@pytest.mark.parametrize("row", reference(), ids=lambda row: "-".join(row.values()))
def test_the_papers_deck_beside_cbgeo(row: dict[str, str]) -> None:
    aspect_ratio = float(row["aspect_ratio"])
    length = LENGTH[aspect_ratio]
    run = paper_column(aspect_ratio)
    tau = math.sqrt(aspect_ratio * length / 9.81)
    frame = -1 if row["t_over_tau"] == "end" else round(float(row["t_over_tau"]) * tau / run.dt)
    if row["quantity"] == "height":
        ours = float(run.position[frame][:, 2].max()) / length
    else:
        ours = front(run, length, row["front"], frame)
    assert ours == pytest.approx(float(row["value"]), rel=tolerance(row))
