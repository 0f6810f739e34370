"""What to change, judged from the numbers of `advice`: one sentence each, with the number and the setting.

The bounds come from the two settings that are known to train (docs/training.md): the paper's, and the quickstart's.
They mark what is far from both; a sweep decides what is best.
"""

from __future__ import annotations

import math

from gns_pl.graph.radius import RADIUS, advised_radius
from gns_pl.training.advice.data_errors import DATA_ERRORS, Rule, Suggestion, percent
from gns_pl.training.advice.derived import Advice, target_noise

NEIGHBOURS = {2: (4.0, 20.0), 3: (8.0, 60.0)}
"""D → least and largest mean number of neighbours; at `RADIUS` spacings there are about 11 and 28."""

NOISE_SHARE = (0.95, 0.85)
"""Largest share of noise in the target, and the one that is suggested instead; about 0.85 is usual."""

NOISE_SPACINGS = (0.001, 0.004, 0.03, 0.05)
"""Random-walk noise over the spacing: least, suggested if less; suggested if more, largest."""

NOISE_VELOCITY = 0.01
"""Noise is too little only if it is also less than this share of the velocities."""

STRAIN_SPACINGS = (0.15, 0.5)
"""Coherent displacement over the spacing: suggested, largest."""

IMPACTS, HUBER_DELTA = 0.5, 0.3
"""Part of the squared acceleration in 1 % of the particles beyond which a Huber loss is suggested, and its δ."""

START_SHARE, MAX_REPEATS = 0.15, 10
"""Least share of windows in which a body sets out from rest, and the most repeats that are suggested."""

MOVING_FRAMES, MOVING_AT_END = 0.4, 0.3
"""Least share of frames that move, and largest share of particles that still move at the end."""

DENSITY_CHANGE = (0.75, 1.3)
"""Least and largest density at the end over that at the start."""

KEPT_SHORT, KEPT_LEAST = 0.03, 5
"""Largest error of the kept points' front in the mean, over so many trajectories at least; lattices of every third
point are 5 to 10 % short."""

IN_MEMORY, TOO_LARGE = 0.5, 0.8
"""Shares of the machine's memory: positions up to the first may be kept there, beyond the second not."""


def suggest(advice: Advice) -> list[Suggestion]:
    """Return what to change, most important first; nothing else is said where the data themselves look wrong.

    Args:
        advice: the numbers.
    """
    wrong = [suggestion for rule in DATA_ERRORS if (suggestion := rule(advice)) is not None]
    return wrong or [suggestion for rule in RULES if (suggestion := rule(advice)) is not None]


def _radius(advice: Advice) -> Suggestion | None:
    density, dim = advice.survey.density, advice.survey.dim
    mean, (low, high) = density.neighbours[0], NEIGHBOURS[dim]
    if low <= mean <= high:
        return None
    what = "too few to carry forces" if mean < low else "costly, and no better"
    return Suggestion(
        f"a particle has {mean:.3g} neighbours within {density.radius:.3g} m ({density.radius / density.spacing:.3g} "
        f"spacings), {what}; at {RADIUS:g} spacings it has {density.by_spacing[f'{RADIUS:g}']:.3g}.",
        f"model.connectivity_radius={advised_radius(density.spacing):g}",
    )


def _fast(advice: Advice) -> Suggestion | None:
    motion, radius = advice.survey.motion, advice.survey.density.radius
    if motion.step[2] <= radius:
        return None
    return Suggestion(
        f"the fastest 0.1 % of the particles move {motion.step[2]:.3g} m in a step, past everything within the radius "
        f"of {radius:.3g} m, before they are seen.",
        f"data.frame_interval={motion.dt * radius / (2 * motion.step[2]):.2g}",
    )


def _reach(advice: Advice) -> Suggestion | None:
    needed = min(advice.survey.starts.body_height, advice.wave)
    if advice.model.context or advice.reach >= needed:
        return None
    steps = math.ceil(needed / advice.model.connectivity_radius)
    return Suggestion(
        f"in a step pressure crosses {needed:.2g} m (wave {advice.wave:.2g} m, highest body "
        f"{advice.survey.starts.body_height:.2g} m), message passing only {advice.reach:.2g} m; "
        f"model.num_message_passing_steps={steps} would do as well.",
        "model.context=true",
    )


