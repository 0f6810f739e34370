"""Runs on a terrain against planes, Newton's law on curved ground, and the run of the same ground turned."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from gns_pl.errors import InputError
from gns_pl.mpm import MPMConfig, simulate
from gns_pl.mpm.ground import surface_distance, surface_table
from gns_pl.mpm.plan import make_grid
from gns_pl.mpm.solver import start_points
from gns_pl.scene import Body, Plane, Scene, Terrain, Wall, make_release, signed_distance
from gns_pl.trajectory import Trajectory
from tests.mpm.conftest import energy, make_box, make_elastic, make_mpm

DIMS = pytest.mark.parametrize("dim", [2, 3])
GRAVITY = 9.81


def make_terrain(height: Any, domain: tuple[float, ...], cell: float, wall: Wall) -> Terrain:
    """Heights of a function of x, and y, over a box at the origin and a cell beyond it."""
    lines = [np.arange(-0.5, edge / cell + 1) * cell for edge in domain[:-1]]
    return Terrain(height(*np.meshgrid(*lines, indexing="ij")), (-0.5 * cell,) * len(lines), cell, wall)


def depths(scene: Scene, run: Trajectory, config: MPMConfig) -> NDArray[np.float64]:
    """Distance of every particle from the ground as the grid has it, in every fourth frame and the last [m]."""
    grid = make_grid(scene, config.cell_size)
    row = surface_table(scene, grid)[-1]
    places = np.zeros((*run.position.shape[:2], 3))
    places[..., list(grid.axes)] = run.position.astype(np.float64) - scene.lower
    kept = np.concatenate([places[::4], places[-1:]]).reshape(-1, 3)
    return np.array([surface_distance(row, *place)[0] for place in kept])


@DIMS
def test_a_plane_as_a_raster_is_the_plane_and_a_block_slides_down_as_newton_says(dim: int) -> None:
    angle, friction = math.radians(25), 0.2
    normal = (math.sin(angle),) + (0.0,) * (dim - 2) + (math.cos(angle),)
    along = np.array((math.cos(angle),) + (0.0,) * (dim - 2) + (-math.sin(angle),))
    body = Body((0.1,) * (dim - 1) + (0.5,), (0.3,) * (dim - 1) + (0.4,), (0.0,) * dim)
    box, wall = (1.5, *(0.5,) * (dim - 2), 1.0), Wall("friction", friction)
    scene = make_box(box, body, duration=0.4, material=make_elastic())
    slope = Plane((0.0,) * (dim - 1) + (0.7,), normal, wall)
    ground = make_terrain(lambda x, *_: 0.7 - math.tan(angle) * x, box, 0.1, wall)
    on_plane, run = (
        simulate(each, make_mpm(), frame_interval=0.01)
        for each in (scene.replace(obstacles=(slope,)), scene.replace(terrain=ground))
    )
    assert np.abs(run.position - on_plane.position).max() < 1e-6  # told to be so; float32 frames, exactly alike
    velocity = run.velocity().mean(axis=1)
    late = (velocity[-1] - velocity[-16]) / (15 * run.dt)
    assert late @ along == pytest.approx(GRAVITY * (math.sin(angle) - friction * math.cos(angle)), rel=0.01)
    assert abs(velocity[-1] @ np.array(normal)) < 0.01
    assert min(signed_distance(slope, frame)[0].min() for frame in run.position) > 0


@DIMS
def test_the_kernels_distance_is_that_from_a_sphere(dim: int) -> None:
    radius, cell, domain = 2.0, 0.05, (1.5,) * dim

    def bowl(*x: NDArray[np.float64]) -> NDArray[np.float64]:
        return 2.5 - np.sqrt(radius**2 - sum((each - 0.75) ** 2 for each in x))

    scene = make_box(domain, Body((0.5,) * (dim - 1) + (1.2,), (0.1,) * dim, (0.0,) * dim), duration=1.0)
    scene = scene.replace(terrain=make_terrain(bowl, domain, cell, Wall("slip")))
    grid = make_grid(scene, cell)
    row = surface_table(scene, grid)[-1]
    rng = np.random.default_rng(0)
    for _ in range(50):
        way, above = np.zeros(3), rng.uniform(-0.03, 0.03)
        way[list(grid.axes[:-1])] = rng.uniform(-0.3, 0.3, dim - 1)
        way[2] = -math.sqrt(1 - way @ way)
        centre = np.array([0.75, 0.75 if dim == 3 else 0.0, 2.5])
        distance, *normal = surface_distance(row, *(centre + (radius - above) * way))
        assert distance == pytest.approx(above, abs=0.3 * cell**2)  # the curvature that means and splines smooth
        assert np.array(normal) @ -way > 1 - 1e-4


@pytest.fixture(scope="module")
def profile() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A slope of 25°, an arc of radius 2 m, and a flat floor: places and heights 2 cm apart."""
    angle, start, radius = math.radians(25), 1.5, 2.0
    x = np.arange(-0.01, 5.0, 0.02)
    end = start + radius * math.sin(angle)
    low = radius * (1 - math.cos(angle))
    arc = radius - np.sqrt(radius**2 - np.clip(end - x, 0, radius / 2) ** 2)
    return x, 0.1 + np.where(x < start, low + math.tan(angle) * (start - x), arc)


