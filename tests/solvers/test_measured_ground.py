"""On a terrain an error is promised of scenes whose numbers lie among measured ones; of others it is unmeasured."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gns_pl.errors import InputError
from gns_pl.evaluation.chart.records import write_records
from gns_pl.scene import Box, Scene, Wall, make_release, read_scene
from gns_pl.solvers.catalogue import make_solvers
from gns_pl.solvers.measured_ground import ground_setup
from gns_pl.solvers.measured_range import setup_text, unmeasured_reasons
from gns_pl.solvers.selection import TERRAIN_ERRORS, WORSE, Record, choose, estimate, kind_of
from gns_pl.solvers.simulate import simulate_by_choice
from tests.solvers.test_selection import MPM

CHOICE: dict[str, Any] = {
    "cells": [5, 10], "mpm": MPM, "shallow": {"thin": {"cells": 20.0, "earth_pressure": "at_rest"}},
    "frame_interval": 0.05,
}  # fmt: skip


def material(scene: Scene, **changes: float) -> Scene:
    return scene.replace(materials={name: replace(each, **changes) for name, each in scene.materials.items()})


def scaled(scene: Scene, factor: float) -> Scene:
    """A scene of another size, everything else in proportion."""
    assert scene.terrain is not None
    (body,) = scene.bodies
    changes = {"corner": tuple(factor * low for low in scene.terrain.corner), "cell": factor * scene.terrain.cell}
    ground = scene.terrain.replace(heights=factor * scene.terrain.heights, **changes)
    outline = [[(factor * x, factor * y) for x, y in ring] for ring in body.outline]  # type: ignore[attr-defined]
    lower, upper = (tuple(factor * value for value in corner) for corner in (scene.lower, scene.upper))
    return material(scene, youngs_modulus=factor * 3e5).replace(
        lower=lower, upper=upper, terrain=ground, duration=factor**0.5 * scene.duration,
        bodies=(make_release(ground, outline=outline, thickness=factor * body.height),),
    )  # fmt: skip


def record(solver: str, scene: Scene, error: float, seconds: float, kind: str = "terrain") -> Record:
    return Record(
        solver, kind, scene.name, error, 0.0, 0.0, 0.0, seconds, 1e6, 100, 1, "here", setup=setup_text(scene),
        map_error=error / 2,
    )  # fmt: skip


def measured(*names: str) -> list[Record]:
    errors = {"thin": (0.15, 0.1), "mpm_5": (0.2, 1.0), "mpm_10": (0.04, 9.0)}
    return [
        record(solver, read_scene(name), error * (1 + 0.1 * number), seconds)
        for number, name in enumerate(names)
        for solver, (error, seconds) in errors.items()
    ]


def test_the_numbers_of_a_scene_are_those_of_its_file() -> None:
    scene = read_scene("runout")
    setup = ground_setup(scene)
    assert kind_of(scene) == "terrain" and setup["bodies"] == "1 release, at rest"
    assert setup["ground_slope"] == pytest.approx(30.0, abs=0.01) and setup["ground_friction"] == 0.35
    assert setup["release_ratio"] == pytest.approx(0.44) and setup["friction_angle"] == 30.0
    # An arc from tan 30° to 0 over 0.4 m, in units of √(0.5 · 0.22) m.
    assert setup["ground_bend"] == pytest.approx(np.tan(np.radians(30)) / 0.4 * np.sqrt(0.11), rel=0.15)
    large = ground_setup(scaled(scene, 100.0))
    for key, value in setup.items():
        if key != "release_size":
            assert large[key] == (value if isinstance(value, str) else pytest.approx(value, rel=1e-6, abs=1e-9)), key
    assert large["release_size"] == pytest.approx(100 * float(setup["release_size"]))


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda scene: scene, None),
        (lambda scene: scaled(scene, 1.3), None),
        (lambda scene: material(scene, friction_angle_deg=31.0, youngs_modulus=9e5), None),
        (lambda scene: scaled(scene, 20.0), "measured with √(L0 H0) 0.332 m, here 6.63"),
        (lambda scene: material(scene, friction_angle_deg=40.0), "measured with friction angle 30°, here 40"),
        (lambda scene: material(scene, youngs_modulus=1e5), "compression by own weight"),
        (lambda scene: material(scene, cohesion=500.0), "cohesion over ρ g H 0, here 0.129"),
        (lambda scene: scene.replace(terrain=scene.terrain.replace(wall=Wall("friction", 0.2))), "friction of the gr"),
        (lambda scene: scene.replace(terrain=scene.terrain.replace(wall=Wall("stick"))), "here stick"),
        (lambda scene: scene.replace(duration=0.5), "measured with duration 14.7"),
        (lambda scene: read_scene("runout", {"terrain.slope_deg": 40.0}), "slope of the ground under the release 30°"),
        (lambda scene: read_scene("runout", {"terrain.toe": [1.2, 0.2]}), "change of slope over √(L0 H0)"),
        (
            lambda scene: scene.replace(obstacles=(Box((2.0, 0.5, 0.0), (0.2, 0.2, 0.2), Wall("slip")),)),
            "measured with no obstacle, here 1 obstacle",
        ),
        (
            lambda scene: scene.replace(bodies=(replace(scene.bodies[0], velocity=(1.0, 0.0, 0.0)),)),
            "measured with 1 release, at rest, here 1 release, in motion",
        ),
    ],
)  # fmt: skip
def test_what_is_alike_and_what_is_not(change: Any, reason: str | None) -> None:
    scene = read_scene("runout")
    reasons = unmeasured_reasons(change(scene), [setup_text(scene)])
    assert reasons == [] if reason is None else reason in "; ".join(reasons)


def test_numbers_between_those_of_two_terrains_are_measured_ones() -> None:
    """The largest error on either counts, with the names of both."""
    gully = read_scene("gully")
    between = material(gully, friction_angle_deg=32.0)
    solvers = make_solvers(CHOICE)
    options = {each.solver.name: each for each in estimate(between, solvers, measured("runout", "gully"))}
    assert options["thin"].errors["front"] == pytest.approx(1.1 * 0.15) and options["thin"].unmeasured is None
    assert options["thin"].terrains == ("runout", "gully")
    chosen, why = choose(list(options.values()), 0.2)
    assert (
        chosen.solver.name == "thin"
        and "as measured on terrains (runout, gully) among whose numbers its own lie" in why
    )
    assert choose(list(options.values()), 0.1)[0].solver.name == "mpm_10"
    with pytest.raises(InputError, match=f"the smallest tolerance that can be met is {TERRAIN_ERRORS[WORSE]:g} "):
        choose(list(options.values()), 0.01)


def test_without_a_like_terrain_mpm_runs_it_without_a_promise() -> None:
    steep = read_scene("runout", {"terrain.slope_deg": 44.0})
    options = estimate(steep, make_solvers(CHOICE), measured("runout", "gully"))
    assert not any(option.errors for option in options)
    chosen, why = choose(options, 0.1)
    assert chosen.solver.name == "mpm_10" and "slope of the ground under the release" in why and "check=true" in why
    # A table from before there were scenes on terrain in it says nothing of them.
    column = read_scene("slope")
    old = [record("mpm_10", column, 0.03, 9.0, "space"), record("thin", column, 0.03, 0.1, "space")]
    chosen, why = choose(estimate(read_scene("runout"), make_solvers(CHOICE), old), 0.1)
    assert chosen.solver.name == "mpm_10" and "the error on this scene is unmeasured" in why


def test_what_a_cheaper_solver_leaves_out_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = tmp_path / "records.csv"
    write_records(table, measured("runout"))
    choice, scene = CHOICE | {"records": str(table)}, read_scene("runout")
    for tolerance in (0.2, 0.1):
        simulate_by_choice([scene], out=tmp_path, choice=choice, tolerance=tolerance, explain=True)  # runs nothing
    said = capsys.readouterr().out
    assert "runout: on a terrain, √(L0 H0) = 0.332 m" in said
    assert said.count("leaves out:") == 1
    assert "thin leaves out: motion within the layer and along the vertical, lift-off from the ground" in said
    assert "chosen: mpm_10, the cheapest of 1 that meet 10 %" in said
