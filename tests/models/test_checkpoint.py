from __future__ import annotations

import os
from pathlib import Path

import pytest
import torch

from gns_pl.errors import InputError
from gns_pl.graph import SceneBatch
from gns_pl.models.checkpoint import KEY, Checkpoint, load_checkpoint, load_simulator, save_checkpoint
from tests.conftest import make_simulator, make_static

GOLDEN = Path(__file__).parents[1] / "golden"


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    path = tmp_path / "model.ckpt"
    save_checkpoint(path, Checkpoint(make_simulator(), {"name": "tiny"}, {"steps": 3}))
    return path


def test_round_trip_steps_the_same(saved: Path) -> None:
    checkpoint = load_checkpoint(saved)
    history = torch.rand(20, 4, 3)
    torch.testing.assert_close(
        checkpoint.simulator(history, make_static(20)), make_simulator()(history, make_static(20)), atol=0, rtol=0
    )
    assert checkpoint.data == {"name": "tiny"} and checkpoint.provenance == {"steps": 3}
    assert load_simulator(saved).config == make_simulator().config


def test_missing_foreign_and_truncated_files_are_named(saved: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nowhere\.ckpt: there is no such"):
        load_checkpoint(tmp_path / "nowhere.ckpt")
    foreign = tmp_path / "foreign.ckpt"
    torch.save({"weights": torch.ones(3)}, foreign)
    with pytest.raises(InputError, match=r"foreign\.ckpt: is not a checkpoint of gns_pl"):
        load_checkpoint(foreign)
    content = saved.read_bytes()
    for size in (0, 1, 100, len(content) // 2, len(content) - 1):
        saved.write_bytes(content[:size])
        with pytest.raises(InputError, match=r"model\.ckpt"):
            load_checkpoint(saved)


def test_newer_format_and_damaged_weights(saved: Path) -> None:
    content = torch.load(saved, weights_only=True)
    content[KEY]["format_version"] = 99
    torch.save(content, saved)
    with pytest.raises(InputError, match="format 99"):
        load_checkpoint(saved)
    content[KEY]["format_version"] = 1
    content["state_dict"].popitem()
    torch.save(content, saved)
    with pytest.raises(InputError, match="damaged"):
        load_checkpoint(saved)


class Hostile:
    def __reduce__(self) -> tuple[object, tuple[str]]:
        return os.system, ("touch hacked",)


def test_a_hostile_pickle_runs_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    torch.save({KEY: Hostile(), "state_dict": {}}, "hostile.ckpt")
    with pytest.raises(InputError):
        load_checkpoint("hostile.ckpt")
    assert not Path("hacked").exists()


@pytest.mark.parametrize("path", sorted(GOLDEN.glob("format_*.ckpt")), ids=lambda path: path.stem)
def test_golden_checkpoints_load_for_ever(path: Path) -> None:
    """One tiny checkpoint per format version, with the output its simulator had when it was written."""
    expected = torch.load(path.with_suffix(".pt"), weights_only=True)
    simulator = load_simulator(path)
    output = simulator(expected["history"], SceneBatch(**expected["static"]))
    torch.testing.assert_close(output, expected["output"], atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("which", ["first", "second"])
def test_networks_with_earlier_context_features_are_refused(which: str) -> None:
    with pytest.raises(InputError, match=rf"{which}_context\.ckpt: was trained with other features of model\.context"):
        load_simulator(GOLDEN / f"{which}_context.ckpt")


def test_there_are_golden_checkpoints() -> None:
    assert all((GOLDEN / f"format_{number}.ckpt").is_file() for number in (1, 3, 4))


@pytest.mark.parametrize(
    ("key", "value"), [("output", "pairs"), ("output", "held"), ("aggregation", "mean"), ("static_edges", True)]
)
def test_what_is_no_longer_supported_is_told(key: str, value: object, tmp_path: Path) -> None:
    content = torch.load(GOLDEN / "format_3.ckpt", weights_only=True)
    content[KEY]["config"][key] = value
    torch.save(content, tmp_path / "old.ckpt")
    with pytest.raises(InputError, match=f"was trained with model.{key}={value}, which is no longer supported"):
        load_checkpoint(tmp_path / "old.ckpt")