def test_a_block_runs_out_on_curved_ground_as_newton_says(profile: Any) -> None:
    """x'' = −cos²θ (g + b'' x'²) (b' + μ): friction takes the pressure of the curve too. And the energy line."""
    from scipy.integrate import solve_ivp

    x, heights = profile
    friction = 0.3
    body = Body((0.1, float(np.interp(0.25, x, heights))), (0.15, 0.35), (0.0, 0.0))
    scene = make_box((4.9, 1.8), body, duration=2.4, material=make_elastic())
    scene = scene.replace(terrain=Terrain(heights, (float(x[0]),), 0.02, Wall("friction", friction)))
    run = simulate(scene, make_mpm(), frame_interval=0.02)
    centre = run.position.mean(axis=1, dtype=np.float64)

    def newton(_: float, state: Any) -> list[float]:
        place, speed = state
        slope = (
            -math.tan(math.radians(25)) if place < 1.5 else -max(1.5 + 2 * math.sin(math.radians(25)) - place, 0) / 2
        )
        bend = 0.5 if 1.5 < place < 1.5 + 2 * math.sin(math.radians(25)) else 0.0
        if place > 1.5:
            slope /= math.sqrt(1 - slope**2)
            bend *= (1 + slope**2) ** 1.5
        return [speed, -(GRAVITY + bend * speed**2) * (slope + friction) / (1 + slope**2)]

    exact = solve_ivp(newton, (0, 2.4), [centre[0, 0], 1e-9], max_step=0.005)
    reach = exact.y[0].max() - centre[0, 0]
    assert centre[50, 0] - centre[0, 0] == pytest.approx(np.interp(1.0, exact.t, exact.y[0]) - centre[0, 0], rel=0.02)
    assert centre[-1, 0] - centre[0, 0] == pytest.approx(reach, rel=0.03)
    # The energy line: tan is the friction, but for what the curve adds, some 2 μ Δθ Δz / Δx at most.
    drop = (centre[0, 1] - centre[-1, 1]) / (centre[-1, 0] - centre[0, 0])
    assert friction < drop < friction * 1.15
    assert np.diff(energy(run)).max() < 0


def test_a_block_swings_in_a_smooth_bowl_as_a_pendulum_does() -> None:
    radius = 2.0
    ground = make_terrain(lambda x: 2.1 - np.sqrt(radius**2 - (x - 1.5) ** 2), (3.0, 1.2), 0.05, Wall("slip"))
    body = Body((0.7, float(ground.height([[0.9]])[0])), (0.2, 0.35), (0.0, 0.0))
    scene = make_box((3.0, 1.2), body, duration=2.9, material=make_elastic()).replace(terrain=ground)
    run = simulate(scene, make_mpm(), frame_interval=0.02)
    away = run.position.mean(axis=1, dtype=np.float64)[:, 0] - 1.5
    passes = np.flatnonzero(np.diff(np.sign(away))) * run.dt
    # Its middle is nearer to the centre than the ground; its swing of 20° is longer than a small one's by 0.8 %.
    period = 2 * math.pi * math.sqrt((radius - 0.15) / GRAVITY) * 1.008
    assert passes[1] - passes[0] == pytest.approx(period / 2, rel=0.03)
    assert away.max() > 0.99 * -away[0] and away[-20:].min() < 0.97 * away[0]