def _noise(advice: Advice) -> Suggestion | None:
    perturbation, motion, spacing = advice.training.perturbation, advice.survey.motion, advice.survey.density.spacing
    noise, (least, small, large, most) = perturbation.noise_std, NOISE_SPACINGS
    walk, _ = target_noise(perturbation, advice.model.input_sequence_length)
    too_large = []
    if advice.noise_share > NOISE_SHARE[0] and walk > 0:
        usual = NOISE_SHARE[1] / (1 - NOISE_SHARE[1]) * (motion.acceleration_std * motion.dt**2) ** 2
        too_large.append(noise * math.sqrt(usual / walk))
    if noise > most * spacing:
        too_large.append(large * spacing)
    if too_large:
        return Suggestion(
            f"noise is {percent(advice.noise_share)} of the one-step target's variance and {noise / spacing:.2g} "
            "spacings, so that the loss tells little and heaps may freeze; take less, or judge by rollouts alone.",
            f"training.noise_std={min(too_large):.2g}",
        )
    if noise < least * spacing and advice.noise_over_velocity < NOISE_VELOCITY:
        return Suggestion(
            f"noise of {noise / spacing:.2g} spacings, {percent(advice.noise_over_velocity)} of the velocities, is "
            "less than a rollout's own errors, which then run away.",
            f"training.noise_std={small * spacing:.2g}",
        )
    return None


def _strain(advice: Advice) -> Suggestion | None:
    small, most = STRAIN_SPACINGS
    if advice.strain_over_spacing <= most:
        return None
    perturbation = advice.training.perturbation
    return Suggestion(
        f"coherent noise moves particles by {advice.strain_over_spacing:.2g} spacings, far beyond a rollout's errors.",
        f"training.strain_std={small * advice.survey.density.spacing / perturbation.strain_length:.2g}",
    )


def _impacts(advice: Advice) -> Suggestion | None:
    share = advice.survey.motion.impacts
    if advice.training.optimisation.huber_delta is not None or not share > IMPACTS:
        return None
    return Suggestion(
        f"1 % of the particles hold {percent(share)} of the squared acceleration, so that impacts drown the rest of a "
        "squared loss.",
        f"training.optimisation.huber_delta={HUBER_DELTA}",
    )


def _cold_starts(advice: Advice) -> Suggestion | None:
    starts = advice.survey.starts
    if starts.num_cold:
        return None
    low, high = starts.body_length
    # Blocks of the bodies' lengths that stay in the box; the tests' aspect ratios 0.8 and 2.0 are left out.
    high = min(high, 0.55 * starts.domain[-1], 0.9 * min(starts.domain[:-1]))
    domain, length = ",".join(f"{edge:.4g}" for edge in starts.domain), f"{min(low, 0.9 * high):.3g},{high:.3g}"
    count = max(4, round(advice.survey.sizes.num_trajectories / 3))
    return Suggestion(
        f"none of {starts.num_seen} trajectories begins at rest on the floor, so the network learns that what does not "
        "move has settled, and a column will not start; add bodies that are let go.",
        f"+data.families.block={{kind:block_release,count:{count},valid:1,test:0,duration:{starts.duration:.3g},"
        f"domain:[{domain}],length:[{length}],aspect_ratio:[1.0,1.7],at_wall:0.7}}",
    )


def _setting_out(advice: Advice) -> Suggestion | None:
    share, starts = advice.cold_start_share, advice.survey.starts
    if not starts.num_cold or share >= START_SHARE:
        return None
    # Of r starts to every other window r s / (r s + 1 − s) are starts.
    odds = START_SHARE / (1 - START_SHARE) / (share / (1 - share))
    repeats = min(MAX_REPEATS, math.ceil(advice.training.start_repeats * odds))
    if repeats <= advice.training.start_repeats:
        return None
    return Suggestion(
        f"only {percent(share)} of the windows show how bodies set out from rest, which decides whether they do.",
        f"training.start_repeats={repeats}",
    )


