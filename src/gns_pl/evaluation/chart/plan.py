"""What a chart is about, as plain values in a file beside its tables: with both it is drawn again anywhere.

The tables keep what was ever measured in a folder; the plan says which of their rows make the chart.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from gns_pl.errors import InputError
from gns_pl.evaluation.chart.tables import BatchRow, Environment, RatioRow, RunRow, Table
from gns_pl.io.atomic import write_atomically
from gns_pl.text import command

PLAN, PAGE = "plan.json", "chart.md"
"""Files in the folder of a chart: this, and the page."""

FORMAT, FORMAT_VERSION = "gns_pl chart", 3

LEARNED = ("learned", "corrected", "hybrid")
"""Groups that were trained."""

PLAIN = ("mpm",)
"""Groups of the material point method as it is; the time that it takes for an error is the measure of all others."""

UNTRAINED = ("mpm", "retuned", "shallow")
"""Groups of solvers without a network, which those with one are compared with."""

COMPARED = (*LEARNED, "retuned", "shallow")
"""Groups that are compared with plain MPM."""

WHERE = {"plane": "in plane strain", "space": "in space", "terrain": "on terrain"}
"""Kind of scenes → the same in words."""

MEASURES = {
    "front": "final front, 99 % of the mass",
    "map": "final deposit from above, the share of its volume in the wrong place",
    "worse": "the worse of front and map",
}
"""What settings are compared by → in words."""


@dataclass(frozen=True)
class Cost:
    """Times spent before [s]; NaN where nobody knows.

    Attributes:
        data_seconds: of the solver for all trajectories, one after the other.
        train_seconds: wall time of the fit.
        source: where this is known from.
    """

    data_seconds: float
    train_seconds: float
    source: str

    @property
    def seconds(self) -> float:
        """T_data + T_train [s]."""
        return self.data_seconds + self.train_seconds


@dataclass(frozen=True)
class SceneFacts:
    """A scene and what becomes of it.

    Attributes:
        name: of the scene.
        judged: hash of scene, frames and reference.
        aspect_ratio: H0 / L0.
        length: L0 [m].
        column: whether laws of the aspect ratio are about it.
        front: final advance of the front, by the reference [m].
        uncertainty: "front", "map", "height", "arrest" → that of the reference, relative.
        seconds: processor time of one run of the reference [s].
        duration: simulated [s].
        interval: time between frames [s].
        words: how the reference was made.
        setup: what its errors hold for (`solvers.measured_range.setup_text`).
    """

    name: str
    judged: str
    aspect_ratio: float
    length: float
    column: bool
    front: float
    uncertainty: dict[str, float]
    seconds: float
    duration: float
    interval: float
    words: str
    setup: str = ""


@dataclass(frozen=True)
class EntryFacts:
    """A setting: its name, group, hash, device, and whether `simulate.py tolerance=…` may take it."""

    name: str
    group: str
    identity: str
    device: str
    for_choice: bool


@dataclass(frozen=True)
class Plan:
    """Which rows make the chart, and what they are compared with.

    Attributes:
        command: by which it was measured.
        kind: of the scenes, "plane", "space" or "terrain".
        scenes: all.
        entries: settings.
        left_out: name of a setting → scene that it cannot run → why.
        beyond: likewise, what it runs though it was made for other scenes.
        places: device → where was measured.
        more_threads: other numbers of threads on which times were measured.
        placements: of each setting and scene.
        pairs: of cells that are extrapolated, the coarser first.
        order: to which.
        law: coefficients of the fitted law; none where a scene is no column.
        law_seconds: of the runs it was fitted to [s].
        costs: name of a trained setting → what was spent on it.
    """

    command: str
    kind: str
    scenes: tuple[SceneFacts, ...]
    entries: tuple[EntryFacts, ...]
    left_out: dict[str, dict[str, str]]
    beyond: dict[str, dict[str, str]]
    places: dict[str, Environment]
    more_threads: tuple[int, ...]
    placements: int
    pairs: tuple[tuple[float, float], ...]
    order: float
    law: tuple[float, ...]
    law_seconds: float
    costs: dict[str, Cost]

    @property
    def title(self) -> str:
        """What it is about, in words."""
        what = "columns" if all(each.column for each in self.scenes) else f"{len(self.scenes)} scenes without a law"
        return f"{what} {WHERE[self.kind]}"

    def band(self, measure: str) -> float:
        """Return the uncertainty of the reference by a key of `MEASURES`: root mean square over the scenes."""
        if measure == "worse":
            return max(self.band("front"), self.band("map"))
        return math.sqrt(sum(each.uncertainty[measure] ** 2 for each in self.scenes) / len(self.scenes))

    def runs_scene(self, name: str, scene: str) -> bool:
        """Return whether a setting can run a scene."""
        return scene not in self.left_out.get(name, {})

    def together(self, name: str = "") -> str:
        """Return a hash of all scenes that a setting can run, by which ratios and batches are found; "" runs all."""
        from gns_pl.solvers.solver import hashed  # with it comes torch, which reading a plan does not need

        return hashed([each.judged for each in self.scenes if self.runs_scene(name, each.name)])

    def told(self) -> list[str]:
        """Return what settings cannot run, and what is outside of their range, a sentence each."""
        lines = []
        for what, reasons in (("is not run", self.left_out), ("is run outside of its range", self.beyond)):
            for name, of_scene in reasons.items():
                for reason in dict.fromkeys(of_scene.values()):
                    those = [scene.name for scene in self.scenes if of_scene.get(scene.name) == reason]
                    where = "" if len(those) == len(self.scenes) else f" on {', '.join(those)}"
                    lines.append(f"`{name}` {what}{where}: {reason}")
        return lines

    def runs(self, table: Table[RunRow], threads: int | None = None) -> list[RunRow]:
        """Return the runs of the chart.

        Args:
            table: of runs.
            threads: one of `more_threads`; None for the number that the chart is about.
        """
        judged = {each.judged for each in self.scenes}
        return [row for row in self._ours(table, threads) if row.judged in judged and row.placement < self.placements]

    def all_runs(self, table: Table[RunRow]) -> list[RunRow]:
        """Return the runs of the chart on all numbers of threads."""
        return [row for number in (None, *self.more_threads) for row in self.runs(table, number)]

    def batches(self, table: Table[BatchRow]) -> list[BatchRow]:
        """Return the batches of the chart."""
        return [row for row in self._ours(table) if row.judged == self.together()]

    def ratios(self, table: Table[RatioRow]) -> list[RatioRow]:
        """Return what was measured in turns of the chart's settings."""
        identity = {each.name: each.identity for each in self.entries}
        here = {(place.machine, place.threads) for place in self.places.values()}
        return [
            row
            for row in table
            if row.judged == self.together(row.name)
            and (identity.get(row.name), identity.get(row.other)) == (row.identity, row.other_identity)
            and (row.machine, row.threads) in here
        ]

    def _ours(self, table: Iterable[Any], threads: int | None = None) -> list[Any]:
        wanted = set()
        for each in self.entries:
            place = self.places[each.device]
            wanted.add((each.name, each.identity, place.machine, place.device, threads or place.threads))
        return [row for row in table if (row.name, row.identity, row.machine, row.device, row.threads) in wanted]


