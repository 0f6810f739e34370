"""What a training stores of what it saw, and a checkpoint that is told it later."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from gns_pl.errors import InputError
from gns_pl.generation import generate_dataset
from gns_pl.models.checkpoint import KEY, Checkpoint, load_checkpoint, save_checkpoint
from gns_pl.training.distribution import add_distribution
from gns_pl.training.train import train
from tests.conftest import make_simulator
from tests.training.conftest import make_config


def test_a_training_stores_what_it_saw_and_an_older_file_is_told_the_same(data_root: Path, tmp_path: Path) -> None:
    cfg = make_config(data_root, tmp_path, "training.optimisation.num_steps=2", "trainer.val_check_interval=2")
    last = train(cfg, tmp_path, None)
    stored = load_checkpoint(last).distribution
    assert stored is not None and stored.source == load_checkpoint(last).provenance["manifest_sha256"]
    content = torch.load(last, weights_only=True)
    del content[KEY]["seen"]
    older = tmp_path / "older.ckpt"
    torch.save(content, older)
    assert load_checkpoint(older).distribution is None
    from omegaconf import OmegaConf

    folder = generate_dataset(OmegaConf.to_container(cfg.data, resolve=True), device="auto", progress=False)
    assert add_distribution(older, folder, tmp_path / "told.ckpt") is None
    told = load_checkpoint(tmp_path / "told.ckpt")
    assert told.distribution is not None and told.distribution.usual == stored.usual
    for name in ("low", "high", "mean", "spread", "whitening"):
        torch.testing.assert_close(getattr(told.distribution, name), getattr(stored, name), atol=0, rtol=0)
    for name, value in load_checkpoint(last).simulator.state_dict().items():
        assert torch.equal(value, told.simulator.state_dict()[name])
    assert (tmp_path / "told.ckpt").stat().st_size < older.stat().st_size


def test_data_that_do_not_fit_and_a_checkpoint_that_does_not_say(data_root: Path, tmp_path: Path) -> None:
    path = tmp_path / "plain.ckpt"
    save_checkpoint(path, Checkpoint(make_simulator(), {}, {}))
    cfg = make_config(data_root, tmp_path)
    from omegaconf import OmegaConf

    folder = generate_dataset(OmegaConf.to_container(cfg.data, resolve=True), device="auto", progress=False)
    with pytest.raises(InputError, match="does not say how it was trained"):
        add_distribution(path, folder, tmp_path / "out.ckpt")
    with pytest.raises(InputError, match="another dimension, spacing or interval"):
        add_distribution("collapse_plane", folder, tmp_path / "out.ckpt")
    assert not (tmp_path / "out.ckpt").exists()
