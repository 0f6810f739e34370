"""The CSV files of several starts become one training."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from gns_pl.training.history import read_history


def write(run: Path, start: str, *lines: str) -> None:
    path = run / "csv" / start / "metrics.csv"
    path.parent.mkdir(parents=True)
    path.write_text(
        "step,loss,hours,step_seconds,windows_per_s,lr-AdamW,valid/position_error\n" + "\n".join(lines) + "\n"
    )


def test_a_resumed_start_takes_the_place_of_what_it_repeats(tmp_path: Path) -> None:
    """Killed after 40 steps and resumed from 20: steps 30 and 40 count as the second start made them."""
    write(
        tmp_path,
        "2026-01-01_00-00-00",
        "9,8.0,0.1,,,,",
        "19,7.0,0.2,,,,",
        "19,,0.25,,,,3.0",
        "29,6.0,0.4,,,,",
        "39,5.0,0.5,,,,",
    )
    write(tmp_path, "2026-01-02_00-00-00", "29,,,,,0.1,", "29,6.5,0.3,,,,", "39,5.5,0.35,,,,", "39,,0.4,,,,2.0")
    history = read_history(tmp_path)
    assert history.num_starts == 2
    np.testing.assert_array_equal(history.training["step"], [10, 20, 30, 40])
    np.testing.assert_array_equal(history.training["loss"], [8, 7, 6.5, 5.5])
    np.testing.assert_array_equal(history.training["hours"], [0.1, 0.2, 0.3, 0.35])
    np.testing.assert_array_equal(history.validation["step"], [20, 40])
    np.testing.assert_array_equal(history.validation["position_error"], [3, 2])
    np.testing.assert_array_equal(history.validation["hours"], [0.25, 0.4])
    assert np.isnan(history.training["windows_per_s"]).all()


def test_a_training_begun_anew_in_the_same_folder_replaces_the_old_one(tmp_path: Path) -> None:
    write(tmp_path, "a", "9,8.0,,,,,", "19,7.0,,,,,")
    write(tmp_path, "b", "9,6.0,,,,,")
    np.testing.assert_array_equal(read_history(tmp_path).training["loss"], [6])


def test_what_a_kill_left_is_read_as_far_as_it_goes(tmp_path: Path) -> None:
    write(tmp_path, "a", "9,8.0,0.1,,,,", "19,nan,0.2,,,,", "19,,,,,,nan", ",7.")
    history = read_history(tmp_path)
    np.testing.assert_array_equal(history.training["step"], [10, 20])
    assert math.isnan(history.training["loss"][1]) and math.isnan(history.validation["position_error"][0])


def test_nothing_logged(tmp_path: Path) -> None:
    (tmp_path / "csv" / "a").mkdir(parents=True)
    (tmp_path / "csv" / "a" / "metrics.csv").touch()
    history = read_history(tmp_path)
    assert history.num_starts == 0 and len(history.training["step"]) == len(history.validation["step"]) == 0
