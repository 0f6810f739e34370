"""Tables and numbers for people."""

import math

import pytest

from gns_pl.evaluation import report


@pytest.mark.parametrize(
    ("value", "text"),
    [(None, "–"), (0, "0"), (1.23456, "1.23"), (-0.012345, "-0.0123"), (1.2e-7, "1.20e-07"), (5678.9, "5679")],
)
def test_numbers_have_three_digits(value, text) -> None:
    assert report.number(value) == text


def test_relative_errors_have_a_sign() -> None:
    assert report.percent(0.1234) == "+12.3 %"
    assert report.percent(-0.5) == "-50.0 %"
    assert report.percent(None) == ""


def test_what_is_not_finite_becomes_null() -> None:
    assert report.without_nan({"a": [1.0, math.nan], "b": {"c": math.inf, "d": "NaN"}, "e": 3}) == {
        "a": [1.0, None],
        "b": {"c": None, "d": "NaN"},
        "e": 3,
    }


def test_rows_name_keys_that_exist() -> None:
    from gns_pl.evaluation.metrics import COMPARISON, SUMMARY

    summary, errors = ({quantity.name for quantity in table} for table in (SUMMARY, COMPARISON))
    assert all(key in summary and (not error or error in errors) for _, key, error in report.ROWS)
    assert all(key in errors for _, key in report.ERROR_ROWS)


def test_what_rollouts_start_from_is_said() -> None:
    assert report.describe_start({"input_sequence_length": 6}, 6) == "Rollouts start from 6 frames of the reference."
    assert report.describe_start({"input_sequence_length": 6}, 1).endswith("with straight motion before.")
    theirs = report.describe_start({"input_sequence_length": 6, "edge_update": "residual"}, 1)
    assert theirs.endswith("such a network from 6 true frames instead: evaluation.start=frames")
