"""The suite from its settings, for a learned simulator and for the material point method."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from gns_pl.errors import InputError
from gns_pl.evaluation.stress.judge import run_suite, stress_from_settings
from gns_pl.evaluation.stress.report import read_rows
from gns_pl.models.checkpoint import Checkpoint, save_checkpoint
from gns_pl.scene import FACES
from tests.conftest import MPM, SAND, make_simulator

WALL = {"condition": "friction", "friction": 0.385}
SAND_2D = {"gravity": 9.81, "material": {**vars(SAND)}, "walls": dict.fromkeys(FACES[3], WALL)}
SETTINGS = {
    "logger": None, "stabilise": {}, "seed": 5, "axes": ["tilt"], "label": None, "shown": None, "figures": False,
    "device": "cpu", "dim": 2, "interval": 0.02, "sand": SAND_2D, "mpm": {**MPM, "cell_size": 0.1}, "only": None,
    "variants": {"mpm": {}, "fast": {"courant": 6.0, "allow_large_courant": True}},
}  # fmt: skip


def stress(tmp_path: Path, checkpoints=None, **changes):
    return run_suite(checkpoints or {}, out=tmp_path / "out", cache=tmp_path / "cache", **(SETTINGS | changes))


def test_mpm_above_its_limit_is_found_and_within_it_is_not(tmp_path: Path, capsys) -> None:
    found = stress(tmp_path)
    assert found["mpm"] == {"scenes": 10, "failed": 0, "failed_inside": 0}
    assert found["fast"]["failed"] == 10
    rows = read_rows(tmp_path / "out" / "stress.csv")
    assert all(row.failed_at <= row.duration and row.message for row in rows if row.kind)
    text = (tmp_path / "out" / "stress.md").read_text()
    assert "| `mpm` | 0 of 10 |" in text and "| `fast` | 10 of 10 |" in text
    assert "Made:" in capsys.readouterr().out


def test_what_is_in_the_table_is_not_run_again(tmp_path: Path, monkeypatch) -> None:
    stress(tmp_path, axes=["count"], only="mpm")
    before = (tmp_path / "out" / "stress.csv").read_bytes()
    monkeypatch.setattr("gns_pl.evaluation.stress.runs.run_scene", lambda *a, **k: pytest.fail("run again"))
    stress(tmp_path, axes=["count"], only="mpm")
    assert (tmp_path / "out" / "stress.csv").read_bytes() == before


def test_a_simulator_that_makes_energy_fails_and_less_so_when_it_is_kept_from_it(tmp_path: Path) -> None:
    simulator = make_simulator(dim=2, dt=0.02, material_features=(), output="gated")
    simulator.set_statistics(velocity=0.8, acceleration=20.0, material=torch.zeros(2, 0))
    for weights in simulator.network.parameters():
        weights.data *= 2.0
    data = {**SAND_2D, "walls": dict.fromkeys(FACES[2], WALL), "mpm": {"jitter": 0.5}}
    path = tmp_path / "wild.ckpt"
    save_checkpoint(path, Checkpoint(simulator, data, {"steps": 0}))
    wild = stress(tmp_path, {"wild": path}, axes=["speed"])["wild"]
    assert wild["failed"] >= 8
    stable = {"stabilise": {"energy_limiter": True, "min_distance": 0.2}, "label": " stable"}
    calm = stress(tmp_path, {"wild": path}, axes=["speed"], **stable)["wild stable"]
    assert calm["failed"] < wild["failed"]
    rows = read_rows(tmp_path / "out" / "stress.csv")
    assert {row.model for row in rows} == {"wild", "wild stable"}  # both are kept
    stress(tmp_path, {"wild": path}, axes=["speed"], stabilise={"energy_limiter": True})
    again = [row for row in read_rows(tmp_path / "out" / "stress.csv") if row.model == "wild"]
    assert len(again) == 10 and all("energy_limiter" in row.settings for row in again)  # in the place of what was


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"axes": ["aspect"]}, "aspect"),
        ({"only": "nobody"}, "nobody"),
        ({"dim": 4}, "2 or 3"),
        ({"mpm": {**MPM, "cell_size": -1}}, "cell_size"),
    ],
)
def test_settings_that_cannot_be_used_are_refused(tmp_path: Path, changes, words) -> None:
    with pytest.raises(InputError, match=words):
        stress(tmp_path, **changes)


@pytest.mark.parametrize(("solver", "words"), [("learned", "which checkpoint"), ("dem", "learned, mpm")])
def test_the_command_asks_for_what_is_missing(solver: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        stress_from_settings({"solver": solver, "ckpt": None, "evaluation": {"stress": {}}})
