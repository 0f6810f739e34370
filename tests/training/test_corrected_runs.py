"""A training of a corrector of retuned coarse MPM on whole runs: resumed to the bit, exported, run as a solver."""

from __future__ import annotations

import math
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from omegaconf import DictConfig, OmegaConf, open_dict

from gns_pl.errors import InputError
from gns_pl.io import read_manifest, read_observables, read_trajectory
from gns_pl.models.corrector import load_corrector
from gns_pl.scene import FACES, Box, Scene, Wall, column_collapse
from gns_pl.solvers.corrected import CorrectedSolver
from gns_pl.solvers.fitted_files import read_fitted
from gns_pl.training.resume import find_resume
from gns_pl.training.summary import objective, read_summary
from gns_pl.training.train import train
from tests.conftest import MPM, SAND
from tests.training.conftest import CONF, assert_same, rows
from tests.training.test_stopping import callback

FAMILY = {"kind": "column_collapse", "domain": [0.9, 0.4, 0.5], "length": [0.25, 0.3], "duration_tau": 1.5}
DATA = {
    "name": "tiny",
    "seed": 0,
    "frame_interval": 0.02,
    "store_every": [2],
    "every": 2,
    "gravity": 9.81,
    "material": dict(vars(SAND)),
    "walls": {face: {"condition": "friction", "friction": 0.385} for face in FACES[3]},
    "mpm": {**MPM, "cell_size": 1 / 12},
    "families": {"low": {**FAMILY, "aspect_ratio": [0.8, 1.2], "count": 3, "valid": 1, "test": 0}},
}
TINY = [
    "+experiment=corrected",
    "logger=csv",
    "name=tiny",
    "model.latent_size=8",
    "training.stride=2",
    "training.placements=1",
    "training.optimisation.num_steps=4",
    "trainer.val_check_interval=2",
    "trainer.enable_progress_bar=false",
    "~callbacks.progress",
    "trainer.log_every_n_steps=1",
    "callbacks.last.every_n_steps=1",
]


def make_config(root: Path, output: Path, **changes: Any) -> DictConfig:
    """Compose conf/train.yaml as the command does, for a training on DATA, twice, in `output`."""
    GlobalHydra.instance().clear()
    with initialize_config_dir(str(CONF), version_base=None):
        cfg = compose("train", TINY)
    with open_dict(cfg):
        cfg.data = {**DATA, "root": str(root)}
        cfg.also = {**DATA, "root": str(root)}
        cfg.callbacks.last.directory = cfg.callbacks.best.directory = cfg.logger.csv.save_dir = str(output)
        for key, value in changes.items():
            cfg[key].update(value) if isinstance(value, dict) else cfg.update({key: value})
    return cfg


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("data") / "tiny"


