"""The standard scenes are what they say, and everything drawn stays in its ranges and in the box."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from gns_pl.errors import InputError
from gns_pl.scene import (
    FACES,
    Material,
    Wall,
    block_release,
    column_collapse,
    sample_block_release,
    sample_column_collapse,
    sample_cube_drop,
    sample_pair_release,
)

COMMON: dict[str, Any] = {"gravity": 9.81, "duration": 1.0, "material": Material(1800, 2e6, 0.3, 30)}
WALLS = {dim: {face: Wall("friction", 0.4) for face in FACES[dim]} for dim in FACES}
DROP: dict[str, Any] = {"domain": (1, 1.5, 0.8), "side": (0.25, 0.4), "speed": 1.5, "max_drop": 0.3}
BLOCK: dict[str, Any] = {"domain": (1, 1.5, 0.8), "length": (0.2, 0.5), "aspect_ratio": (0.4, 3.0), "at_wall": 0.5}
PAIR: dict[str, Any] = {
    "domain": (1.2, 0.6, 0.8),
    "length": (0.2, 0.35),
    "aspect_ratio": (0.4, 2.0),
    "at_wall": 0.5,
    "speed": 1.0,
}
COLUMN: dict[str, Any] = {"domain": (2.0, 0.5, 1.0), "length": (0.2, 0.4), "aspect_ratio": (0.5, 2.5)}
SPAN: dict[str, Any] = {"gravity": 9.81, "material": COMMON["material"], "duration_tau": 6.0}


def test_column_spans_the_width_against_the_wall() -> None:
    scene = column_collapse(domain=(1.5, 0.5, 0.7), length=0.3, height=0.6, walls=WALLS[3], **COMMON)
    assert (scene.lower, scene.upper) == ((0, 0, 0), (1.5, 0.5, 0.7))
    assert (scene.bodies[0].position, scene.bodies[0].size) == ((0, 0, 0), (0.3, 0.5, 0.6))
    assert scene.gravity == (0, 0, -9.81)
    flat = column_collapse(domain=(1.5, 0.7), length=0.3, height=0.6, walls=WALLS[2], **COMMON)
    assert flat.bodies[0].size == (0.3, 0.6)


def test_block_stands_on_the_floor_at_rest() -> None:
    scene = block_release(domain=(1, 1, 1), size=(0.2, 0.3, 0.4), position=(0.1, 0.5), walls=WALLS[3], **COMMON)
    assert scene.bodies[0].position == (0.1, 0.5, 0)
    assert scene.bodies[0].velocity == (0, 0, 0)


@pytest.mark.parametrize("dim", [2, 3])
def test_drops_stay_in_range(dim: int) -> None:
    parameters = DROP | {"domain": DROP["domain"][-dim:]}
    drawn = []
    for seed in range(300):
        scene = sample_cube_drop(np.random.default_rng(seed), walls=WALLS[dim], **parameters, **COMMON)
        (body,) = scene.bodies
        assert len(set(body.size)) == 1
        drawn.append([body.size[0], body.position[-1], max(map(abs, body.velocity))])
    low, high = np.min(drawn, axis=0), np.max(drawn, axis=0)
    assert (low >= [0.25, 0, 0]).all()
    assert (high <= [0.4, 0.3, 1.5]).all()
    assert (high - low > 0.9 * np.array([0.15, 0.3, 1.0])).all()  # and the ranges are used


def test_blocks_stay_in_range_and_half_of_them_touch_a_wall() -> None:
    touching, ratios = [], []
    for seed in range(300):
        scene = sample_block_release(np.random.default_rng(seed), walls=WALLS[3], **BLOCK, **COMMON)
        (body,) = scene.bodies
        assert 0.2 <= min(body.size[:2]) <= max(body.size[:2]) <= 0.5
        assert body.size[2] <= 0.9 * 0.8 + 1e-12
        ratios.append(body.size[2] / body.size[0])
        touching.append([abs(body.position[axis] * (body.upper[axis] - scene.upper[axis])) < 1e-9 for axis in (0, 1)])
    assert min(ratios) >= 0.4
    assert max(ratios) <= 3.0
    assert (np.mean(touching, axis=0) > 0.4).all()
    assert (np.mean(touching, axis=0) < 0.6).all()


@pytest.mark.parametrize("dim", [2, 3])
def test_pairs_stand_apart_and_move_towards_each_other(dim: int) -> None:
    domain, behind, speeds = (1.2, 0.8) if dim == 2 else (1.2, 0.6, 0.8), [], []
    for seed in range(200):
        parameters = PAIR | {"domain": domain, "walls": WALLS[dim]}
        scene = sample_pair_release(np.random.default_rng(seed), **parameters, **COMMON)
        left, right = scene.bodies
        assert left.position[0] >= 0 and left.upper[0] <= 0.6 + 1e-12 <= right.position[0] + 2e-12
        assert right.upper[0] <= 1.2 + 1e-12 and left.position[-1] == right.position[-1] == 0
        assert all(0.2 <= edge <= 0.35 for body in scene.bodies for edge in body.size[:-1])
        assert left.velocity[0] >= 0 >= right.velocity[0] and not any(left.velocity[1:] + right.velocity[1:])
        behind.append([left.position[0] < 1e-9, right.upper[0] > 1.2 - 1e-9])
        speeds.append(left.velocity[0] - right.velocity[0])
    assert (np.abs(np.mean(behind, axis=0) - 0.5) < 0.12).all()
    assert min(speeds) > 0 and 1.6 < max(speeds) <= 2.0


@pytest.mark.parametrize("dim", [2, 3])
def test_columns_stay_in_range_and_run_for_their_own_time(dim: int) -> None:
    domain = COLUMN["domain"] if dim == 3 else (2.0, 1.0)
    drawn = []
    for seed in range(300):
        parameters = COLUMN | SPAN | {"domain": domain, "walls": WALLS[dim]}
        scene = sample_column_collapse(np.random.default_rng(seed), **parameters)
        (body,) = scene.bodies
        length, height = body.size[0], body.size[-1]
        assert body.position == (0,) * dim
        assert body.velocity == (0,) * dim
        assert body.size[1:-1] == domain[1:-1]
        assert scene.duration == pytest.approx(6 * np.sqrt(height / 9.81))
        drawn.append([length, height / length])
    low, high = np.min(drawn, axis=0), np.max(drawn, axis=0)
    assert (low >= [0.2, 0.5 - 1e-12]).all()
    assert (high <= [0.4, 2.5 + 1e-12]).all()
    assert (high - low > 0.9 * np.array([0.2, 2.0])).all()


@pytest.mark.parametrize(
    ("sampler", "parameters"), [(sample_cube_drop, DROP), (sample_block_release, BLOCK), (sample_pair_release, PAIR)]
)
def test_the_same_seed_draws_the_same_scene(sampler: Any, parameters: dict[str, Any]) -> None:
    def draw(seed: int) -> Any:
        return sampler(np.random.default_rng(seed), walls=WALLS[3], **parameters, **COMMON)

    assert draw(3) == draw(3)
    assert draw(3) != draw(4)


@pytest.mark.parametrize(
    ("sampler", "parameters", "changes", "sentence"),
    [
        (sample_cube_drop, DROP, {"side": (0.4, 0.25)}, "side must be two positive numbers, the smaller first"),
        (sample_cube_drop, DROP, {"side": (0, 0.25)}, "side must be two positive"),
        (sample_cube_drop, DROP, {"side": (0.25,)}, "side must be two positive"),
        (sample_cube_drop, DROP, {"side": "big"}, "side must be a list of numbers"),
        (sample_cube_drop, DROP, {"side": (0.3, 0.9)}, "does not fit a domain"),
        (sample_cube_drop, DROP, {"speed": -1}, "speed must be"),
        (sample_cube_drop, DROP, {"speed": float("nan")}, "speed must be"),
        (sample_cube_drop, DROP, {"max_drop": -0.1}, "max_drop must be"),
        (sample_cube_drop, DROP, {"domain": (1, "x", 1)}, "domain must be a list of numbers"),
        (sample_block_release, BLOCK, {"length": (0.2, 1.0)}, "does not fit a domain"),
        (sample_block_release, BLOCK, {"aspect_ratio": 0.5}, "aspect_ratio must be a list of numbers"),
        (sample_block_release, BLOCK, {"aspect_ratio": (0, 1)}, "aspect_ratio must be two positive"),
        (sample_block_release, BLOCK, {"at_wall": 1.5}, "at_wall is a probability"),
        (sample_block_release, BLOCK, {"at_wall": "often"}, "at_wall must be a number"),
    ],
)
def test_ranges_that_make_no_sense_are_refused(
    sampler: Any, parameters: dict[str, Any], changes: dict[str, Any], sentence: str
) -> None:
    with pytest.raises(InputError, match=sentence):
        sampler(np.random.default_rng(0), walls=WALLS[3], **(parameters | changes), **COMMON)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"length": (0.4, 0.2)}, "length must be two positive numbers"),
        ({"aspect_ratio": (0, 2)}, "aspect_ratio must be two positive numbers"),
        ({"aspect_ratio": (0.5, 2.6)}, "a length of 0.4 m with an aspect ratio of 2.6 does not fit a domain"),
        ({"domain": (0.4, 0.5, 1.0)}, "does not fit a domain"),
        ({"duration_tau": 0}, "duration_tau must be a finite number above 0"),
        ({"duration_tau": "long"}, "duration_tau must be a number"),
    ],
)
def test_columns_that_make_no_sense_are_refused(changes: dict[str, Any], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        sample_column_collapse(np.random.default_rng(0), walls=WALLS[3], **(COLUMN | SPAN | changes))
