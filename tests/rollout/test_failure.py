"""When a run has failed: what falls freely, slides and rests has not; an unphysical state has, at the right frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gns_pl.fields import ParticleType
from gns_pl.mpm import MPMConfig, simulate
from gns_pl.rollout import rollout
from gns_pl.rollout.failure import ENERGY, Watch, first_failure
from gns_pl.scene import Scene
from tests.conftest import MPM, make_simulator, make_start

DT = 0.01


def falling(scene: Scene, steps: int) -> np.ndarray:
    """Free fall of a scene's particles by semi-implicit Euler, as simulators step [T, N, D]."""
    start = make_start(scene)
    velocity, frames = start.initial_velocity.astype(np.float64), [start.position[0].astype(np.float64)]
    for _ in range(steps):
        velocity = velocity + np.array(scene.gravity) * DT
        frames.append(frames[-1] + velocity * DT)
    return np.stack(frames)


@pytest.mark.parametrize("upwards", [2.0, 0.0, -2.0])
def test_free_fall_keeps_its_energy_and_is_no_failure(drop: Scene, upwards: float) -> None:
    body = replace(drop.bodies[0], velocity=(0.5, -0.2, upwards))
    scene = drop.replace(bodies=(body,))
    frames = falling(scene, 5)
    watch = Watch(make_start(scene), DT)
    assert all(watch.look(frame) is None for frame in frames[1:])
    energy = np.array(watch.energy[1:])
    np.testing.assert_allclose(energy, energy[0], rtol=1e-12)
    assert watch.rise < 1e-12


@pytest.mark.parametrize(
    ("spoil", "kind"),
    [
        (lambda x: np.where(np.arange(len(x))[:, None] == 3, np.nan, x), "not finite"),
        (lambda x: x + np.where(np.arange(len(x))[:, None] == 3, [0.2, 0.0, 0.0], 0.0), "speed"),
        (lambda x: np.where(np.arange(len(x))[:, None] < len(x) // 4, x[:1] + 1e-4, x), "clumping"),
        (lambda x: x + np.array([0.0, 0.0, 0.03]), "energy"),
    ],
)
def test_each_condition_is_met_by_what_it_is_for(column: Scene, spoil, kind) -> None:
    start = make_start(column)
    watch, rest = Watch(start, DT), start.position[0]
    assert watch.look(rest) is None and watch.look(rest) is None
    failure = watch.look(spoil(rest.astype(np.float64)))
    if kind == "clumping":  # brought together at once they are too fast as well
        watch = Watch(start, 1e3)
        failure = watch.look(spoil(rest.astype(np.float64)))
        assert failure is not None and failure.kind == "clumping"
        return
    assert failure is not None and failure.kind == kind
    assert failure.time == pytest.approx(3 * DT) and "0.03 s" in failure.message
    assert watch.look(rest) is failure  # the first one stays


def test_a_wall_may_be_entered_by_few_and_not_deeply(column: Scene) -> None:
    start = make_start(column)
    watch = Watch(start, 1e3)  # so that nothing is fast
    into = start.position[0].astype(np.float64)
    into[:10, 0] = -0.02
    assert watch.look(into) is None  # 0.4 spacings
    into[:10, 0] = -0.03
    failure = watch.look(into)
    assert failure is not None and failure.kind == "penetration"


def test_energy_may_rise_by_one_per_cent_of_the_start_over_the_least_since(column: Scene) -> None:
    start = make_start(column)
    height = float(start.position[0, :, 2].mean())
    low, step = start.position[0] * [1, 1, 0.8], np.array([0, 0, ENERGY * height])
    for share, fails in ((0.9, False), (1.1, True)):
        watch = Watch(start, 1e3)
        watch.look(low)
        assert watch.look(low) is None
        watch.look(low + share * step)
        assert (watch.look(low + share * step) is not None) == fails


def test_kinematic_particles_may_lift_the_sand(column: Scene) -> None:
    start = make_start(column)
    kinds = np.where(np.arange(start.num_particles) == 0, int(ParticleType.KINEMATIC), start.particle_type)
    watch = Watch(replace(start, particle_type=kinds), 1e3)
    assert watch.look(start.position[0] + [0, 0, 0.1]) is None


def test_a_run_that_goes_on_is_looked_at_from_its_last_frame(drop: Scene) -> None:
    frames = falling(drop, 6)
    watch = Watch(make_start(drop), DT, before=frames[4], made=4)
    assert watch.look(frames[5]) is None
    failure = watch.look(frames[6] * np.nan)
    assert failure is not None and failure.time == pytest.approx(0.06)


def test_the_material_point_method_does_not_fail(column: Scene) -> None:
    config = MPMConfig(cell_size=0.1, **MPM)
    made = simulate(column.replace(duration=0.8), config, frame_interval=0.02)
    assert first_failure(made) is None


def test_looking_at_some_frames_alone_sees_what_lasts(column: Scene) -> None:
    start = make_start(column)
    watch, lifted = Watch(start, DT, every=4), start.position[0] + np.array([0, 0, 0.03])
    rest = start.position[0]
    assert [watch.look(each) is not None for each in (rest, rest, lifted, lifted)] == [False, False, False, True]
    assert watch.failure is not None and watch.failure.time == pytest.approx(0.04)


def test_a_rollout_ends_at_its_failure_and_says_so(column: Scene) -> None:
    simulator, start = make_simulator(), make_start(column)
    for weights in simulator.network.parameters():
        weights.data *= 3.0
    whole = rollout(simulator, start, 40)
    wanted = first_failure(whole)
    assert wanted is not None
    made = rollout(simulator, start, 40, watch=Watch(start, simulator.config.dt))
    assert made.num_frames == round(wanted.time / DT) + 1
    assert made.provenance["failure"] == wanted.message and made.provenance["failed_at"] == wanted.time


def test_frames_that_are_not_needed_may_be_passed_over(column: Scene) -> None:
    start = make_start(column)
    rest, lifted = start.position[0], start.position[0] + np.array([0, 0, 0.03])
    frames = [rest, rest, rest, lifted, lifted, lifted, rest, rest]
    all_shown, some_shown = Watch(start, DT, every=4), Watch(start, DT, every=4)
    shown = 0
    for frame in frames:
        all_shown.look(frame)
        if some_shown.due:
            shown += 1
            some_shown.look(frame)
        else:
            some_shown.skip()
    assert shown == 4 and some_shown.failure == all_shown.failure and some_shown.failure is not None
