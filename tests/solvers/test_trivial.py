"""What costs nothing: closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from gns_pl.metrics.curves import compute_curves
from gns_pl.scene import Scene
from gns_pl.solvers.trivial import Ballistic, FittedLaw, Still, extrapolate


def test_extrapolation_is_exact_on_what_is_linear_in_the_cell() -> None:
    def runout(cell: float) -> float:
        return 3.0 - 7.0 * cell

    for coarse, fine in ((0.1, 0.05), (0.3, 0.01)):
        assert extrapolate(runout(coarse), runout(fine), coarse / fine) == pytest.approx(3.0)


def test_extrapolation_of_second_order_is_exact_on_squares() -> None:
    assert extrapolate(3.0 - 7.0 * 0.3**2, 3.0 - 7.0 * 0.1**2, 3.0, order=2.0) == pytest.approx(3.0)


def test_a_power_law_is_fitted_exactly() -> None:
    law = FittedLaw.to_runs({a: 1.3 * a**0.8 for a in (0.5, 1.0, 2.0, 3.0)})
    assert law(1.7) == pytest.approx(1.3 * 1.7**0.8)
    assert law.coefficients[2] == pytest.approx(0.0, abs=1e-9)
    assert FittedLaw.to_runs({2.0: 3.0})(5.0) == pytest.approx(3.0)


def test_nothing_moves(column: Scene) -> None:
    still = Still("still", 4.0)
    made = still.run(column, interval=0.1, seed=0)
    assert made.num_frames == 6 and (made.position == made.position[0]).all()
    assert made.num_particles == pytest.approx(still.size(column)[0], rel=0.05)
    assert compute_curves(made)["runout_99"][-1] == 0


def test_a_ballistic_particle_falls_freely_and_stops_at_the_floor(drop: Scene) -> None:
    scene = drop.replace(duration=0.6)
    made = Ballistic("ballistic", 4.0).run(scene, interval=0.05, seed=0)
    start, velocity = made.position[0].astype(np.float64), made.initial_velocity
    free = start[:, 2] + velocity[:, 2] * 0.1 - 0.5 * 9.81 * 0.1**2
    assert made.position[2][:, 2] == pytest.approx(free, abs=1e-5)
    assert made.position[2][:, 0] == pytest.approx(start[:, 0] + velocity[:, 0] * 0.1, abs=1e-5)
    assert (made.position[-1][:, 2] >= 0).all() and made.position[-1][:, 2] == pytest.approx(0, abs=1e-6)
    assert made.position[-1] == pytest.approx(made.position[-2])  # what lies, lies


def test_a_standing_column_is_flat_when_its_particles_have_fallen(column: Scene) -> None:
    made = Ballistic("ballistic", 4.0).run(column, interval=0.1, seed=0)
    assert compute_curves(made)["runout_99"][-1] == pytest.approx(0, abs=1e-6)
    assert compute_curves(made)["mean_height"][-1] == pytest.approx(0, abs=1e-6)
