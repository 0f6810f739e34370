"""Retuned MPM is MPM of a changed scene, knows the range it was fitted to, and comes back from its file."""

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
from gns_pl.scene import FACES, Body, Box, Scene, Wall
from gns_pl.solvers import recording
from gns_pl.solvers.fitted_files import write_fitted
from gns_pl.solvers.fitted_range import range_of
from gns_pl.solvers.mpm import MPMSolver
from gns_pl.solvers.retuned import MPMFactors, RetunedMPMSolver
from gns_pl.solvers.selection import Record
from gns_pl.solvers.simulate import simulate, simulate_by_choice
from tests.solvers.test_selection import MPM, ROUGH, column, record

FACTORS = MPMFactors(wall_friction=0.8, internal_friction=0.9, cohesion=0.5, damping_rate=0.25)


def retuned(factors: MPMFactors = FACTORS, **changes: object) -> RetunedMPMSolver:
    return replace(RetunedMPMSolver("mine", 5.0, MPM, factors=factors), **changes)  # type: ignore[arg-type]


def by_hand(scene: Scene) -> Scene:
    """The scene with the factors multiplied in, without the code that is tested."""
    wall = Wall("friction", 0.8 * 0.385)
    sand = replace(
        scene.materials["sand"],
        friction_angle_deg=math.degrees(math.atan(0.9 * math.tan(math.radians(30)))),
        cohesion=0.5 * scene.materials["sand"].cohesion,
    )
    walls = {face: wall if each.condition == "friction" else each for face, each in scene.walls.items()}
    obstacles = tuple(replace(each, wall=wall) for each in scene.obstacles)
    return scene.replace(walls=walls, materials={"sand": sand}, obstacles=obstacles)


@pytest.mark.parametrize("kind", ["slice", "half", "whole", "obstacle"])
def test_it_is_mpm_whose_settings_are_changed_by_hand(kind: str) -> None:
    scene = column(sides=Wall("slip") if kind == "slice" else ROUGH)
    if kind == "whole":
        scene = scene.replace(bodies=(Body((0, 0, 0), (0.3, 0.3, 0.3), (0, 0, 0)),))
    if kind == "obstacle":
        scene = scene.replace(obstacles=(Box((0.5, 0, 0), (0.1, 0.5, 0.1), ROUGH),))
    settings = {**MPM, "damping_rate": 0.25 * MPM["damping_rate"]}
    changed = MPMSolver("mpm", 5.0, settings).run(by_hand(scene), seed=3)
    run = retuned().run(scene, seed=3)
    np.testing.assert_array_equal(run.position, changed.position)
    assert run.scene == scene and not np.array_equal(
        run.position, MPMSolver("mpm", 5.0, MPM).run(scene, seed=3).position
    )
    assert {"slice": "plane strain", "whole": ""}.get(kind, "mirror") in retuned().reduced(scene).description


def test_factors_of_one_are_mpm() -> None:
    plain = MPMSolver("mpm", 5.0, MPM)
    np.testing.assert_array_equal(retuned(MPMFactors()).run(column()).position, plain.run(column()).position)
    assert len({plain.identity(), retuned().identity(), retuned(MPMFactors()).identity()}) == 3


def test_its_run_goes_on_after_a_kill(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    scene, append, count = column(sides=ROUGH), recording.Recording.append, [0]
    monkeypatch.setattr(recording, "SAVE_EVERY", 0.0)

    def broken(self: recording.Recording, position: np.ndarray) -> None:
        count[0] += 1
        if count[0] == 5:
            raise KeyboardInterrupt
        append(self, position)

    monkeypatch.setattr(recording.Recording, "append", broken)
    with pytest.raises(SystemExit, match="the same command goes on"):
        simulate(retuned(), [scene], out=tmp_path, interval=0.02)
    monkeypatch.setattr(recording.Recording, "append", append)
    (path,) = simulate(retuned(), [scene], out=tmp_path, interval=0.02)
    assert "goes on after" in capsys.readouterr().out
    written = read_trajectory(path)
    np.testing.assert_array_equal(written.position, retuned().run(scene, interval=0.02).position)
    assert written.scene == scene and written.provenance["factors"] == vars(FACTORS)
    with pytest.raises(InputError, match="of another scene, solver"):
        simulate(retuned(MPMFactors()), [scene], out=tmp_path, interval=0.02)


def test_a_file_gives_the_solver_back(tmp_path: Path) -> None:
    solver = retuned(fitted_range=range_of([column(0.5), column(2.0)]))
    write_fitted(tmp_path / "mine.yaml", solver, {"runs": 3})
    back = read_fitted(tmp_path / "mine.yaml")
    assert back == replace(solver, path=tmp_path / "mine.yaml") and back.identity() == solver.identity()
    assert gns_pl.load_solver(tmp_path / "mine.yaml").file() == tmp_path / "mine.yaml"


def test_what_is_outside_the_fitted_range_is_told() -> None:
    fitted = [column(0.5), column(2.0), column(1.0, obstacles=(Box((0.5, 0, 0), (0.1, 0.5, 0.1), ROUGH),))]
    solver = retuned(fitted_range=range_of(fitted))
    for scene in (*fitted, column(1.2)):
        assert solver.out_of_range_reason(scene) is None
    assert retuned().out_of_range_reason(column(3.0)) is None, "no range, nothing to tell"
    gravel = {"sand": replace(column().materials["sand"], friction_angle_deg=38.0)}
    moving = (replace(column().bodies[0], velocity=(1.0, 0.0, 0.0)),)
    reasons = {
        "aspect ratios of 0.5 to 2, here 3": column(3.0),
        "another material": column(materials=gravel),
        r"other walls \(friction 0.385 or slip, here stick\)": column(walls=dict.fromkeys(FACES[3], Wall("stick"))),
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
    write_fitted(tmp_path / "mine.yaml", retuned(fitted_range=range_of([rough])), {})
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


@pytest.mark.parametrize("name", retuned_names())
def test_each_that_ships_has_a_card_a_range_and_its_errors(name: str) -> None:
    solver = gns_pl.load_solver(name)
    assert isinstance(solver, RetunedMPMSolver) and solver.name == name and solver.group == "retuned"
    assert (FOLDER / f"{name}.md").read_text(encoding="utf-8").split("---\n", 2)[2].startswith(f"# {name}\n")
    assert solver.out_of_range_reason(column(1.0)) is not None, "slip side walls were not among the fitted"
    run = solver.run(column(1.0, sides=ROUGH))
    assert np.isfinite(run.position).all() and solver.cost(run.scene) < 1e8


def test_two_sizes_ship() -> None:
    assert retuned_names() == ["mpm-retuned-5", "mpm-retuned-7.6"]


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("a: [1", "is not YAML"),
        ("name: a scene", "is no retuned solver"),
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
