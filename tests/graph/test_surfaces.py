"""What particles see of rigid surfaces, against the plain distances of the scene's own geometry."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from gns_pl.data.solids import grip, surfaces_of
from gns_pl.errors import InputError
from gns_pl.graph import Surfaces, node_features
from gns_pl.scene import Body, Box, Plane, Scene, Wall, signed_distance
from gns_pl.scene.definition import FACES
from gns_pl.scene.terrain import Terrain
from gns_pl.training.symmetry import Symmetry
from tests.conftest import SAND, make_random, make_simulator, make_static

RADIUS = 0.1
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
    """Each pushes along its normal by 1 − d / R, and holds by its friction as well."""
    scene, position = furnished(dim), places(300, dim)
    approach, held, contact, falling = *np.zeros((3, 300, dim)), speeds(300, dim)

    def add(distance: np.ndarray, normal: np.ndarray, wall: Wall) -> None:
        nonlocal approach, held, contact
        weight = np.clip(1 - distance / RADIUS, 0, 1.5)
        approach, held = approach + weight[:, None] * normal, held + grip(wall) * weight[:, None] * normal
        for row, (fall, up) in enumerate(zip(falling.numpy(), normal, strict=True)):
            into, along = -(fall @ up), fall - (fall @ up) * up
            if into > 0:  # Coulomb's law of a single particle
                most = np.inf if wall.condition == "stick" else wall.friction * into
                stopped = along * min(1.0, most / np.linalg.norm(along))
                contact[row] += weight[row] * (into * up - stopped)

    assert scene.terrain is not None
    for axis in range(dim):
        for side, corner in ((1.0, 0.0), (-1.0, 1.0)):
            if (axis, side) != (dim - 1, 1.0):  # the floor is the terrain's
                add(side * (position.numpy()[:, axis] - corner), np.tile(side * np.eye(dim)[axis], (300, 1)), ROUGH)
    for obstacle in scene.obstacles:
        add(*signed_distance(obstacle, position.numpy()), obstacle.wall)
    add(*scene.terrain.signed_distance(position.numpy()), GROUND)
    found = seen(scene).fields(position, torch.zeros(300, dtype=torch.int64), RADIUS, falling)
    assert found.contact is not None
    np.testing.assert_allclose(found.contact.numpy(), contact, atol=1e-3)  # a wall that sticks has a friction of 1,000
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
    contact = seen(scene).fields(place, torch.zeros(1, dtype=torch.int64), RADIUS, falling).contact
    assert contact is not None
    left = max(0.0, np.sin(angle) - 0.25 * np.cos(angle)) * step
    expected = -left * torch.tensor([[np.cos(angle), np.sin(angle)]])
    torch.testing.assert_close(falling + contact, expected, atol=1e-6, rtol=0)


@pytest.mark.parametrize("output", ["acceleration", "gated"])
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
    width = 2 * (1 + (output == "gated")) + 1
    nothing = torch.zeros(1, width)
    if output == "gated":
        nothing[:, 2:4] = 50.0  # wide open
    speed, way = 0.5, 0.0
    with torch.inference_mode():
        for _ in range(steps):
            place = simulator(history, static, network=lambda *features: nothing)
            history = torch.stack([history[:, -1], place], dim=1)
            speed = max(0.0, speed + 9.81 * (np.sin(angle) - mu * np.cos(angle)) * dt)
            way += speed * dt
    np.testing.assert_allclose(history[0, -1].numpy(), first + way * down, atol=2e-4)
    assert 0.03 < way < 0.5


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
        seen(scene).fields(position, batch, RADIUS, fall) for scene in (plane, make_scene(terrain=incline(3)))
    )
    for left, right in zip(one, other, strict=True):
        torch.testing.assert_close(left, right, atol=1e-6, rtol=0)


@pytest.mark.parametrize("dim", [2, 3])
def test_scenes_of_a_batch_are_seen_as_alone(dim: int) -> None:
    scenes = [furnished(dim), make_scene(dim), make_scene(dim, terrain=incline(dim))]
    position, fall = places(3 * 50, dim), speeds(3 * 50, dim)
    together = Surfaces.joined([seen(scene) for scene in scenes])
    found = together.fields(position, torch.arange(3).repeat_interleave(50), RADIUS, fall)
    out = together.keep_out(position, torch.arange(3).repeat_interleave(50))
    for number, scene in enumerate(scenes):
        rows, own = slice(50 * number, 50 * number + 50), torch.zeros(50, dtype=torch.int64)
        by_itself = seen(scene).fields(position[rows], own, RADIUS, fall[rows])
        for all_of_them, alone in zip(found, by_itself, strict=True):
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
    assert torch.autograd.gradcheck(
        lambda *given: tuple(surfaces.fields(given[0], batch, RADIUS, given[1])), (position, fall)
    )
    assert torch.autograd.gradcheck(lambda place: surfaces.keep_out(place, batch), position)


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("dim", [2, 3])
def test_loops_see_what_torch_sees(dim: int, turned: bool) -> None:
    """In single precision a particle a time; also of scenes that were mirrored, and without what a contact would do."""
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
    for wanted in (fall, None):
        expected = exact.fields(position, batch, RADIUS, wanted)
        found = plain.fields(position.float(), batch, RADIUS, None if wanted is None else wanted.float())
        for name in ("approach", "grip", "ground"):
            torch.testing.assert_close(getattr(found, name).double(), getattr(expected, name), atol=2e-5, rtol=1e-4)
        if wanted is not None:
            assert found.contact is not None and expected.contact is not None
            torch.testing.assert_close(found.contact.double(), expected.contact, atol=2e-4, rtol=1e-3)
        else:
            assert found.contact is None
    out = plain.keep_out(position.float(), batch)
    torch.testing.assert_close(out.double(), exact.keep_out(position, batch), atol=1e-5, rtol=1e-5)
    with_gradient = plain.fields(position.float().requires_grad_(), batch, RADIUS, fall.float())
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
    before = surfaces.fields(position, static.batch, RADIUS, fall)
    after = turned.fields(moved, static.batch, RADIUS, turned_fall)
    torch.testing.assert_close(after.ground, before.ground)
    for name in ("approach", "grip", "contact"):
        expected = symmetry.turned(getattr(before, name)[:, None], static.batch, vectors=True)[:, 0]
        torch.testing.assert_close(getattr(after, name), expected)
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
