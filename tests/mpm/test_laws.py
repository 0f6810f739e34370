"""A material law of one's own: the one of docs/extend.md, from a file in the working folder."""

from __future__ import annotations

import importlib
import math
import sys
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest

from gns_pl.errors import InputError
from gns_pl.mpm import register_law, simulate
from gns_pl.mpm.compiled import variant
from gns_pl.mpm.constitutive import material_row, update_stress
from gns_pl.mpm.laws import LAWS, find_law, law_names
from gns_pl.mpm.settings import solver_version
from gns_pl.scene import Body, Wall
from gns_pl.solvers.mpm import MPMSolver
from tests.extend.page import blocks
from tests.mpm.conftest import make_box, make_mpm, make_sand

OWN = "own_laws.inertial_friction"
COLUMN = Body((0.0, 0.0), (0.2, 0.4), (0.0, 0.0))
ARGUMENTS = "pressure, root_j2, shear_rate, dt, shear, bulk, slope, intercept, dilation, tension"


def write_law(text: str) -> None:
    Path("own_laws.py").write_text(text)
    importlib.invalidate_caches()
    sys.modules.pop("own_laws", None)


@pytest.fixture
def own_law(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A working folder that holds the law of the page; returns its text."""
    monkeypatch.chdir(tmp_path)
    (text,) = blocks("A material law")
    monkeypatch.setattr(sys, "dont_write_bytecode", True)  # a file that changes within a second is read again
    write_law(text)
    return text


def step_of(law: str) -> Any:
    """`update_stress` under a law."""
    found = find_law(law)
    assert found is not None
    return variant(update_stress, "float64", law_names(found), lambda function: numba.njit(function))


def test_steady_shear_ends_on_the_law_of_the_page(own_law: str) -> None:
    constants, rate, pressure = material_row(make_sand(), 0.3, 1 / 12), 20.0, 500.0
    step, stress = step_of(OWN), (0.0,) * 6 + (pressure,)
    for _ in range(2000):
        stress = step(*stress, 0.0, 0.0, rate, *(0.0,) * 6, 1e-5, *constants[:6])
    inertial = rate * 0.01 * math.sqrt(1800.0 / pressure)
    slope = math.sin(math.radians(30)) + 0.27 * inertial / (0.3 + inertial)
    xx, yy, zz, xy, yz, zx, after = stress
    assert after == pytest.approx(pressure)
    assert math.sqrt(0.5 * (xx**2 + yy**2 + zz**2) + xy**2 + yz**2 + zx**2) == pytest.approx(slope * pressure)


def test_the_shipped_law_as_ones_own_gives_the_same_bits(own_law: str) -> None:
    write_law(
        "from gns_pl.mpm.constitutive import return_map\n\n\n"
        f"def again({ARGUMENTS}):\n"
        "    return return_map(pressure, root_j2, shear, bulk, slope, intercept, dilation, tension)\n"
    )
    rng, constants = np.random.default_rng(0), material_row(make_sand(dilation_angle_deg=5.0), 0.3, 1 / 12)
    step, same = step_of("own_laws.again"), variant(update_stress, "float64", {}, lambda function: numba.njit(function))
    for _ in range(100):
        stress, gradient = 1e3 * rng.normal(size=7), 10 * rng.normal(size=9)
        assert step(*stress, *gradient, 1e-4, *constants[:6]) == same(*stress, *gradient, 1e-4, *constants[:6])


def test_a_run_under_a_law_of_ones_own(own_law: str) -> None:
    """A column under friction that grows with the rate runs out less far; settings and version say which law it was."""
    scene = make_box((1.2, 0.5), COLUMN, duration=0.6, wall=Wall("friction", 0.4))
    runs = [
        simulate(scene, make_mpm(cell_size=0.05, points_per_direction=2, **law), frame_interval=0.2)
        for law in ({}, {"law": OWN})
    ]
    assert runs[0].position[-1, :, 0].max() > runs[1].position[-1, :, 0].max() + 0.02
    assert np.isfinite(runs[1].position).all()
    assert runs[1].provenance["config"]["law"] == OWN  # type: ignore[index]


def test_a_law_is_known_by_its_code(own_law: str) -> None:
    solvers = [MPMSolver.preset("paper", cell_size=0.1, **law) for law in ({}, {"law": OWN})]
    facts, identities = (
        solvers[1].facts(make_box((1.0, 1.0), COLUMN, duration=0.1)),
        {each.identity() for each in solvers},
    )
    shipped, version = solver_version(), solver_version({"law": OWN})
    assert solver_version({"law": "drucker_prager"}) == shipped and version.startswith(f"{shipped}.")
    write_law(own_law.replace("DIAMETER, DENSITY = 0.01", "DIAMETER, DENSITY = 0.02"))
    assert solver_version({"law": OWN}) not in (shipped, version)
    assert len(identities) == 2 and solvers[1].identity() not in identities
    assert solvers[1].facts(make_box((1.0, 1.0), COLUMN, duration=0.1)) != facts
    write_law(own_law.replace("inertial_number)", "inertial_number * 1.0)"))
    assert solver_version({"law": OWN}) not in (shipped, version)
    write_law(f"# a comment changes nothing\n{own_law}")
    assert solver_version({"law": OWN}) == version


def test_what_is_registered_goes_by_its_name(own_law: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gns_pl.mpm.laws.LAWS", dict(LAWS))
    find_law(OWN)
    register_law("inertial", sys.modules["own_laws"].inertial_friction)
    assert make_mpm(law="inertial").law == "inertial"
    assert solver_version({"law": "inertial"}) == solver_version({"law": OWN})


@pytest.mark.parametrize(
    ("law", "text", "message"),
    [
        ("mohr", "", r"mpm\.law must be one of drucker_prager, or MODULE\.FUNCTION of your own, not 'mohr'"),
        ("own_laws.nothing", "", "mpm.law=own_laws.nothing: .* has no attribute 'nothing'"),
        ("own_laws.law", "law = 1", "mpm.law=own_laws.law: is no function"),
        ("own_laws.law", "def law(pressure): return pressure, 1.0", "mpm.law=own_laws.law: "),
        ("own_laws.law", f"def law({ARGUMENTS}): return pressure", "mpm.law=own_laws.law: "),
        (
            "own_laws.law",
            f"def law({ARGUMENTS}): return 1 / (dt - dt), 1.0",
            "fails on a plain state: division by zero",
        ),
        ("own_laws.law", f"def law({ARGUMENTS}): return unknown(pressure), 1.0", "numba cannot compile it: .*unknown"),
        ("own_laws.law", f"def law({ARGUMENTS}): return pressure, float('nan')", "two finite numbers"),
    ],
)
def test_what_is_no_law_is_told(law: str, text: str, message: str, own_law: str) -> None:
    write_law(text)
    with pytest.raises(InputError, match=message) as refused:
        make_mpm(law=law)
    assert "\n" not in str(refused.value)
