"""The fit of a coarse solver finds factors that were hidden, goes on after a kill, and refuses what it cannot use."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from gns_pl.errors import InputError
from gns_pl.inverse import search as search_module
from gns_pl.inverse.fit_errors import Row
from gns_pl.inverse.observed import errors, observe
from gns_pl.inverse.scenes import short_scene
from gns_pl.inverse.search import Goal, Runs, search
from gns_pl.inverse.solver_fit import fit_solver
from gns_pl.io.tables import read_table
from gns_pl.scene import FACES, Body, Scene, Wall, write_scene
from gns_pl.solvers.fitted import Factors, FittedSolver
from gns_pl.solvers.fitted_files import read_fitted
from gns_pl.solvers.reduction import reduce_scene
from gns_pl.solvers.retuned import MPMFactors, RetunedMPMSolver
from gns_pl.solvers.shallow import FittedShallowSolver, ShallowFactors
from tests.commands.in_process import call
from tests.conftest import SAND
from tests.solvers.test_selection import MPM, column

BOUNDS = {name: [0.3, 3.0] for name in vars(MPMFactors())}
RETUNED = RetunedMPMSolver("mine", 5.0, MPM)
HIDDEN = MPMFactors(wall_friction=0.75, internal_friction=0.9, cohesion=0.6, damping_rate=0.5)
MOVES = ((0.1, 0.0), (0.2, 0.05))
SCENES = [column(ratio).replace(name=f"column_{ratio:g}", duration=0.8) for ratio in (0.6, 1.0, 1.8)]


def goal(scenes: Sequence[Scene], solver: FittedSolver = RETUNED, hidden: Factors = HIDDEN) -> Goal:
    """Slices of columns, the references made by the very solver with hidden factors."""
    own = replace(solver, factors=hidden)
    references = [observe(own.run(scene, interval=0.05, seed=n)) for n, scene in enumerate(scenes)]
    return Goal(solver, scenes, references, np.array([1.0, 1.0, 2.0]), 0.05)


def misfit(goal: Goal, factors: Factors) -> float:
    return float(((goal.weights * goal.errors(factors)) ** 2).sum())


def test_hidden_factors_are_found(tmp_path: Path) -> None:
    wanted = goal(SCENES)
    assert misfit(wanted, HIDDEN) == 0.0
    found = search(wanted, BOUNDS, difference=0.05, budget=50, runs=Runs(tmp_path / "runs.json", "id"))
    assert misfit(wanted, found) < 0.02 * misfit(wanted, MPMFactors())
    assert isinstance(found, MPMFactors) and found.wall_friction == pytest.approx(0.75, rel=0.1)
    assert found.internal_friction == pytest.approx(0.9, rel=0.1)


def test_hidden_factors_of_a_layer_are_found(tmp_path: Path) -> None:
    hidden = ShallowFactors(earth_pressure=1.3, floor_friction=0.8)
    wanted = goal(SCENES, FittedShallowSolver("layer", 15.0, {"earth_pressure": "at_rest"}), hidden)
    bounds = {name: [0.3, 3.0] for name in vars(hidden)}
    found = search(wanted, bounds, difference=0.05, budget=40, runs=Runs(tmp_path / "runs.json", "id"))
    assert vars(found) == pytest.approx(vars(hidden), rel=0.03)


def test_a_killed_fit_goes_on_to_the_same_factors(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    wanted, how = goal(SCENES[:2]), {"difference": 0.05, "budget": 15}
    whole = search(wanted, BOUNDS, runs=Runs(tmp_path / "whole.json", "id"), **how)  # type: ignore[arg-type]
    count, add = [0], Runs.add

    def killed(self: Runs, factors: tuple[float, ...], values: Any) -> None:
        add(self, factors, values)
        count[0] += 1
        if count[0] == 7:
            raise KeyboardInterrupt

    monkeypatch.setattr(search_module.Runs, "add", killed)
    with pytest.raises(KeyboardInterrupt):
        search(wanted, BOUNDS, runs=Runs(tmp_path / "parts.json", "id"), **how)  # type: ignore[arg-type]
    assert search(wanted, BOUNDS, runs=Runs(tmp_path / "parts.json", "id"), **how) == whole  # type: ignore[arg-type]
    assert (tmp_path / "parts.json").read_text() == (tmp_path / "whole.json").read_text()
    assert count[0] == len(Runs(tmp_path / "whole.json", "id").errors), "no run is made twice"
    with pytest.raises(InputError, match="holds runs of other scenes, settings or version; remove it"):
        Runs(tmp_path / "parts.json", "another")


def test_a_fit_writes_a_solver_and_its_errors(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    how: dict[str, Any] = {"bounds": BOUNDS, "difference": 0.05, "budget": 15}
    path = fit_solver(goal, SCENES[::2], SCENES[1:2], out=tmp_path, name="mine", fitted={"fine": "hidden"}, **how)
    solver, rows = read_fitted(path), read_table(tmp_path / "mine.csv", Row, "?")
    assert solver.name == "mine" and solver.factors != MPMFactors()
    assert [(row.scene, row.held_out) for row in rows] == [("column_0.6", 0), ("column_1.8", 0), ("column_1", 1)]
    assert all(abs(row.front_after) < abs(row.front_before) for row in rows)
    fitted = yaml.safe_load(path.read_text())["fitted"]
    assert fitted["fine"] == "hidden" and fitted["scenes"] == ["column_0.6", "column_1.8"]
    assert fitted["errors"]["held_out"]["front"] == pytest.approx(
        [abs(rows[2].front_before), abs(rows[2].front_after)], rel=1e-2
    )
    out = capsys.readouterr().out
    assert "| column_1, held out | " in out and "| **rms, fitted** | " in out and f"solver={path}" in out
    assert solver.out_of_range_reason(SCENES[1]) is None
    assert "aspect ratios of 0.6 to 1.8" in str(solver.out_of_range_reason(column(3.0)))


def test_a_fit_may_begin_with_the_factors_of_another_one(tmp_path: Path) -> None:
    """The errors before are those of factors of 1 all the same."""
    begun = partial(goal, solver=replace(RETUNED, factors=HIDDEN))
    how: dict[str, Any] = {"bounds": BOUNDS, "difference": 0.05, "budget": 5}
    path = fit_solver(begun, SCENES[:1], out=tmp_path, name="mine", fitted={}, **how)
    (row,) = read_table(tmp_path / "mine.csv", Row, "?")
    assert (row.front_after, row.height_after, row.map_after) == (0.0, 0.0, 0.0) and abs(row.front_before) > 0.01
    assert read_fitted(path).factors == HIDDEN
    assert yaml.safe_load(path.read_text())["fitted"]["start"] == vars(HIDDEN)


def test_a_run_that_becomes_unstable_is_a_bad_one_and_no_end() -> None:
    wanted = goal(SCENES[:1])
    settings = {**MPM, "courant": 30.0, "allow_large_courant": True, "damping_rate": 0.0}
    found = replace(wanted, solver=replace(wanted.solver, settings=settings)).errors(MPMFactors())
    assert (found == search_module.FAILED).all()


@pytest.mark.parametrize(
    "bounds",
    [{}, {**BOUNDS, "cohesion": [2.0, 1.0]}, {**BOUNDS, "cohesion": [0.0, 1.0]}, {**BOUNDS, "cohesion": [0.1, 0.5]}],
)
def test_bounds_that_hold_nothing_are_refused(bounds: Mapping[str, Sequence[float]], tmp_path: Path) -> None:
    with pytest.raises(InputError, match="bounds: "):
        search(goal([]), bounds, difference=0.1, budget=5, runs=Runs(tmp_path / "runs.json", "id"))


def test_the_command_fits_scenes_of_ones_own(tmp_path: Path) -> None:
    """As anybody types it for his own walls and sand; typed again it makes nothing new."""
    for scene in SCENES[:2]:
        write_scene(scene.replace(duration=0.3), tmp_path / f"{scene.name}.yaml")
    typed = ("name=mine", "scene=[column_0.6.yaml,column_1.yaml]", "held_out=[column_1]", "cells=4", "budget=5")
    told = call(tmp_path, "fit.py", *typed, "fine.cells_per_metre=24", "cache=cache")
    assert told.returncode == 0, told.stderr
    assert "run 5 of about 5: front" in told.stdout and "| column_1, held out | " in told.stdout
    solver = read_fitted(tmp_path / "runs/mine/mine.yaml")
    assert solver.cells == 4.0 and solver.settings["precision"] == "float32"
    again = call(tmp_path, "fit.py", *typed, "fine.cells_per_metre=24", "cache=cache")
    assert "run 1" not in again.stdout and read_fitted(tmp_path / "runs/mine/mine.yaml") == solver
    other = call(tmp_path, "fit.py", *typed, "fine.cells_per_metre=24", "cache=cache", "seed=3")
    assert other.returncode == 2 and "holds runs of other scenes, settings or version" in other.stderr
    assert yaml.safe_load((tmp_path / "runs/mine/mine.yaml").read_text())["fitted"]["fine"]["cells_per_metre"] == 24
    ran = call(tmp_path, "simulate.py", "solver=runs/mine/mine.yaml", "scene=column_1.yaml")
    assert ran.returncode == 0 and "chosen: mine, as asked for" in ran.stdout, ran.stderr


def test_the_command_fits_a_layer_to_what_it_can_run(tmp_path: Path) -> None:
    flying = SCENES[0].replace(name="flying", bodies=(Body((0, 0, 0.2), (0.3, 0.5, 0.18), (0, 0, 0)),))
    for scene in (SCENES[0], flying):
        write_scene(scene.replace(duration=0.3), tmp_path / f"{scene.name}.yaml")
    typed = ("solver=shallow-k0", "name=layer", "scene=[column_0.6.yaml,flying.yaml]", "held_out=[]", "cells=10")
    told = call(tmp_path, "fit.py", *typed, "budget=3", "fine.cells_per_metre=12", "cache=cache")
    assert told.returncode == 0, told.stderr
    assert "flying: left out; depth-averaged flow cannot fall" in told.stdout
    solver = read_fitted(tmp_path / "runs/layer/layer.yaml")
    assert isinstance(solver, FittedShallowSolver) and solver.settings == {"earth_pressure": "at_rest"}
    assert solver.cells == 10.0 and solver.factors != ShallowFactors()
    other = call(tmp_path, "fit.py", "start=runs/layer/layer.yaml", "scene=column_0.6.yaml", "held_out=[]")
    assert other.returncode == 2 and "layer.yaml is a fit of shallow, not of mpm" in other.stderr


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("held_out=[colum]",), "held_out: there is no scene colum"),
        (("solver=shalow",), "solver: shalow cannot be fitted (did you mean shallow?)"),
        (("weights.fron=1",), "did you mean weights.front?"),
        (("choice.mpm.courant=2",), "courant 2 is above the limit"),
        (("scene=nowhere.yaml",), "nowhere.yaml: cannot be read"),
        (("+scenes.mine={domain:[1,1,1]}",), "scenes.mine: needs domain and bodies"),
        (("fine.cells_per_metre=0",), "cells_per_metre must be"),
    ],
)
def test_what_cannot_be_fitted_is_refused(tmp_path: Path, arguments: tuple[str, ...], sentence: str) -> None:
    told = call(tmp_path, "fit.py", *arguments)
    assert told.returncode == 2 and sentence in told.stderr, told.stderr
    assert not list(tmp_path.iterdir())


def test_a_short_scene_is_the_scene() -> None:
    parts = {"domain": [1.5, 0.5, 0.9], "bodies": [{"size": [0.3, 0.5, 0.6]}]}
    walls = {face: vars(wall) for face, wall in column().walls.items()}
    common: dict[str, Any] = {"material": vars(SAND), "walls": walls, "gravity": 9.81, "duration_tau": 6.0}
    scene = short_scene("column", parts, **common)
    assert scene.replace(duration=0.2) == column(2.0).replace(name="column")
    assert scene.duration == pytest.approx(6 * np.sqrt(0.6 / 9.81))
    slope = short_scene("slope", {**parts, "slope_deg": 30}, **common)
    np.testing.assert_allclose(slope.gravity, [9.81 / 2, 0.0, -9.81 * np.sqrt(0.75)])
    barrier = {"kind": "box", "position": [1, 0, 0], "size": [0.1, 0.5, 0.1]}
    (box,) = short_scene("barrier", {**parts, "obstacles": [barrier]}, **common).obstacles
    assert box.wall == scene.walls["z-"]
    rough = {face: {"condition": "friction", "friction": 0.385} for face in FACES[3]}
    smooth = {face: {"condition": "slip"} for face in ("y-", "y+")}
    plane = short_scene("plane", {**parts, "walls": smooth}, **{**common, "walls": rough})
    assert reduce_scene(plane).across == 1 and plane.walls["z-"].friction == 0.385


def test_errors_have_a_closed_form() -> None:
    """Of a column in plane strain that is moved as a whole, measured on its slice."""
    scene = column().replace(walls=dict.fromkeys(FACES[3], Wall("slip")), duration=0.01)
    start = RetunedMPMSolver("mine", 5.0, MPM).run(scene, interval=0.01)
    moved = [replace(start, position=start.position[:1] + np.float32([[[0, 0, 0]], [[x, 0, z]]])) for x, z in MOVES]
    once, twice = map(observe, moved)
    assert once.front == pytest.approx(0.1, rel=1e-4) and once.volumes.ndim == 1
    assert once.volumes.sum() == pytest.approx(0.3 * 0.3, rel=1e-5)
    front, height, misplaced = errors(twice, once)
    assert front == pytest.approx(1.0, rel=1e-3) and height == pytest.approx(0.05 / once.height, rel=1e-3)
    assert misplaced == pytest.approx(0.1 / 0.3, rel=0.02)