def write_plan(path: Path, plan: Plan) -> None:
    """Write a plan as JSON, whole or not at all."""
    content = {"format": FORMAT, "format_version": FORMAT_VERSION, **asdict(plan)}
    write_atomically(path, (json.dumps(content, indent=1, ensure_ascii=False) + "\n").encode())


def read_plan(path: Path) -> Plan:
    """Read a plan.

    Raises:
        InputError: no such file, or another one.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if (content.pop("format"), content.pop("format_version")) != (FORMAT, FORMAT_VERSION):
            raise ValueError("another format")
        content["scenes"] = tuple(SceneFacts(**each) for each in content["scenes"])
        content["entries"] = tuple(EntryFacts(**each) for each in content["entries"])
        content["places"] = {device: Environment(**each) for device, each in content["places"].items()}
        content["costs"] = {name: Cost(**each) for name, each in content["costs"].items()}
        content["more_threads"] = tuple(content["more_threads"])
        content["pairs"] = tuple((float(coarse), float(fine)) for coarse, fine in content["pairs"])
        return Plan(**{**content, "law": tuple(content["law"])})
    except FileNotFoundError as error:
        raise InputError(f"{path}: is not there yet; run {command('benchmark')} without from_table=true.") from error
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(f"{path}: is no plan of benchmark.py ({error}); choose another out=.") from error
