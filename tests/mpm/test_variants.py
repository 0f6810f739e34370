"""One source, several kernels: threads, float32 and linear shape functions beside the plain one."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numba
import numpy as np
import pytest

from gns_pl.errors import InputError
from gns_pl.mpm import simulate
from gns_pl.mpm.shape import axis_shape, linear_axis_shape
from gns_pl.scene import Body, Plane, Scene, Wall
from tests.mpm.conftest import make_box, make_mpm

DIMS = pytest.mark.parametrize("dim", [2, 3])


def collision(dim: int, duration: float = 0.25) -> Scene:
    """Two blocks, rough walls and a slope, so that every branch of the kernels is taken."""
    left = Body((0.0, *(0.1,) * (dim - 2), 0.15), (0.25,) * dim, (1.0,) + (0.0,) * (dim - 1))
    right = Body((0.45, *(0.2,) * (dim - 2), 0.1), (0.25,) * dim, (-1.0,) + (0.0,) * (dim - 1))
    slope = Plane((0.0,) * (dim - 1) + (0.1,), (0.2,) + (0.0,) * (dim - 2) + (1.0,), Wall("friction", 0.3))
    scene = make_box((0.8,) * dim, left, right, duration=duration, wall=Wall("friction", 0.385))
    return scene.replace(obstacles=(slope,))


@pytest.mark.skipif(numba.config.NUMBA_NUM_THREADS < 2, reason="one thread only")
@pytest.mark.parametrize("dim", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_threads_do_not_change_a_bit(dim: int) -> None:
    config = make_mpm(points_per_direction=2, jitter=0.5)
    one, two = (simulate(collision(dim), config, frame_interval=0.025, num_threads=n) for n in (1, 2))
    assert two.provenance["num_threads"] == 2
    np.testing.assert_array_equal(one.position, two.position)


def test_more_threads_than_there_are_is_refused() -> None:
    with pytest.raises(InputError, match="num_threads must lie between 1 and"):
        simulate(collision(2), make_mpm(), frame_interval=0.05, num_threads=10_000)


@DIMS
def test_float32_follows_float64(dim: int) -> None:
    """Early within rounding; later contacts open and close a step apart, and only the whole agrees."""
    scene = collision(dim, duration=0.2)
    double, single = (
        simulate(scene, make_mpm(points_per_direction=2, jitter=0.5, precision=precision), frame_interval=0.01)
        for precision in ("float64", "float32")
    )
    assert np.abs(single.position[2] - double.position[2]).max() < 1e-6
    assert np.abs(single.position[-1] - double.position[-1]).mean() < 1e-4


@pytest.mark.parametrize("function", [axis_shape, linear_axis_shape])
def test_every_shape_function_is_a_partition_of_unity_with_exact_linear_fields(function: object) -> None:
    for x in np.linspace(0.0, 5.0, 201):
        base, *rest = function(float(x), 5)  # type: ignore[operator]
        weights, gradients, moment = np.array(rest[:3]), np.array(rest[3:6]), rest[6]
        nodes = base + np.arange(3)
        acting = weights @ nodes
        assert weights.sum() == pytest.approx(1.0, abs=1e-14)
        assert weights.min() >= 0
        assert 0 <= base <= 3
        assert gradients.sum() == pytest.approx(0.0, abs=1e-13)
        assert gradients @ nodes == pytest.approx(1.0, abs=1e-12)
        assert weights @ (nodes - acting) ** 2 == pytest.approx(moment, abs=1e-12)


@pytest.mark.slow
def test_linear_shape_functions_are_another_scheme_of_the_same_sand() -> None:
    scene = make_box((1.0, 0.5), Body((0.0, 0.0), (0.3, 0.3), (0.0, 0.0)), duration=0.8, lower_z=Wall("friction", 0.4))
    quadratic, linear = (
        simulate(scene, make_mpm(shape=shape), frame_interval=0.02) for shape in ("quadratic", "linear")
    )
    front = [np.quantile(run.position[-1][:, 0], 0.99) for run in (quadratic, linear)]
    assert front[0] != front[1]
    assert front[0] == pytest.approx(front[1], rel=0.15)


RUN = """
import hashlib
from gns_pl.mpm import simulate
from tests.mpm.conftest import make_mpm
from tests.mpm.test_variants import collision
run = simulate(collision(3), make_mpm(points_per_direction=2, jitter=0.5, precision="float32"), frame_interval=0.025)
print(hashlib.sha256(run.position.tobytes()).hexdigest())
"""


@pytest.mark.slow
def test_kernels_just_compiled_and_kernels_from_the_cache_give_the_same_bits(tmp_path: Path) -> None:
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-c", RUN]
    first, second = (
        subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout for _ in range(2)
    )
    assert first == second
    assert len(first.strip()) == 64
