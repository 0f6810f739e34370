"""How far a run is from training: training states are near, others far, and a checkpoint remembers what was near."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from gns_pl.evaluation.scenes import build_scenes
from gns_pl.graph import TrainingDistribution, surroundings
from gns_pl.graph.training_distribution import LEAST_SPREAD, QUANTILE, RIDGE
from gns_pl.models.checkpoint import KEY, Checkpoint, load_checkpoint, save_checkpoint
from gns_pl.rollout import rollout, static_of
from gns_pl.rollout.engine import Run, history_of
from gns_pl.scene import Scene
from gns_pl.solvers.learned import LearnedSolver
from gns_pl.solvers.ood import OutOfDistribution, compute_ood, ood_message
from gns_pl.trajectory import Trajectory
from tests.conftest import make_moving, make_simulator, make_start
from tests.solvers.simulated import simulate_learned


def sampled(number: int = 4000) -> torch.Tensor:
    """Return inputs with one feature tied to another and one that never varied."""
    draw = torch.randn(number, 4, generator=torch.Generator().manual_seed(0))
    draw[:, 1] = 0.9 * draw[:, 0] + 0.3 * draw[:, 1]
    draw[:, 3] = 0.5
    return draw


def test_summary_equals_a_plain_oracle() -> None:
    features = sampled()
    seen, values = TrainingDistribution.of(features, list("abcd")), features.numpy().astype(np.float64)
    np.testing.assert_allclose(seen.low, np.quantile(values, QUANTILE, axis=0), atol=1e-5)
    np.testing.assert_allclose(seen.high, np.quantile(values, 1 - QUANTILE, axis=0), atol=1e-5)
    spread = np.maximum(values.std(axis=0), LEAST_SPREAD)
    scaled = (values - values.mean(axis=0)) / spread
    inverse = np.linalg.inv(scaled.T @ scaled / len(scaled) + RIDGE * np.eye(4))
    distance = np.sqrt(np.einsum("nf,fg,ng->n", scaled, inverse, scaled) / 4)
    assert seen.usual == pytest.approx(np.quantile(distance, 0.99), rel=1e-5)
    np.testing.assert_allclose(seen.distance(features), distance / seen.usual, rtol=1e-4, atol=1e-5)


def test_what_was_seen_is_near_and_what_was_not_is_far() -> None:
    features = sampled()
    seen = TrainingDistribution.of(features[:3000], list("abcd"))
    fresh = features[3000:]
    assert float((seen.distance(fresh) > 1).float().mean()) == pytest.approx(0.01, abs=0.01)
    assert float(seen.outside(fresh)[:, :3].float().mean()) < 0.006
    assert not seen.outside(fresh)[:, 3].any()
    apart = torch.tensor([[2.0, -2.0, 0.0, 0.5]])  # each within its range, never together
    assert not seen.outside(apart).any() and float(seen.distance(apart)) > 2
    shifted = torch.tensor([[0.0, 0.0, 0.0, 0.7]])  # what never varied does
    assert seen.outside(shifted).tolist() == [[False, False, False, True]] and float(seen.distance(shifted)) > 1


def test_surroundings_of_a_chain() -> None:
    position = torch.tensor([[0.0, 0.0], [0.5, 0.0], [0.75, 0.0], [9.0, 0.0]])
    velocity = torch.tensor([[1.0, 0.0], [0.0, 0.0], [0.0, 0.0], [3.0, 0.0]])
    edges = torch.tensor([[0, 1, 1, 2, 3], [1, 0, 2, 1, 3]])
    expected = [[0.1, 0.5, 1.0], [0.2, 0.25, 0.5], [0.1, 0.25, 0.0], [0.0, 1.0, 0.0]]
    torch.testing.assert_close(surroundings(position, velocity, edges, 1.0), torch.tensor(expected))


def states_of(trajectory: Trajectory, frames: range) -> torch.Tensor:
    """Return all states of a trajectory, one frame after the other."""
    simulator, static = make_simulator(), static_of(trajectory)
    states = []
    for frame in frames:
        past = trajectory.position[: frame + 1]
        states.append(simulator.state(history_of(Run(trajectory, 1, past), simulator.config), static))
    return torch.cat(states).detach()


@pytest.fixture
def known(drop: Scene) -> tuple[Checkpoint, Trajectory]:
    """A checkpoint that saw two of three motions of one kind, and the third."""
    names = make_simulator().state_names()
    motions = [make_moving(drop, frames=12, seed=seed) for seed in range(3)]
    seen = TrainingDistribution.of(torch.cat([states_of(each, range(12)) for each in motions[:2]]), names)
    return Checkpoint(make_simulator(), {}, {}, seen), motions[2]


def test_training_like_frames_are_familiar(known: tuple[Checkpoint, Trajectory]) -> None:
    checkpoint, motion = known
    found = compute_ood(checkpoint, motion)
    assert found is not None and len(found.time) == len(found.mean) == 12
    assert found.share.mean() < 0.05 and found.exit_time is None and found.early_score(0.05) < 1
    thinned = compute_ood(checkpoint, motion, every=3)
    assert thinned is not None
    np.testing.assert_allclose(thinned.mean, found.mean[::3])


def test_twice_the_speed_and_a_squeezed_lattice_are_not(known: tuple[Checkpoint, Trajectory]) -> None:
    checkpoint, motion = known
    step = motion.position - motion.position[:1]
    fast = replace(motion, position=motion.position[:1] + 2 * step, initial_velocity=2 * motion.initial_velocity)
    middle = motion.position.mean(axis=1, keepdims=True)
    squeezed = replace(motion, position=(middle + 0.7 * (motion.position - middle)).astype(np.float32))
    for strange in (fast, squeezed):
        found = compute_ood(checkpoint, strange)
        assert found is not None and found.exit_time == 0.0 and found.share[0] > 0.3
        assert "left the training range at 0 s" in str(found.message())
    tilted = replace(motion, scene=motion.scene.replace(gravity=(3.0, 0.0, -9.0)))
    found = compute_ood(checkpoint, tilted)
    assert found is not None and "gravity" in str(found.message())


def test_a_round_trip_keeps_it_and_an_old_checkpoint_has_none(
    known: tuple[Checkpoint, Trajectory], tmp_path: Path
) -> None:
    checkpoint, motion = known
    path = tmp_path / "model.ckpt"
    save_checkpoint(path, checkpoint)
    again = load_checkpoint(path)
    one, two = compute_ood(checkpoint, motion), compute_ood(again, motion)
    assert isinstance(one, OutOfDistribution) and isinstance(two, OutOfDistribution)
    np.testing.assert_array_equal(one.mean, two.mean)
    assert one.names == two.names == tuple(checkpoint.simulator.state_names())
    content = torch.load(path, weights_only=True)
    del content[KEY]["seen"]
    torch.save(content, path)
    assert load_checkpoint(path).distribution is None and compute_ood(load_checkpoint(path), motion) is None


def test_states_have_as_many_names_as_columns(drop: Scene, column: Scene) -> None:
    for changes in ({}, {"context": True}, {"particle_types": (3, 6), "input_sequence_length": 2}):
        simulator, start = make_simulator(**changes), make_start(column)
        state = simulator.state(history_of(Run(start, 1), simulator.config), static_of(start))
        assert state.shape == (start.num_particles, len(simulator.state_names()))


def test_shipped_checkpoints_know_columns_of_theirs_and_not_those_of_the_moon(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    checkpoint = load_checkpoint("collapse_plane")
    settings = {"only": None, "domain": [2.0, 0.7], "duration": 2.0, "interval": 0.02, "data": checkpoint.data}
    scene = build_scenes({"column": {"length": 0.3, "height": 0.3}}, None, **settings)["column"]
    found = compute_ood(checkpoint, rollout(checkpoint.simulator, LearnedSolver.of(checkpoint).start(scene), 20))
    assert found is not None and found.message() is None and found.early_score(0.2) < 0.6
    moon = scene.replace(gravity=(0.0, -1.62), name="moon", duration=0.2)
    paths = simulate_learned("collapse_plane", [scene.replace(duration=0.2), moon], out=tmp_path)
    printed = capsys.readouterr().out
    assert "moon.h5: left the training range at 0 s (gravity)" in printed and "trained at a gravity of 9.81" in printed
    assert "column.h5: left" not in printed and ood_message(checkpoint, paths[0]) is None
