"""A heap that rests by statics does not move, and whatever else begins at rest goes as it went."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from gns_pl.fields import ParticleType
from gns_pl.rollout import Run, rollout, unroll
from gns_pl.rollout.engine import history_of
from gns_pl.rollout.policy import Policy
from gns_pl.rollout.stabilise import stabilise
from gns_pl.rollout.statics import is_resting_heap, steepest_slope
from gns_pl.scene import Body, Box, Scene, Wall
from gns_pl.trajectory import Trajectory
from tests.conftest import make_simulator, make_start
from tests.rollout.test_loops import without_loops


def wedge(scene: Scene, slope_deg: float, height: float = 0.5, lifted: float = 0.0, **changes: Any) -> Trajectory:
    """A heap at the lower wall, as wide as the box, that falls at a slope to the floor [degrees, m]."""
    body = Body((0.0, 0.0, 0.0), (1.5, 0.5, height), (0.0, 0.0, 0.0), material=scene.bodies[0].material)
    whole = make_start(scene.replace(bodies=(body,), **changes))
    x, _, z = whole.position[0].T
    kept = z < height - x * math.tan(math.radians(slope_deg))
    arrays = ("particle_type", "material", "mass", "initial_velocity")
    position = whole.position[:, kept] + np.array([0.0, 0.0, lifted], dtype=np.float32)
    return replace(whole, position=position, **{name: getattr(whole, name)[kept] for name in arrays})


def with_floor(scene: Scene, floor: Wall) -> dict[str, Any]:
    return {"walls": {**scene.walls, "z-": floor}}


@pytest.mark.parametrize(("slope_deg", "rests"), [(0.0, True), (15.0, True), (26.0, True), (40.0, False)])
def test_a_heap_rests_up_to_the_slope_of_its_friction(column: Scene, slope_deg: float, rests: bool) -> None:
    assert column.materials["sand"].friction_angle_deg == 30
    assert is_resting_heap(wedge(column, slope_deg)) is rests
    weaker = replace(column.materials["sand"], friction_angle_deg=10.0, dilation_angle_deg=0.0)
    assert is_resting_heap(wedge(column, slope_deg, materials={"sand": weaker})) is (slope_deg == 0)


def test_what_does_not_rest_on_the_floor_alone_is_left_to_the_network(column: Scene, drop: Scene) -> None:
    heap = wedge(column, 26.0)
    moving, types = heap.initial_velocity.copy(), heap.particle_type.copy()
    moving[3, 0], types[3] = 0.1, int(ParticleType.KINEMATIC)
    others = {
        "a column": make_start(column),
        "a drop": make_start(drop),
        "a grain that moves": replace(heap, initial_velocity=moving),
        "a script": replace(heap, particle_type=types),
        "tilted": wedge(column, 0.0, gravity=(1.0, 0.0, -9.81)),
        "upwards": wedge(column, 0.0, gravity=(0.0, 0.0, 9.81)),
        "an obstacle": wedge(column, 26.0, obstacles=(Box((1.3, 0.1, 0.0), (0.1, 0.1, 0.1), Wall("stick")),)),
        "a layer in the air": wedge(column, 0.0, height=0.2, lifted=0.1),
        "a smooth floor": wedge(column, 26.0, **with_floor(column, Wall("slip"))),
        "a weak floor": wedge(column, 26.0, **with_floor(column, Wall("friction", 0.1))),
    }
    assert [name for name, start in others.items() if is_resting_heap(start)] == []
    rough = [wedge(column, 26.0, **with_floor(column, wall)) for wall in (Wall("stick"), Wall("friction", 0.385))]
    assert all(map(is_resting_heap, [heap, *rough]))


@pytest.mark.parametrize("angle_deg", [10.0, 30.0, 45.0])
def test_the_steepest_slope_is_that_of_the_sand_on_a_rough_floor_and_rankines_on_a_smooth_one(angle_deg: float) -> None:
    internal = math.tan(math.radians(angle_deg))
    assert steepest_slope(angle_deg, math.inf) == pytest.approx(internal, rel=1e-3)
    assert steepest_slope(angle_deg, 0.0) == 0.0
    active = math.tan(math.radians(45 - angle_deg / 2)) ** 2
    assert steepest_slope(angle_deg, 1e-4) == pytest.approx(1e-4 / active, rel=1e-3)
    slopes = [steepest_slope(angle_deg, friction) for friction in (0.01, 0.05, 0.2, 0.6)]
    assert slopes == sorted(slopes)


@pytest.mark.parametrize("loops", [True, False])
def test_a_heap_that_rests_stays_where_it_is(column: Scene, loops: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever the network says: it moves the heap by itself, and under the policy one that is too steep."""
    if not loops:
        without_loops(monkeypatch)
    simulator, policy = make_simulator(output="gated", context=True, input_sequence_length=2), Policy()
    stable, heap = stabilise(simulator, **policy.stabilise), wedge(column, 26.0)
    run = rollout(stable, heap, 20, rest=policy.rest())
    np.testing.assert_array_equal(run.position, np.repeat(heap.position, len(run.position), axis=0))
    assert run.provenance["at_rest_from"] == pytest.approx(0.05)
    assert np.abs(rollout(simulator, heap, 6).position[-1] - heap.position[0]).max() > 1e-3
    assert np.abs(rollout(stable, wedge(column, 40.0), 6).position[-1] - wedge(column, 40.0).position[0]).max() > 1e-3
    past = heap.position[[0, 0, 0]]
    with torch.inference_mode():  # one that goes on early, beside one that flows
        parts = list(unroll(stable, [Run(heap, 6, past, 2), Run(make_start(column), 6)]))
    assert all(np.array_equal(part[0].numpy(), heap.position[0]) for part in parts)
    flow = rollout(stable, make_start(column), 6).position
    np.testing.assert_allclose(np.stack([part[1].numpy() for part in parts]), flow[1:], atol=1e-6, rtol=0)


def test_only_a_heap_that_rests_has_a_known_past(column: Scene) -> None:
    simulator = make_simulator(input_sequence_length=2)
    for start, known in ((wedge(column, 26.0), True), (wedge(column, 40.0), False)):
        history = history_of(Run(start, 1), simulator.config, frames=6)
        assert history.shape[1] == 6 and bool(history[:, :4].isnan().all()) is not known
        assert history_of(Run(start, 1), simulator.config).equal(history[:, 4:])