@pytest.fixture(scope="module")
def whole(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a training that nothing has interrupted; nobody writes into it."""
    folder = tmp_path_factory.mktemp("whole")
    assert train(make_config(root, folder), folder, None) == folder / "last.ckpt"
    return folder


def test_the_run_leaves_what_any_training_leaves_and_its_corrector(whole: Path, root: Path) -> None:
    summary, losses = read_summary(whole), [float(row["loss"]) for row in rows(whole) if row["loss"]]
    assert summary is not None and summary["status"] == "finished" and len(losses) == 4 and min(losses) > 0
    assert summary["data"]["num_train"] == 4 and summary["data"]["num_valid"] == 2  # of both sets
    assert objective(whole) == summary["best"]["deposit_error"] > 0
    file = load_corrector(whole / "tiny.corrector")
    fit = read_fitted("mpm-retuned-5")
    assert file.corrector.config.coarse == {"cells": fit.cells, "factors": dict(vars(fit.factors))}
    folder = root / "every_2" if (root / "every_2").is_dir() else root
    names = read_manifest(folder).splits["train"]
    energies = [(read_observables(folder / name), read_trajectory(folder / name).mass.sum()) for name in names]
    squares = np.concatenate([2 * each.every(2).kinetic_energy / mass / 3 for each, mass in energies if each])
    assert float(file.corrector.velocity_scale) == pytest.approx(math.sqrt(squares.mean()), rel=1e-5)
    assert file.provenance["steps"] == summary["best"]["step"]


def test_stopped_and_resumed_it_ends_where_an_uninterrupted_run_does(root: Path, whole: Path, tmp_path: Path) -> None:
    stopping = callback("SignalAt", step=2, number=int(signal.SIGTERM))
    cut = make_config(root, tmp_path)
    with open_dict(cut):
        cut.merge_with(OmegaConf.from_dotlist([each.lstrip("+") for each in stopping]))
    with pytest.raises(SystemExit, match="stopped after 3 steps"):
        train(cut, tmp_path, None)
    train(make_config(root, tmp_path), tmp_path, find_resume("auto", tmp_path))
    for name in ("last.ckpt", "best.ckpt"):
        assert_same(*(torch.load(folder / name, weights_only=True) for folder in (whole, tmp_path)))


def column(**changes: Any) -> Scene:
    walls = dict.fromkeys(FACES[3], Wall("friction", 0.385))
    scene = column_collapse(
        domain=(0.9, 0.4, 0.5), length=0.27, height=0.27, gravity=9.81, duration=0.2, material=SAND, walls=walls
    )
    return scene.replace(**changes)


def test_it_runs_wherever_the_coarse_solver_does(whole: Path, tmp_path: Path) -> None:
    """On obstacles and slopes too; as a half; into a file, cut off and gone on with to the same bits."""
    solver = CorrectedSolver("tiny", whole / "tiny.corrector")
    fit, barrier = read_fitted("mpm-retuned-5"), Box((0.5, 0.0, 0.0), (0.05, 0.4, 0.1), Wall("friction", 0.385))
    for scene in (column(), column(obstacles=(barrier,)), column(gravity=(1.0, 0.0, -9.7))):
        assert solver.unsupported_reason(scene) is None
        run, alone = (each.run(scene, seed=2, interval=0.02) for each in (solver, fit))
        assert run.scene == scene and run.num_particles == alone.num_particles and run.num_frames == alone.num_frames
        assert 0 < np.abs(run.position - alone.position).max() < 0.02  # four steps of training
    points, steps = solver.size(column())
    assert points == pytest.approx(solver.run(column()).num_particles / 2, rel=0.05) and steps == 5
    assert "mirror" in solver.reduced(column()).description
    assert "obstacles" in str(solver.out_of_range_reason(column(obstacles=(barrier,))))
    solver.record([column()], [tmp_path / "a.h5"], interval=0.01, seed=2, monitor=True)
    recorded = read_trajectory(tmp_path / "a.h5")
    np.testing.assert_allclose(recorded.position, solver.run(column(), seed=2).position, atol=1e-7)
    assert recorded.scene == column()
    flat = column_collapse(
        domain=(0.9, 0.5), length=0.27, height=0.27, gravity=9.81, duration=0.2, material=SAND,
        walls=dict.fromkeys(FACES[2], Wall("slip")),
    )  # fmt: skip
    assert solver.unsupported_reason(flat) == "has 3 dimensions, the scene 2"
    with pytest.raises(InputError, match="2 dimensions"):
        solver.run(flat)


def test_a_broken_run_is_a_step_left_out(root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from gns_pl.mpm import SimulationError
    from gns_pl.training.corrected_runs import CorrectedRunsModule

    whole = CorrectedRunsModule.errors

    def errors(self: CorrectedRunsModule, run: Any, number: int) -> Any:
        if number == 2:
            raise SimulationError("points left the box")
        return whole(self, run, number)

    monkeypatch.setattr(CorrectedRunsModule, "errors", errors)
    train(make_config(root, tmp_path, training={"stride": 2}), tmp_path, None)
    log = rows(tmp_path)
    assert max(float(row["skipped"]) for row in log if row.get("skipped")) == 1
    assert sum(math.isnan(float(row["loss"])) for row in log if row["loss"]) == 1


def test_what_it_cannot_use_is_refused(root: Path, tmp_path: Path) -> None:
    for change, sentence in (
        ({"model": {"coarse": "shallow-fitted"}}, "shallow-fitted is no retuned MPM"),
        ({"model": {"connectivity_radius": 0.5}}, "reaches no neighbour"),
        ({"model": {"largest": -1}}, r"model\.largest must be positive"),
        ({"training": {"weights": {"map": 0, "height": 0, "front": 0, "energy": 0, "rise": 0}}}, "must be above 0"),
        ({"training": {"scenes": 0}}, "scenes must be a whole number"),
        ({"ckpt": "collapse"}, "begins with random weights"),
        ({"trainer": {"devices": 3}}, "one process on a CPU"),
    ):
        with pytest.raises(InputError, match=sentence):
            train(make_config(root, tmp_path, **change), tmp_path, None)
