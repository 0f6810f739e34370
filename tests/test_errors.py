"""Wrong input becomes one line and status 2 in a command; everything else keeps its traceback."""

from __future__ import annotations

import pytest

from gns_pl.errors import InputError, report_input_errors


def test_input_error_is_one_line_and_status_two(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped, report_input_errors("tool.py"):
        raise InputError("a wall is missing.")
    assert stopped.value.code == 2
    assert capsys.readouterr().err == "tool.py: a wall is missing.\n"


def test_other_errors_pass_through() -> None:
    with pytest.raises(KeyError), report_input_errors("tool.py"):
        raise KeyError("x")
    with report_input_errors("tool.py"):
        pass
