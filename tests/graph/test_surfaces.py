"""What particles see of rigid surfaces, against the plain distances of the scene's own geometry."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from gns_pl.data.solids import grip, surfaces_of
from gns_pl.errors import InputError
from gns_pl.graph import SceneBatch, Surfaces, node_features
from gns_pl.models.config import OUTPUTS
from gns_pl.scene import Body, Box, Plane, Scene, Wall, signed_distance
from gns_pl.scene.definition import FACES
from gns_pl.scene.terrain import Terrain
from gns_pl.training.symmetry import Symmetry
from tests.conftest import SAND, make_random, make_simulator, make_static

RADIUS, TOUCHING = 0.1, 0.03
NEAR = {"radius": RADIUS, "touching": TOUCHING, "ahead": 0.0}
ROUGH, GROUND = Wall("friction", 0.5), Wall("friction", 0.25)


def make_scene(dim: int = 3, *, terrain: Terrain | None = None, obstacles: tuple[Plane | Box, ...] = ()) -> Scene:
    return Scene(
        name="scene",
        lower=(0.0,) * dim,
        upper=(1.0,) * dim,
        gravity=(*(0.0,) * (dim - 1), -9.81),
        duration=1.0,
        materials={"sand": SAND},
        bodies=(Body((0.1,) * (dim - 1) + (0.7,), (0.2,) * dim, (0.0,) * dim),),
        walls=dict.fromkeys(FACES[dim], ROUGH),
        obstacles=obstacles,
        terrain=terrain,
    )


def incline(dim: int) -> Terrain:
    """A plane that rises along x, and half as steeply along y."""
    along = np.linspace(-0.5, 1.5, 81)
    heights = 0.1 + 0.2 * along if dim == 2 else 0.1 + 0.2 * along[:, None] + 0.1 * along
    return Terrain(heights, (-0.5,) * (dim - 1), 0.025, GROUND)


def furnished(dim: int) -> Scene:
    level = (0.0,) * (dim - 2)
    obstacles = (
        Plane((0.3, *level, 0.4), (-0.6, *level, 0.8), ROUGH),
        Box((0.6,) * (dim - 1) + (0.0,), (0.2,) * (dim - 1) + (0.5,), Wall("stick")),
    )
    return make_scene(dim, terrain=incline(dim), obstacles=obstacles)


def places(number: int, dim: int) -> torch.Tensor:
    return torch.from_numpy(np.random.default_rng(0).uniform(0, 0.9, (number, dim)))


def speeds(number: int, dim: int) -> torch.Tensor:
    return torch.from_numpy(np.random.default_rng(1).normal(0, 1, (number, dim)))


def seen(scene: Scene) -> Surfaces:
    return surfaces_of(scene, 0.05).in_precision(torch.float64)


@pytest.mark.parametrize("dim", [2, 3])
def test_sums_are_those_of_all_surfaces(dim: int) -> None:
    """Each pushes along its normal by 1 − d / R, holds by its friction as well, and stops as what touches it."""
    scene, position = furnished(dim), places(300, dim)
    approach, held, contact, falling = *np.zeros((3, 300, dim)), speeds(300, dim)

    def add(distance: np.ndarray, normal: np.ndarray, wall: Wall) -> None:
        nonlocal approach, held, contact
        weight = np.clip(1 - distance / RADIUS, 0, 1.5)
        approach, held = approach + weight[:, None] * normal, held + grip(wall) * weight[:, None] * normal
        near = np.clip((RADIUS - distance) / (RADIUS - TOUCHING), 0, 1)
        for row, (fall, up) in enumerate(zip(falling.numpy(), normal, strict=True)):
            into, along = -(fall @ up), fall - (fall @ up) * up
            if into > 0:  # Coulomb's law of a single particle
                most = np.inf if wall.condition == "stick" else wall.friction * into
                stopped = along * min(1.0, most / np.linalg.norm(along))
                contact[row] += near[row] * (into * up - stopped)

    assert scene.terrain is not None
    for axis in range(dim):
        for side, corner in ((1.0, 0.0), (-1.0, 1.0)):
            if (axis, side) != (dim - 1, 1.0):  # the floor is the terrain's
                add(side * (position.numpy()[:, axis] - corner), np.tile(side * np.eye(dim)[axis], (300, 1)), ROUGH)
    for obstacle in scene.obstacles:
        add(*signed_distance(obstacle, position.numpy()), obstacle.wall)
    add(*scene.terrain.signed_distance(position.numpy()), GROUND)
    batch = torch.zeros(300, dtype=torch.int64)
    found, added = seen(scene).fields(position, batch, RADIUS), seen(scene).contacts(falling, position, batch, **NEAR)
    np.testing.assert_allclose(added.numpy(), contact, atol=1e-3)  # a wall that sticks has a friction of 1,000
    np.testing.assert_allclose(found.approach.numpy(), approach, atol=1e-6)
    np.testing.assert_allclose(found.grip.numpy(), held, atol=1e-6)
    assert np.abs(approach).max() > 1


@pytest.mark.parametrize("degrees", [10.0, 30.0])
def test_a_particle_on_an_incline_slides_as_a_block(degrees: float) -> None:
    """What its contact leaves of a step's gravity is g (sin θ − μ cos θ) Δt along the slope, or nothing."""
    angle, step = np.radians(degrees), 9.81 * 0.02
    along = np.linspace(-0.5, 1.5, 81)
    scene = make_scene(2, terrain=Terrain(0.1 + np.tan(angle) * along, (-0.5,), 0.025, GROUND))
    place = torch.tensor([[0.4, 0.1 + 0.4 * np.tan(angle)]])
    falling = torch.tensor([[0.0, -step]], dtype=torch.float64)
    contact = seen(scene).contacts(falling, place, torch.zeros(1, dtype=torch.int64), **NEAR)
    left = max(0.0, np.sin(angle) - 0.25 * np.cos(angle)) * step
    expected = -left * torch.tensor([[np.cos(angle), np.sin(angle)]])
    torch.testing.assert_close(falling + contact, expected, atol=1e-6, rtol=0)


