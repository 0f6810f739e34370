"""What an evaluation leaves behind in words: metrics.json for programs, table.md and a printed table for people."""

from __future__ import annotations

import json
import math
import platform
import shlex
import sys
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gns_pl import __version__
from gns_pl.machine import machine_name

if TYPE_CHECKING:
    from gns_pl.checkpoint import Checkpoint

FORMAT = "gns_pl evaluation"
FORMAT_VERSION = 2

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
    ("nearest other, 1 % [spacing]", "spacing_1", ""),
    ("solid fraction inside", "density", ""),
)
"""Rows of a table: label, key of the summary, key of its relative error if it has one."""

ERROR_ROWS: tuple[tuple[str, str], ...] = (
    ("deposit profile, L1 over area", "profile_l1"),
    ("MSE of 1 step [m²]", "mse_1"),
    ("MSE of 20 steps [m²]", "mse_20"),
    ("MSE of all steps [m²]", "mse_end"),
    ("position error [spacing]", "position_error"),
    ("transport of deposit [spacing]", "sinkhorn"),
)
"""Rows that only a comparison has: label, key of the errors."""

HEADER = ("", "MPM", "±", "learned", "error", "still")

NOTE = """\
Everything is measured at the last frame unless the row says otherwise. Errors are relative to the MPM that taught the \
model, not to a converged one; "±" is by how much MPM itself changes on other cells (the paragraph above \
says which), so that a smaller error means nothing. Judge by the 99 % fronts: the maximum is a few stragglers. Wall \
times are those of the loops alone: MPM's as measured when the reference was computed (it is cached); the learned \
simulator's with neighbour search and copies to and from its device. Loading, compilation and files are left out of \
both. In "still" nothing moves. docs/evaluation.md defines every number."""


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
        "run": run(),
        "checkpoint": {
            "model": checkpoint.simulator.config.to_dict(),
            "data": checkpoint.data,
            "provenance": checkpoint.provenance,
        },
        "scenes": dict(scenes),
    }
    plain: dict[str, Any] = without_nan(json.loads(json.dumps(content, default=_plain)))
    return plain


def run() -> dict[str, Any]:
    """Return how and where this process was started, and with which packages."""
    from importlib.metadata import version

    packages = ("gns_pl", "torch", "torch-geometric", "numpy", "numba", "scipy", "POT")
    return {
        "command": shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "machine": machine_name(),
        "python": platform.python_version(),
        "versions": {name: version(name) for name in packages},
    }


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
    text += f" {describe_mpm(scene)}"
    if scene["failed_at"] is not None:
        text += f" **The rollout failed: positions are not finite from t = {scene['failed_at']:.4g} s on.**"
    elif scene["failure"] is not None:
        text += f" **No sand does this: {scene['failure']}.**"
    return text


def describe_mpm(scene: Mapping[str, Any]) -> str:
    """Return in words how the reference was made, where times were taken, and on which other cells it was run."""
    made, wall = scene["made_by"]["reference"], scene["wall_seconds"]["reference"]
    config = made.get("config", {})
    parts = []
    if "cell_size" in config:
        per = config["points_per_direction"]
        parts.append(f"cells of {config['cell_size']:.3g} m, {per} points per direction, Courant {config['courant']:g}")
        parts.append(f"{config['precision']}, steps of {made['time_step']:.2e} s")
    if "num_threads" in made:
        parts.append(f"{made['num_threads']} threads of {made.get('machine', 'an unknown machine')}")
    solver = str(made.get("solver", ""))
    text = f"MPM: {'; '.join(parts) or 'settings unknown'}."
    if solver.startswith("imported"):
        text = f"Reference: {solver}, {made.get('source', '')}."
    learned = scene["made_by"]["learned"]
    here = f"{learned.get('num_threads', '?')} threads of {learned.get('machine', 'an unknown machine')}"
    text += f" Learned: {learned.get('device', 'cpu')}, {here}."
    if wall and made.get("machine") != learned.get("machine"):
        text += " MPM's time was taken on another machine: remove the cache and run again to compare times."
    cells = scene["reference_spread"]["cells"]
    if cells:
        text += f" ±: against cells {' and '.join(f'{each:g}' for each in cells)} times as large."
    return text


def scene_rows(scene: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Return the rows of one scene's table under `HEADER`."""
    learned, still = scene["errors"]["learned"], scene["errors"]["no_motion"]
    rows: list[tuple[str, ...]] = [
        (
            label,
            number(scene["reference"][key]),
            spread(scene, key),
            number(scene["learned"][key]),
            percent(learned.get(error)),
            number(scene["no_motion"][key]),
        )
        for label, key, error in ROWS
    ]
    rows += [(label, "", spread(scene, key), "", number(learned[key]), number(still[key])) for label, key in ERROR_ROWS]
    wall = scene["wall_seconds"]
    rows.append(("wall time [s]", number(wall["reference"]), "", number(wall["learned"]), "", ""))
    return rows


def spread(scene: Mapping[str, Any], key: str) -> str:
    """Return by how much MPM itself changes a number on other cells, "" where that was not run."""
    value = scene["reference_spread"].get(key)
    return "" if value is None else number(value)


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


def show(content: Mapping[str, Any]) -> None:
    """Print the tables."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    console = Console(markup=False, highlight=False)
    for name, scene in content["scenes"].items():
        console.print(f"\n{name}: {describe(scene).replace('**', '')}", soft_wrap=True)
        table = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, padding=(0, 1, 0, 0))
        for column, head in enumerate(HEADER):
            table.add_column(head, justify="right" if column else "left", no_wrap=True)
        for row in scene_rows(scene):
            table.add_row(*row)
        console.print(table)
