"""What is wrong with a data set: not finite, or units, a time step or boxes that do not fit the motion."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from gns_pl.errors import InputError
from gns_pl.scene.origin import check_coarseness
from gns_pl.training.advice.derived import Advice

SPACING_FACTOR, GRAVITY_FACTOR, SAME_FACTOR, STATISTICS_FACTOR = 1.3, 1.05, 1.15, 2.0
"""Within these factors what is measured fits what is stated: spacing, gravity, one against the other, velocities."""

MAX_SPEED = 50.0
"""No sand of ours is faster [m/s]."""

OUTSIDE = 1e-3
"""Share of particles outside their box that a few stragglers explain."""


@dataclass(frozen=True)
class Suggestion:
    """One thing to change.

    Attributes:
        message: why, with the number.
        change: setting as one types it; None where the data themselves need mending.
    """

    message: str
    change: str | None = None


Rule = Callable[[Advice], Suggestion | None]


def _finite(advice: Advice) -> Suggestion | None:
    bad = advice.survey.data_errors.not_finite
    if not bad:
        return None
    return Suggestion(
        f"{len(bad)} files hold numbers that are not finite ({_some(bad)}); remove them or make them again."
    )


def _lengths(advice: Advice) -> Suggestion | None:
    density, motion = advice.survey.density, advice.survey.motion
    factor = density.measured / density.spacing
    if math.isnan(factor) or 1 / SPACING_FACTOR < factor < SPACING_FACTOR:
        return None
    text = f"particles lie {density.measured:.3g} m apart, the manifest says {density.spacing:.3g} m"
    if _near(motion.gravity / motion.gravity_stated / factor, SAME_FACTOR):
        text += f", and free fall is {motion.gravity:.3g} m/s² instead of {motion.gravity_stated:.3g}"
        times = motion.gravity / motion.gravity_stated  # the sharper of the two
        return Suggestion(f"{text}: positions are {times:.3g} times what they were in metres; divide them by it.")
    return Suggestion(f"{text}: positions are not in metres, or the manifest's spacing is wrong.")


def _time_step(advice: Advice) -> Suggestion | None:
    density, motion = advice.survey.density, advice.survey.motion
    ratio, factor = motion.gravity / motion.gravity_stated, density.measured / density.spacing
    if math.isnan(ratio) or _near(ratio, GRAVITY_FACTOR) or _near(ratio / factor, SAME_FACTOR):
        return None  # lengths explain it
    return Suggestion(
        f"free fall is {motion.gravity:.3g} m/s² where the scenes state {motion.gravity_stated:.3g}: dt = "
        f"{motion.dt:.4g} s does not fit the motion, {motion.dt * math.sqrt(ratio):.4g} s would; mend dt in the files "
        "and the manifest."
    )


def _gravity(advice: Advice) -> Suggestion | None:
    stated = advice.survey.motion.gravity_stated
    if math.isclose(stated, advice.gravity, rel_tol=0.01):
        return None
    return Suggestion(
        f"the scenes have a gravity of {stated:.4g} m/s², the settings {advice.gravity:.4g}.",
        f"data.gravity={stated:.4g}",
    )


def _far(advice: Advice) -> Suggestion | None:
    extent, spacing = advice.survey.data_errors.extent, advice.survey.density.spacing
    try:
        check_coarseness("the data", extent, spacing, "convert their source again, which takes the origin off")
    except InputError as error:
        return Suggestion(str(error))
    return None


def _outside(advice: Advice) -> Suggestion | None:
    data_errors = advice.survey.data_errors
    if data_errors.outside <= OUTSIDE or _lengths(advice) is not None:
        return None
    return Suggestion(
        f"{percent(data_errors.outside)} of the particles lie outside their box by more than a spacing (coordinates up "
        f"to {data_errors.extent:.3g} m): the scenes' boxes do not fit the positions."
    )


def _speed(advice: Advice) -> Suggestion | None:
    motion = advice.survey.motion
    speed = motion.step[3] / motion.dt
    if speed <= MAX_SPEED:
        return None
    return Suggestion(f"the fastest particle moves at {speed:.3g} m/s; check units, dt and the solver's stability.")


def _statistics(advice: Advice) -> Suggestion | None:
    motion = advice.survey.motion
    if not motion.velocity_std > 0:
        return Suggestion("the manifest's standard deviation of the velocity is 0: nothing in the data moves.")
    if _near(motion.velocity_std_seen / motion.velocity_std, STATISTICS_FACTOR):
        return None
    return Suggestion(
        f"the velocity's standard deviation is {motion.velocity_std_seen:.3g} m/s in the frames seen, "
        f"{motion.velocity_std:.3g} in the manifest: its statistics are not those of these files."
    )


def _other_dt(advice: Advice) -> Suggestion | None:
    other = advice.survey.data_errors.other_dt
    if not other:
        return None
    return Suggestion(
        f"{len(other)} files have another dt than the manifest's {advice.survey.motion.dt:.4g} s ({_some(other)})."
    )


def _obstacles(advice: Advice) -> Suggestion | None:
    number = advice.survey.starts.num_obstacles
    if not number:
        return None
    return Suggestion(
        f"{number} trajectories have obstacles, which a learned simulator does not know yet; leave them out."
    )


DATA_ERRORS: tuple[Rule, ...] = (
    _finite,
    _far,
    _lengths,
    _time_step,
    _gravity,
    _outside,
    _speed,
    _other_dt,
    _statistics,
    _obstacles,
)
"""What is wrong with the data: as long as one of these speaks, the others are not asked."""


def _near(ratio: float, factor: float) -> bool:
    """Return whether `ratio` lies within 1/factor … factor; NaN does not."""
    return 1 / factor < ratio < factor


def percent(share: float) -> str:
    """Return a share in per cent: three digits, four where they tell it from everything."""
    return f"{100 * share:.4g} %" if 0.995 <= share < 1 else f"{100 * share:.3g} %"


def _some(names: tuple[str, ...]) -> str:
    return ", ".join(names[:3]) + (", …" if len(names) > 3 else "")
