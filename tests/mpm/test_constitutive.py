from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from gns_pl.mpm.constitutive import (
    COHESION_INTERCEPT,
    DILATION_SLOPE,
    FRICTION_SLOPE,
    TENSION,
    material_row,
    return_map,
    total_pressure,
    update_stress,
)
from tests.mpm.conftest import make_sand

ANGLES = pytest.mark.parametrize(("phi", "psi"), [(30.0, 0.0), (30.0, 10.0), (35.0, 35.0), (65.0, 5.0)])


def row(**changes: Any) -> NDArray[np.float64]:
    return material_row(make_sand(**changes), 0.3, 1 / 12)


def step(
    stress: NDArray[np.float64], gradient: NDArray[np.float64], dt: float, constants: NDArray[np.float64]
) -> NDArray[np.float64]:
    return np.array(update_stress(*stress, *gradient.ravel(), dt, *constants[:6]))


def tensor(stress: NDArray[np.float64]) -> NDArray[np.float64]:
    xx, yy, zz, xy, yz, zx, pressure = stress
    return np.asarray(np.array([[xx, xy, zx], [xy, yy, yz], [zx, yz, zz]]) - pressure * np.eye(3))


def root_j2(stress: NDArray[np.float64]) -> float:
    deviator = tensor(np.append(stress[:6], 0.0))
    return math.sqrt(0.5 * (deviator * deviator).sum())


@ANGLES
def test_plane_strain_yields_at_mohr_coulomb(phi: float, psi: float) -> None:
    """Long shearing in plane strain ends on Mohr–Coulomb's line in the plane, and dilates at the angle ψ."""
    cohesion = 200.0
    constants = row(friction_angle_deg=phi, dilation_angle_deg=psi, cohesion=cohesion)
    stress = np.array([0, 0, 0, 0, 0, 0, 1e4])
    # Pure shear plus the dilation that the flow rule wants, so that the stress settles.
    shear = np.array([[1.0, 0, 0], [0, 0, 0], [0, 0, -1.0]]) + math.sin(math.radians(psi)) * np.diag([1.0, 0, 1.0])
    for _ in range(4000):
        stress = step(stress, shear, 1e-4, constants)
    xx, zz, zx = tensor(stress)[0, 0], tensor(stress)[2, 2], tensor(stress)[2, 0]
    radius = math.hypot(0.5 * (xx - zz), zx)
    centre = -0.5 * (xx + zz)
    phi_rad = math.radians(phi)
    assert radius == pytest.approx(centre * math.sin(phi_rad) + cohesion * math.cos(phi_rad), rel=1e-3)


def test_slopes_of_known_cases() -> None:
    assert row()[FRICTION_SLOPE] == pytest.approx(0.5)
    assert row(cohesion=100)[COHESION_INTERCEPT] == pytest.approx(100 * math.cos(math.radians(30)))
    associated = row(dilation_angle_deg=30.0)
    tangent = math.tan(math.radians(30))
    known = 3 * tangent / math.sqrt(9 + 12 * tangent**2)
    assert associated[FRICTION_SLOPE] == pytest.approx(known)
    assert associated[DILATION_SLOPE] == pytest.approx(known)


@ANGLES
def test_return_mapping_lands_on_the_yield_surface(phi: float, psi: float) -> None:
    constants = row(friction_angle_deg=phi, dilation_angle_deg=psi, cohesion=100.0, tension_cutoff=50.0)
    rng = np.random.default_rng(0)
    for _ in range(200):
        pressure, shear = rng.uniform(-500, 2e4), rng.uniform(0, 5e4)
        new, factor = return_map(pressure, shear, *constants[:6])
        strength = constants[COHESION_INTERCEPT] + constants[FRICTION_SLOPE] * max(new, -constants[TENSION])
        assert 0 <= factor <= 1
        if factor < 1:
            assert factor * shear == pytest.approx(max(strength, 0.0), abs=1e-6 * max(shear, 1.0))
        else:
            assert new == pressure
            assert shear <= strength
        if psi == 0:
            assert new == pressure  # no plastic volume


@ANGLES
def test_mapping_twice_is_mapping_once(phi: float, psi: float) -> None:
    constants = row(friction_angle_deg=phi, dilation_angle_deg=psi, cohesion=100.0)
    new, factor = return_map(3e3, 9e4, *constants[:6])
    again, second = return_map(new, factor * 9e4, *constants[:6])
    assert again == pytest.approx(new)
    assert second == pytest.approx(1.0)


def test_elastic_states_follow_hooke() -> None:
    constants = row(cohesion=1e9, tension_cutoff=1e9)
    shear, bulk = constants[:2]
    rng = np.random.default_rng(1)
    strain = rng.normal(size=(3, 3)) * 1e-4
    strain = strain + strain.T
    stress = step(np.zeros(7), strain, 1.0, constants)
    expected = 2 * shear * strain + (bulk - 2 * shear / 3) * np.trace(strain) * np.eye(3)
    assert tensor(stress) == pytest.approx(expected, rel=1e-12)


def test_rotation_turns_the_stress_and_changes_nothing_else() -> None:
    constants = row(cohesion=1e9, tension_cutoff=1e9)
    start = np.array([300.0, -100.0, -200.0, 50.0, -80.0, 120.0, 400.0])
    axis = np.array([1.0, 2.0, -0.5])
    spin = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    steps, angle = 20000, 0.7
    rate = angle / np.linalg.norm(axis)
    stress = start
    for _ in range(steps):
        stress = step(stress, spin * rate, 1 / steps, constants)
    unit = spin / np.linalg.norm(axis)
    rotation = np.eye(3) + math.sin(angle) * unit + (1 - math.cos(angle)) * unit @ unit
    assert tensor(stress) == pytest.approx(rotation @ tensor(start) @ rotation.T, abs=0.05)
    assert stress[6] == 400.0


def test_tension_ends_at_the_cut_off_and_never_above_the_apex() -> None:
    assert row(cohesion=100.0, tension_cutoff=50.0)[TENSION] == 50.0
    apex = 100.0 / math.tan(math.radians(30))
    assert row(cohesion=100.0, tension_cutoff=1e6)[TENSION] == pytest.approx(apex)
    assert row(cohesion=0.0, tension_cutoff=50.0)[TENSION] == 0.0
    assert total_pressure(-1e5, 0.0, 50.0, 0.0) == -50.0
    _, factor = return_map(-1e9, 1e6, *row(tension_cutoff=50.0)[:6])
    assert factor == 0.0  # no shear stress without cohesion and pressure


def test_an_opened_gap_must_close_before_pressure_is_felt_again() -> None:
    constants = row()
    opening = np.eye(3) / 3
    stress = np.array([0, 0, 0, 0, 0, 0, 1e3])
    stress = step(stress, opening, 0.02, constants)  # opens by 2 %
    assert total_pressure(stress[6], 0.0, 0.0, 0.0) == 0.0
    stress = step(stress, -opening, 0.015, constants)
    assert total_pressure(stress[6], 0.0, 0.0, 0.0) == 0.0
    stress = step(stress, -opening, 0.005, constants)
    assert stress[6] == pytest.approx(1e3)


def test_bulk_viscosity_acts_in_contact_only_and_never_pulls() -> None:
    assert total_pressure(1000.0, -2.0, 50.0, 10.0) == 1020.0
    assert total_pressure(-51.0, -2.0, 50.0, 10.0) == -50.0
    assert total_pressure(0.0, 100.0, 50.0, 10.0) == -50.0
