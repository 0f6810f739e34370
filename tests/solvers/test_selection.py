"""Which solver is taken for a scene, and why another is not."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from gns_pl.errors import InputError
from gns_pl.io import read_trajectory
from gns_pl.machine import available_cores
from gns_pl.models.checkpoint import Checkpoint, save_checkpoint
from gns_pl.presets import preset
from gns_pl.scene import FACES, Body, Plane, Scene, Wall, column_collapse, read_scene
from gns_pl.solvers.catalogue import make_solvers
from gns_pl.solvers.hybrid import HybridSolver
from gns_pl.solvers.learned import LearnedSolver
from gns_pl.solvers.measured_range import setup_text
from gns_pl.solvers.mpm import MPMSolver
from gns_pl.solvers.selection import RECORDS, Record, choose, estimate, kind_of, read_records, table
from gns_pl.solvers.simulate import simulate_by_choice
from gns_pl.solvers.solver import characteristic_size
from tests.conftest import MPM as mpm_settings
from tests.conftest import SAND, make_simulator

ROUGH, SLIP = Wall("friction", 0.385), Wall("slip")
MPM = {**mpm_settings, "precision": "float32"}
DATA = {
    "gravity": 9.81,
    "material": {
        "density": 1800,
        "youngs_modulus": 2e6,
        "poisson_ratio": 0.3,
        "friction_angle_deg": 30,
        "cohesion": 100,
    },
    "walls": {face: {"condition": "friction", "friction": 0.385} for face in FACES[2]},
    "families": {
        "low": {"kind": "column_collapse", "length": [0.2, 0.5], "aspect_ratio": [0.5, 1.0]},
        "high": {"kind": "column_collapse", "length": [0.2, 0.3], "aspect_ratio": [2.0, 3.0]},
        "drop": {"kind": "cube_drop", "side": [0.2, 0.3], "speed": 1.0, "max_drop": 0.2},
    },
}


def column(ratio: float = 1.0, sides: Wall = SLIP, **changes: object) -> Scene:
    """A column of the data's sand."""
    walls = dict.fromkeys(FACES[3], ROUGH) | {"y-": sides, "y+": sides}
    scene = column_collapse(
        domain=(1.5, 0.5, 0.9), length=0.3, height=0.3 * ratio, gravity=9.81, duration=0.2, material=SAND, walls=walls
    )
    return scene.replace(**changes)


@pytest.fixture
def learned(tmp_path: Path) -> LearnedSolver:
    simulator = make_simulator(dim=2, spacing=0.05, connectivity_radius=0.1, latent_size=16)
    path = tmp_path / "flat.ckpt"
    save_checkpoint(path, Checkpoint(simulator, DATA, {}))
    return LearnedSolver("flat", path)


def record(solver: str, kind: str, error: float, seconds: float, work: float = 1e6) -> Record:
    """A measured run of `column`, between smooth or rough side walls."""
    setup = setup_text(column(sides=SLIP if kind == "plane" else ROUGH))
    return Record(solver, kind, "column", error, 0.0, 0.0, 0.0, seconds, work, 100, 1, "somewhere", setup=setup)


def test_a_scene_like_the_data_is_trusted_in_its_slice(learned: LearnedSolver) -> None:
    scene = column(1.5)
    assert kind_of(scene) == "plane" and learned.unsupported_reason(scene) is None
    assert learned.reduced(scene).scene.dim == 2
    made = learned.run(scene, interval=0.004, seed=0)
    assert made.scene == scene and made.num_frames == 51
    assert made.mass.sum() == pytest.approx(1800 * 0.3 * 0.5 * 0.45, rel=1e-5)


def test_a_run_that_stops_being_finite_ends_there(learned: LearnedSolver) -> None:
    torch.nn.init.constant_(learned.checkpoint.simulator.network.decoder[-1].bias, 1e30)
    made = learned.run(column(), interval=0.004, seed=0)
    assert "failed_at" in made.provenance and made.num_frames < 51
    with pytest.raises(InputError, match="not in plane strain"):
        learned.reduced(column(sides=ROUGH))