@pytest.mark.parametrize("output", OUTPUTS)
@pytest.mark.parametrize("degrees", [10.0, 30.0])
def test_a_network_that_adds_nothing_leaves_a_block_on_an_incline(output: str, degrees: float) -> None:
    """From 0.5 m/s down: v = v0 + g (sin θ − μ cos θ) t, or at rest once that is used up; the place is exact, too."""
    angle, mu, steps = np.radians(degrees), 0.25, 20
    along = np.linspace(-0.5, 1.5, 81)
    scene = make_scene(2, terrain=Terrain(0.1 + np.tan(angle) * along, (-0.5,), 0.025, GROUND))
    simulator = make_simulator(
        dim=2, output=output, walls="contacts", input_sequence_length=2, connectivity_radius=RADIUS
    )
    static = dataclasses.replace(make_static(1, gravity=(0.0, -9.81)), surfaces=surfaces_of(scene, 0.05))
    down, dt = np.array([-np.cos(angle), -np.sin(angle)]), simulator.config.dt
    first = np.array([0.8, 0.1 + 0.8 * np.tan(angle)])
    history = torch.tensor(np.stack([first - 0.5 * dt * down, first])[None], dtype=torch.float32)
    nothing = torch.zeros(1, 2 if output == "acceleration" else 4)
    nothing[:, 2:] = 50.0  # a gate that is wide open
    speed, way = 0.5, 0.0
    with torch.inference_mode():
        for _ in range(steps):
            place = simulator(history, static, network=lambda *features: nothing)
            history = torch.stack([history[:, -1], place], dim=1)
            speed = max(0.0, speed + 9.81 * (np.sin(angle) - mu * np.cos(angle)) * dt)
            way += speed * dt
    np.testing.assert_allclose(history[0, -1].numpy(), first + way * down, atol=2e-4)
    assert 0.03 < way < 0.5


