"""The errors of a fit, scene by scene, before and after it, and as a Markdown table."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

KINDS = {"fitted": False, "held_out": True}
"""Key of a summary → whether its scenes were held out."""


@dataclass(frozen=True)
class Row:
    """Errors on a scene, before the fit and after it.

    Attributes:
        scene: its name.
        held_out: it was not fitted to.
        front_before: relative, of the advance of the front within which 99 % of the mass lies.
        front_after: likewise.
        height_before: relative, of the mean height.
        height_after: likewise.
        map_before: part of the volume that is misplaced.
        map_after: likewise.
    """

    scene: str
    held_out: bool
    front_before: float
    front_after: float
    height_before: float
    height_after: float
    map_before: float
    map_after: float

    @property
    def cells(self) -> str:
        """Front, mean height and map as three cells of a table."""
        front, height = (
            f"{100 * before:+.1f} → {100 * after:+.1f} %"
            for before, after in ((self.front_before, self.front_after), (self.height_before, self.height_after))
        )
        return f"{front} | {height} | {self.map_before:.3f} → {self.map_after:.3f}"


def summary(rows: Sequence[Row]) -> dict[str, list[float]]:
    """Return the rms of every error over scenes, before and after."""
    return {
        key: [
            round(math.sqrt(sum(getattr(row, f"{key}_{when}") ** 2 for row in rows) / max(1, len(rows))), 5)
            for when in ("before", "after")
        ]
        for key in ("front", "height", "map")
    }


def rms_cells(rows: Sequence[Row]) -> str:
    """Return the rms of front, mean height and map over scenes as three cells of a table."""
    both = summary(rows)
    front, height = (" → ".join(f"{100 * value:.1f}" for value in both[key]) for key in ("front", "height"))
    return f"{front} % | {height} % | {' → '.join(f'{value:.3f}' for value in both['map'])}"


def table(rows: Sequence[Row]) -> str:
    """Return errors before and after as a Markdown table."""
    lines = ["| scene | front | mean height | map |", "|---|---|---|---|"]
    lines += [f"| {row.scene}{', held out' if row.held_out else ''} | {row.cells} |" for row in rows]
    for kind, held in KINDS.items():
        of_kind = [row for row in rows if row.held_out == held]
        if of_kind:
            lines.append(f"| **rms, {kind.replace('_', ' ')}** | {rms_cells(of_kind)} |")
    return "\n".join(lines)
