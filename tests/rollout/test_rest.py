"""Sleeping particles and scenes at rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from gns_pl.errors import InputError
from gns_pl.models.simulator import Simulator
from gns_pl.rollout import Run, rollout, unroll
from gns_pl.rollout.engine import history_of, static_of
from gns_pl.rollout.policy import Policy
from gns_pl.rollout.rest import REST_STEPS, Rest, SleepingStepper
from gns_pl.rollout.stabilise import stabilise
from gns_pl.scene import FACES, Scene, Wall, column_collapse
from gns_pl.trajectory import Trajectory
from tests.conftest import SAND, CallStepper, make_simulator, make_start
from tests.rollout.test_loops import without_loops


def long_column() -> Scene:
    """A low column along a whole long box, of which one end can be set in motion."""
    walls = dict.fromkeys(FACES[3], Wall("slip"))
    return column_collapse(
        domain=(3, 0.2, 0.5), length=2.9, height=0.2, gravity=9.81, duration=1, material=SAND, walls=walls
    )


def test_nobody_sleeps_at_once_and_while_all_move_the_steps_are_the_same(column: Scene) -> None:
    simulator, start = make_simulator(output="gated", context=True), make_start(column)
    plain = rollout(simulator, start, 8).position
    sleeping = SleepingStepper(simulator, speed=1e-9)
    assert sleeping.history_length == simulator.history_length + REST_STEPS - 1
    np.testing.assert_array_equal(rollout(sleeping, start, 8).position, plain)
    assert bool(sleeping.awake.all())


def long_still(start: Trajectory) -> torch.Tensor:
    """Positions of particles that have not moved for as long as a sleeping step looks back [N, H, D]."""
    return torch.from_numpy(start.position[0])[:, None].repeat(1, REST_STEPS + 1, 1)


@torch.inference_mode()
def with_sleepers(simulator: Simulator) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """A step's positions in full and with sleepers, and who is awake: one end moves, the rest has long been still."""
    start = make_start(long_column())
    history, static = long_still(start), static_of(start)
    step = SleepingStepper(simulator, speed=0.01)
    moving = history[:, -1, 0] > 2.5
    history[moving, :-1, 0] -= 0.01
    position = step(history, static)
    return simulator(history[:, -simulator.config.input_sequence_length :], static), position, step.awake


def test_what_is_awake_moves_as_in_the_full_step_of_two_layers() -> None:
    """Messages reach one radius around what is awake: all that two layers see, and not all that three do."""
    full, position, awake = with_sleepers(make_simulator(num_message_passing_steps=2))
    assert 0.1 < awake.float().mean() < 0.5
    torch.testing.assert_close(position[awake], full[awake], atol=1e-6, rtol=0)
    full, position, awake = with_sleepers(make_simulator(num_message_passing_steps=3))
    assert not torch.allclose(position[awake], full[awake], atol=1e-6, rtol=0)


def test_sleepers_stay_where_they_are_and_wake_by_contact() -> None:
    simulator, start = make_simulator(), make_start(long_column())
    history, static = long_still(start), static_of(start)
    step = SleepingStepper(simulator, speed=0.01)
    with torch.inference_mode():
        position = step(history, static)
        assert not bool(step.awake.any())
        assert torch.equal(position, history[:, -1])
        pushed = history.clone()
        pushed[0, :-1, 0] -= 0.01
        step(pushed, static)
    near = (history[:, -1] - history[0, -1]).norm(dim=1) < simulator.config.connectivity_radius
    assert torch.equal(step.awake, near)


def test_a_scene_at_rest_is_recognised_after_some_steps() -> None:
    rest, place = Rest(speed=0.01), torch.zeros(10, 3)
    assert [rest.reached(0, place, place, 0.1) for _ in range(REST_STEPS)] == [False] * (REST_STEPS - 1) + [True]
    moved = place.clone()
    moved[0] = 0.1
    assert not any(rest.reached(1, place, moved, 0.1) for _ in range(2 * REST_STEPS)) and rest.rested == {0}
    mostly = Rest(speed=0.01, share=0.9)
    assert [mostly.reached(1, place, moved, 0.1) for _ in range(REST_STEPS)][-1]
    with pytest.raises(InputError, match="must be positive"):
        Rest(speed=0)


