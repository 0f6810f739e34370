from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest

import gns_pl.mpm.plan
from gns_pl.errors import InputError
from gns_pl.mpm import SimulationError, simulate
from gns_pl.mpm.plan import largest_speed, make_grid
from gns_pl.scene import Body, Scene, Wall, fill_scene
from tests.mpm.conftest import make_box, make_elastic, make_mpm, make_sand

DIMS = pytest.mark.parametrize("dim", [2, 3])


def in_air(dim: int, **changes: Any) -> Scene:
    velocity = (0.5, 1.0) if dim == 2 else (0.5, -0.25, 1.0)
    return make_box((1.0,) * dim, Body((0.3,) * dim, (0.25,) * dim, velocity), **({"duration": 0.1} | changes))


@DIMS
@pytest.mark.parametrize("transfer", ["affine_flip", "flip", "apic", "pic"])
def test_free_fall_is_exact(dim: int, transfer: str) -> None:
    run = simulate(in_air(dim), make_mpm(transfer=transfer, jitter=0.7), frame_interval=0.0025)
    gravity, dt = np.array(run.scene.gravity), run.provenance["time_step"]
    assert isinstance(dt, float)
    steps = np.round(run.time / dt)
    # Semi-implicit Euler: x_n = x_0 + n dt v_0 + n (n + 1) / 2 · g dt².
    moved = run.time[:, None] * run.initial_velocity[0] + (steps * (steps + 1) / 2 * dt**2)[:, None] * gravity
    assert np.abs(run.position - run.position[0] - moved[:, None]).max() < 5e-7


@DIMS
def test_frames_types_and_provenance(dim: int) -> None:
    seen: list[tuple[int, int]] = []
    run = simulate(in_air(dim), make_mpm(), frame_interval=0.01, seed=3, on_frame=lambda *at: seen.append(at))
    assert run.num_frames == 11
    assert run.position.dtype == np.float32
    assert seen == [(frame, 11) for frame in range(11)]
    assert run.mass.sum() == pytest.approx(1800 * 0.25**dim, rel=1e-6)
    told = run.provenance
    assert json.loads(json.dumps(told)) == told
    assert told["seed"] == 3
    assert told["config"]["courant"] == 0.3  # type: ignore[index]
    assert told["num_steps"] * told["time_step"] == pytest.approx(0.1)  # type: ignore[operator]


@DIMS
def test_the_same_seed_gives_the_same_bits(dim: int) -> None:
    scene = make_box((0.5,) * dim, Body((0.1,) * dim, (0.2,) * dim, (1.0,) * dim), duration=0.3)
    config = make_mpm(jitter=0.7, points_per_direction=2)
    first, again, other = (simulate(scene, config, frame_interval=0.01, seed=seed) for seed in (1, 1, 2))
    assert np.array_equal(first.position, again.position)
    assert not np.array_equal(first.position, other.position)


def test_a_plane_scene_is_a_slice_of_a_slippery_channel() -> None:
    plane = make_box(
        (0.6, 0.5), Body((0.0, 0.0), (0.25, 0.25), (0.0, 0.0)), duration=0.3, lower_z=Wall("friction", 0.4)
    )
    body = Body((0.0, 0.0, 0.0), (0.25, 0.25, 0.25), (0.0, 0.0, 0.0))
    channel = make_box((0.6, 0.25, 0.5), body, duration=0.3, lower_z=Wall("friction", 0.4))
    two, three = (simulate(scene, make_mpm(), frame_interval=0.01) for scene in (plane, channel))
    lattice = three.position[-1].reshape(12, 12, 12, 3)  # x, y, z in filling order
    expected = two.position[-1].reshape(12, 12, 2)
    assert np.abs(lattice[..., [0, 2]] - expected[:, None]).max() < 1e-4
    assert np.abs(np.diff(lattice[..., 1].mean(axis=(0, 2)), axis=0) - 1 / 48).max() < 1e-4


@DIMS
@pytest.mark.parametrize("axis", [0, -1])
def test_an_elastic_bar_oscillates_at_its_frequency(dim: int, axis: int) -> None:
    """A bar that sticks to a wall and is pushed along: its ends meet the wave of speed √(E/ρ), period 4 L / c."""
    length, width = 0.5, 0.125
    size, speed = [width] * dim, [0.0] * dim
    size[axis], speed[axis] = length, 0.01
    position = [0.2] * dim
    position[axis] = 0.0
    material = make_elastic(poisson_ratio=0.0)
    period = 4 * length / material.p_wave_speed  # c = √(E/ρ) at ν = 0
    scene = make_box(
        (0.8,) * dim,
        Body(tuple(position), tuple(size), tuple(speed)),
        duration=1.1 * period,
        material=material,
        gravity=(0.0,) * dim,
        wall=Wall("stick"),
    )
    config = make_mpm(cell_size=1 / 24, points_per_direction=2, damping_rate=0.0, bulk_viscosity=0.0)
    run = simulate(scene, config, frame_interval=period / 200)
    moved = (run.position - run.position[0])[..., axis].mean(axis=1)
    down = np.flatnonzero((moved[:-1] > 0) & (moved[1:] <= 0))
    up = np.flatnonzero((moved[:-1] < 0) & (moved[1:] >= 0))
    assert run.time[down[0]] == pytest.approx(period / 2, rel=0.03)
    assert run.time[up[-1]] == pytest.approx(period, rel=0.03)
    # Largest mean displacement of a triangular wave: half of the end's, v L / c.
    assert moved.max() == pytest.approx(0.5 * 0.01 * period / 4, rel=0.05)


