"""Wrong input becomes one line and status 2 at a door; everything else keeps its traceback."""

from __future__ import annotations

import pytest

from gns_pl.errors import InputError, told_plainly


def test_input_error_is_one_line_and_status_two(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped, told_plainly("door.py"):
        raise InputError("a wall is missing.")
    assert stopped.value.code == 2
    assert capsys.readouterr().err == "door.py: a wall is missing.\n"


def test_other_errors_pass_through() -> None:
    with pytest.raises(KeyError), told_plainly("door.py"):
        raise KeyError("x")
    with told_plainly("door.py"):
        pass
