"""What an evaluation leaves behind in words: metrics.json for programs, table.md and a printed table for people."""

from __future__ import annotations

import json
import platform
import shlex
import sys
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gns_pl import __version__
from gns_pl.machine import machine_name
from gns_pl.metrics.curves import Quantity
from gns_pl.metrics.quantities import COMPARISONS, SUMMARY
from gns_pl.text import number, percent, without_nan

if TYPE_CHECKING:
    from gns_pl.models.checkpoint import Checkpoint

FORMAT = "gns_pl evaluation"
FORMAT_VERSION = 3


def _label(label: str, quantity: Quantity) -> str:
    return label if quantity.unit == "1" else f"{label} [{quantity.unit}]"


ROWS: tuple[tuple[str, str, str], ...] = tuple(
    (_label(metric.label, metric), metric.name, f"{metric.name}_error" if metric.error else "")
    for metric in SUMMARY
    if metric.label
)
"""Rows of a table: label, key of the summary, key of its relative error if it has one."""

ERROR_ROWS: tuple[tuple[str, str], ...] = (
    *((_label(entry.label, entry), entry.name) for entry in COMPARISONS if entry.label),
    ("MSE of 1 step [m²]", "mse_1"),
    ("MSE of 20 steps [m²]", "mse_20"),
    ("MSE of all steps [m²]", "mse_end"),
    ("position error [spacing]", "position_error"),
    ("transport of deposit [spacing]", "sinkhorn"),
)
"""Rows that only a comparison has: label, key of the errors."""

NOTE = """\
Everything is measured at the last frame unless the row says otherwise. MPM's numbers are those of all its points, and \
errors are relative to them: to the MPM that taught the model, not to a converged one. "learned" and "error" are the \
mean and standard deviation over the placements of the particles; MSE, position error and transport follow single \
particles and are of the run that starts from MPM's own. The second "±" is by how much MPM itself changes on other \
cells (the paragraph above says which): a smaller error means nothing. Judge by the 99 % fronts: the maximum is a few \
stragglers. Times are those of the loops alone, without loading, compilation and files: of the learned simulator the \
median over the placements, measured now; of MPM on the cells of the data, measured when the reference was computed \
(it is cached). They are of different sessions and different accuracy, and make no ratio; evaluation.speed=true \
measures one. In "still" nothing moves. docs/evaluation.md defines every number."""


