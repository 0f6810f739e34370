"""What keeps a run within physical limits: nothing where it is, and each promise kept where it is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree

from gns_pl.data.solids import surfaces_of
from gns_pl.errors import InputError
from gns_pl.graph import Surfaces
from gns_pl.models.simulator import Simulator
from gns_pl.rollout import Run, rollout, unroll
from gns_pl.rollout.engine import history_of, static_of
from gns_pl.rollout.failure import Watch
from gns_pl.rollout.stabilise import stabilise
from gns_pl.scene import Scene
from tests.conftest import CallStepper, make_simulator, make_start
from tests.rollout.test_loops import without_loops


def wild() -> Simulator:
    """A simulator that makes energy out of nothing."""
    simulator = make_simulator()
    for weights in simulator.network.parameters():
        weights.data *= 3.0
    return simulator


def test_nothing_asked_for_is_the_simulator_itself() -> None:
    simulator = make_simulator()
    assert stabilise(simulator) is simulator


def test_free_fall_is_left_alone(drop: Scene) -> None:
    simulator, start = make_simulator(), make_start(drop, spacing=0.15)  # no neighbours within the radius
    plain = rollout(simulator, start, 12).position
    stable = stabilise(simulator, energy_limiter=True, min_distance=0.2)
    np.testing.assert_array_equal(rollout(stable, start, 12).position, plain)


@pytest.mark.parametrize("loops", [True, False])
def test_the_centre_of_mass_of_what_flies_falls_freely(
    drop: Scene, column: Scene, loops: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """x(k Δt) = x0 + k v Δt + g Δt² k (k + 1) / 2 until a wall may be felt, whatever pushes the particles around."""
    if not loops:
        without_loops(monkeypatch)
    start, beside = make_start(drop), make_start(column)
    stable, radius = stabilise(wild(), min_distance=0.2), wild().config.connectivity_radius
    with torch.inference_mode():
        parts = list(unroll(stable, [Run(start, 30), Run(beside, 30)]))
    position = np.concatenate([start.position, np.stack([part[0].numpy() for part in parts])]).astype(np.float64)
    room = np.minimum(position - drop.lower, np.array(drop.upper) - position).min(axis=(1, 2))
    flight = int((room <= radius).argmax())  # the first frame near a wall
    assert flight > 6
    count = np.arange(flight)[:, None]
    free = position[0].mean(axis=0) + count * 0.01 * np.array(drop.bodies[0].velocity)
    free[:, 2:] -= 9.81 * 0.01**2 * count * (count + 1) / 2
    np.testing.assert_allclose(position[:flight].mean(axis=1), free, atol=2e-4, rtol=0)
    raw = rollout(wild(), start, 6).position[6].mean(axis=0)
    assert np.abs(raw - free[6]).max() > 2e-3
    others = rollout(stabilise(wild(), min_distance=0.2), beside, 30).position[-1]  # the column stands at walls
    np.testing.assert_allclose(parts[-1][1].numpy(), others, atol=1e-5, rtol=0)


@pytest.mark.parametrize("loops", [True, False])
def test_what_stands_in_the_box_or_moves_by_a_script_may_push(
    drop: Scene, loops: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not loops:
        without_loops(monkeypatch)
    start, simulator = make_start(drop), make_simulator(particle_types=(3, 6))
    aside = torch.tensor([0.0, 0.004, 0.0])
    stable = stabilise(
        CallStepper(simulator, lambda history, _: 2 * history[:, -1] - history[:, -2] + aside), sleep=0.1
    )
    history = history_of(Run(start, 1), simulator.config, stable.history_length)
    scripted = np.where(np.arange(start.num_particles) < 2, 3, 6)
    surfaces = Surfaces.joined([surfaces_of(drop, simulator.config.spacing)])
    scenes = {
        "free": static_of(start),
        "a level floor": replace(static_of(start), surfaces=surfaces),
        "an obstacle": replace(static_of(start), surfaces=replace(surfaces, inner=True)),
        "a script": static_of(replace(start, particle_type=scripted)),
    }
    fall = torch.tensor([0.0, 0.0, -9.81e-4])
    for name, scene in scenes.items():
        moved = (stable(history, scene) - 2 * history[:, -1] + history[:, -2])[-1]
        expected = fall if name in ("free", "a level floor") else aside
        torch.testing.assert_close(moved, expected, atol=1e-6, rtol=0, msg=name)


def test_derivatives_of_what_flies_are_those_without_its_mean(drop: Scene) -> None:
    simulator, start = make_simulator(), make_start(drop)
    history = history_of(Run(start, 1), simulator.config, frames=8)
    shift = 0.001 + 0.001 * torch.randn(len(history), 3, generator=torch.Generator().manual_seed(0))
    told = (2 * history[:, -1] - history[:, -2] + shift).requires_grad_()
    made, plain = (
        stabilise(CallStepper(simulator, lambda _history, _scenes, each=each: each), sleep=0.1)(  # type: ignore[misc]
            history, static_of(start)
        )
        for each in (told, told.detach())
    )
    torch.testing.assert_close(made, plain, atol=1e-6, rtol=0)
    (gradient,) = torch.autograd.grad(made[0].sum(), told)
    expected = torch.full_like(gradient, -1 / len(history))
    expected[0] += 1
    torch.testing.assert_close(gradient, expected, atol=1e-6, rtol=0)


@pytest.mark.parametrize("thrown", [(0.0, 0.0, 2.0), (0.0, 0.0, -2.0), (1.0, 0.0, 0.0)])
def test_energy_never_rises(drop: Scene, thrown: tuple[float, float, float]) -> None:

    scene = drop.replace(bodies=(replace(drop.bodies[0], velocity=thrown),))
    start = make_start(scene)
    watch = Watch(start, 0.01)
    made = rollout(wild(), start, 30)
    for frame in made.position[1:]:
        watch.look(frame)
    assert watch.rise > 0.01  # it is wild
    watch, made = Watch(start, 0.01), rollout(stabilise(wild(), energy_limiter=True), start, 30)
    for frame in made.position[1:]:
        assert watch.look(frame) is None or watch.failure.kind != "energy"
    assert watch.rise < 1e-4


def test_scenes_of_a_batch_are_scaled_each_on_its_own(column: Scene, drop: Scene) -> None:
    simulator, starts = wild(), [make_start(column), make_start(drop)]
    stable = stabilise(simulator, energy_limiter=True)
    with torch.inference_mode():
        history = torch.cat([history_of(Run(start, 1), simulator.config) for start in starts])
        together = stable(history, static_of(*starts))
        alone = [
            stabilise(simulator, energy_limiter=True)(history_of(Run(start, 1), simulator.config), static_of(start))
            for start in starts
        ]
    torch.testing.assert_close(together, torch.cat(alone), atol=1e-6, rtol=0)


def test_particles_are_moved_apart_and_stay_in_the_box(column: Scene) -> None:
    simulator, start = make_simulator(), make_start(column)
    close = start.position[0].copy()
    close[1] = close[0] + [1e-4, 0, 0]
    close[3] = close[2]  # in one place
    history = torch.from_numpy(np.repeat(close[:, None], 4, axis=1))
    static = static_of(start)
    stable = stabilise(simulator, min_distance=0.3)
    with torch.inference_mode():
        before, after = simulator(history, static).numpy(), stable(history, static).numpy()
    least = 0.3 * simulator.config.spacing
    assert cKDTree(before).query(before, k=2)[0][:, 1].min() < 0.1 * least
    assert cKDTree(after).query(after, k=2)[0][:, 1].min() > 0.9 * least
    moved = np.abs(after - before).max(axis=1) > 1e-7
    assert moved.sum() < 12  # and nobody else
    assert (after >= np.array(column.lower)).all() and (after <= np.array(column.upper)).all()
    np.testing.assert_allclose(after[moved].mean(axis=0), before[moved].mean(axis=0), atol=0.1 * least)


def test_what_sleeps_does_not_creep(column: Scene) -> None:
    simulator, start = make_simulator(output="gated"), make_start(column)
    made = rollout(stabilise(simulator, sleep=100.0), start, 12).position  # faster than anything
    np.testing.assert_array_equal(made[5:], np.repeat(made[5:6], len(made) - 5, axis=0))
    assert np.abs(made[4] - made[0]).max() > 0


@pytest.mark.parametrize("settings", [{"sleep": -1.0}, {"min_distance": 1.0}])
def test_limits_that_make_no_sense_are_refused(settings: dict[str, float]) -> None:
    with pytest.raises(InputError, match=r"stabilise\."):
        stabilise(make_simulator(), **settings)


def test_who_sleeps_does_so_where_no_message_can_be_saved(column: Scene) -> None:
    simulator, start = make_simulator(output="gated"), make_start(column)
    stable = stabilise(CallStepper(simulator, simulator), sleep=100.0)
    made = rollout(stable, start, 12).position
    np.testing.assert_array_equal(made[5:], np.repeat(made[5:6], len(made) - 5, axis=0))
    assert np.abs(made[4] - made[0]).max() > 0


@pytest.mark.parametrize("moves", [True, False])
def test_obstacles_that_move_do_work(column: Scene, moves: bool) -> None:
    """Where kinematic particles push, the energy may rise, so nothing is scaled; where they stand still, it is."""
    torch.manual_seed(0)
    simulator = make_simulator(particle_types=(3, 6))
    for weights in simulator.network.parameters():
        weights.data *= 3.0
    start = make_start(column)
    types = np.where(np.arange(start.num_particles) < 8, 3, 6)
    script = np.repeat(start.position, 6, axis=0)
    velocity = np.zeros_like(start.initial_velocity)
    if moves:
        script[:, :8, 0] += 0.01 * np.arange(6)[:, None]
        velocity[:8, 0] = 1.0
    start = replace(start, position=script, particle_type=types, initial_velocity=velocity)
    plain = rollout(simulator, start, 5).position
    stable = rollout(stabilise(simulator, energy_limiter=True), start, 5).position
    np.testing.assert_array_equal(stable[:, :8], script[:, :8])
    assert np.array_equal(stable, plain) is moves


def test_derivatives_go_past_shifts_and_through_the_factor_that_scales(column: Scene) -> None:
    """Where particles were moved apart the derivative is that of the step; where all are slowed down, by the factor."""
    simulator, start = make_simulator(), make_start(column)
    static, history = static_of(start), history_of(Run(start, 1), simulator.config)
    shift = 0.03 * torch.randn(len(history), 3, generator=torch.Generator().manual_seed(0))
    history[:, -2] = history[:, -1] - 0.5 * shift  # a quarter of the energy that is asked for
    for settings in ({"min_distance": 0.9}, {"energy_limiter": True}):
        told = (history[:, -1] + shift).requires_grad_()
        made, plain = (
            stabilise(CallStepper(simulator, lambda _history, _scenes, each=each: each), **settings)(history, static)  # type: ignore[arg-type, misc]
            for each in (told, told.detach())
        )
        assert torch.equal(made, plain)  # derivatives change no number
        moved, asked = (made - history[:, -1]).detach(), (told - history[:, -1]).detach()
        assert not torch.equal(moved, asked)
        factor = 1.0 if "min_distance" in settings else float((moved * asked).sum() / asked.square().sum())
        assert factor == 1.0 or 0.3 < factor < 0.7
        (gradient,) = torch.autograd.grad(made.sum(), told)
        torch.testing.assert_close(gradient, torch.full_like(gradient, factor))


@pytest.mark.parametrize(("sleep", "speed", "begun"), [(0.1, 0.08, 0.08), (0.1, 0.2, 0.1), (0.0, 0.08, 0.0)])
def test_what_begins_from_rest_is_not_held(column: Scene, sleep: float, speed: float, begun: float) -> None:
    """All are pushed aside on a level, and nothing falls: before anybody can sleep, so much motion is no energy."""
    simulator, start = make_simulator(input_sequence_length=2), make_start(column)
    aside = torch.tensor([speed * simulator.config.dt, 0.0, 0.0])
    pushed = CallStepper(simulator, lambda history, _: history[:, -1] + aside)
    stable = stabilise(pushed, sleep=sleep, energy_limiter=True)
    history = history_of(Run(start, 1), simulator.config, frames=stable.history_length)
    for places in (history, history.double()):  # compiled, and torch's
        moved = (stable(places, static_of(start)) - places[:, -1]) / simulator.config.dt
        wanted = torch.tensor([begun, 0.0, 0.0]).to(moved)
        torch.testing.assert_close(moved.mean(dim=0), wanted, atol=3e-3, rtol=0)  # what rounding is allowed
    if sleep:  # later, what was at rest is held
        later = history[:, -1:].repeat(1, stable.history_length, 1)
        later[: len(later) // 2, -2] -= 2 * sleep * simulator.config.dt * torch.tensor([1.0, 0.0, 0.0])  # wakes all
        faster = CallStepper(simulator, lambda history, _: history[:, -1] + 100 * aside)
        made = stabilise(faster, sleep=sleep, energy_limiter=True)(later, static_of(start))
        motion = ((made - later[:, -1]) / simulator.config.dt).square().sum(1).mean()
        before = ((later[:, -1] - later[:, -2]) / simulator.config.dt).square().sum(1).mean()
        assert motion <= 1.05 * before
        scenes = static_of(start, start)  # each on its own beside one that begins
        beside = stabilise(faster, sleep=sleep, energy_limiter=True)(torch.cat([later, history]), scenes)
        torch.testing.assert_close(beside[: len(made)], made, atol=0, rtol=0)
