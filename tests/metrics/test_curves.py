"""Curves under their documented names, their truths and their file."""

from dataclasses import replace

import numpy as np

from gns_pl.fields import ParticleType
from gns_pl.metrics.curves import CURVES, compute_curves, cut, mobile, num_finite_frames, read_curves, write_curves
from tests.evaluation.made_up import HEIGHT, LENGTH, spreading, standing


def test_curves_have_the_documented_names_and_are_finite() -> None:
    curves = compute_curves(spreading())
    assert list(curves) == [quantity.name for quantity in CURVES]
    assert all(len(values) == 30 and np.isfinite(values).all() for values in curves.values())


def test_a_column_stretched_to_twice_its_length() -> None:
    curves = compute_curves(spreading())
    assert curves["runout_99"][0] == curves["runout_max"][0] == 0
    np.testing.assert_allclose(curves["height_max"][0], HEIGHT / LENGTH, rtol=1e-5)
    np.testing.assert_allclose(curves["height_99"][0], 0.99 * HEIGHT / LENGTH, rtol=1e-5)
    # the foremost layer's centre, half a spacing inside, has gone twice as far
    np.testing.assert_allclose(curves["runout_max"][-1], (LENGTH - 0.025) / LENGTH, rtol=1e-5)
    np.testing.assert_allclose(curves["mean_height"][[0, -1]], [HEIGHT / 2, HEIGHT / 4], rtol=1e-5)
    energy = curves["kinetic_energy"] + curves["potential_energy"] + curves["dissipated_energy"]
    np.testing.assert_allclose(energy, energy[0], rtol=1e-9)


def test_what_does_not_move_has_no_runout() -> None:
    curves = compute_curves(standing())
    for name in ("runout_99", "runout_995", "runout_max", "kinetic_energy", "speed_99", "penetration"):
        assert not curves[name].any()


def test_obstacles_are_not_measured() -> None:
    still = standing()
    types = still.particle_type.copy()
    types[:10] = ParticleType.KINEMATIC
    flow = mobile(replace(still, particle_type=types))
    assert flow.num_particles == still.num_particles - 10
    assert mobile(still) is still


def test_finite_frames_are_counted_up_to_the_first_broken_one() -> None:
    flow = spreading()
    position = flow.position.copy()
    position[7, 3, 1] = np.nan
    position[9] = np.inf
    assert num_finite_frames(flow) == 30
    assert num_finite_frames(replace(flow, position=position)) == 7
    assert cut(flow, 7).num_frames == 7


def test_csv_round_trip_with_a_shorter_simulator(tmp_path) -> None:
    curves = {"reference": compute_curves(spreading()), "learned": compute_curves(cut(spreading(share=0.8), 12))}
    write_curves(tmp_path / "curves.csv", curves)
    table = read_curves(tmp_path / "curves.csv")
    np.testing.assert_allclose(table["time_tau"], curves["reference"]["time_tau"], rtol=1e-8)
    for simulator, frames in (("reference", 30), ("learned", 12)):
        for name in ("runout_99", "mean_height", "kinetic_energy"):
            column = table[f"{simulator}.{name}"]
            np.testing.assert_allclose(column[:frames], curves[simulator][name], rtol=1e-8, atol=1e-12)
            assert np.isnan(column[frames:]).all()
