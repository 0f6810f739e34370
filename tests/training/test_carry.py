"""Windows that are carried on: own states come back, large errors do not, and a resumed run is the same."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch

from gns_pl.graph import Static
from gns_pl.training.carry import CarriedHistories
from gns_pl.training.train import train
from tests.conftest import make_static
from tests.training.conftest import make_config

LARGEST = 3.0
CARRY = [
    "training.optimisation.visits=3",
    "training.optimisation.unroll_from=0.0",
    "training.optimisation.num_steps=10",
    "callbacks.last.every_n_steps=4",
    "trainer.val_check_interval=10",
]


@pytest.fixture(autouse=True)
def small_pool(monkeypatch: pytest.MonkeyPatch) -> None:
    """Come back to a window after two steps, and to bad ones too, so that a short training does."""
    monkeypatch.setattr("gns_pl.data.sampler.POOL", 2)
    monkeypatch.setattr("gns_pl.training.carry.LARGEST_ERROR", LARGEST)


def windows(number: int) -> Static:
    static = make_static(number)
    return Static(
        **{
            **vars(static),
            "lower": static.lower.repeat(2, 1),
            "upper": static.upper.repeat(2, 1),
            "gravity": static.gravity.repeat(2, 1),
            "batch": torch.arange(number) // (number - 4),  # the second window has 4 particles
        }
    )


def test_a_kept_history_comes_back_once_and_to_its_own_window() -> None:
    static, carried = windows(10), CarriedHistories()
    history = torch.rand(10, 3, 3)
    both, none = torch.tensor([True, True]), torch.zeros(10)
    carried.keep(torch.tensor([5, 8]), both, history, none, static)
    truth = torch.zeros(10, 3, 3)
    got, which = carried.take(torch.tensor([9, 8]), torch.tensor([1, 1]), truth, static)
    assert which.tolist() == [False, True]
    assert torch.equal(got[6:], history[6:]) and not got[:6].any() and not truth.any()
    _, which = carried.take(torch.tensor([9, 8]), torch.tensor([1, 2]), truth, static)
    assert not which.any()
    assert set(carried.state()) == {5}


def test_what_is_not_kept() -> None:
    """Windows that are not visited again, that have strayed too far, or whose positions are not finite."""
    static, history = windows(10), torch.rand(10, 3, 3)
    far = torch.full((10,), 0.99 * LARGEST)
    for again, factor, kept in (([True, False], 1.0, {1}), ([True, True], 1.02, {2}), ([True, True], torch.nan, {2})):
        carried, error = CarriedHistories(), far.clone()
        error[:6] *= factor
        carried.keep(torch.tensor([1, 2]), torch.tensor(again), history, error, static)
        assert set(carried.state()) == kept


def last(path: Path) -> dict[str, Any]:
    content: dict[str, Any] = torch.load(path / "last.ckpt", weights_only=True)
    return content


def test_a_resumed_run_carries_on_the_same_windows(data_root: Path, tmp_path: Path) -> None:
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    train(make_config(data_root, whole, *CARRY), whole, None)
    train(make_config(data_root, cut, *CARRY, "trainer.max_steps=4"), cut, None)
    assert last(cut)["carried"]
    train(make_config(data_root, cut, *CARRY), cut, cut / "last.ckpt")
    expected, got = last(whole), last(cut)
    assert expected["carried"].keys() == got["carried"].keys() and expected["carried"]
    for number, history in expected["carried"].items():
        assert torch.equal(history, got["carried"][number])
    for name, value in expected["current_model_state"].items():
        assert torch.equal(value, got["current_model_state"][name]), name


def test_without_what_was_carried_it_ends_elsewhere(data_root: Path, tmp_path: Path) -> None:
    """The control of the test above: what is carried matters."""
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    train(make_config(data_root, whole, *CARRY), whole, None)
    train(make_config(data_root, cut, *CARRY, "trainer.max_steps=4"), cut, None)
    content = last(cut)
    torch.save(content | {"carried": {}}, cut / "last.ckpt")
    train(make_config(data_root, cut, *CARRY), cut, cut / "last.ckpt")
    expected, got = last(whole)["current_model_state"], last(cut)["current_model_state"]
    assert any(not torch.equal(value, got[name]) for name, value in expected.items())
