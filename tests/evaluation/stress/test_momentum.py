"""The momentum that gravity and walls explain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gns_pl.evaluation.stress.momentum import momentum_residual
from gns_pl.mpm import MPMConfig, simulate
from gns_pl.scene import FACES, Scene, Wall
from tests.conftest import MPM, make_start

DT = 0.01


def driven(scene: Scene, acceleration: tuple[float, float, float], steps: int = 6):
    """All particles of a scene under one acceleration, from rest."""
    start = make_start(scene)
    time = np.arange(steps + 1)[:, None, None] * DT
    position = start.position[:1].astype(np.float64) + 0.5 * np.array(acceleration) * time**2
    return replace(start, position=position)


def test_free_fall_needs_nothing(drop: Scene) -> None:
    np.testing.assert_allclose(momentum_residual(driven(drop, (0, 0, -9.81)), 0.05), 0, atol=1e-6)


def test_a_push_in_the_air_is_explained_by_nothing(drop: Scene) -> None:
    np.testing.assert_allclose(momentum_residual(driven(drop, (3, 0, -9.81)), 0.05), 3 / 9.81, rtol=1e-6)


@pytest.mark.parametrize(
    ("acceleration", "residual"),
    [
        ((0.0, 0.0, 0.0), 0.0),  # the floor carries it
        ((0.38 * 9.81, 0.0, 0.0), 0.0),  # Coulomb friction, or the wall behind it
        ((1.5 * 9.81, 0.0, 0.0), 0.0),  # the wall behind pushes as much as it likes
        ((-1.0, 0.0, 0.0), 0.0),  # friction of the floor
        ((-0.385 * 9.81 - 1.0, 0.0, 0.0), None),  # more than that
        ((0.0, 0.0, -9.81 - 2.0), 2 / 9.81),  # no floor pulls; friction cannot help
    ],
)
def test_walls_push_and_rub_and_do_not_pull(column: Scene, acceleration, residual) -> None:
    walls = {**column.walls, "x-": Wall("slip"), "y-": Wall("slip"), "y+": Wall("slip"), "x+": Wall("slip")}
    found = momentum_residual(driven(column.replace(walls=walls), acceleration), 0.06)
    if residual is None:
        slope = 1 / np.hypot(1, 0.385)  # distance from the cone's side
        np.testing.assert_allclose(found, slope / 9.81, rtol=1e-5)
    else:
        np.testing.assert_allclose(found, residual, atol=1e-5)


def test_the_material_point_method_accounts_for_its_momentum(column: Scene) -> None:
    made = simulate(column.replace(duration=0.6), MPMConfig(cell_size=0.1, **MPM), frame_interval=0.01)
    residual = momentum_residual(made, 0.1)
    assert np.quantile(residual, 0.95) < 0.02
    assert set(column.walls) == set(FACES[3])