@DIMS
def test_a_body_thinner_than_a_cell_falls_and_lies(dim: int) -> None:
    size = (0.3,) * (dim - 1) + (0.01,)
    scene = make_box((1.0,) * dim, Body((0.3,) * (dim - 1) + (0.1,), size, (0.0,) * dim), duration=0.6)
    run = simulate(scene, make_mpm(), frame_interval=0.02)
    assert np.abs(run.velocity()[-1][:, -1]).max() < 0.01
    assert run.position[-1][:, -1].min() > 0
    assert run.position[-1][:, -1].max() < 0.03


@DIMS
def test_bodies_against_every_wall_stay_inside(dim: int) -> None:
    far = tuple(0.7 for _ in range(dim))
    bodies = Body((0.0,) * dim, (0.3,) * dim, (-2.0,) * dim), Body(far, (0.3,) * dim, (3.0,) * dim)
    scene = make_box((1.0,) * dim, *bodies, duration=0.5, wall=Wall("friction", 0.3))
    run = simulate(scene, make_mpm(points_per_direction=2, jitter=0.5), frame_interval=0.01)
    assert run.position.min() > 0
    assert run.position.max() < 1


def test_two_materials_keep_their_properties() -> None:
    light, heavy = make_sand(density=900.0), make_sand(density=2700.0, friction_angle_deg=40.0)
    bodies = Body((0.0, 0.0), (0.2, 0.2), (0.0, 0.0), "light"), Body((0.5, 0.0), (0.2, 0.2), (0.0, 0.0), "heavy")
    scene = make_box((1.0, 0.5), Body((0.1, 0.1), (0.1, 0.1), (0.0, 0.0)), duration=0.05)
    scene = scene.replace(bodies=bodies, materials={"light": light, "heavy": heavy})
    run = simulate(scene, make_mpm(), frame_interval=0.01)
    half = run.num_particles // 2
    assert run.mass[:half] == pytest.approx(run.mass[half:] / 3)
    assert run.material[-1, 0] == pytest.approx(math.tan(math.radians(40)))


def test_an_unstable_run_is_stopped_and_told() -> None:
    scene = make_box((1.0, 1.0), Body((0.0, 0.0), (0.3, 0.5), (0.0, 0.0)), duration=3.0)
    with pytest.raises(
        SimulationError, match=r"'box'.*unstable: .* in step \d+ at .* s, point \d+ at \(.*\) m \(courant 12"
    ):
        simulate(scene, make_mpm(courant=12, allow_large_courant=True), frame_interval=0.2)


def test_a_grid_that_does_not_fit_into_memory_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """The grid spans the box, 11 numbers of 8 bytes a node; nothing of it is made before."""
    scene = make_box((100.0, 100.0, 100.0), Body((0.3,) * 3, (0.25,) * 3, (0.0,) * 3), duration=0.1)
    monkeypatch.setattr(gns_pl.mpm.plan, "free_memory", lambda: 8 * 10**9)
    with pytest.raises(
        InputError, match=r"grid of 2,000 x 2,000 x 2,000 cells of 0.05 m, which needs 705 GB, and 8 GB"
    ):
        simulate(scene, make_mpm(cell_size=0.05), frame_interval=0.01)


def test_the_largest_speed_counts_start_and_fall() -> None:
    scene = make_box((1.0, 1.0), Body((0.2, 0.4), (0.2, 0.2), (3.0, 0.0)), duration=0.1)
    particles = fill_scene(scene, 0.02)
    assert largest_speed(scene, particles) == pytest.approx(math.sqrt(9 + 2 * 9.81 * 0.6), rel=0.02)
    tilted = scene.replace(gravity=(5.0, -5.0))
    assert largest_speed(tilted, particles) == pytest.approx(math.sqrt(9 + 10 * (0.8 + 0.6)), rel=0.02)


def test_walls_lie_on_nodes_whatever_the_box() -> None:
    scene = make_box((1.5, 0.5, 0.7), Body((0.0,) * 3, (0.2,) * 3, (0.0,) * 3), duration=0.1)
    grid = make_grid(scene, 1 / 12)
    assert grid.cells == (18, 6, 8)
    assert np.array(grid.cells) * grid.cell == pytest.approx([1.5, 0.5, 0.7])
    plane = make_box((1.0, 0.5), Body((0.0,) * 2, (0.2,) * 2, (0.0,) * 2), duration=0.1)
    assert make_grid(plane, 0.1).nodes == (11, 1, 6)


@DIMS
@pytest.mark.parametrize("down", [True, False])
def test_a_box_two_cells_high_has_a_floor_and_a_ceiling(dim: int, down: bool) -> None:
    """Every stencil reaches both of them there; far from one, a body falls on the other as in a higher box."""
    body = Body((0.1,) * (dim - 1) + (0.04 if down else 0.1,), (0.2,) * (dim - 1) + (0.06,), (0.0,) * dim)
    low = make_box((0.5,) * (dim - 1) + (0.2,), body, duration=0.2, gravity=(0.0,) * (dim - 1) + (-5 if down else 5,))
    high = low.replace(
        **({"upper": (*low.upper[:-1], 0.4)} if down else {"lower": (*low.lower[:-1], -0.2)})  # two cells more
    )
    config = make_mpm(cell_size=0.1, courant=0.1)
    last, expected = (simulate(scene, config, frame_interval=0.02).position[-1] for scene in (low, high))
    assert np.abs(last - expected).max() < 2e-3
    assert 0 < (last[:, -1] if down else 0.2 - last[:, -1]).min() < 0.02
