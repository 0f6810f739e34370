"""Retuned MPM is MPM of a changed scene, and goes on where it was."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gns_pl.errors import InputError
from gns_pl.io import read_trajectory
from gns_pl.scene import Body, Box, Scene, Wall
from gns_pl.solvers import recording
from gns_pl.solvers.mpm import MPMSolver
from gns_pl.solvers.retuned import MPMFactors, RetunedMPMSolver
from gns_pl.solvers.simulate import simulate
from tests.solvers.test_selection import MPM, ROUGH, column

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