@pytest.mark.parametrize(
    ("scene", "reason"),
    [
        (column(sides=ROUGH), "runs plane strain only, and the scene is not: wall y- is not slip"),
        (
            column(3.0, walls=column().walls | {"z-": Wall("friction", 0.2)}),
            "trained with other walls (z-: friction 0.385, here friction 0.2)",
        ),
        (column(3.0, gravity=(0, 0, -1.62)), "gravity of 9.81"),
        (column(0.3), "aspect ratios from 0.5 to 3, not 0.3"),
        (column(bodies=(Body((0, 0, 0), (0.8, 0.5, 0.8), (0, 0, 0)),)), "lengths from 0.2 to 0.5 m"),
        (column(bodies=(Body((0, 0, 0), (0.3, 0.5, 0.3), (9, 0, 0)),)), "initial speeds up to 1 m/s"),
        (column(bodies=(Body((0, 0, 0.5), (0.3, 0.5, 0.3), (0, 0, 0)),)), "drops up to 0.2 m"),
        (column(obstacles=(Plane((1, 0, 0), (-1, 0, 1), ROUGH),)), "knows no obstacles"),
        (column(materials={"sand": SAND.__class__(**{**vars(SAND), "density": 2000})}), "trained on another material"),
        (
            column(materials={"sand": SAND.__class__(**{**vars(SAND), "friction_angle_deg": 40})}),
            "trained on another material",
        ),
        (
            column(bodies=(Body((0, 0, 0), (0.3, 0.5, 0.3), (0, 0, 0)), Body((1, 0, 0), (0.3, 0.5, 0.3), (0, 0, 0)))),
            "trained on single bodies",
        ),
    ],
)
def test_a_scene_outside_the_data_is_refused_with_the_reason(scene: Scene, reason: str, learned: LearnedSolver) -> None:
    assert reason in str(learned.unsupported_reason(scene) or learned.out_of_range_reason(scene))


def test_the_friction_angle_may_lie_in_the_range_of_the_data(learned: LearnedSolver, tmp_path: Path) -> None:
    families = {name: {**each, "friction_angle_deg": [20, 45]} for name, each in DATA["families"].items()}
    save_checkpoint(
        tmp_path / "flat.ckpt", Checkpoint(learned.checkpoint.simulator, {**DATA, "families": families}, {})
    )
    several = LearnedSolver("flat", tmp_path / "flat.ckpt")
    for angle, reason in ((40, None), (50, "friction angles of 20 to 45")):
        sand = SAND.__class__(**{**vars(SAND), "friction_angle_deg": angle})
        found = several.out_of_range_reason(column(materials={"sand": sand}))
        assert found is None if reason is None else reason in str(found)


def test_mpm_runs_the_slice_and_its_cells_grow_with_the_bodies() -> None:
    solver = MPMSolver("mpm", 6.0, MPM)
    scene = column(1.0)
    assert characteristic_size(scene) == pytest.approx(0.3)
    assert solver.settings_of(scene)["cell_size"] == pytest.approx(0.05)
    made = solver.run(scene, interval=0.02, seed=0)
    points, _ = solver.size(scene)
    assert points == 144 and made.num_particles == 144 * 20
    assert solver.cost(scene) == math.prod(solver.size(scene))
    whole = MPMSolver("mpm", 6.0, MPM, reduces=False)
    assert whole.size(scene)[0] == 144 * 20


def test_the_cheapest_that_is_accurate_enough(learned: LearnedSolver) -> None:
    scene = column()
    solvers = [learned, MPMSolver("coarse", 5, MPM), MPMSolver("fine", 20, MPM)]
    work = {solver.name: solver.cost(scene) for solver in solvers}
    records = [
        record("flat", "plane", -0.04, 0.2, work["flat"]),
        record("flat", "plane", 0.02, 0.2, work["flat"]),
        record("coarse", "plane", -0.3, 0.1, work["coarse"]),
        record("fine", "plane", 0.01, 3.0, work["fine"]),
        record("fine", "space", 0.01, 9.0, work["fine"]),
    ]
    options = estimate(scene, solvers, records)
    assert [each.solver.name for each in options] == ["coarse", "flat", "fine"]
    assert [each.error for each in options] == [0.3, 0.04, 0.03]
    for tolerance, name, words in (
        (0.05, "flat", "cheapest of 2"),
        (0.03, "fine", "of 1"),
    ):
        chosen, why = choose(options, tolerance)
        assert chosen.solver.name == name and words in why
    assert "30.0 %" in table(options, scene)
    with pytest.raises(InputError, match=r"tolerance=0\.001: .* the smallest tolerance that can be met is 0\.03 "):
        choose(options, 0.001)
    twice = [*records, Record(**{**vars(records[3]), "threads": 2, "seconds": 1.0, "runout_error": 0.02})]
    [fine] = [each for each in estimate(scene, solvers, twice) if each.solver.name == "fine"]
    assert fine.error == 0.03 and fine.seconds == pytest.approx(3.0 if available_cores() == 1 else 1.0)
    options = estimate(column(sides=ROUGH), solvers, records)
    chosen, why = choose(options, 0.5)
    assert chosen.solver.name == "fine" and "outside the range of every learned solver" in why
    assert "not: runs plane strain only" in table(options, column(sides=ROUGH))
    assert f"{'coarse':24} not: was not measured" in table(options, column(sides=ROUGH))
    with pytest.raises(InputError, match="tolerance must be positive"):
        choose(options, 0.0)
    with pytest.raises(InputError, match="no solver was measured"):
        choose(estimate(scene, solvers, []), 0.1)


