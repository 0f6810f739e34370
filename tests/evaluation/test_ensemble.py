"""Bands of runs: every member once, maps of all of them, and going on after one that failed."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gns_pl.errors import InputError
from gns_pl.evaluation import ensemble
from gns_pl.evaluation.simulation import simulate_and_describe
from gns_pl.metrics.rasters import compute_maps, map_grid
from gns_pl.scene import Scene, read_raster, write_scene
from gns_pl.solvers.catalogue import REGISTERED, register_solver
from gns_pl.solvers.solver import Solver
from gns_pl.trajectory import Trajectory
from tests.evaluation.made_up import SPACING, column, spreading
from tests.evaluation.test_simulation import config, told

RUNS: list[Scene] = []


class Spreading(Solver):
    """Spreads the farther the less friction there is; thin releases fail once they are told to."""

    name = "spreading"
    fails_below = 0.0

    def run(self, scene: Scene, *, interval: float | None = None, seed: int = 0, monitor: bool = True) -> Trajectory:
        RUNS.append(scene)
        if scene.bodies[0].size[-1] < self.fails_below:
            raise InputError("too thin to be run.")
        angle = scene.materials["sand"].friction_angle_deg
        return spreading(scene, frames=round(scene.duration / 0.01) + 1, share=30 / angle - 0.5, dt=0.01)


@pytest.fixture(autouse=True)
def solver(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(ensemble, "available_cores", lambda: 1)  # in this process, which alone knows the solver
    RUNS.clear()
    register_solver("spreading", Spreading)
    yield
    del REGISTERED["spreading"]


def run(folder: Path, *settings: str) -> list[Path]:
    write_scene(column().replace(duration=0.1), folder / "small.yaml")
    shared = (f"scene={folder / 'small.yaml'}", "solver=spreading", f"out={folder / 'out'}", "seed=7")
    return simulate_and_describe(config("simulate", *shared, "reporting.reached=0.02", *settings))


BAND = ("+ensemble.vary.friction_angle_deg=[20,40]", "+ensemble.vary.release=[0.5,1]")


def test_maps_are_of_all_members(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A grid of two values each: four runs, by hand."""
    assert run(tmp_path, *BAND, "ensemble.grid=2", "ensemble.thresholds=[0.053,0.157]") == []
    folder = tmp_path / "out" / "column" / "ensemble"
    grid, largest, deposits = map_grid(column(), SPACING), [], []
    for angle in (20, 40):
        for factor in (0.5, 1.0):
            [body] = column().bodies
            scene = column().replace(bodies=(type(body)(body.position, (0.4, 0.5, 0.2 * factor), body.velocity),))
            maps = compute_maps(spreading(scene, frames=11, share=30 / angle - 0.5, dt=0.01), grid=grid, reached=0.02)
            largest.append(maps.max_thickness)
            deposits.append(maps.deposit)
    for threshold in (0.053, 0.157):
        found = read_raster(folder / f"column_exceedance_{threshold}m.asc").values
        np.testing.assert_allclose(found, np.mean([each >= threshold for each in largest], axis=0))
        assert 0 < found.mean() < 1
    np.testing.assert_allclose(
        read_raster(folder / "column_mean_deposit.asc").values, np.mean(deposits, axis=0), rtol=1e-5, atol=1e-9
    )
    rows = list(csv.DictReader((folder / "members.csv").open()))
    assert [(row["friction_angle_deg"], row["release"], row["seed"]) for row in rows] == [
        ("20", "0.5", "7"), ("20", "1", "8"), ("40", "0.5", "9"), ("40", "1", "10"),
    ]  # fmt: skip
    areas = [(each >= 0.02).sum() * grid.cell**2 for each in largest]
    np.testing.assert_allclose([float(row["area_reached_m2"]) for row in rows], areas, rtol=1e-4)
    collection = json.loads((folder / "column_exceedance.geojson").read_text())["features"]
    assert len(collection) == 6 and collection[0]["properties"]["share_of_runs"] == 0.05
    assert (folder / "column_ensemble.png").is_file() and not list(folder.glob("members/*.h5"))
    text = told(capsys)
    assert "4 of 4, seeds 7 to 10" in text and "friction_angle_deg from 20 to 40" in text


