"""Stress of one material point: hypoelastic Drucker–Prager sand that matches Mohr–Coulomb in plane strain.

Tension is positive in the stress, compression in the pressure p. With s the deviator and √J2 = √(s:s / 2):

======================================================  ===========================================
equation                                                code
======================================================  ===========================================
yield: √J2 = q p + k                                    `friction_slope`, `cohesion_intercept`
flow: plastic volume over shear, q_ψ                    `dilation_slope`
q_ψ = sin ψ √(3 / (3 + sin²ψ))                          `material_row`
q = sin φ / a, k = c cos φ / a,                         `material_row`
a = √(3 / (3 + sin²ψ)) + q_ψ sin φ / 3
ds/dt = 2 G dev D + W s − s W (Jaumann)                 `update_stress`
dp/dt = −K tr D, kept signed                            `update_stress`
======================================================  ===========================================

The match: in plane strain the flow rule fixes the stress across the plane, s_yy = −(2/3) q_ψ √J2; put into
Mohr–Coulomb's τ = p' sin φ + c cos φ with the in-plane mean p' this gives a. For ψ = φ these are the well-known
3 tan φ / √(9 + 12 tan²φ); for ψ = 0 they are sin φ and c cos φ (M = √3 sin φ).

Pressure memory: the stored pressure goes on below the tension cut-off when the material opens, though the stress stays
at the cut-off. A closing material must come back to it before it presses again. Without it every gap opened once
would count as sound material and heaps would swell.
"""

# ruff: noqa: D417 (arguments of one kind share a line)
# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gns_pl.mpm.compiled import compiled
from gns_pl.scene import Material

SHEAR, BULK, FRICTION_SLOPE, COHESION_INTERCEPT, DILATION_SLOPE, TENSION, VISCOSITY = range(7)
"""Columns of the material table."""


def material_row(material: Material, bulk_viscosity: float, cell: float) -> NDArray[np.float64]:
    """Return the constants of a material [7] in the order of the columns above (Pa, Pa, 1, Pa, 1, Pa, Pa s).

    Args:
        material: from the scene.
        bulk_viscosity: b of the bulk viscosity b ρ c h.
        cell: h, the edge of a grid cell [m].
    """
    shear = material.youngs_modulus / (2 * (1 + material.poisson_ratio))
    bulk = material.youngs_modulus / (3 * (1 - 2 * material.poisson_ratio))
    phi, psi = math.radians(material.friction_angle_deg), math.radians(material.dilation_angle_deg)
    root = math.sqrt(3 / (3 + math.sin(psi) ** 2))
    dilation = math.sin(psi) * root
    match = root + dilation * math.sin(phi) / 3
    slope, intercept = math.sin(phi) / match, material.cohesion * math.cos(phi) / match
    # The cone ends at its apex k / q (c / tan φ): no mean tension beyond it can be carried.
    tension = min(material.tension_cutoff, intercept / slope) if slope > 0 else material.tension_cutoff
    viscosity = bulk_viscosity * material.density * material.p_wave_speed * cell
    return np.array([shear, bulk, slope, intercept, dilation, tension, viscosity])


@compiled
def total_pressure(pressure, divergence, tension, viscosity):
    """Return the pressure that acts [Pa]: the stored one cut off in tension, with bulk viscosity while in contact.

    Args:
        pressure: stored signed pressure [Pa].
        divergence: div v at the point [1/s].
        tension: tension cut-off [Pa].
        viscosity: bulk viscosity b ρ c h [Pa s].
    """
    if pressure <= -tension:
        return -tension
    total = pressure - viscosity * divergence
    return total if total > -tension else -tension


