from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
import torch

from gns_pl.training import progress
from gns_pl.training.progress import TrainingProgress


class Trainer(SimpleNamespace):
    """Counts how often the metrics are read, for each of which a GPU would have to stop."""

    readings = 0

    @property
    def progress_bar_metrics(self) -> dict[str, float]:
        self.readings += 1
        return {"v_num": 3.0, "loss": 0.12345, "windows_per_s": 104.9}


def test_the_bar_reads_the_loss_once_a_second_and_shows_what_matters(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [100.0]
    monkeypatch.setattr(progress.time, "perf_counter", lambda: now[0])
    errors = {"valid/position_error": torch.tensor(2.0), "valid/runout_99_error": torch.tensor(-0.25)}
    trainer: Any = Trainer(callback_metrics=errors)
    bar = TrainingProgress("cubes")
    for _ in range(50):
        shown = bar.get_metrics(trainer, None)  # type: ignore[arg-type]
        now[0] += 0.01
    assert shown == {"windows/s": "105", "loss": "0.123", "error": "2", "runout": "-25%"}
    assert trainer.readings == 1
    now[0] += 1
    bar.get_metrics(trainer, None)  # type: ignore[arg-type]
    assert trainer.readings == 2