def test_more_members_keep_those_that_there_are(tmp_path: Path) -> None:
    run(tmp_path, *BAND, "ensemble.members=3", "reporting.figures=false")
    first = read_raster(tmp_path / "out" / "column" / "ensemble" / "column_mean_deposit.asc").values
    assert len(RUNS) == 1 + 3  # the first frame of the scene itself, then the members
    angles = [scene.materials["sand"].friction_angle_deg for scene in RUNS[1:]]
    assert len(set(angles)) == 3 and all(20 < angle < 40 for angle in angles)
    run(tmp_path, *BAND, "ensemble.members=5", "reporting.figures=false")
    assert len(RUNS) == 1 + 3 + 1 + 2
    run(tmp_path, *BAND, "ensemble.members=3", "reporting.figures=false")
    again = read_raster(tmp_path / "out" / "column" / "ensemble" / "column_mean_deposit.asc").values
    np.testing.assert_array_equal(first, again)
    with pytest.raises(InputError, match=r"0000\.npz: is of another scene, solver, seed or version; remove its folder"):
        run(tmp_path, *BAND, "ensemble.members=3", "reporting.reached=0.03")


def test_a_member_that_fails_costs_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(Spreading, "fails_below", 0.15)
    with pytest.raises(InputError, match=r"2 of 4 members failed \(member 0: too thin to be run\), so the maps are of"):
        run(tmp_path, *BAND, "ensemble.grid=2", "reporting.figures=false")
    folder = tmp_path / "out" / "column" / "ensemble"
    rows = list(csv.DictReader((folder / "members.csv").open()))
    assert [row["status"] for row in rows] == ["too thin to be run.", "done"] * 2
    half = read_raster(folder / "column_mean_deposit.asc").values
    assert half.sum() * map_grid(column(), SPACING).cell ** 2 == pytest.approx(0.4 * 0.5 * 0.2, rel=1e-4)
    monkeypatch.setattr(Spreading, "fails_below", 0.0)
    RUNS.clear()
    run(tmp_path, *BAND, "ensemble.grid=2", "reporting.figures=false")
    assert len(RUNS) == 1 + 2  # only those that failed
    assert "column: 4 members, 2 of them to run, 1 at a time." in capfd.readouterr().err


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        (
            ("+ensemble.vary.release=0.5",),
            r"ensemble\.release=\[LOW,HIGH\] takes two numbers, the smaller first, not 0.5",
        ),
        (("+ensemble.vary.release=[2,1]",), r"takes two numbers, the smaller first, not \[2, 1\]"),
        (("+ensemble.vary.release=[a,1]",), r"takes two numbers, the smaller first, not \['a', 1\]"),
        (("+ensemble.vary.release=[-1,1]", "ensemble.grid=2"), r"member 0 \(release -1\): .*release must be a finite"),
        (("+ensemble.vary.frictoin=[1,2]",), r"member 0 \(frictoin 1\.\d+\): .*frictoin"),
        (("+ensemble.vary.release=[1,9]", "ensemble.grid=2"), r"member 1 \(release 9\): .*outside the domain"),
        (("+ensemble.vary.ground_friction=[0.1,0.5]",), "nothing that scene 'column' stands on has a coefficient"),
        ((*BAND, "ensemble.thresholds=[0]"), r"ensemble\.thresholds must be thicknesses above 0 m, not \[0\]"),
        ((*BAND, "solver=null"), "name a solver: .*simulate"),
        ((*BAND, "tolerance=0.1"), "an ensemble runs one solver: give solver= or ckpt="),
        ((*BAND, "scene=[a.yaml,b.yaml]"), "an ensemble is of one scene"),
    ],
)
def test_what_cannot_be_varied_is_refused_before_any_run(
    tmp_path: Path, settings: tuple[str, ...], sentence: str
) -> None:
    with pytest.raises(InputError, match=sentence):
        run(tmp_path, *settings)
    assert not RUNS and not (tmp_path / "out").exists()


def test_a_member_whose_state_became_unphysical_has_failed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Failing(Spreading):
        def run(self, scene: Scene, **settings: Any) -> Trajectory:
            flow = super().run(scene, **settings)
            flow.provenance.update({"failure": "particles flew up", "failed_at": 0.05})
            return flow

    register_solver("spreading", Failing)
    with pytest.raises(InputError, match=r"2 of 2 members failed .*unphysical state: particles flew up"):
        run(tmp_path, "+ensemble.vary.release=[0.5,1]", "ensemble.members=2")
