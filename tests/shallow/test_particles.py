"""The particles that show a layer: they must be the layer, to much less than one per cent."""

from __future__ import annotations

import numpy as np
import pytest

from gns_pl.metrics import compute_curves
from gns_pl.scene import Body
from gns_pl.shallow import ShallowConfig, simulate
from gns_pl.shallow.particles import hammersley
from gns_pl.shallow.solver import make_start
from tests.shallow.conftest import Floats, make_column, make_scene

CONFIG = ShallowConfig(cell_size=1 / 48)


def test_shares_are_evenly_spread_and_move_with_the_seed() -> None:
    first, second = hammersley(4096, 0), hammersley(4096, 1)
    assert first.min() >= 0
    assert first.max() < 1
    assert (np.diff(first[:, 0]) > 0).all()
    assert not np.allclose(first, second)
    counts, _ = np.histogramdd(first, bins=(8, 8, 8), range=[(0, 1)] * 3)
    assert np.abs(counts - 8).max() <= 4


def weighted_front(layer_thickness: Floats, width: float, percent: float) -> float:
    """The place behind which `percent` of a layer in one dimension lies."""
    share = np.concatenate([[0.0], np.cumsum(layer_thickness)]) / layer_thickness.sum()
    return float(np.interp(percent / 100, share, np.arange(len(share)) * width))


@pytest.mark.parametrize(("length", "height"), [(0.475, 0.38), (0.15, 0.3)])
@pytest.mark.parametrize("dim", [2, 3])
def test_fronts_and_mean_height_are_those_of_the_layer(dim: int, length: float, height: float) -> None:
    scene = make_column(dim, length, height)
    run = simulate(scene, CONFIG, frame_interval=0.1)
    curves = compute_curves(run)
    layer = make_start(scene, CONFIG)
    assert curves["runout_99"][0] == 0
    for frame in (2, 4, 12):
        layer.advance(frame * 0.1)
        row = layer.thickness.reshape(layer.grid.shape).mean(axis=1)
        for percent, name, error in ((99, "runout_99", 0.002), (99.5, "runout_995", 0.004)):
            exact = (weighted_front(row, layer.grid.sizes[0], percent) - percent / 100 * length) / length
            assert curves[name][frame] == pytest.approx(exact, abs=error * max(exact, 1))
        mean = (layer.thickness**2).sum() / (2 * layer.thickness.sum())
        assert curves["mean_height"][frame] == pytest.approx(mean, rel=1e-3)
    assert curves["penetration"].max() == 0
    assert run.mass.sum() / 1800 == pytest.approx(length * height * (0.5 if dim == 3 else 1), rel=1e-4)


def test_the_thickness_map_is_that_of_the_layer() -> None:
    scene = make_scene((1.0, 1.0, 0.5), Body((0.0, 0.1, 0.0), (0.3, 0.4, 0.3), (0.0, 0.0, 0.0)), duration=0.5)
    run = simulate(scene, CONFIG, frame_interval=0.5)
    layer = make_start(scene, CONFIG)
    for frame in (0, 1):
        layer.advance(frame * 0.5)
        whole = layer.thickness.reshape(24, 2, 24, 2).sum(axis=(1, 3)) * layer.grid.sizes[0] * layer.grid.sizes[1]
        found, *_ = np.histogram2d(*run.position[frame, :, :2].T, bins=24, range=[(0, 1), (0, 1)])
        found *= whole.sum() / len(run.mass)
        assert np.abs(found - whole).sum() / (2 * whole.sum()) < 0.01


def test_in_one_dimension_particles_move_as_the_layer_does() -> None:
    scene = make_column(2, duration=0.32)
    run = simulate(scene, CONFIG, frame_interval=0.02)
    layer = make_start(scene, CONFIG)
    layer.advance(0.31)
    x, _ = layer.grid.centres
    wet = layer.thickness > 0.02
    velocity = np.interp(run.position[-2, :, 0], x[wet], layer.momentum[0][wet] / layer.thickness[wet])
    inside = run.position[-2, :, 0] < x[wet].max()
    measured = run.velocity()[-1, :, 0]
    assert np.abs(measured - velocity)[inside].mean() < 0.02 * measured[inside].max()


def test_frames_are_still_once_the_flow_is_and_the_seed_moves_particles_alone() -> None:
    scene = make_column(3, duration=2.0)
    run, other = (simulate(scene, CONFIG, frame_interval=0.1, seed=seed) for seed in (0, 1))
    assert run.provenance["at_rest"]
    assert np.array_equal(run.position[-1], run.position[-2])
    assert np.array_equal(run.position, simulate(scene, CONFIG, frame_interval=0.1).position)
    fronts = [compute_curves(each)["runout_99"][-1] for each in (run, other)]
    assert fronts[0] == pytest.approx(fronts[1], rel=2e-3)
    assert not np.array_equal(run.position[0], other.position[0])


def test_what_rains_is_shown_in_the_air() -> None:
    scene = make_column(2, 0.1, 0.4, duration=0.3)
    run = simulate(scene, ShallowConfig(cell_size=1 / 100, rain=1.0), frame_interval=0.05)
    top = run.position[:, :, 1].max(axis=1)
    fallen = 0.5 * 9.81 * (0.05 * np.arange(4)) ** 2
    assert top[0] == pytest.approx(0.4, abs=0.001)
    assert (top[:4] > 0.399 - fallen).all()
    assert top[-1] < 0.35
    assert run.position[0, :, 1].mean() == pytest.approx(0.2, rel=1e-3)