@DIMS
@pytest.mark.parametrize("kind", ["steep", "rough"])
def test_nothing_leaks_through_and_no_energy_is_made(dim: int, kind: str) -> None:
    """A slope of 72° into a level floor, and a slope of 31° with bumps up to the roughest that is run."""
    cell = 1 / 24 if dim == 2 else 1 / 12
    domain = (1.2, *(0.5,) * (dim - 2), 2.0)
    bumps = np.random.default_rng(3).uniform(-1, 1, 1000)

    def steep(x: NDArray[np.float64], *_: object) -> NDArray[np.float64]:
        return 0.1 + 3.0 * np.maximum(0.45 - x, 0.0)

    def rough(x: NDArray[np.float64], *_: object) -> NDArray[np.float64]:
        return 0.2 + 0.6 * np.maximum(0.9 - x, 0.0) + 1.1 * cell * bumps[: x.size].reshape(x.shape)

    ground = make_terrain({"steep": steep, "rough": rough}[kind], domain, cell, Wall("friction", 0.3))
    body = Body((0.05, *(0.1,) * (dim - 2), 0.8), (0.3, *(0.3,) * (dim - 2), 0.6), (0.0,) * dim)
    scene = make_box(domain, body, duration=0.7).replace(terrain=ground)
    config = make_mpm(cell_size=cell, points_per_direction=2, jitter=0.5)
    run = simulate(scene, config, frame_interval=0.02)
    assert depths(scene, run, config).min() > -1e-6  # frames are float32
    assert run.position[-1][:, 0].max() > 0.6
    total = energy(run)
    assert np.diff(total).max() < 1e-3 * (total[0] - total[-1])


def test_a_turned_terrain_gives_the_turned_run() -> None:
    domain, wall = (0.8, 0.8, 0.8), Wall("friction", 0.3)
    ground = make_terrain(lambda x, y: 0.3 - 0.3 * x + 0.1 * np.sin(5 * x) * np.cos(4 * y), domain, 0.1, wall)
    body = Body((0.1, 0.2, 0.35), (0.2, 0.3, 0.2), (0.5, 0.2, 0.0))
    scene = make_box(domain, body, duration=0.1, material=make_elastic()).replace(terrain=ground)
    turned_ground = ground.replace(heights=np.rot90(ground.heights)[:, :])
    # A quarter turn: (x, y) → (0.8 − y, x); the raster is square and lies evenly around the box.
    side = ground.extent[1][0] - 0.8
    turned_ground = turned_ground.replace(corner=(0.8 - ground.corner[0] - 0.1 * (len(ground.heights) - 1), -0.05))
    assert side > 0
    quarter = Body((0.8 - 0.5, 0.1, 0.35), (0.3, 0.2, 0.2), (-0.2, 0.5, 0.0))
    turned = scene.replace(bodies=(quarter,), terrain=turned_ground)
    config = make_mpm(cell_size=0.1, points_per_direction=2)
    first, second = (simulate(each, config, frame_interval=0.02).position for each in (scene, turned))
    back = np.stack([second[..., 1], 0.8 - second[..., 0], second[..., 2]], axis=-1)
    order, other = (np.lexsort(frame.round(4).T) for frame in (first[0], back[0]))
    assert np.abs(first[:, order] - back[:, other]).max() < 1e-5


def test_points_start_as_thick_over_the_grids_ground_as_over_the_terrains() -> None:
    domain, wall = (4.0, 4.0, 2.0), Wall("friction", 0.3)
    bumps = np.random.default_rng(0)
    ground = make_terrain(lambda x, y: 0.5 + 0.2 * x + bumps.uniform(-0.05, 0.05, x.shape), domain, 0.1, wall)
    release = make_release(ground, outline=[[(1, 1), (3, 1), (3, 3), (1, 3)]], thickness=0.3)
    scene = make_box(domain, Body((1.0,) * 3, (0.1,) * 3, (0.0,) * 3), duration=1.0)
    scene = scene.replace(terrain=ground, bodies=(release,))
    config = make_mpm(cell_size=0.4, points_per_direction=2, jitter=0.5)
    points = start_points(scene, config, 0)
    places = points.position - scene.lower
    row = surface_table(scene, make_grid(scene, config.cell_size))[-1]
    distance = np.array([surface_distance(row, *place)[0] for place in places])
    assert points.volume.sum() == pytest.approx(4 * 0.3, rel=1e-12)
    assert distance.min() > 0 and distance.max() < 0.3


@pytest.mark.parametrize(
    ("ground", "message"),
    [
        (
            lambda x, y: 4 * x,
            r"on cells of 0\.1 m the ground at \(.*\) m is as steep as 76°, and 75° .* larger cells\.",
        ),
        (lambda x, y: 0.3 + 0.15 * np.cos(math.pi * x / 0.1), "so rough that its slope changes by .* smaller cells"),
    ],
)
def test_ground_that_the_cells_do_not_resolve_is_told(ground: Any, message: str) -> None:
    domain = (0.8, 0.8, 3.5)
    scene = make_box(domain, Body((0.1, 0.1, 3.2), (0.2, 0.2, 0.2), (0.0, 0.0, 0.0)), duration=0.1)
    scene = scene.replace(terrain=make_terrain(ground, domain, 0.05, Wall("slip")))
    with pytest.raises(InputError, match=message):
        simulate(scene, make_mpm(cell_size=0.1), frame_interval=0.02)
