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
from gns_pl.evaluation.chart.rows import BatchRow, Place, RatioRow, RunRow, Table
from gns_pl.io.atomic import write_atomically
from gns_pl.text import command

FORMAT, FORMAT_VERSION = "gns_pl chart", 1

LEARNED = ("learned", "corrected", "hybrid")
"""Groups that were trained."""


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
        runout: final, 99 % of the mass, by the reference [L0].
        uncertainty: of that, relative.
        seconds: wall time of one run of the reference [s].
        duration: simulated [s].
        interval: time between frames [s].
        words: how the reference was made.
        setup: what its errors hold for (`solvers.measured_range.setup_text`); empty in plans from before it was
            written.
    """

    name: str
    judged: str
    aspect_ratio: float
    runout: float
    uncertainty: float
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
        scenes: all.
        together: hash of all scenes, by which ratios and batches are found.
        entries: settings.
        left_out: name of a setting that cannot run the scenes → why.
        places: device → where was measured.
        placements: of each setting and scene.
        pairs: of cells that are extrapolated, the coarser first.
        order: to which.
        law: coefficients of the fitted law.
        law_seconds: of the runs it was fitted to [s].
        costs: name of a trained setting → what was spent on it.
    """

    command: str
    scenes: tuple[SceneFacts, ...]
    together: str
    entries: tuple[EntryFacts, ...]
    left_out: dict[str, str]
    places: dict[str, Place]
    placements: int
    pairs: tuple[tuple[float, float], ...]
    order: float
    law: tuple[float, ...]
    law_seconds: float
    costs: dict[str, Cost]

    @property
    def band(self) -> float:
        """Uncertainty of the reference, relative: root mean square over the scenes."""
        return math.sqrt(sum(each.uncertainty**2 for each in self.scenes) / len(self.scenes))

    def runs(self, table: Table[RunRow]) -> list[RunRow]:
        """Return the runs of the chart."""
        judged = {each.judged for each in self.scenes}
        return [row for row in self._ours(table) if row.judged in judged and row.placement < self.placements]

    def batches(self, table: Table[BatchRow]) -> list[BatchRow]:
        """Return the batches of the chart."""
        return [row for row in self._ours(table) if row.judged == self.together]

    def ratios(self, table: Table[RatioRow]) -> list[RatioRow]:
        """Return what was measured in turns of the chart's settings."""
        identity = {each.name: each.identity for each in self.entries}
        here = {(place.machine, place.threads) for place in self.places.values()}
        return [
            row
            for row in table
            if row.judged == self.together
            and (identity.get(row.name), identity.get(row.other)) == (row.identity, row.other_identity)
            and (row.machine, row.threads) in here
        ]

    def _ours(self, table: Iterable[Any]) -> list[Any]:
        wanted = set()
        for each in self.entries:
            place = self.places[each.device]
            wanted.add((each.name, each.identity, place.machine, place.device, place.threads))
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
        content["places"] = {device: Place(**each) for device, each in content["places"].items()}
        content["costs"] = {name: Cost(**each) for name, each in content["costs"].items()}
        content["pairs"] = tuple((float(coarse), float(fine)) for coarse, fine in content["pairs"])
        return Plan(**{**content, "law": tuple(content["law"])})
    except FileNotFoundError as error:
        raise InputError(f"{path}: is not there yet; run {command('benchmark')} without from_table=true.") from error
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(f"{path}: is no plan of benchmark.py ({error}); choose another out=.") from error
