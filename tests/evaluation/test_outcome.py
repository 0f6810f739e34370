"""What became of a run, in metres and seconds, on motions whose outcome is known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gns_pl.evaluation.outcome import outcome_of, read_outcome
from gns_pl.io import write_trajectory
from gns_pl.metrics.curves import compute_curves
from gns_pl.scene import Body, Scene
from gns_pl.trajectory import Trajectory
from tests.evaluation.made_up import DT, HEIGHT, LENGTH, SPACING, column, moved, spreading, standing


def blocks() -> Scene:
    """Two blocks in the middle of a box, away from every wall."""
    bodies = (Body((0.4, 0.1, 0), (0.2, 0.3, 0.1), (0, 0, 0)), Body((0.8, 0.1, 0), (0.2, 0.3, 0.1), (0, 0, 0)))
    return column().replace(bodies=bodies)


def test_a_column_is_told_in_metres_as_its_curves_tell_in_its_lengths() -> None:
    run = spreading(frames=30)
    outcome, curves = outcome_of(run), compute_curves(run)
    assert outcome.runout == pytest.approx(LENGTH * curves["runout_99"][-1])
    assert outcome.runout == pytest.approx(
        LENGTH - SPACING / 2, rel=1e-4
    )  # the last column goes from L − s/2 to twice that
    assert (outcome.largest_height, outcome.largest_height_at) == pytest.approx((HEIGHT, 0.0))
    assert outcome.final_height == pytest.approx(HEIGHT / 2 + SPACING / 4, rel=0.01)
    assert outcome.mean_height == pytest.approx(HEIGHT / 4, rel=1e-3)
    assert outcome.volume == pytest.approx(LENGTH * 0.5 * HEIGHT, rel=1e-5)
    assert outcome.extent["y"] == pytest.approx((0.0025, 0.4975), abs=1e-3)
    assert outcome.extent["x"][1] == pytest.approx(2 * LENGTH - SPACING / 2 - 0.005 * LENGTH, rel=1e-4)
    assert "advance of the front along x" in dict(outcome.rows())["runout"]


def test_a_front_that_rests_has_an_arrest_time_and_one_that_does_not_still_moves() -> None:
    run = spreading(frames=30)
    cut = replace(run, position=run.position[:10])
    assert outcome_of(cut).moving and outcome_of(cut).arrest_time is None
    assert "still moving at 0.18 s, by " in dict(outcome_of(cut).rows())["front"]
    rate = (run.position[9, :, 0].max() - run.position[8, :, 0].max()) / DT
    assert outcome_of(cut).front_speed == pytest.approx(rate, rel=0.05)
    longer = replace(run, position=np.concatenate([run.position, np.repeat(run.position[-1:], 30, axis=0)]))
    outcome = outcome_of(longer)
    assert not outcome.moving and outcome.arrest_time == pytest.approx(26 * DT, abs=2 * DT)
    assert outcome.mean_speed == 0 and "at rest from 0.5" in dict(outcome.rows())["front"]
    still = outcome_of(standing(frames=5))
    assert still.runout == 0 and not still.moving and "did not advance" in dict(still.rows())["front"]


def test_a_run_that_ended_at_rest_or_failed_says_so() -> None:
    run = replace(spreading(frames=30), provenance={"at_rest_from": 0.58})
    cut = replace(run, position=run.position[:10])
    assert not outcome_of(cut).moving and outcome_of(cut).arrest_time is not None
    failed = replace(cut, provenance={"failed_at": 0.2, "failure": "grains flew"})
    assert dict(outcome_of(failed).rows())["ended early"] == "failed at 0.2 s (grains flew)"


@pytest.mark.parametrize("direction", [(1, 0), (-1, 0), (0, 1)])
def test_bodies_away_from_a_wall_run_out_in_every_direction(direction: tuple[float, float]) -> None:
    """Half of the mass goes 0.3 m aside; the other half stays, so the 99 % are 0.3 m from where they were released."""
    start = standing(blocks(), frames=3)
    goes = start.position[0, :, 0] < 0.7 if direction[0] <= 0 else start.position[0, :, 0] > 0.7
    offset = np.zeros((3, start.num_particles, 3))
    offset[1:, goes, :2] = 0.3 * np.array(direction)
    outcome = outcome_of(moved(start, offset))
    assert outcome.runout == pytest.approx(0.3, abs=0.03)
    assert "from where the bodies were released" in outcome.measured_from


def test_a_file_says_what_the_run_said(tmp_path: Path) -> None:
    run: Trajectory = spreading(column(dim=2), frames=30)
    write_trajectory(tmp_path / "run.h5", run)
    assert read_outcome(tmp_path / "run.h5").to_dict() == outcome_of(run).to_dict()
    assert "m³ per metre of width" in dict(outcome_of(run).rows())["deposit"]
    long = replace(run, position=np.repeat(run.position, 15, axis=0), dt=DT / 15)
    write_trajectory(tmp_path / "long.h5", long)  # of which every third frame is looked at
    found, whole = read_outcome(tmp_path / "long.h5"), outcome_of(long)
    assert found.runout == whole.runout and found.end == whole.end and found.mean_speed == whole.mean_speed
    assert found.arrest_time == pytest.approx(whole.arrest_time, abs=3 * long.dt)