@pytest.mark.parametrize("mu", [0.0, 0.15])
def test_ground_that_bends_presses_by_the_square_of_speed(mu: float) -> None:
    """Through a round valley as the law of motion says: s'' = −g sin θ − μ (g cos θ + v² / r), to 3 % of the way up.

    Half of v² / r was missing where normals were those at the place that a particle is leaving.
    """
    r, first = 0.6, 0.6
    place = np.arange(-0.5, 0.5 + 1e-9, 0.01)
    scene = make_scene(2, terrain=Terrain(0.1 + r - np.sqrt(r**2 - place**2), (0.0,), 0.01, Wall("friction", mu)))
    simulator = make_simulator(dim=2, output="acceleration", walls="contacts", connectivity_radius=RADIUS)
    static = dataclasses.replace(make_static(1, gravity=(0.0, -9.81)), surfaces=surfaces_of(scene, 0.02))
    dt, start = simulator.config.dt, np.array([0.5 - r * np.sin(first), 0.1 + r - r * np.cos(first)])
    history = torch.tensor(np.repeat(start[None], simulator.history_length, axis=0)[None], dtype=torch.float32)
    along, speed, highest, found = -first, 0.0, -first, -first
    with torch.inference_mode():
        for _ in range(int(2.5 / dt)):
            step = simulator(history, static, network=lambda *features: torch.zeros(1, 2))
            history = torch.cat([history[:, 1:], step[:, None]], dim=1)
            found = max(found, float(np.arcsin((history[0, -1, 0] - 0.5) / r)))
            for _ in range(100):
                pull = -9.81 * np.sin(along) - mu * (9.81 * np.cos(along) + speed**2 / r) * np.sign(speed)
                speed += pull * dt / 100
                along += speed * dt / 100 / r
            highest = max(highest, along)
    np.testing.assert_allclose(found, highest, rtol=0.03)
    assert highest > (0.25 if mu else 0.59)


def test_friction_of_walls() -> None:
    assert [grip(wall) for wall in (Wall("slip"), Wall("friction", 0.25), Wall("friction", 1.0), Wall("stick"))] == [
        0.0,
        0.2,
        0.5,
        1.0,
    ]


def test_ground_below_is_the_highest_surface() -> None:
    """A cuboid counts where a particle is over its top, not beside it or in it; planes and terrain everywhere."""
    scene = furnished(3)
    position = torch.tensor([[0.7, 0.7, 0.8], [0.7, 0.7, 0.45], [0.4, 0.9, 0.9], [0.1, 0.1, 0.9]], dtype=torch.float64)
    plane, terrain = 0.4 + 0.75 * (position[:, 0] - 0.3), 0.1 + 0.2 * position[:, 0] + 0.1 * position[:, 1]
    expected = torch.maximum(plane, terrain)
    expected[0] = torch.maximum(expected[0], torch.tensor(0.5))
    found = seen(scene).fields(position, torch.zeros(4, dtype=torch.int64), RADIUS)
    torch.testing.assert_close(found.ground, expected, atol=1e-6, rtol=0)


def test_plane_and_terrain_of_one_slope_are_alike() -> None:
    """Ground given as heights is seen as the same ground given as a plane."""
    normal = (-0.2, -0.1, 1.0)
    plane = make_scene(obstacles=(Plane((0.0, 0.0, 0.1), normal, GROUND),))
    position = places(200, 3)
    position[:, 2] += 0.4  # away from the box's own floor, which the terrain takes the place of
    batch, fall = torch.zeros(200, dtype=torch.int64), speeds(200, 3)
    one, other = (
        (*seen(scene).fields(position, batch, RADIUS), seen(scene).contacts(fall, position, batch, **NEAR))
        for scene in (plane, make_scene(terrain=incline(3)))
    )
    for left, right in zip(one, other, strict=True):
        torch.testing.assert_close(left, right, atol=1e-6, rtol=0)


