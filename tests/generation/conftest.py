"""The fake solver in place of the real one."""

from __future__ import annotations

import pytest

from gns_pl.mpm import settings as solver
from tests.generation.fake import fake_solver


@pytest.fixture
def faked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(solver, "run_solver", fake_solver)
