"""Rows, plans and a folder of a chart, without running anything."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from gns_pl.evaluation.chart.plan import Cost, EntryFacts, Plan, SceneFacts
from gns_pl.evaluation.chart.tables import Environment, RunRow, Tables

PLACE = Environment("a machine", "cpu", 1, "python 3", "now")


def row(name: str, group: str, error: float, seconds: float, **changes: Any) -> RunRow:
    """A run."""
    values: dict[str, Any] = {
        "name": name, "group": group, "identity": f"of {name}", "kind": "plane", "scene": "low", "judged": "low fine",
        "placement": 0, "machine": PLACE.machine, "device": "cpu", "threads": 1, "dim": 2, "dtype": "float32",
        "particles": 100, "steps": 10, "work": 1000.0, "front": 2.0 * (1 + error), "front_error": error,
        "map_error": abs(error) / 4, "arrest_error": error, "curve_error": abs(error) / 2,
        "height_error": -error / 3, "profile_error": abs(error), "seconds": seconds, "cpu_seconds": seconds,
        "first_seconds": 2 * seconds, "file_seconds": 0.01, "versions": PLACE.versions, "session": PLACE.session,
    }  # fmt: skip
    return RunRow(**values | changes)


SURE = ("front", "map", "height", "arrest")

SCENES = (
    SceneFacts("low", "low fine", 0.8, 1.0, True, 2.0, dict.fromkeys(SURE, 0.01), 9.0, 1.2, 0.02, "MPM"),
    SceneFacts("high", "high fine", 2.0, 1.0, True, 2.0, dict.fromkeys(SURE, 0.02), 9.0, 1.2, 0.02, "MPM"),
)

SETTINGS = {
    "mpm_5": ("mpm", -0.4, 0.1, True),
    "mpm_10": ("mpm", -0.2, 0.8, True),
    "mpm_20": ("mpm", -0.1, 6.4, True),
    "mpm_5_whole": ("mpm", -0.4, 2.0, False),
    "good": ("learned", 0.05, 0.5, True),
    "poor": ("learned", 0.3, 0.9, True),
    "still": ("trivial", -1.0, 0.001, False),
}
"""Name → group, error, seconds, whether the choice may take it."""


def rows() -> list[RunRow]:
    """Every setting on two scenes from two placements."""
    return [
        row(name, group, error * (1 + 0.1 * number), seconds, scene=scene.name, judged=scene.judged, placement=number)
        for name, (group, error, seconds, _) in SETTINGS.items()
        for scene in SCENES
        for number in (0, 1)
    ]  # fmt: skip


def plan(**changes: Any) -> Plan:
    """What `rows` are of."""
    values: dict[str, Any] = {
        "command": "python benchmark.py",
        "kind": "plane",
        "scenes": SCENES,
        "entries": tuple(EntryFacts(n, s[0], f"of {n}", "cpu", s[3]) for n, s in SETTINGS.items()),
        "left_out": {"other": {"low": "trained with other walls", "high": "trained with other walls"}},
        "beyond": {"poor": {"high": "trained on low columns"}},
        "places": {"cpu": PLACE},
        "more_threads": (),
        "placements": 2,
        "pairs": ((5.0, 10.0),),
        "order": 1.0,
        "law": (0.5, 1.0, 0.0),
        "law_seconds": 8.0,
        "costs": {"good": Cost(60.0, 540.0, "provenance"), "poor": Cost(60.0, float("nan"), "unknown")},
    }
    return Plan(**values | changes)


def folder(path: Path) -> Tables:
    """The tables of `rows` in a folder."""
    tables = Tables(path)
    tables.runs.add(*rows())
    return tables
