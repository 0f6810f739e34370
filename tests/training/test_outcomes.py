"""Errors of whole runs against NumPy's measures, and their derivatives through a whole run against differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from gns_pl.metrics.maps import volume_map
from gns_pl.metrics.observables import compute_observables
from gns_pl.metrics.release import release_distance
from gns_pl.models.simulator import Simulator
from gns_pl.rollout import static_of
from gns_pl.rollout.gradient import differentiable_distance, differentiable_rollout, differentiable_volume_map
from gns_pl.scene import Body, Scene, Wall, column_collapse
from gns_pl.scene.definition import FACES
from gns_pl.training.outcomes import ERRORS, compared_frames, outcome_errors
from tests.conftest import SAND, make_moving, make_simulator, make_start

CELL, SPACING, STEPS = 0.12, 0.06, 5
WEIGHTS = torch.tensor([1.0, 0.5, 0.5, 0.1, 0.3], dtype=torch.float64)


@pytest.fixture
def plane() -> Scene:
    walls = {face: Wall("friction", 0.385) for face in FACES[2]}
    return column_collapse(
        domain=(1.0, 0.6), length=0.3, height=0.24, gravity=9.81, duration=0.05, material=SAND, walls=walls
    )


def pair(scene: Scene) -> Scene:
    """The scene with a second body in the middle, so that fronts are counted from bodies."""
    body = Body((0.6, *(0.1,) * (scene.dim - 2), 0.0), (0.2,) * scene.dim, (0.0,) * scene.dim, scene.bodies[0].material)
    return replace(scene, bodies=(*scene.bodies, body))


@pytest.mark.parametrize("bodies", [1, 2])
@pytest.mark.parametrize("scene_name", ["plane", "column", "drop"])
def test_map_and_distances_are_those_that_are_measured(
    scene_name: str, bodies: int, request: pytest.FixtureRequest
) -> None:
    scene = request.getfixturevalue(scene_name)
    scene = pair(scene) if bodies == 2 else scene
    generator = np.random.default_rng(0)
    position = generator.uniform(-0.05, 1.1, (200, scene.dim))  # beyond the walls too
    volume = generator.uniform(1, 2, 200)
    place, weight = torch.from_numpy(position), torch.from_numpy(volume)
    for cell in (0.05, CELL, 5.0):
        found = differentiable_volume_map(place, weight, scene, cell).numpy()
        np.testing.assert_allclose(found, volume_map(position, volume, scene, cell), atol=1e-12)
    found = differentiable_distance(place, scene).numpy()
    np.testing.assert_allclose(found, release_distance(position, scene), atol=1e-12)


def test_a_run_has_no_error_against_itself_and_those_of_its_observables_against_another(plane: Scene) -> None:
    """The errors are written out with the stored observables of both runs."""
    one, two = (make_moving(plane, frames=8, spacing=SPACING, seed=seed) for seed in (0, 1))
    mine, fine = compute_observables(one, CELL), compute_observables(two, CELL)
    compared = compared_frames(7, 7)
    assert compared == [1, 2, 3, 4, 5, 6, 7] and compared_frames(80, 30) == [8, 16, 24, 30]
    frames = torch.from_numpy(one.position).double()
    own = outcome_errors(frames, one, mine, compared)
    assert float(own[:-1].max()) < 1e-9
    found = outcome_errors(frames, one, fine, compared)
    expected = np.zeros(len(ERRORS) - 1)
    advance = fine.advance()[:, 2]
    for frame in compared:
        volumes, wanted = mine.volume_map[frame], fine.volume_map[frame]
        expected += [
            np.square(volumes - wanted).sum() / np.square(wanted).sum(),
            (mine.mean_height[frame] / fine.mean_height[frame] - 1) ** 2,
            ((mine.advance()[frame, 2] - advance[frame]) / max(advance[-1], 2 * CELL)) ** 2,
            # at rest and on the way there: the second half
            (frame >= 4)
            * np.diff(np.sqrt([run.kinetic_energy[frame] for run in (mine, fine)]))[0] ** 2
            / fine.kinetic_energy.max(),
        ]
    np.testing.assert_allclose(found[:-1].numpy(), expected / len(compared), rtol=2e-3, atol=1e-6)


def test_rises_of_the_energy_are_what_a_push_adds(plane: Scene) -> None:
    """Free fall keeps the energy of `rise`; a push in the middle adds its work, and braking nothing."""
    start = make_start(plane, SPACING)
    dt, mass = start.dt, float(start.mass.sum())
    velocity = np.array([0.3, 0.0]) + np.arange(8)[:, None] * dt * np.array(plane.gravity)
    velocity[4:] += (0.2, 0.0)  # 4: the push
    velocity[6:] -= (0.5, 0.0)
    start = replace(start, initial_velocity=np.tile(np.float32(velocity[0]), (start.num_particles, 1)))
    path = np.concatenate([np.zeros((1, 2)), np.cumsum(dt * (velocity[1:] + velocity[:-1]) / 2, axis=0)])
    frames = torch.from_numpy(start.position[0] + path[:, None])
    fine = compute_observables(make_moving(plane, frames=8, spacing=SPACING, seed=0), CELL)
    found = float(outcome_errors(frames, start, fine, [7])[-1]) * float(fine.kinetic_energy.max())
    half = (0.4**2 - 0.3**2) / 2 + (0.5**2 - 0.4**2) / 2  # the push is spread over two of these steps
    assert found == pytest.approx(mass * half, rel=1e-3)


def case(scene: Scene, stabilised: dict[str, object]) -> tuple[Simulator, list[Tensor], object]:
    """A tiny network in float64, its weights, and the weighted loss of a run as a function."""
    simulator = make_simulator(
        dim=2, connectivity_radius=0.16, latent_size=4, input_sequence_length=2, output="gated", context=True
    ).double()
    start = make_start(scene, SPACING)
    fine = compute_observables(make_moving(scene, frames=STEPS + 1, spacing=SPACING / 2, seed=3), CELL)
    static = static_of(start)
    position = torch.from_numpy(start.position[0]).double()
    velocity = 0.3 * torch.randn(position.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(1))

    def loss() -> Tensor:
        frames = differentiable_rollout(simulator, position, velocity, static, STEPS, stabilised=stabilised)
        return (WEIGHTS * outcome_errors(frames, start, fine, compared_frames(STEPS, STEPS))).sum()

    return simulator, list(simulator.parameters()), loss


@pytest.mark.parametrize("stabilised", [{}, {"sleep": 1e-9, "min_distance": 0.01}])
def test_the_gradient_of_the_loss_is_its_difference(plane: Scene, stabilised: dict[str, object]) -> None:
    """Along a random direction of all weights; where nobody sleeps or is too near, of stabilised steps too."""
    _, parameters, loss = case(plane, stabilised)
    gradients = torch.autograd.grad(loss(), parameters)  # type: ignore[operator]
    generator = torch.Generator().manual_seed(2)
    directions = [torch.randn(p.shape, generator=generator, dtype=p.dtype) for p in parameters]
    along = sum(float((g * d).sum()) for g, d in zip(gradients, directions, strict=True))
    small, values = 1e-6, []
    with torch.no_grad():
        for sign in (1, -2):
            for parameter, direction in zip(parameters, directions, strict=True):
                parameter += sign * small * direction
            values.append(float(loss()))  # type: ignore[operator]
    assert abs(along) > 1e-3
    assert along == pytest.approx((values[0] - values[1]) / (2 * small), rel=1e-5)


def test_recomputed_steps_have_the_same_gradient(plane: Scene) -> None:
    """To the last bit in double precision, in which no way there is compiled; also where particles sleep, are moved
    apart and are slowed down, of which a step remembers something."""
    simulator = case(plane, {})[0]
    start = make_start(plane, SPACING)
    velocity = torch.randn(start.position[0].shape, generator=torch.Generator().manual_seed(4))
    velocity[len(velocity) // 2 :] = 0.0
    settings = {"sleep": 0.5, "min_distance": 0.9, "energy_limiter": True}
    found = []
    for recompute in (True, False):
        frames = differentiable_rollout(
            simulator,
            torch.from_numpy(start.position[0]),
            velocity,
            static_of(start),
            12,
            recompute=recompute,
            stabilised=settings,
        )
        found.append([frames, *torch.autograd.grad(frames[-1].square().sum(), list(simulator.parameters()))])
    for one, two in zip(*found, strict=True):
        assert torch.equal(one, two)
    assert any(float(gradient.abs().max()) > 0 for gradient in found[0][1:])


def test_a_run_that_is_nowhere_ends_there(plane: Scene) -> None:
    simulator, start = make_simulator(dim=2), make_start(plane, SPACING)
    velocity = torch.full_like(torch.from_numpy(start.initial_velocity), 1e4)  # across the whole box in a step
    frames = differentiable_rollout(simulator, torch.from_numpy(start.position[0]), velocity, static_of(start), 6)
    assert len(frames) == 2 and not bool(torch.isfinite(frames[1]).any())