@pytest.mark.parametrize("dim", [2, 3])
def test_scenes_of_a_batch_are_seen_as_alone(dim: int) -> None:
    scenes = [furnished(dim), make_scene(dim), make_scene(dim, terrain=incline(dim))]
    position, fall = places(3 * 50, dim), speeds(3 * 50, dim)
    together = Surfaces.joined([seen(scene) for scene in scenes])
    batch = torch.arange(3).repeat_interleave(50)
    found = (*together.fields(position, batch, RADIUS), together.contacts(fall, position, batch, **NEAR))
    out = together.keep_out(position, batch)
    for number, scene in enumerate(scenes):
        rows, own = slice(50 * number, 50 * number + 50), torch.zeros(50, dtype=torch.int64)
        by_itself = seen(scene).fields(position[rows], own, RADIUS)
        thrown = seen(scene).contacts(fall[rows], position[rows], own, **NEAR)
        for all_of_them, alone in zip(found, (*by_itself, thrown), strict=True):
            torch.testing.assert_close(all_of_them[rows], alone)
        torch.testing.assert_close(out[rows], seen(scene).keep_out(position[rows], own))


def test_what_is_inside_is_put_onto_the_surface() -> None:
    scene, position = furnished(3), places(500, 3)
    surfaces, batch = seen(scene), torch.zeros(500, dtype=torch.int64)
    out = surfaces.keep_out(position, batch).numpy()
    assert scene.terrain is not None
    distances = [signed_distance(each, position.numpy())[0] for each in scene.obstacles]
    distances.append(scene.terrain.signed_distance(position.numpy())[0])
    free = np.min(distances, axis=0) > 0
    assert 50 < free.sum() < 450
    np.testing.assert_array_equal(out[free], position.numpy()[free])
    assert scene.terrain.signed_distance(out)[0].min() > -1e-6
    assert signed_distance(scene.obstacles[1], out)[0].min() > -1e-6
    bare = seen(make_scene())
    assert bare.keep_out(position, batch) is position


@pytest.mark.parametrize("dim", [2, 3])
def test_derivatives(dim: int) -> None:
    position = places(40, dim).requires_grad_()
    surfaces, batch = seen(furnished(dim)), torch.zeros(40, dtype=torch.int64)
    fall = speeds(40, dim).requires_grad_()
    assert torch.autograd.gradcheck(lambda place: tuple(surfaces.fields(place, batch, RADIUS)), position)
    assert torch.autograd.gradcheck(
        lambda speed, place: surfaces.contacts(speed, place, batch, **NEAR), (fall, position)
    )
    assert torch.autograd.gradcheck(lambda place: surfaces.keep_out(place, batch), position)


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("dim", [2, 3])
def test_loops_see_what_torch_sees(dim: int, turned: bool) -> None:
    """In single precision a particle a time; also of scenes that were mirrored, and back by velocities."""
    scenes = [furnished(dim), make_scene(dim), make_scene(dim, terrain=incline(dim))]
    plain = Surfaces.joined([surfaces_of(scene, 0.05) for scene in scenes])
    position, fall = places(3 * 200, dim), speeds(3 * 200, dim)
    batch = torch.arange(3).repeat_interleave(200)
    if turned:
        static = make_static(600, graphs=3)
        static = dataclasses.replace(static, lower=static.lower[:, :dim], upper=static.upper[:, :dim], batch=batch)
        symmetry = Symmetry.sample(static, make_random(static, seed=2), torch.float64)
        plain = plain.turned(symmetry.sign.float(), symmetry.offset.float(), symmetry.order)
        assert (symmetry.sign < 0).any()
    exact = plain.in_precision(torch.float64)
    expected, found = exact.fields(position, batch, RADIUS), plain.fields(position.float(), batch, RADIUS)
    for name in ("approach", "grip", "ground"):
        torch.testing.assert_close(getattr(found, name).double(), getattr(expected, name), atol=2e-5, rtol=1e-4)
    above, by_speed = speeds(3 * 200, dim).flip(0), []
    soon = NEAR | {"ahead": 0.01}
    for surfaces, dtype in ((plain, torch.float32), (exact, torch.float64)):
        speed = fall.to(dtype, copy=True).requires_grad_()
        thrown = surfaces.contacts(speed, position.to(dtype), batch, **soon)
        (thrown * above.to(dtype)).sum().backward()
        by_speed.append((thrown.detach().double(), speed.grad.double()))  # type: ignore[union-attr]
    for loops, torchs in zip(*by_speed, strict=True):
        torch.testing.assert_close(loops, torchs, atol=5e-4, rtol=2e-3)
    assert torch.equal(by_speed[0][0].float(), plain.contacts(fall.float(), position.float(), batch, **soon))
    out = plain.keep_out(position.float(), batch)
    torch.testing.assert_close(out.double(), exact.keep_out(position, batch), atol=1e-5, rtol=1e-5)
    with_gradient = plain.fields(position.float().requires_grad_(), batch, RADIUS)
    torch.testing.assert_close(with_gradient.approach, plain.fields(position.float(), batch, RADIUS).approach)