def test_a_tolerance_is_of_one_quantity(learned: LearnedSolver) -> None:
    """One that has the front alone is promised for the front alone; the worst of several runs counts in each."""
    scene = column()
    solvers = [learned, MPMSolver("coarse", 5, MPM), MPMSolver("fine", 20, MPM)]
    seconds = {"flat": 0.1, "coarse": 0.2, "fine": 0.3}
    work = {solver.name: solver.cost(scene) for solver in solvers}
    errors = {"flat": (-0.04, 0.2, 0.09), "coarse": (0.3, 0.05, -0.3), "fine": (0.01, 0.01, 0.05)}
    records = [
        replace(
            record(name, "plane", part * front, seconds[name], work[name]),
            map_error=misplaced,
            height_error=part * height,
        )
        for name, (front, misplaced, height) in errors.items()
        for part in (0.5, 1.0)
    ]
    options = estimate(scene, solvers, records)
    assert {option.solver.name: dict(option.errors) for option in options} == {
        "flat": {"front": 0.04, "map": 0.2, "height": 0.09, "worse": 0.2},
        "coarse": {"front": 0.3, "map": 0.05, "height": 0.3, "worse": 0.3},
        "fine": {"front": 0.03, "map": 0.02, "height": 0.05, "worse": 0.03},  # the reference is not better
    }
    row = next(line for line in table(options, scene).splitlines() if line.startswith("flat"))
    assert row.split()[-8:-2] == ["4.0", "%", "20.0", "%", "9.0", "%"]
    for of, tolerance, name, words in (
        (
            "front",
            0.05,
            "flat",
            "of 2 that meet 5 % in the front; without a promise: up to 20.0 % in the map and 9.0 %",
        ),
        (
            "map",
            0.05,
            "coarse",
            "of 2 that meet 5 % in the map; without a promise: up to 30.0 % in the front and 30.0 %",
        ),
        ("height", 0.1, "flat", "of 2 that meet 10 % in the mean height; without a promise: up to 4.0 % in the front"),
        ("height", 0.05, "fine", "of 1 that meet 5 % in the mean height; "),
        ("worse", 0.05, "fine", "of 1 that meet 5 % in the worse of front and map; without a promise: up to 5.0 % in"),
    ):
        chosen, why = choose(options, tolerance, of)
        assert chosen.solver.name == name and f"the cheapest {words}" in why
    for of, least in (("front", "0.03"), ("map", "0.02"), ("height", "0.05"), ("worse", "0.03")):
        words = {"height": "mean height", "worse": "worse of front and map"}.get(of, of)
        with pytest.raises(InputError, match=rf"by more in the {words} on .* can be met is {least} \(by fine\)"):
            choose(options, 0.01, of)
    with pytest.raises(InputError, match=r"one of front, map, height, worse, not 'hight' \(did you mean height\?\)"):
        choose(options, 0.1, "hight")
    # Where only some were measured by their map, the others are left out; where the map was measured elsewhere, nobody
    # knows it here.
    bare = [replace(each, map_error=math.nan) if each.solver == "coarse" else each for each in records]
    options = estimate(scene, solvers, bare)
    assert choose(options, 0.1, "map")[0].solver.name == "fine" and "    –" in table(options, scene)
    elsewhere = [replace(each, setup=setup_text(column(duration=9.0, gravity=(1.0, 0.0, -9.0)))) for each in records]
    options = estimate(scene, solvers, [*(replace(each, map_error=math.nan) for each in records), *elsewhere])
    assert "on scenes like this one nobody measured the map" in choose(options, 0.5, "map")[1]