def _aspect_ratios(advice: Advice) -> Suggestion | None:
    low, _, high = advice.survey.starts.aspect_ratio
    if not advice.survey.starts.num_cold or high > 1.3 * low:
        return None
    return Suggestion(
        f"all bodies have an aspect ratio of about {high:.2g}; a range in data.families.NAME.aspect_ratio, or several "
        "families, teaches more than one way to collapse."
    )


def _rest(advice: Advice) -> Suggestion | None:
    motion = advice.survey.motion
    if motion.frames_moving < MOVING_FRAMES and advice.training.moving_repeats == 1:
        return Suggestion(
            f"in {percent(1 - motion.frames_moving)} of the frames nothing moves, which is soon learned; show the "
            "others more often, or shorten data.families.NAME.duration.",
            "training.moving_repeats=4",
        )
    if motion.moving_at_end > MOVING_AT_END:
        return Suggestion(
            f"{percent(motion.moving_at_end)} of the particles still move when their trajectory ends, so the network "
            "sees little of coming to rest; lengthen data.families.NAME.duration."
        )
    return None


def _density_change(advice: Advice) -> Suggestion | None:
    change = advice.survey.density.end_over_start
    if math.isnan(change) or DENSITY_CHANGE[0] <= change <= DENSITY_CHANGE[1]:
        return None
    return Suggestion(
        f"the material ends with {change:.2g} of the density it begins with, and a network will learn that; "
        "check the solver that made the data (data.mpm)."
    )


def _kept(advice: Advice) -> Suggestion | None:
    kept = advice.survey.kept
    chance = 2 * kept.front_scatter / math.sqrt(max(1, kept.num_seen))  # what a mean of so many may be off
    if kept.stratified or kept.num_seen < KEPT_LEAST or abs(kept.front) <= max(KEPT_SHORT, chance):
        return None
    return Suggestion(
        f"the front of the kept points is {percent(abs(kept.front))} {'short of' if kept.front < 0 else 'beyond'} that "
        "of all points of their runs, and so will be a simulator that repeats them; draw the points instead.",
        "+data.sampling=stratified",
    )


def _memory(advice: Advice) -> Suggestion | None:
    size, training = advice.survey.sizes.bytes, advice.training
    fits = size < IN_MEMORY * advice.memory
    have = f"the positions take {size / 1e9:.2g} GB"
    if size > training.memory_limit and fits:
        return Suggestion(
            f"{have}, more than training.memory_limit, so every window is read from the disk; this machine has "
            f"{advice.memory / 1e9:.2g} GB.",
            f"training.memory_limit={1.05 * size:.1e}",
        )
    if size <= training.memory_limit and size > TOO_LARGE * advice.memory:
        return Suggestion(
            f"{have}, and this machine has {advice.memory / 1e9:.2g} GB; let windows be read from the disk.",
            f"training.memory_limit={IN_MEMORY * advice.memory:.1e}",
        )
    if size > training.memory_limit and training.num_workers < 2:
        return Suggestion(
            f"{have}, too much for memory, so loader processes should read them ahead.", "training.num_workers=2"
        )
    return None


def _passes(advice: Advice) -> Suggestion | None:
    if advice.passes >= 1:
        return None
    return Suggestion(
        f"the training sees {percent(advice.passes)} of its {advice.windows} windows.",
        f"training.optimisation.num_steps={advice.steps_per_pass}",
    )


def _validation(advice: Advice) -> Suggestion | None:
    if advice.survey.sizes.num_valid:
        return None
    return Suggestion(
        "there is no validation trajectory, so no best.ckpt; hold one out with data.families.NAME.valid=1."
    )


RULES: tuple[Rule, ...] = (
    _radius,
    _fast,
    _reach,
    _cold_starts,
    _setting_out,
    _aspect_ratios,
    _noise,
    _strain,
    _impacts,
    _rest,
    _density_change,
    _kept,
    _memory,
    _passes,
    _validation,
)