def header(scene: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the heads of the columns of `scene_rows`."""
    return ("", "MPM" if scene["reference_points"]["all"] else "MPM, stored points", "±", "learned", "error", "still")


def document(name: str, checkpoint: Checkpoint, scenes: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Return the content of metrics.json, in plain values, with None for what is not finite.

    Args:
        name: of the checkpoint, as it was typed.
        checkpoint: what was evaluated.
        scenes: name → its part.
    """
    content = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "gns_pl_version": __version__,
        "run": run(),
        "checkpoint": {
            "name": name,
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


def _plain(value: Any) -> Any:
    return value.item() if hasattr(value, "item") else str(value)


def write(content: Mapping[str, Any], out: Path) -> list[Path]:
    """Write metrics.json and table.md into `out` and return their paths."""
    metrics, table = out / "metrics.json", out / "table.md"
    metrics.write_text(json.dumps(content, indent=2, allow_nan=False, ensure_ascii=False) + "\n", encoding="utf-8")
    parts = []
    for name, scene in content["scenes"].items():
        heads = header(scene)
        rows = [heads, ("---",) + ("---:",) * (len(heads) - 1), *scene_rows(scene)]
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
    if scene["given_frames"] > 1:
        text += f" The rollouts go on from {scene['given_frames']} frames of MPM."
    text += f" {describe_mpm(scene)}"
    if scene["failed_at"] is not None:
        text += f" **The rollout failed: positions are not finite from t = {scene['failed_at']:.4g} s on.**"
    elif scene["failure"] is not None:
        text += f" **Unphysical state: {scene['failure']}.**"
    return text


def describe_start(model: Mapping[str, Any], given: int) -> str:
    """Return what rollouts start from; of a network of another program also that it starts there from true frames.

    Args:
        model: the simulator's config as plain values.
        given: true frames that every rollout starts from.
    """
    if given > 1:
        return f"Rollouts start from {given} frames of the reference."
    text = "Rollouts start from the scene alone, with straight motion before."
    if "edge_update" in model:  # of geoelements/gns, and of what is trained with its features
        text += f" geoelements/gns starts such a network from {model['input_sequence_length']} true frames instead: "
        text += "evaluation.start=frames"
    return text


def describe_mpm(scene: Mapping[str, Any]) -> str:
    """Return in words how the reference was made, where times were taken, and on which other cells it was run."""
    provenance, points = scene["made_by"]["reference"], scene["reference_points"]
    config, number_of = provenance.get("config", {}), f"all its {points['number']:,} points"
    parts = [number_of if points["all"] else "the stored points alone, whose front is not that of all"]
    if "cell_size" in config:
        per = config["points_per_direction"]
        parts.append(f"cells of {config['cell_size']:.3g} m, {per} points per direction, Courant {config['courant']:g}")
        parts.append(f"{config['precision']}, steps of {provenance['time_step']:.2e} s")
    if "num_threads" in provenance:
        parts.append(f"{provenance['num_threads']} threads of {provenance.get('machine', 'an unknown machine')}")
    solver = str(provenance.get("solver", ""))
    text = f"MPM: {'; '.join(parts)}."
    if solver.startswith("imported"):
        text = f"Reference: {solver}, {provenance.get('source', '')}."
    learned = scene["made_by"]["learned"]
    here = f"{learned.get('num_threads', '?')} threads of {learned.get('machine', 'an unknown machine')}"
    text += f" Learned: {learned.get('device', 'cpu')}, {here}."
    cells = scene["reference_spread"]["cells"]
    if cells:
        text += f" ±: against cells {' and '.join(f'{each:g}' for each in cells)} times as large."
    return text


def scene_rows(scene: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Return the rows of one scene's table under `HEADER`."""
    learned, still, std = scene["errors"]["learned"], scene["errors"]["no_motion"], scene["placements"]["std"]
    rows: list[tuple[str, ...]] = [
        (
            label,
            number(scene["reference"][key]),
            spread(scene, key),
            number(scene["learned"][key], None if error else std.get(key)),
            percent(learned.get(error), std.get(error)),
            number(scene["no_motion"][key]),
        )
        for label, key, error in ROWS
    ]
    rows += [
        (label, "", spread(scene, key), "", number(learned[key], std.get(key)), number(still[key]))
        for label, key in ERROR_ROWS
    ]
    wall, speed = scene["wall_seconds"], scene.get("speed")
    rows.append(("time of a run [s]", number(wall["reference"]), "", number(wall["learned"]), "", ""))
    if speed is not None:
        rival = speed["as_accurate"] or {"seconds": None}
        timed = (number(rival["seconds"]), "", number(speed["learned"]["seconds"]), "", "")
        rows.append(("the same, MPM as accurate [s]", *timed))
    return rows


def spread(scene: Mapping[str, Any], key: str) -> str:
    """Return by how much MPM itself changes a number on other cells, "" where that was not run."""
    value = scene["reference_spread"].get(key)
    return "" if value is None else number(value)


def show(content: Mapping[str, Any]) -> None:
    """Print the tables."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    console = Console(markup=False, highlight=False)
    if not console.is_terminal:  # of unknown width: nothing is folded
        console.width = 120
    for name, scene in content["scenes"].items():
        console.print(f"\n{name}: {describe(scene).replace('**', '')}", soft_wrap=True)
        table = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, padding=(0, 1, 0, 0))
        for column, head in enumerate(header(scene)):
            table.add_column(head, justify="right" if column else "left", overflow="fold")
        for row in scene_rows(scene):
            table.add_row(*row)
        console.print(table)
