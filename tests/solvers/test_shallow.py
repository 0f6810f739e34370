"""Depth-averaged flow as one solver among others."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import gns_pl
from gns_pl.errors import InputError
from gns_pl.io import read_trajectory
from gns_pl.presets import preset
from gns_pl.scene import Body
from gns_pl.shallow import ShallowConfig, simulate
from gns_pl.solvers.catalogue import make_solvers
from gns_pl.solvers.shallow import ShallowSolver
from gns_pl.solvers.simulate import simulate as simulate_files
from tests.solvers.test_selection import SAND, column


def test_a_column_in_plane_strain_is_its_slice_and_keeps_its_mass() -> None:
    solver = gns_pl.load_solver("shallow-k0")
    flow = solver.run(column(), interval=0.02)
    assert flow.scene == column() and flow.mass.sum() == pytest.approx(1800 * 0.3 * 0.5 * 0.3, rel=1e-5)
    assert flow.num_frames == 11 and flow.position[-1, :, 0].max() > 0.35
    assert flow.provenance["shallow"]["earth_pressure"] == pytest.approx(0.5)  # type: ignore[index]


def test_it_is_the_rooms_own_run_with_cells_that_grow_with_the_bodies() -> None:
    solver = ShallowSolver("mine", 10.0, {"rain": 1.0, "num_particles": 500})
    assert solver.config(column()) == ShallowConfig(cell_size=0.03, rain=1.0, num_particles=500)
    reduction = solver.reduced(column(1.5))
    own = simulate(reduction.scene, solver.config(column(1.5)), frame_interval=0.05, seed=3)
    flow = solver.run(column(1.5), interval=0.05, seed=3)
    np.testing.assert_array_equal(reduction.project(flow.position), own.position)
    assert solver.cost(column(1.5, duration=0.4)) == pytest.approx(2 * solver.cost(column(1.5)))


def test_what_no_layer_can_show_is_refused_with_the_reason(tmp_path: Path) -> None:
    flying = column(bodies=(Body((0, 0, 0.3), (0.3, 0.5, 0.3), (0, 0, 0)),))
    two = column(
        bodies=(Body((0, 0, 0), (0.3, 0.5, 0.3), (0, 0, 0)), Body((1, 0, 0), (0.3, 0.5, 0.3), (0, 0, 0), "clay")),
        materials={"sand": SAND, "clay": SAND.__class__(**{**vars(SAND), "friction_angle_deg": 20})},
    )
    for scene, reason in ((flying, "cannot fall"), (two, "several friction angles")):
        assert reason in str(gns_pl.load_solver("shallow-k0").unsupported_reason(scene))
        with pytest.raises(InputError, match=reason):
            simulate_files("shallow-k0", [scene], out=tmp_path / "out")
    with pytest.raises(InputError, match=r"choice\.shallow\.x: .*unexpected keyword argument 'cell'"):
        make_solvers({"shallow": {"x": {"cells": 9, "cell": 1}}})
    with pytest.raises(InputError, match=r"choice\.shallow\.x: needs cells"):
        make_solvers({"shallow": {"x": {"rain": 1.0}}})


def test_a_file_of_it_is_complete_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for _ in range(2):
        (path,) = simulate_files("shallow", [column()], out=tmp_path, interval=0.05)
    assert "already complete" in capsys.readouterr().out and read_trajectory(path).provenance["solver"] == "shallow"
    assert {"shallow", "shallow-k0"} <= {solver.name for solver in make_solvers(preset("choice/default"))}
