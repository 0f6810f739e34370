"""How far material goes from where it was released."""

from __future__ import annotations

import numpy as np
import pytest

from gns_pl.metrics.curves import compute_curves
from gns_pl.metrics.release import distance_from_bodies, front_advance, is_column
from gns_pl.presets import scene_names
from gns_pl.scene import Body, Box, Wall, read_scene
from tests.evaluation.made_up import LENGTH, column, moved, spreading, standing
from tests.evaluation.test_outcome import blocks


def test_distances_are_those_from_the_nearest_body() -> None:
    position = np.array([[0.5, 0.2, 0], [0.7, 0.2, 0], [1.3, 0.8, 9.0], [0.5, 0.05, 0]])
    assert distance_from_bodies(position, blocks()) == pytest.approx([-0.1, 0.1, 0.5, 0.05])


@pytest.mark.parametrize("dim", [2, 3])
def test_of_a_column_it_is_the_runout(dim: int) -> None:
    run = spreading(column(dim))
    np.testing.assert_allclose(front_advance(run), LENGTH * compute_curves(run)["runout_99"], rtol=1e-9, atol=1e-12)


def test_of_a_block_it_is_the_same_in_every_direction() -> None:
    scene = column(3).replace(bodies=(Body((0.6, 0.15, 0.0), (0.2, 0.2, 0.2), (0.0, 0.0, 0.0)),))
    still, ends = standing(scene, frames=2, spacing=0.02), []
    for direction in ([1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]):
        start, end = front_advance(moved(still, np.array([[0, 0, 0], 0.1 * np.array(direction)])))
        assert start == 0
        ends.append(end)
    assert ends == pytest.approx([ends[0]] * 4, abs=1e-6) and ends[0] == pytest.approx(0.099, abs=1e-3)


def test_what_the_laws_are_about() -> None:
    scene = column(3)
    [body] = scene.bodies
    assert is_column(scene) and is_column(column(2))
    for other in (
        scene.replace(bodies=(Body((0.1, 0.0, 0.0), body.size, body.velocity),)),
        scene.replace(bodies=(Body(body.position, (0.4, 0.3, 0.2), body.velocity),)),
        scene.replace(bodies=(Body(body.position, body.size, (1.0, 0.0, 0.0)),)),
        scene.replace(obstacles=(Box((1.0, 0.0, 0.0), (0.1, 0.5, 0.1), Wall("slip")),)),
        scene.replace(gravity=(1.0, 0.0, -9.7)),
    ):
        assert not is_column(other)
    assert not any(is_column(read_scene(name)) for name in scene_names())
