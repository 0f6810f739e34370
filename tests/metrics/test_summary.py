"""One number per question."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gns_pl.fields import ParticleType
from gns_pl.metrics import rollout_errors, summarise
from gns_pl.metrics import summary as summary_module
from gns_pl.metrics.curves import CURVES, cut
from gns_pl.metrics.summary import COMPARISON, ERRORS, SUMMARY, Measured, compare
from tests.evaluation.made_up import HEIGHT, SPACING, moved, spreading, standing

ALL = [quantity.name for quantity in (*ERRORS, *SUMMARY)]


def test_summary_has_the_documented_keys() -> None:
    summary = summarise(spreading())
    assert sorted(summary) == sorted(quantity.name for quantity in SUMMARY)
    assert all(np.isfinite(value) for value in summary.values())


def test_summary_of_a_column_at_rest() -> None:
    summary = summarise(standing())
    assert summary["runout_99"] == summary["speed_mean"] == summary["penetration_max"] == 0
    assert summary["mean_height"] == pytest.approx(HEIGHT / 2)
    assert summary["spacing_min"] == summary["spacing_1"] == pytest.approx(1, rel=1e-4)
    assert np.isnan(summary["arrest_time"])


def test_penetration_counts_what_is_deeper_than_half_a_spacing() -> None:
    still = standing()
    position = still.position.copy()
    number = still.num_particles
    position[2, : number // 4, 2] = -0.6 * SPACING
    position[3, : number // 2, 2] = -0.4 * SPACING
    summary = summarise(replace(still, position=position))
    assert summary["penetration_max"] == pytest.approx(0.6, rel=1e-4)
    assert summary["penetrating_fraction"] == pytest.approx(0.25)


def test_a_perfect_rollout_has_no_error() -> None:
    errors = rollout_errors(spreading(frames=120), spreading(frames=120))
    assert list(errors) == ALL
    assert errors["finite_fraction"] == 1
    comparing = {quantity.name for quantity in ERRORS} - {"finite_fraction"}
    assert all(errors[name] == 0 for name in comparing)


def test_errors_have_the_sign_of_the_rollout() -> None:
    errors = rollout_errors(spreading(share=0.5), spreading())
    assert errors["runout_99_error"] == pytest.approx(-0.5, abs=0.02)
    assert errors["runout_max_error"] == pytest.approx(-0.5, rel=1e-4)
    assert errors["runout_99_difference"] < -0.4
    assert errors["mean_height_error"] == pytest.approx((1 / 1.5) / (1 / 2) - 1, rel=1e-4)
    assert np.isnan(errors["mse_50"]) and errors["mse_20"] > 0


def test_position_error_is_in_spacings() -> None:
    still = standing()
    errors = rollout_errors(moved(still, np.ones((5, 1)) * [0, 2 * SPACING, 0]), still)
    assert errors["position_error"] == pytest.approx(2, rel=1e-4)
    assert errors["mse_end"] == pytest.approx((2 * SPACING) ** 2 / 3, rel=1e-4)


def test_profile_difference_of_a_pancake_is_its_area() -> None:
    still = standing()
    position = still.position.copy()
    position[1:, :, 2] /= 4
    errors = rollout_errors(replace(still, position=position), still)
    assert errors["profile_l1"] == pytest.approx(0.75, rel=1e-4)
    assert errors["mean_height_error"] == pytest.approx(-0.75, rel=1e-4)


def test_relative_runout_error_is_undefined_where_nothing_moves() -> None:
    errors = rollout_errors(spreading(frames=5), standing())
    assert np.isnan(errors["runout_99_error"])
    assert errors["runout_99_difference"] > 0.5


@pytest.mark.parametrize("ends", ["early", "with a NaN"])
def test_a_rollout_that_breaks_has_no_numbers_beyond(ends: str) -> None:
    reference, rollout = spreading(), spreading(share=0.9)
    if ends == "early":
        rollout = cut(rollout, 12)
    else:
        position = rollout.position.copy()
        position[12, 5] = np.nan
        rollout = replace(rollout, position=position)
    errors = rollout_errors(rollout, reference)
    assert list(errors) == ALL
    assert errors["finite_fraction"] == pytest.approx(12 / 30)
    assert np.isfinite([errors["mse_1"], errors["mse_5"]]).all()
    assert np.isnan([errors["mse_20"], errors["mse_end"], errors["runout_99"], errors["penetration_max"]]).all()


def test_a_longer_rollout_is_judged_at_the_references_end() -> None:
    reference = cut(spreading(), 20)
    assert rollout_errors(spreading(), reference)["position_error"] == 0


def test_the_measures_are_light_to_import() -> None:
    code = "import sys, gns_pl.evaluation; sys.exit(any(m in sys.modules for m in ('torch', 'matplotlib', 'wandb')))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_every_number_is_documented() -> None:
    lines = (Path(__file__).parents[2] / "docs" / "evaluation.md").read_text(encoding="utf-8").splitlines()
    for quantity in (*CURVES, *SUMMARY, *COMPARISON):
        assert f"| `{quantity.name}` | {quantity.unit} | {quantity.meaning} |" in lines


def test_a_trajectory_is_measured_once(monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []
    plain = summary_module.compute_curves
    monkeypatch.setattr(summary_module, "compute_curves", lambda flow: (calls.append(flow), plain(flow))[1])
    measured = Measured(spreading())
    assert measured.summary["runout_99"] == measured.curves["runout_99"][-1] == measured.summary["runout_99"]
    assert len(calls) == 1 and calls[0] is measured.flow


def test_what_is_measured_is_the_flow_without_kinematic_particles() -> None:
    flow = spreading()
    types = flow.particle_type.copy()
    far = flow.position[-1, :, 0] > np.median(flow.position[-1, :, 0])
    types[far] = int(ParticleType.KINEMATIC)
    mixed = Measured(replace(flow, particle_type=types))
    assert mixed.flow.num_particles == (~far).sum()
    assert mixed.summary["runout_max"] < Measured(flow).summary["runout_max"]


def test_transport_is_nothing_for_the_same_and_unknown_for_a_run_that_ended() -> None:
    flow = spreading(frames=6)
    same, short = compare(flow, flow), compare(cut(flow, 3), flow)
    assert same["sinkhorn"] == pytest.approx(0, abs=0.05) and list(same) == [*ALL, "sinkhorn"]
    assert np.isnan(short["sinkhorn"]) and short["finite_fraction"] == 0.5


def test_against_all_points_a_rollout_of_some_has_the_runout_of_some() -> None:
    """Every other particle of the reference is rolled out; fronts are compared with those of all."""
    whole = spreading(frames=20)
    some = np.arange(0, whole.num_particles, 2)
    names = ("particle_type", "material", "mass", "initial_velocity")
    half = replace(whole, position=whole.position[:, some], **{name: getattr(whole, name)[some] for name in names})
    alone, against_all = rollout_errors(half, half), rollout_errors(half, half, Measured(whole))
    assert alone["runout_99_error"] == 0 and alone["position_error"] == against_all["position_error"] == 0
    own, wanted = Measured(half).curves["runout_99"][-1], Measured(whole).curves["runout_99"][-1]
    assert against_all["runout_99_error"] == pytest.approx(own / wanted - 1)
