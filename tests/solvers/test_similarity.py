"""Froude similarity: a scene of another size moves alike, so what learned in a box of one metre runs a hillside."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from gns_pl.io import read_trajectory
from gns_pl.metrics.release import front_advance
from gns_pl.mpm.settings import run_solver
from gns_pl.scene import FACES, Body, Box, Material, Scene, Wall, column_collapse, read_scene
from gns_pl.solvers.catalogue import load_solver
from gns_pl.solvers.similarity import Similarity, resized
from gns_pl.trajectory import Trajectory

SCENES = Path(__file__).parents[2] / "conf" / "scenes"
SAND = Material(density=1800, youngs_modulus=2e6, poisson_ratio=0.3, friction_angle_deg=30, cohesion=100)
ROUGH = Wall("friction", 0.385)
WIDE = 64.0


def column(length: float = 0.3, side: Wall = ROUGH) -> Scene:
    """A column as high as it is long, in a box that goes with it."""
    walls = dict.fromkeys(FACES[3], ROUGH) | {"y-": side, "y+": side}
    domain = (4 * length, 1.5 * length, 2 * length)
    duration = 3 * math.sqrt(length / 9.81)
    return column_collapse(
        domain=domain, length=length, height=length, gravity=9.81, duration=duration, material=SAND, walls=walls
    )


def alike(one: Trajectory, other: Trajectory, factor: float) -> None:
    """The first is the second, so many times as large, to the bit."""
    np.testing.assert_array_equal(one.position, other.position * np.float32(factor))
    assert one.dt == pytest.approx(other.dt * math.sqrt(factor), rel=1e-6)
    np.testing.assert_allclose(one.mass, other.mass * factor**3, rtol=1e-6)


def test_mpm_moves_a_similar_scene_alike() -> None:
    """The scaling is a law of the equations, not of a network: MPM, which has all of a material's numbers, keeps it."""
    block = Box((0.75, 0.0, 0.0), (0.08, 0.45, 0.08), ROUGH)
    body = Body((0.0, 0.0, 0.0), (0.3, 0.45, 0.3), (0.3, 0.0, 0.0))
    scene = column().replace(obstacles=(block,), bodies=(body,), duration=0.3)
    runs = []
    for each, factor in ((scene, 1.0), (resized(scene, WIDE), WIDE)):
        mpm = {
            "cell_size": factor / 12,
            "points_per_direction": 2,
            "courant": 0.3,
            "transfer": "affine_flip",
            "damping_rate": 20 / math.sqrt(factor),  # over a time
            "bulk_viscosity": 0.86,
            "jitter": 0.0,
        }
        runs.append(run_solver(each, mpm, frame_interval=each.duration / 10, seed=0))
    moved = np.abs(runs[0].position - runs[0].position[0]).max()
    assert moved > 0.1
    np.testing.assert_allclose(runs[1].position / WIDE, runs[0].position, atol=1e-3 * moved)


@pytest.mark.parametrize("name", ["barrier", "bowl"])
def test_a_scene_far_larger_than_the_data_is_run_at_their_size(name: str) -> None:
    """With its obstacles, mirrors, terrain and release; the file says so, in its own metres and seconds."""
    scene, solver = read_scene(SCENES / f"{name}.yaml"), load_solver("ground")
    scene = scene.replace(duration=0.4)
    wide = resized(scene, WIDE)
    similarity = solver.reduced(wide).similarity
    assert similarity.length > 1 and solver.reduced(scene).similarity.length == 1
    near = similarity.model(wide)
    assert solver.size(wide) == solver.size(near)
    run, small = solver.run(wide), solver.run(near)
    alike(run, small, similarity.length)
    assert run.scene == wide and run.provenance["length_scale"] == similarity.length
    alike(solver.run(wide, interval=0.05 * similarity.time), solver.run(near, interval=0.05), similarity.length)


def test_a_file_is_gone_on_with_to_the_same_bits(tmp_path: Path) -> None:
    """Frames are read back as they were run; times of the file are the scene's."""
    scene = resized(column(), WIDE)
    solver, path = load_solver("ground"), tmp_path / "run.h5"
    for share in (0.4, 1.0):
        short = scene.replace(duration=share * scene.duration)
        solver.record([short], [path], interval=1.0, seed=0, monitor=True)
    whole, run = read_trajectory(path), solver.run(scene)
    np.testing.assert_array_equal(whole.position, run.position)
    assert whole.dt == pytest.approx(run.dt) and whole.scene == scene
    assert whole.provenance["length_scale"] == solver.reduced(scene).similarity.length


def test_a_small_heap_is_as_finely_resolved_as_the_largest_of_the_data() -> None:
    """A column of 3 cm would be a single particle."""
    solver, scene = load_solver("column-fast"), column(0.03)
    assert solver.reduced(scene).similarity.length == 1 / 16
    run, near = solver.run(scene), solver.run(resized(scene, 16.0))
    alike(run, near, 1 / 16)
    assert run.num_particles > 1000
    assert float(front_advance(run)[-1]) == pytest.approx(float(front_advance(near)[-1]) / 16)


def test_a_slice_of_another_size_is_lifted_and_flattened() -> None:
    """What is looked at afterwards, as the distance from training, is the run that was made."""
    solver = load_solver("column-fast-plane")
    scene = column(30.0, Wall("slip"))
    reduction = solver.reduced(scene)
    assert reduction.across == 1 and "Froude" in reduction.description and "plane strain" in reduction.description
    run = solver.run(scene)
    flat = reduction.flatten(run)
    assert flat.scene == reduction.scene and flat.dt == pytest.approx(solver.interval)
    np.testing.assert_array_equal(flat.position, solver.run(reduction.scene).position)
    np.testing.assert_array_equal(reduction.project(run.position), flat.position)
    np.testing.assert_allclose(flat.mass, solver.run(reduction.scene).mass, rtol=1e-5)


def test_sizes_near_the_data_are_run_as_they_are() -> None:
    """Twice or half as large is within what the trust indicator judges."""
    for factor in (0.5, 1.0, 2.0):
        assert load_solver("column-fast").reduced(column(0.35 * factor)).similarity.length == 1
    assert Similarity.of(5.0, None).length == 1  # data that do not say their sizes
    assert Similarity.of(1.0, (0.1, 0.4)).length == 1
    assert Similarity.of(4.0, (0.1, 0.4)).length == 8
    assert Similarity.of(0.01, (0.1, 0.4)).length == 1 / 32


def test_what_is_told_of_a_run_is_in_the_seconds_of_its_scene() -> None:
    ending = Similarity(16.0).ending({"at_rest_from": 0.5, "failure": "a particle reached 9 m/s"})
    assert ending["at_rest_from"] == 2.0 and ending["length_scale"] == 16.0
    assert "9 m/s at 1/16 of its size" in str(ending["failure"])
    assert Similarity().ending({"at_rest_from": 0.5}) == {"at_rest_from": 0.5}
