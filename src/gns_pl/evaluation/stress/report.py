"""What the suite gave: rows on the disk, tables, and what they say."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from gns_pl.evaluation.stress.runs import Row
from gns_pl.evaluation.stress.survival import survival
from gns_pl.io.tables import read_table, write_table
from gns_pl.rollout.failure import CLOSE, CLOSE_SHARE, ENERGY, OUTSIDE, OUTSIDE_SHARE, SPEED

NAMED = 3
"""Failures of a model that the report tells one by one."""


def read_rows(path: Path) -> list[Row]:
    """Return the rows of a table; none if it is not there.

    Raises:
        InputError: a file that is no such table.
    """
    if not path.is_file():
        return []
    advice = "is no table of the stress suite; remove it, or choose another out="
    return read_table(path, Row, advice, renamed={"sentence": "message", "left_at": "exit_time"})


def write_rows(path: Path, rows: Sequence[Row]) -> None:
    """Write a table, whole or not at all."""
    write_table(path, Row, rows, digits=6)


def by_model(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Return model → its rows, in their order."""
    return {name: [row for row in rows if row.model == name] for name in dict.fromkeys(row.model for row in rows)}


def summary_table(rows: Sequence[Row]) -> str:
    """Return a line for every model, in Markdown."""
    lines = [
        "| model | failed | within its data | warned before | first failures | heaps: centre, farthest particle "
        "[spacings] | momentum not explained [g] | seconds |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for name, own_rows in by_model(rows).items():
        failed, inside = [row for row in own_rows if row.kind], [row for row in own_rows if row.inside]
        kinds = ", ".join(f"{kind} {number}" for kind, number in Counter(row.kind for row in failed).most_common())
        heaps = [row for row in own_rows if not math.isnan(row.drift)]
        drift = f"{max(r.drift for r in heaps):.2f}, {max(r.drift_largest for r in heaps):.2f}" if heaps else "–"
        announced = f"{sum(row.announced for row in failed)} of {len(failed)}" if failed else "–"
        lost = f"{sum(bool(row.kind) for row in inside)} of {len(inside)}"
        momentum = max(row.momentum for row in own_rows)
        lines.append(
            f"| `{name}` | {len(failed)} of {len(own_rows)} | {lost} | {announced} | {kinds or '–'} | {drift} "
            f"| {momentum:.2f} | {sum(row.seconds for row in own_rows):.0f} |"
        )
    return "\n".join(lines)


def axis_table(rows: Sequence[Row]) -> str:
    """Return failures of every model along every axis, with the earliest, in Markdown."""
    models = by_model(rows)
    lines = ["| axis | scenes | " + " | ".join(f"`{name}`" for name in models) + " |", "|---" * (len(models) + 2) + "|"]
    for axis in dict.fromkeys(row.axis for row in rows):
        cells, number = [], 0
        for own_rows in models.values():
            along = [row for row in own_rows if row.axis == axis]
            number = max(number, len(along))
            times = [row.failed_at for row in along if row.kind]
            cells.append(f"{len(times)} (from {min(times):.1f} τc)" if times else "0" if along else "–")
        lines.append(f"| {axis.replace('_', ' ')} | {number} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def failures(rows: Sequence[Row]) -> str:
    """Return sentences for failures within the data and for those without a warning before, in Markdown."""
    lines = []
    for name, own_rows in by_model(rows).items():
        unexpected = [row for row in own_rows if row.kind and (row.inside or not row.announced)]
        for row in unexpected[:NAMED]:
            where = "within its data" if row.inside else "no warning before"
            lines.append(f"- `{name}`, {row.scene} ({row.value}), {where}: {row.message}.")
        if len(unexpected) > NAMED:
            lines.append(f"- `{name}`: and {len(unexpected) - NAMED} more (stress.csv).")
    return "\n".join(lines) or "None."


def document(rows: Sequence[Row], seed: int) -> str:
    """Return the whole report in Markdown.

    Args:
        rows: of all models.
        seed: of the scenes.
    """
    settings = "\n".join(f"- `{name}`: {own_rows[0].settings}" for name, own_rows in by_model(rows).items())
    return f"""# Stress suite

Scenes of seed {seed}. Learned runs stabilised by, or settings of the material point method that differ:

{settings}

A run fails, and is stopped, at the first frame in which a particle is faster than {SPEED:g} √(2 g H) plus the largest
initial speed; more than {100 * OUTSIDE_SHARE:g} % of the particles are deeper than {OUTSIDE:g} spacings in a wall; more
than {100 * CLOSE_SHARE:g} % are nearer to another than {CLOSE:g} of the first distance; the energy of motion and height
is {100 * ENERGY:g} % (of that at the start) over the least before; or a number is not finite.

{summary_table(rows)}

Failures along each axis, and when the first of them came:

{axis_table(rows)}

![survival](stress.png)

Failures within a model's data, and those without a warning before:

{failures(rows)}
"""


def draw(rows: Sequence[Row], out: Path, shown: Sequence[str] | None = None) -> list[Path]:
    """Draw the survival curves and return the files.

    Args:
        rows: of all models.
        out: folder.
        shown: names of the models that are drawn; None draws all.
    """
    from gns_pl.viz import plot_survival

    paths = [out / "stress.png", out / "stress.pdf"]
    curves = {
        name: {
            axis: survival([row for row in own_rows if row.axis == axis])
            for axis in dict.fromkeys(row.axis for row in own_rows)
        }
        for name, own_rows in by_model(rows).items()
        if not shown or name in shown
    }
    plot_survival(curves, paths)
    return paths
