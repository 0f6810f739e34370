"""Solvers with fitted scalars come back from their files, know the range they were fitted to, and are chosen in it."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import gns_pl
from gns_pl.errors import InputError
from gns_pl.io import read_trajectory
from gns_pl.io.tables import write_table
from gns_pl.models.shipped import FOLDER, fitted_names
from gns_pl.scene import FACES, Box, Material, Wall
from gns_pl.solvers.fitted import FittedSolver
from gns_pl.solvers.fitted_files import read_fitted, write_fitted
from gns_pl.solvers.fitted_range import range_of
from gns_pl.solvers.reduction import reduce_scene
from gns_pl.solvers.retuned import MPMFactors, RetunedMPMSolver
from gns_pl.solvers.selection import Record
from gns_pl.solvers.shallow import FittedShallowSolver, ShallowFactors, ShallowSolver
from gns_pl.solvers.simulate import simulate_by_choice
from tests.solvers.test_selection import MPM, ROUGH, column, record

RETUNED = RetunedMPMSolver("mine", 5.0, MPM, factors=MPMFactors(damping_rate=0.25))
LAYER = FittedShallowSolver("mine", 20.0, {"earth_pressure": "at_rest"}, factors=ShallowFactors(1.5, 0.5))


@pytest.mark.parametrize("solver", [RETUNED, LAYER])
def test_a_file_gives_the_solver_back(solver: FittedSolver, tmp_path: Path) -> None:
    solver = replace(solver, fitted_range=range_of([column(0.5), column(2.0)]))
    write_fitted(tmp_path / "mine.yaml", solver, {"runs": 3})
    back = read_fitted(tmp_path / "mine.yaml")
    assert back == replace(solver, path=tmp_path / "mine.yaml") and back.identity() == solver.identity()
    assert gns_pl.load_solver(tmp_path / "mine.yaml").file() == tmp_path / "mine.yaml"


def test_what_is_outside_the_fitted_range_is_told() -> None:
    fitted = [column(0.5), column(2.0), column(1.0, obstacles=(Box((0.5, 0, 0), (0.1, 0.5, 0.1), ROUGH),))]
    solver = replace(RETUNED, fitted_range=range_of(fitted))
    for scene in (*fitted, column(1.2)):
        assert solver.out_of_range_reason(scene) is None
    assert RETUNED.out_of_range_reason(column(3.0)) is None, "no range, nothing to tell"
    gravel = {"sand": replace(column().materials["sand"], friction_angle_deg=38.0)}
    moving = (replace(column().bodies[0], velocity=(1.0, 0.0, 0.0)),)
    reasons = {
        "aspect ratios of 0.5 to 2, here 3": column(3.0),
        "another material": column(materials=gravel),
        r"other walls \(in plane strain obstacle: friction 0.385; .*\), here in space x: stick": column(
            walls=dict.fromkeys(FACES[3], Wall("stick"))
        ),
        r"\), here in space x: friction 0.385; in space y: friction 0.385; in space z": column(sides=ROUGH),
        "initial speeds of 0 to 0 m/s, here 1": column(bodies=moving),
        "slopes of 0 to 0°, here 30": column(gravity=(9.81 / 2, 0.0, -9.81 * math.sqrt(3) / 2)),
        "numbers of obstacles of 0 to 1, here 2": column(
            obstacles=tuple(Box((x, 0, 0), (0.1, 0.5, 0.1), ROUGH) for x in (0.5, 0.8))
        ),
    }
    for reason, scene in reasons.items():
        with pytest.raises(AssertionError, match=reason):
            assert solver.out_of_range_reason(scene) is None, solver.out_of_range_reason(scene)


def test_a_tolerance_chooses_it_within_its_range_once_it_was_measured(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Outside it the next MPM is taken; and its factors are not checked on cells for which they were not fitted."""
    rough = column(sides=ROUGH)
    write_fitted(tmp_path / "mine.yaml", replace(RETUNED, fitted_range=range_of([rough])), {})
    table = [record("mine", kind, 0.05, 1.0) for kind in ("space", "plane")]
    write_table(tmp_path / "records.csv", Record, [*table, *(record("mpm_8", r.kind, 0.04, 9.0) for r in table)])
    choice = {"fitted": [str(tmp_path / "mine.yaml")], "cells": [8], "mpm": MPM, "frame_interval": 0.05}
    choice["records"] = str(tmp_path / "records.csv")
    how = {"choice": choice, "tolerance": 0.06, "check": True}
    (path,) = simulate_by_choice([rough], out=tmp_path / "space", **how)  # type: ignore[arg-type]
    assert read_trajectory(path).provenance["solver"] == "mine"
    out = capsys.readouterr().out
    assert "chosen: mine" in out and "check: mine has no cells of its own to compare" in out
    assert not list(tmp_path.rglob("*.coarser.h5"))
    (path,) = simulate_by_choice([column()], out=tmp_path / "plane", **how)  # type: ignore[arg-type]
    assert read_trajectory(path).provenance["solver"] == "mpm_8"
    assert "mine                     not: fitted with other walls" in capsys.readouterr().out