@pytest.mark.parametrize("place", [float("nan"), float("inf"), -1e30])
def test_a_run_that_broke_costs_nobody_else(place: float) -> None:
    """What is nowhere reads nothing beyond the heights, which a compiled loop does not check."""
    surfaces, batch = surfaces_of(furnished(3), 0.05), torch.zeros(50, dtype=torch.int64)
    position, broken = places(50, 3).float(), places(50, 3).float()
    broken[7] = place
    others = torch.arange(50) != 7
    kept, found = surfaces.keep_out(broken, batch), surfaces.fields(broken, batch, RADIUS)
    assert torch.equal(kept[others], surfaces.keep_out(position, batch)[others])
    assert torch.equal(found.approach[others], surfaces.fields(position, batch, RADIUS).approach[others])


def test_mirrored_scenes_are_seen_mirrored() -> None:
    """Ground is not alike on both sides, so it has to be turned with the particles."""
    graphs, number = 16, 20
    static = make_static(number, graphs=graphs)
    position = places(number * graphs, 3)
    surfaces = Surfaces.joined([seen(furnished(3))] * graphs)
    symmetry = Symmetry.sample(static, make_random(static), position.dtype)
    turned = surfaces.turned(symmetry.sign.double(), symmetry.offset.double(), symmetry.order)
    moved = symmetry.turned(position[:, None], static.batch)[:, 0]
    fall = speeds(number * graphs, 3)
    turned_fall = symmetry.turned(fall[:, None], static.batch, vectors=True)[:, 0]
    before = surfaces.fields(position, static.batch, RADIUS)
    after = turned.fields(moved, static.batch, RADIUS)
    torch.testing.assert_close(after.ground, before.ground)
    vectors = [(after.approach, before.approach), (after.grip, before.grip)]
    thrown = surfaces.contacts(fall, position, static.batch, **NEAR)
    vectors.append((turned.contacts(turned_fall, moved, static.batch, **NEAR), thrown))
    for found, was in vectors:
        expected = symmetry.turned(was[:, None], static.batch, vectors=True)[:, 0]
        torch.testing.assert_close(found, expected)
    out = symmetry.turned(surfaces.keep_out(position, static.batch)[:, None], static.batch)[:, 0]
    torch.testing.assert_close(turned.keep_out(moved, static.batch), out)
    assert not torch.equal(moved, position)


def rows(position: torch.Tensor, scene: Scene, *, surfaces: bool) -> torch.Tensor:
    number = len(position)
    static = make_static(number, gravity=(0.0, 0.0, -9.81))
    velocity = torch.rand(number, 2, 3, generator=torch.Generator().manual_seed(1))
    return node_features(
        velocity,
        position.float(),
        dataclasses.replace(static, surfaces=surfaces_of(scene, 0.05)),
        velocity_scale=torch.tensor(2.0),
        radius=RADIUS,
        spacing=0.05,
        particle_types=(6,),
        material_scale=torch.tensor([[0.5], [0.1]]),
        context=True,
        surfaces=surfaces,
    )


