"""The advice in words: a table and sentences for people, advice.json for programs."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Sequence
from pathlib import Path

from gns_pl import __version__
from gns_pl.data.survey_record import IMPACT_SHARE, MOVING_SHARE, SPEED_AT_REST
from gns_pl.text import number, without_nan
from gns_pl.training.advice.data_errors import Suggestion, percent
from gns_pl.training.advice.derived import Advice

FORMAT, FORMAT_VERSION = "gns_pl advice", 1


def write(path: Path, directory: Path, advice: Advice, notes: Sequence[str], suggestions: Sequence[Suggestion]) -> None:
    """Write everything as JSON, with null for what could not be measured.

    Args:
        path: of the file.
        directory: of the data set.
        advice: the numbers.
        notes: sentences about the data set.
        suggestions: what to change.
    """
    content = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "gns_pl_version": __version__,
        "dataset": str(directory),
        "notes": list(notes),
        "suggestions": [dataclasses.asdict(suggestion) for suggestion in suggestions],
        **dataclasses.asdict(advice),
    }
    plain = without_nan(json.loads(json.dumps(content)))
    path.write_text(json.dumps(plain, indent=2, allow_nan=False, ensure_ascii=False) + "\n", encoding="utf-8")


def show(advice: Advice, notes: Sequence[str], suggestions: Sequence[Suggestion], path: Path) -> None:
    """Print the table, what to change, and where the file is."""
    from rich.console import Console
    from rich.table import Table

    console = Console(markup=False, highlight=False)
    table = Table(
        title=f"{advice.survey.name}: {advice.survey.num_windows_seen} windows looked at", title_justify="left"
    )
    for head in ("", "", "of which, or compared with"):
        table.add_column(head, justify="left")
    for row in rows(advice):
        table.add_row(*row)
    console.print(table)
    for note in notes:
        console.print(f"Note: {note}", soft_wrap=True)
    for line in suggestion_lines(suggestions):
        console.print(line, soft_wrap=True)
    print("Made:", path, sep="\n  ")


def suggestion_lines(suggestions: Sequence[Suggestion]) -> list[str]:
    """Return the suggestions as numbered lines, each followed by its setting as a shell takes it."""
    if not suggestions:
        return ["Nothing to change."]
    lines = ["Suggestions:"]
    for index, suggestion in enumerate(suggestions, start=1):
        lines.append(f"{index:>2}. {suggestion.message[0].upper()}{suggestion.message[1:]}")
        if suggestion.change is not None:
            quoted = f"'{suggestion.change}'" if "{" in suggestion.change else suggestion.change
            lines.append(f"    {quoted}")
    if any((suggestion.change or "").lstrip("+").startswith("data.") for suggestion in suggestions):
        lines.append("Other data need another folder: data.root=…")
    return lines


def rows(advice: Advice) -> list[tuple[str, str, str]]:
    """Return the rows of the table: label, value, what it is made of or compared with."""
    return [*_size_rows(advice), *_density_rows(advice), *_motion_rows(advice), *_noise_rows(advice)]


def _size_rows(advice: Advice) -> list[tuple[str, str, str]]:
    survey, training = advice.survey, advice.training
    sizes, starts = survey.sizes, survey.starts
    storage = "kept in memory" if sizes.bytes <= training.memory_limit else "read window by window"
    low, middle, high = starts.aspect_ratio
    return [
        (
            "training trajectories",
            str(sizes.num_trajectories),
            f"{sizes.num_windows} windows; {sizes.num_valid} validation trajectories",
        ),
        ("particles", number(sizes.particles_mean), f"on average; largest {sizes.particles_max}"),
        (
            "positions",
            f"{sizes.bytes / 1e9:.2g} GB",
            f"{storage} (training.memory_limit {training.memory_limit / 1e9:.2g} GB)",
        ),
        (
            "a pass",
            f"{advice.steps_per_pass} steps",
            f"{advice.windows} windows in batches of {training.batch_size}; "
            f"{number(advice.passes)} passes in {training.optimisation.num_steps} steps",
        ),
        (
            "cold starts",
            f"{starts.num_cold} of {starts.num_seen}",
            f"at rest on the floor; {starts.num_hung} at rest in the air; "
            f"{percent(advice.cold_start_share)} of the windows of a pass show them set out",
        ),
        (
            "aspect ratio of bodies",
            f"{number(low)} … {number(high)}",
            f"height over length along x; median {number(middle)}",
        ),
    ]


def _density_rows(advice: Advice) -> list[tuple[str, str, str]]:
    density, model, starts = advice.survey.density, advice.model, advice.survey.starts
    mean, low, _, high, most = density.neighbours
    around = ", ".join(number(count) for count in density.by_spacing.values())
    kept = advice.survey.kept
    front = (
        "kept points' front, error",
        f"{100 * kept.front:+.3g} %",
        f"± {100 * kept.front_scatter:.3g} % over {kept.num_seen} trajectories, against all points of their runs; "
        f"{percent(kept.map)} of the volume misplaced",
    )
    return [
        *([front] if kept.num_seen else []),
        (
            "spacing [m]",
            _number(density.measured),
            f"manifest {number(density.spacing)}; nearest neighbour at {number(density.nearest)} when it begins, "
            f"1 % of all within {number(density.nearest_low)}",
        ),
        ("density, end over start", _number(density.end_over_start), "inside the material"),
        ("radius [m]", number(density.radius), f"{number(density.radius / density.spacing)} spacings"),
        (
            "neighbours within it",
            number(mean),
            f"90 % have {low:.0f} to {high:.0f}, at most {most:.0f}; {percent(density.isolated)} have none; "
            f"about {advice.edges:.0f} edges a window",
        ),
        (f"neighbours at {', '.join(density.by_spacing)} spacings", around, "on average"),
        (
            "message passing reaches [m]",
            number(advice.reach),
            f"{model.num_message_passing_steps} steps; highest body {number(starts.body_height)}; pressure goes "
            f"{number(advice.wave)} in a step; model.context is {'on' if model.context else 'off'}",
        ),
    ]


def _motion_rows(advice: Advice) -> list[tuple[str, str, str]]:
    motion, data_errors = advice.survey.motion, advice.survey.data_errors
    spacing, radius = advice.survey.density.spacing, advice.survey.density.radius
    middle, high, higher, most = (step / spacing for step in motion.step)
    measured = (
        "too little to measure gravity" if math.isnan(motion.gravity) else f"gravity measured {motion.gravity:.4g} m/s²"
    )
    return [
        (
            "displacement in a step [spacing]",
            number(middle),
            f"median; 99 % {number(high)}, 99.9 % {number(higher)}, largest {number(most)} = "
            f"{number(motion.step[3] / radius)} radii, {number(motion.step[3] / motion.dt)} m/s",
        ),
        (
            "particles moving",
            percent(motion.moving),
            f"faster than {SPEED_AT_REST:g} m/s; {percent(motion.moving_at_end)} when a trajectory ends",
        ),
        (
            "frames moving",
            percent(motion.frames_moving),
            f"more than {percent(MOVING_SHARE)} of the particles; {percent(1 - motion.frames_moving)} at rest",
        ),
        ("free fall", percent(motion.free_fall), f"of the particles; {measured}, stated {motion.gravity_stated:.4g}"),
        (
            "impacts",
            percent(motion.impacts),
            f"of the squared acceleration is in {percent(IMPACT_SHARE)} of the particles",
        ),
        (
            "outside the box",
            percent(data_errors.outside),
            f"of the particles, by more than a spacing; largest coordinate {number(data_errors.extent)} m; "
            f"{len(data_errors.not_finite)} files not finite",
        ),
    ]


def _noise_rows(advice: Advice) -> list[tuple[str, str, str]]:
    motion, perturbation = advice.survey.motion, advice.training.perturbation
    spacing = advice.survey.density.spacing
    return [
        (
            "noise over velocity",
            number(advice.noise_over_velocity),
            f"{number(perturbation.noise_std)} m in a step of {motion.dt:g} s = "
            f"{number(perturbation.noise_std / spacing)} spacings; "
            f"velocity {number(motion.velocity_std)} m/s (standard deviation of a component)",
        ),
        (
            "noise in the target",
            percent(advice.noise_share),
            f"of the one-step target's variance, and {percent(advice.restore_share)} undo coherent noise; acceleration "
            f"{number(motion.acceleration_std)} m/s²",
        ),
        (
            "coherent noise [spacing]",
            number(advice.strain_over_spacing),
            f"strain {perturbation.strain_std:g} over {perturbation.strain_length:g} m at most",
        ),
    ]


def _number(value: float) -> str:
    return number(None if math.isnan(value) else value)
