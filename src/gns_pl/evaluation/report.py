"""What an evaluation leaves behind in words: metrics.json for programs, table.md and a printed table for people."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gns_pl import __version__

if TYPE_CHECKING:
    from gns_pl.checkpoint import Checkpoint

FORMAT = "gns_pl evaluation"
FORMAT_VERSION = 1

ROWS: tuple[tuple[str, str, str], ...] = (
    ("runout, 99 % of the mass [L0]", "runout_99", "runout_99_error"),
    ("runout, 99.5 % [L0]", "runout_995", "runout_995_error"),
    ("runout, maximum [L0]", "runout_max", "runout_max_error"),
    ("height, 99 % [L0]", "height_99", "height_99_error"),
    ("height, maximum [L0]", "height_max", "height_max_error"),
    ("mean height [m]", "mean_height", "mean_height_error"),
    ("front at rest [τc]", "arrest_time", ""),
    ("peak kinetic energy [J]", "kinetic_energy_peak", ""),
    ("final mean speed [m/s]", "speed_mean", ""),
    ("deepest penetration [spacing]", "penetration_max", ""),
    ("nearest neighbour 1 % [spacing]", "spacing_1", ""),
)
"""Rows of a table: label, key of the summary, key of its relative error if it has one."""

ERROR_ROWS: tuple[tuple[str, str], ...] = (
    ("deposit profile, L1 over area", "profile_l1"),
    ("MSE of 1 step [m²]", "mse_1"),
    ("MSE of 20 steps [m²]", "mse_20"),
    ("MSE of all steps [m²]", "mse_end"),
    ("position error [spacing]", "position_error"),
)
"""Rows that only a comparison has: label, key of the errors."""

HEADER = ("", "MPM", "learned", "error", "no motion")

NOTE = """\
Everything is measured at the last frame unless the row says otherwise. Errors are relative to the MPM that taught the \
model, not to a converged one. Judge by the 99 % fronts: the maximum is a few stragglers. Wall times are those of the \
loops alone: MPM's as measured when the reference was computed (it is cached); the learned simulator's with neighbour \
search and copies to and from its device. Loading, compilation and files are left out of both. docs/evaluation.md \
defines every number."""


def document(checkpoint: Checkpoint, scenes: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Return the content of metrics.json, in plain values, with None for what is not finite.

    Args:
        checkpoint: what was evaluated.
        scenes: name → its part.
    """
    content = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "gns_pl_version": __version__,
        "checkpoint": {
            "model": checkpoint.simulator.config.to_dict(),
            "data": checkpoint.data,
            "provenance": checkpoint.provenance,
        },
        "scenes": dict(scenes),
    }
    plain: dict[str, Any] = without_nan(json.loads(json.dumps(content, default=_plain)))
    return plain


def without_nan(value: Any) -> Any:
    """Return `value` with every float that is not finite replaced by None, through dicts and lists."""
    if isinstance(value, dict):
        return {key: without_nan(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [without_nan(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _plain(value: Any) -> Any:
    return value.item() if hasattr(value, "item") else str(value)


def write(content: Mapping[str, Any], out: Path) -> list[Path]:
    """Write metrics.json and table.md into `out` and return their paths."""
    metrics, table = out / "metrics.json", out / "table.md"
    metrics.write_text(json.dumps(content, indent=2, allow_nan=False, ensure_ascii=False) + "\n", encoding="utf-8")
    parts = []
    for name, scene in content["scenes"].items():
        rows = [HEADER, ("---",) + ("---:",) * (len(HEADER) - 1), *scene_rows(scene)]
        lines = "\n".join(f"| {' | '.join(row)} |" for row in rows)
        parts.append(f"## {name}\n\n{describe(scene)}\n\n{lines}\n")
    table.write_text("\n".join([*parts, NOTE, ""]), encoding="utf-8")
    return [table, metrics]


def describe(scene: Mapping[str, Any]) -> str:
    """Return one paragraph about a scene: its geometry, its resolution, and a failure if there was one."""
    text = (
        f"L0 = {scene['length']:.3g} m, H0 = {scene['height']:.3g} m, a = {scene['aspect_ratio']:.3g}; "
        f"{scene['num_particles']} particles, spacing {scene['spacing']:.3g} m; {scene['num_steps']} steps of "
        f"{scene['dt']:.4g} s = {scene['num_steps'] * scene['dt'] / scene['characteristic_time']:.3g} τc."
    )
    if scene["failed_at"] is not None:
        text += f" **The rollout failed: positions are not finite from t = {scene['failed_at']:.4g} s on.**"
    return text


def scene_rows(scene: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Return the rows of one scene's table under `HEADER`."""
    learned, still = scene["errors"]["learned"], scene["errors"]["no_motion"]
    rows: list[tuple[str, ...]] = [
        (
            label,
            number(scene["reference"][key]),
            number(scene["learned"][key]),
            percent(learned.get(error)),
            number(scene["no_motion"][key]),
        )
        for label, key, error in ROWS
    ]
    rows += [(label, "", "", number(learned[key]), number(still[key])) for label, key in ERROR_ROWS]
    wall = scene["wall_seconds"]
    rows.append(("wall time [s]", number(wall["reference"]), number(wall["learned"]), "", ""))
    return rows


def number(value: float | None) -> str:
    """Return three significant digits, "–" for None."""
    if value is None:
        return "–"
    if value == 0:
        return "0"
    return f"{value:.2e}" if not 1e-3 <= abs(value) < 1e5 else f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"


def percent(value: float | None) -> str:
    """Return a relative error in per cent with its sign, "" for None."""
    return "" if value is None else f"{100 * value:+.1f} %"


def show(content: Mapping[str, Any], files: Sequence[Path]) -> None:
    """Print the tables and the paths of what was made."""
    from rich.console import Console
    from rich.table import Table

    console = Console(markup=False, highlight=False)
    for name, scene in content["scenes"].items():
        console.print(f"\n{name}: {describe(scene).replace('**', '')}", soft_wrap=True)
        table = Table()
        for column, head in enumerate(HEADER):
            table.add_column(head, justify="right" if column else "left", no_wrap=True)
        for row in scene_rows(scene):
            table.add_row(*row)
        console.print(table)
    print("Made:", *files, sep="\n  ")
