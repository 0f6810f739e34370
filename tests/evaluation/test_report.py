"""Tables and numbers for people."""

from gns_pl.evaluation import report


def test_rows_name_keys_that_exist() -> None:
    from gns_pl.metrics.summary import COMPARISON, SUMMARY

    summary, errors = ({quantity.name for quantity in table} for table in (SUMMARY, COMPARISON))
    assert all(key in summary and (not error or error in errors) for _, key, error in report.ROWS)
    assert all(key in errors for _, key in report.ERROR_ROWS)


def test_what_rollouts_start_from_is_said() -> None:
    assert report.describe_start({"input_sequence_length": 6}, 6) == "Rollouts start from 6 frames of the reference."
    assert report.describe_start({"input_sequence_length": 6}, 1).endswith("with straight motion before.")
    theirs = report.describe_start({"input_sequence_length": 6, "edge_update": "residual"}, 1)
    assert theirs.endswith("such a network from 6 true frames instead: evaluation.start=frames")