def test_features_over_a_floor_are_those_of_a_box() -> None:
    """Only what is said of walls is said otherwise: how near the lower less how near the upper one is."""
    position = places(100, 3)
    box, seen_rows = (rows(position, make_scene(), surfaces=surfaces) for surfaces in (False, True))
    torch.testing.assert_close(seen_rows[:, :6], box[:, :6])
    torch.testing.assert_close(seen_rows[:, 12:], box[:, 12:])
    near = (1 - box[:, 6:12]).clamp(0, 1)
    torch.testing.assert_close(seen_rows[:, 6:9], near[:, :3] - near[:, 3:], atol=1e-5, rtol=0)
    torch.testing.assert_close(seen_rows[:, 9:12], seen_rows[:, 6:9] / 3, atol=1e-5, rtol=0)


def test_scenes_without_surfaces_are_refused_with_what_to_do() -> None:
    simulator, static = make_simulator(walls="surfaces"), make_static(4)
    with pytest.raises(InputError, match=r"make its scenes by static_of\(…, config=simulator\.config\)"):
        simulator(torch.rand(4, simulator.history_length, 3), static)


def test_features_over_raised_ground_are_those_over_a_floor() -> None:
    """What lies above and below, and how densely, is counted from the ground."""
    position = places(100, 3) * torch.tensor([1.0, 1.0, 0.5])
    heights = np.full((30, 30), 0.3)
    raised = make_scene(terrain=Terrain(heights, (-0.2, -0.2), 0.05, ROUGH))
    floor, ground = rows(position, make_scene(), surfaces=True), position + torch.tensor([0.0, 0.0, 0.3])
    torch.testing.assert_close(rows(ground, raised, surfaces=True), floor, atol=1e-5, rtol=0)


def test_a_tilted_box_is_a_slope() -> None:
    """What is in a box of tilted gravity accelerates as on a plane under upright gravity; also beside others."""
    simulator = make_simulator(walls="contacts", output="switched", connectivity_radius=RADIUS, material_features=())
    angle = np.radians(20.0)
    back = torch.tensor([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]).float()
    floor = Plane((0.0, 0.0, 0.0), (float(np.sin(angle)), 0.0, float(np.cos(angle))), GROUND)
    tilted = dataclasses.replace(make_scene(), walls=dict.fromkeys(FACES[3], GROUND))
    slope = dataclasses.replace(make_scene(obstacles=(floor,)), lower=(-9.0,) * 3, upper=(9.0,) * 3)
    place = 0.15 + 0.7 * torch.rand(300, 3, generator=torch.Generator().manual_seed(0))
    place[:, 2] *= 0.3
    history = place[:, None] + 0.005 * torch.rand(300, 4, 3, generator=torch.Generator().manual_seed(1))
    static = dataclasses.replace(make_static(300), surfaces=surfaces_of(slope, 0.05))
    static = dataclasses.replace(static, lower=torch.full((1, 3), -9.0), upper=torch.full((1, 3), 9.0))
    gravity = torch.tensor([[9.81 * float(np.sin(angle)), 0.0, -9.81 * float(np.cos(angle))]])
    leaning = dataclasses.replace(make_static(300), gravity=gravity, surfaces=surfaces_of(tilted, 0.05))
    with torch.inference_mode():
        upright = simulator.normalised_acceleration(history @ back.T, static)
        found = simulator.normalised_acceleration(history, leaning)
        both = SceneBatch(**{
            entry.name: torch.cat([getattr(static, entry.name), getattr(leaning, entry.name)])
            for entry in dataclasses.fields(SceneBatch) if entry.init and entry.name != "surfaces"
        })  # fmt: skip
        surfaces = Surfaces.joined([surfaces_of(slope, 0.05), surfaces_of(tilted, 0.05)])
        both = dataclasses.replace(both, batch=torch.arange(2).repeat_interleave(300), surfaces=surfaces)
        together = simulator.normalised_acceleration(torch.cat([history @ back.T, history]), both)
    torch.testing.assert_close(found @ back.T, upright, atol=2e-4, rtol=1e-3)
    torch.testing.assert_close(together, torch.cat([upright, found]), atol=2e-4, rtol=1e-3)