def test_the_chosen_way_is_run_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    measured = tmp_path / "records.csv"
    measured.write_text(
        "solver,kind,scene,runout_error,curve_error,height_error,profile_error,seconds,work,particles,threads,device,setup\n"
        'mpm_5,plane,c,0.1,0,0,0,1.0,1000000,100,1,here,"' + setup_text(column()).replace('"', '""') + '"\n'
    )
    choice = {"cells": [5], "mpm": MPM, "frame_interval": 0.05, "records": str(measured)}
    settings = {"choice": choice}
    out = tmp_path / "out"
    (path,) = simulate_by_choice([column()], out=out, tolerance=0.2, **settings)
    made = read_trajectory(path)
    assert made.scene == column() and made.num_frames == 5 and made.provenance["solver"] == "mpm_5"
    said = capsys.readouterr().out
    assert (
        "in plane strain" in said
        and "chosen: mpm_5, the cheapest of 1 that meet 20 % in the worse of front and map; without" in said
    )
    assert "up to 3.5 % in the mean height, on scenes like this one; plane strain" in said
    assert "here, 1 threads" in said
    assert made.provenance["choice"] == {"tolerance": 0.2, "of": "worse", "expected_error": 0.1}
    simulate_by_choice([column()], out=out, tolerance=0.2, **settings)
    assert "already complete" in capsys.readouterr().out
    simulate_by_choice([column()], out=out, tolerance=0.3, tolerance_of="height", **settings)
    again = read_trajectory(path)
    assert again.provenance["choice"] == {"tolerance": 0.3, "of": "height", "expected_error": 0.035}
    np.testing.assert_array_equal(again.position, made.position)
    with pytest.raises(InputError, match="tolerance_of=map: the table of measured runs does not say"):
        simulate_by_choice([column()], out=out, tolerance=0.2, tolerance_of="map", **settings)
    with pytest.raises(InputError, match="of another scene, solver or checkpoint, settings"):
        simulate_by_choice([column(1.2)], out=out, tolerance=0.2, **settings)
    with pytest.raises(InputError, match="frame interval"):
        simulate_by_choice([column()], out=out, tolerance=0.2, choice=choice | {"frame_interval": 0.1})
    with pytest.raises(InputError, match="two scenes have the same name"):
        simulate_by_choice([column(), column()], out=out, tolerance=0.2, **settings)
    assert simulate_by_choice([column()], out=tmp_path / "none", tolerance=None, explain=True, **settings) == []
    assert not (tmp_path / "none").exists()


def test_on_terrain_the_learned_one_is_among_the_choices() -> None:
    """With the sand of its data; what is promised of it is the largest error on all terrains that were measured."""
    scene = read_scene("runout")
    solvers, records = make_solvers(preset("choice/default")), read_records(RECORDS)
    own = {option.solver.name: option for option in estimate(scene, solvers, records)}
    assert own["ground"].reason == "trained on another material" and own["mpm_5.09"].errors
    sand = scene.replace(materials=read_scene("barrier").materials)
    options = estimate(sand, solvers, records)
    known = {option.solver.name: option for option in options if option.reason is None}
    assert {"ground", "shallow", "mpm_5.09", "mpm_7.64"} <= set(known)
    measured = [record for record in records if record.solver == "ground" and record.kind == "terrain"]
    assert known["ground"].errors["map"] == max(record.map_error for record in measured if record.map_error is not None)
    front = known["ground"].errors["front"]
    chosen, why = choose(options, front + 0.01, "front")
    assert chosen.solver.name == "ground" and "as measured on terrains (" in why
    assert choose(options, front - 0.01, "front")[0].solver.name != "ground"


def test_the_packages_records_are_of_its_ways() -> None:
    records = read_records(RECORDS)
    assert {each.kind for each in records} == {"plane", "space", "terrain"}
    assert {"collapse", "collapse_plane", "corrected_plane"} <= {each.solver for each in records}
    assert all(np.isfinite(each.runout_error) and each.seconds > 0 for each in records)
    with pytest.raises(InputError, match="is no table"):
        read_records(Path("nowhere.csv"))
    with pytest.raises(InputError, match=r"there is no checkpoint nothing\.ckpt"):
        make_solvers({"learned": ["nothing.ckpt"]})
    with pytest.raises(InputError, match=r"choice\.hybrid\.x: needs learned, until, not learned"):
        make_solvers({"hybrid": {"x": {"learned": "collapse_plane"}}})
    (solver,) = make_solvers({"hybrid": {"x": {"learned": "collapse_plane", "until": 1}}})
    assert isinstance(solver, HybridSolver) and solver.settings["cell_size"] == pytest.approx(1 / 16)