def test_a_run_ends_where_its_scene_rests(drop: Scene, column: Scene) -> None:
    """A step that moves the first scene for three steps: it rests `REST_STEPS` later, the other goes on."""
    simulator = make_simulator()
    starts = [make_start(drop), make_start(column)]
    number, count = starts[0].num_particles, 0

    def step(history: torch.Tensor, static: object) -> torch.Tensor:
        nonlocal count
        count += 1
        moved = history[:, -1].clone()
        moved[: number if count <= 3 else 0] += 0.01
        moved[number if len(moved) > number else 0 :] += 0.001 * count
        return moved

    stepper = CallStepper(simulator, step)
    made = list(unroll(stepper, [Run(start, 12) for start in starts], rest=Rest(speed=0.01)))
    assert [0 in parts for parts in made] == [True] * (3 + REST_STEPS) + [False] * (9 - REST_STEPS)
    assert all(1 in parts for parts in made)


def test_a_run_that_goes_on_sleeps_as_the_one_that_never_stopped(column: Scene) -> None:
    simulator, start = make_simulator(), make_start(column)
    fast = torch.from_numpy(start.position[0, :, 0] > 0.15)

    def step(history: torch.Tensor, static: object) -> torch.Tensor:
        moved = history[:, -1].clone()
        moved[:, 0] += torch.where(fast, 0.01, 0.001)
        return moved

    stable = stabilise(CallStepper(simulator, step), sleep=0.5)
    whole = rollout(stable, start, 20).position
    asleep = (np.diff(whole[9:], axis=0) == 0).all(axis=2)
    assert asleep.any() and not asleep.all()
    past = whole[: 9 + 1][-REST_STEPS - 1 :]
    with torch.inference_mode():
        late = [parts[0].numpy() for parts in unroll(stable, [Run(start, 11, past, 9)])]
    np.testing.assert_array_equal(np.stack(late), whole[10:])


@pytest.mark.parametrize("frames", [2, 6])
def test_unknown_positions_before_the_start_are_motion(column: Scene, frames: int) -> None:
    simulator, start = make_simulator(input_sequence_length=frames), make_start(column)
    step = SleepingStepper(simulator, speed=1e6)
    history = history_of(Run(start, 1), simulator.config, step.history_length)
    assert history.shape[1] == frames + REST_STEPS - 1
    assert bool(history[:, : REST_STEPS - 1].isnan().all()) and bool(history[:, REST_STEPS - 1 :].isfinite().all())
    with torch.inference_mode():
        for places in (history, history.double()):  # compiled, and torch's
            step(places, static_of(start).in_precision(places.dtype))
            assert bool(step.awake.all())
            simulator.double()


@pytest.mark.parametrize("loops", [True, False])
@pytest.mark.parametrize("frames", [2, 6])
def test_a_layer_at_rest_falls_and_sleeps_on_the_floor_however_long_the_history(
    drop: Scene, frames: int, loops: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Under the policy, with a network that leaves all to gravity: x_n = x_0 + g Δt² n (n + 1) / 2, then the floor."""
    if not loops:
        without_loops(monkeypatch)
    simulator = make_simulator(input_sequence_length=frames)
    for weights in simulator.network.decoder[-1].parameters():
        torch.nn.init.zeros_(weights)
    body = replace(drop.bodies[0], size=(0.3, 0.3, 0.05), position=(0.3, 0.2, 0.1), velocity=(0.0, 0.0, 0.0))
    start, policy = make_start(drop.replace(bodies=(body,))), Policy()
    stable = stabilise(simulator, **policy.stabilise)
    whole = rollout(stable, start, 40, rest=policy.rest())
    fall = -9.81 * 0.01**2 * np.arange(18) * np.arange(1, 19) / 2
    expected = np.maximum(start.position[0, :, 2] + fall[:, None], 0)
    np.testing.assert_allclose(whole.position[:18, :, 2], expected, atol=1e-5, rtol=0)
    landed = int((expected[:, 0] > 0).sum())
    assert whole.provenance["at_rest_from"] == pytest.approx((landed + REST_STEPS) * 0.01)
    for steps, awake in ((landed + REST_STEPS, True), (landed + REST_STEPS + 1, False)):
        sleeping = SleepingStepper(simulator, speed=0.1)
        rollout(sleeping, start, steps)
        assert bool(sleeping.awake.all()) is bool(sleeping.awake.any()) is awake
    for made in (2, 7, landed + 3):
        past = whole.position[: made + 1][-stable.history_length :]
        runs = [Run(start, 40 - made, past, made), Run(start, 40)]  # beside one that begins
        with torch.inference_mode():
            late = [parts[0].numpy() for parts in unroll(stable, runs, rest=policy.rest()) if 0 in parts]
        np.testing.assert_array_equal(np.stack(late)[: len(whole.position) - made - 1], whole.position[made + 1 :])