@pytest.mark.parametrize("name", fitted_names())
def test_each_that_ships_has_a_card_a_range_and_its_errors(name: str) -> None:
    """Columns between rough walls and in plane strain are within; a smooth floor, or one smooth side wall, is not."""
    solver = gns_pl.load_solver(name)
    assert isinstance(solver, FittedSolver) and solver.name == name
    assert (FOLDER / f"{name}.md").read_text(encoding="utf-8").split("---\n", 2)[2].startswith(f"# {name}\n")
    sand = {"sand": Material(**solver.fitted_range["materials"][0])}
    rough, plane = column(2.0, sides=ROUGH, materials=sand), column(2.0, materials=sand)
    assert solver.out_of_range_reason(rough) is None and solver.out_of_range_reason(plane) is None
    assert solver.out_of_range_reason(reduce_scene(plane).scene) is None
    for face in ("y-", "z-"):
        assert "other walls" in str(
            solver.out_of_range_reason(rough.replace(walls={**rough.walls, face: Wall("slip")}))
        )
    for scene in (rough, plane):
        run = solver.run(scene)
        assert np.isfinite(run.position).all() and solver.cost(run.scene) < 1e8


def test_two_sizes_of_mpm_and_one_of_a_layer_ship() -> None:
    assert fitted_names() == ["mpm-retuned-5", "mpm-retuned-7.6", "shallow-fitted"]


def test_a_fitted_layer_is_one_with_its_own_pressure_and_friction() -> None:
    """1.5 times 1 − sin 30° over half of the floor's friction, by hand; factors of 1 change nothing."""
    scene = column(1.0)
    by_hand = {"earth_pressure": 0.75, "friction": 0.5 * 0.385}
    run = replace(LAYER, settings=by_hand, factors=ShallowFactors()).run(scene)
    np.testing.assert_array_equal(LAYER.run(scene).position, run.position)
    assert LAYER.run(scene).provenance["factors"] == {"earth_pressure": 1.5, "floor_friction": 0.5}
    plain = FittedShallowSolver("plain", 20.0, LAYER.settings)
    assert plain.config(scene) == ShallowSolver("plain", 20.0, LAYER.settings).config(scene)
    assert plain.identity() != LAYER.identity()


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("a: [1", "is not YAML"),
        ("name: a scene", "is no fitted solver"),
        ("{cells: 5, mpm: {}, shallow: {}, factors: {}, range: {}, fitted: {}}", "is no fitted solver"),
        ("{cells: 5, shallow: {rain: -1}, factors: {}, range: {}, fitted: {}}", "rain must be a finite number"),
        ("{cells: -1, mpm: {}, factors: {}, range: {}, fitted: {}}", "cells must be a finite number above 0"),
        ("{cells: 5, mpm: {}, factors: {}, range: {}, fitted: {}}", "missing key"),
    ],
)
def test_a_file_of_something_else_is_refused(tmp_path: Path, text: str, sentence: str) -> None:
    (tmp_path / "x.yaml").write_text(text)
    with pytest.raises(InputError, match=sentence):
        gns_pl.load_solver(tmp_path / "x.yaml")
    with pytest.raises(InputError, match="cannot be read"):
        gns_pl.load_solver(tmp_path / "none.yaml")
    with pytest.raises(InputError, match="factors: cohesion must be a finite number above 0"):
        MPMFactors(cohesion=0.0)