@compiled
def return_map(pressure, root_j2, shear, bulk, friction_slope, cohesion_intercept, dilation_slope, tension):
    """Return the admissible pressure [Pa] and the factor of the deviator of a trial state.

    Args:
        pressure: signed trial pressure [Pa].
        root_j2: √J2 of the trial deviator [Pa].
        shear, bulk: G and K [Pa].
        friction_slope, cohesion_intercept, dilation_slope: q, k [Pa] and q_ψ.
        tension: tension cut-off [Pa].

    Returns:
        (pressure, factor): the first raised by plastic dilation if q_ψ > 0, the second in [0, 1].
    """
    felt = pressure if pressure > -tension else -tension
    strength = cohesion_intercept + friction_slope * felt
    if root_j2 <= strength:
        return pressure, 1.0
    if pressure <= -tension or dilation_slope == 0.0:
        # Open, or flow without change of volume: straight back along the deviator.
        return pressure, (strength / root_j2 if strength > 0.0 else 0.0)
    multiplier = (root_j2 - strength) / (shear + bulk * friction_slope * dilation_slope)
    left = root_j2 - shear * multiplier
    return pressure + bulk * dilation_slope * multiplier, (left / root_j2 if left > 0.0 else 0.0)


@compiled
def material_law(
    pressure, root_j2, shear_rate, dt, shear, bulk, friction_slope, cohesion_intercept, dilation_slope, tension
):
    """Return the admissible pressure [Pa] and the factor of the deviator of a trial state.

    A law of one's own stands in this function's place, with its arguments (`laws`, docs/extend.md). The law here is
    `return_map`, which depends neither on rate nor on time step.

    Args:
        pressure: signed trial pressure [Pa].
        root_j2: √J2 of the trial deviator [Pa].
        shear_rate: √(2 dev D : dev D) of the step [1/s].
        dt: time step [s].
        shear, bulk, …, tension: see `return_map`.
    """
    return return_map(pressure, root_j2, shear, bulk, friction_slope, cohesion_intercept, dilation_slope, tension)


@compiled
def update_stress(
    sxx, syy, szz, sxy, syz, szx, pressure, lxx, lxy, lxz, lyx, lyy, lyz, lzx, lzy, lzz, dt,
    shear, bulk, friction_slope, cohesion_intercept, dilation_slope, tension,
):  # fmt: skip
    """Return deviator and signed pressure [Pa] after a step with a constant velocity gradient.

    Args:
        sxx, syy, szz, sxy, syz, szx: deviator before [Pa].
        pressure: signed pressure before [Pa].
        lxx, …, lzz: velocity gradient, l_ab = ∂v_a/∂x_b [1/s].
        dt: time step [s].
        shear, bulk, …, tension: see `return_map`.

    Returns:
        (sxx, syy, szz, sxy, syz, szx, pressure).
    """
    trace = lxx + lyy + lzz
    mean = trace / 3.0
    wxy, wyz, wzx = 0.5 * dt * (lxy - lyx), 0.5 * dt * (lyz - lzy), 0.5 * dt * (lzx - lxz)
    twice = 2.0 * shear * dt
    # W s − s W with W antisymmetric: w_xy, w_yz, w_zx and their negatives.
    txx = sxx + twice * (lxx - mean) + 2.0 * (wxy * sxy - wzx * szx)
    tyy = syy + twice * (lyy - mean) + 2.0 * (wyz * syz - wxy * sxy)
    tzz = szz + twice * (lzz - mean) + 2.0 * (wzx * szx - wyz * syz)
    txy = sxy + shear * dt * (lxy + lyx) + wxy * (syy - sxx) - wzx * syz + wyz * szx
    tyz = syz + shear * dt * (lyz + lzy) + wyz * (szz - syy) - wxy * szx + wzx * sxy
    tzx = szx + shear * dt * (lzx + lxz) + wzx * (sxx - szz) - wyz * sxy + wxy * syz
    trial = pressure - bulk * dt * trace
    root_j2 = math.sqrt(0.5 * (txx * txx + tyy * tyy + tzz * tzz) + txy * txy + tyz * tyz + tzx * tzx)
    axx, ayy, azz, axy, ayz, azx = lxx - mean, lyy - mean, lzz - mean, lxy + lyx, lyz + lzy, lzx + lxz
    shear_rate = math.sqrt(2.0 * (axx * axx + ayy * ayy + azz * azz) + axy * axy + ayz * ayz + azx * azx)
    trial, factor = material_law(
        trial, root_j2, shear_rate, dt, shear, bulk, friction_slope, cohesion_intercept, dilation_slope, tension
    )
    return factor * txx, factor * tyy, factor * tzz, factor * txy, factor * tyz, factor * tzx, trial
