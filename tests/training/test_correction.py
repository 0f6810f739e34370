"""Coarse runs that follow fine ones, and a network that learns what they miss."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from gns_pl.errors import InputError
from gns_pl.generation.thinning import thin_trajectory
from gns_pl.models.corrector import Corrector, CorrectorConfig, load_corrector
from gns_pl.mpm.settings import run_solver
from gns_pl.rollout import static_of
from gns_pl.scene import FACES, Scene, Wall, column_collapse
from gns_pl.solvers.correction import corrected_run, followed_run
from gns_pl.solvers.learned import CorrectedSolver
from gns_pl.training.correction import CorrectionModule, fit_corrector, make_examples, runout_errors
from gns_pl.trajectory import Trajectory
from tests.conftest import MPM, SAND
from tests.data import sets

CONFIG = CorrectorConfig(
    dim=2,
    interval=0.02,
    spacing=1 / 16,
    mpm={**MPM, "cell_size": 1 / 8},
    connectivity_radius=0.15,
    latent_size=16,
    num_mlp_layers=1,
    num_message_passing_steps=2,
    slow=0.1,
)


def column() -> Scene:
    walls = dict.fromkeys(FACES[2], Wall("friction", 0.385))
    return column_collapse(
        domain=(1.5, 0.75), length=0.375, height=0.5, gravity=9.81, duration=1.0, material=SAND, walls=walls
    )


def plain() -> Corrector:
    """A corrector that corrects nothing."""
    corrector = Corrector(CONFIG).eval()
    corrector.correction_scale.fill_(0)
    return corrector


@pytest.fixture(scope="module")
def fine() -> Trajectory:
    made = run_solver(column(), {**MPM, "cell_size": 1 / 24}, frame_interval=0.02, seed=0)
    kept: Trajectory = thin_trajectory(made, {**MPM, "cell_size": 1 / 24}, 0, 3, (1, 1))
    return kept


def test_without_a_correction_it_is_the_coarse_run(fine: Trajectory) -> None:
    made = corrected_run(plain(), fine, fine.num_frames - 1)
    assert made.num_frames == fine.num_frames
    steps = list(followed_run(fine, plain(), catch_up=0.2))
    np.testing.assert_allclose(made.position[1], steps[0][2], atol=1e-6)
    assert (made.position[-1] - fine.position[-1])[:, 0].min() < -0.1  # it falls short


def test_a_run_that_follows_ends_where_the_fine_one_ends(fine: Trajectory) -> None:
    steps = list(followed_run(fine, plain(), catch_up=0.2))
    assert len(steps) == fine.num_frames - 1
    off = np.array([np.abs(step[2] - fine.position[k + 1]).mean() for k, step in enumerate(steps)])
    coarse = corrected_run(plain(), fine, fine.num_frames - 1)
    assert off[-1] < 0.5 * np.abs(coarse.position[-1] - fine.position[-1]).mean()


def test_a_run_that_trusts_goes_its_own_way_and_is_told_back(fine: Trajectory) -> None:
    torch.manual_seed(0)
    corrector = Corrector(CONFIG).eval()
    led, own = (make_examples(0, fine, corrector, catch_up=0.2, trust=each) for each in (0.0, 1.0))
    alone = corrected_run(corrector, fine, 20).position
    torch.testing.assert_close(own[18][1][2], own[19][1][1])
    np.testing.assert_allclose(own[19][1][1], alone[19], atol=1e-5)
    wanted = [float(each[19][1][3].square().mean()) for each in (led, own)]
    assert wanted[1] > 2 * wanted[0]


def test_a_batch_of_scenes_gives_what_each_gives(fine: Trajectory) -> None:
    corrector = Corrector(CONFIG).eval()
    module = CorrectionModule(corrector, [fine, fine], [], 1e-3, 10, catch_up=0.2)
    module.log = lambda *_, **__: None
    first, second = module.examples[0][3], module.examples[1][10]
    with torch.no_grad():
        losses = [float(module.training_step([each])) for each in (first, second)]
        together = float(module.training_step([first, second]))
    assert together == pytest.approx(np.mean(losses), rel=1e-4)


def test_fitting_finds_what_a_coarse_run_misses(tmp_path: Path, fine: Trajectory) -> None:
    """A small set, made and learned on the way."""
    walls = {face: {"condition": "friction", "friction": 0.385} for face in FACES[2]}
    family = {"kind": "column_collapse", "domain": [1.5, 0.75], "length": [0.375, 0.375], "duration_tau": 5.0}
    data = {
        "name": "tiny",
        "root": str(tmp_path / "data"),
        "seed": 0,
        "frame_interval": 0.02,
        "store_every": [3],
        "every": 3,
        "gravity": 9.81,
        "material": dict(vars(SAND)),
        "walls": walls,
        "mpm": {**MPM, "cell_size": 1 / 24},
        "families": {
            "low": {**family, "aspect_ratio": [1.2, 1.5], "count": 9, "valid": 1, "test": 0},
        },
    }
    settings = {
        "name": "tiny",
        "description": "",
        "seed": 0,
        "stride": 1,
        "data": data,
        "mpm": dict(CONFIG.mpm),
        "model": {
            "connectivity_radius": 0.15,
            "latent_size": 16,
            "num_mlp_layers": 1,
            "num_message_passing_steps": 2,
            "slow": 0.1,
        },
        "num_steps": 300,
        "batch_size": 2,
        "learning_rate": 1.5e-3,
        "valid_every": 100,
        "renewed": 0.5,
        "catch_up": 0.2,
    }
    path = fit_corrector(settings, tmp_path / "run")
    file = load_corrector(path)
    assert file.provenance["steps"] in (100, 200, 300)
    assert file.provenance["cost"]["train_seconds"] > 0
    assert len(runout_errors(file.corrector, [fine])) == 1 and runout_errors(plain(), [fine])[0] < -0.1
    missed = [
        (velocity - file.corrector(before, now, after, static_of(fine)), velocity)
        for _, (before, now, after, velocity) in make_examples(0, fine, file.corrector, catch_up=0.2)
    ]
    left, whole = (sum(float(each[k].detach().square().sum()) for each in missed) for k in (0, 1))
    assert left < 0.8 * whole  # on a column it was not fitted to
    way = CorrectedSolver("tiny", path)
    assert way.unsupported_reason(column()) is None
    made = way.run(column(), interval=0.01, seed=1)
    assert made.num_frames == 101 and way.size(column())[1] == 50
    with pytest.MonkeyPatch.context() as patch:  # a second run goes on from the first, which was finished
        patch.setattr(CorrectionModule, "training_step", lambda *_: pytest.fail("nothing is left to do"))
        assert fit_corrector(settings, tmp_path / "run") == path
    with pytest.raises(InputError, match="holds a run of other settings"):
        fit_corrector({**settings, "learning_rate": 1e-4}, tmp_path / "run")


def test_without_a_column_to_judge_by_nothing_is_fitted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An error of nothing would be the least there is."""
    flight = sets.make_flight(sets.make_scene(), 3)
    sets.write_set(tmp_path / "set", [flight, flight], valid=1)
    monkeypatch.setattr("gns_pl.training.correction.generate_dataset", lambda *_, **__: tmp_path / "set")
    with pytest.raises(InputError, match="no validation trajectory runs out"):
        fit_corrector({"seed": 0, "stride": 1, "data": {}}, tmp_path / "run")
    assert not list((tmp_path / "run").glob("*.c*"))
