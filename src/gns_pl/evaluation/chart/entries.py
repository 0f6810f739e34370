"""What stands on the chart: every way with its name, its group, and a hash of all that decides what it gives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import gns_pl
from gns_pl.errors import InputError
from gns_pl.evaluation.chart.converged import Converged, hashed
from gns_pl.evaluation.checks import named_checkpoints
from gns_pl.io import file_sha256
from gns_pl.models.shipped import find_checkpoint, find_corrector, is_corrector
from gns_pl.mpm.settings import solver_version
from gns_pl.scene import Scene
from gns_pl.solvers.catalogue import make_ways, way_name
from gns_pl.solvers.learned import CorrectedWay, HandedWay, LearnedWay
from gns_pl.solvers.solver import MPMWay, Way
from gns_pl.solvers.trivial import Ballistic, Still
from gns_pl.trajectory import Trajectory


@dataclass(frozen=True)
class Entry:
    """One setting.

    Attributes:
        way: from a scene to a trajectory.
        group: "mpm", "learned", "corrected", "handed" or "trivial".
        identity: hash of all that decides a run.
        device: on which it runs, "cpu" or "cuda".
        whole: it runs a scene in three dimensions even if a slice would do.
        for_choice: `simulate.py tolerance=…` may take it.
    """

    way: Way
    group: str
    identity: str
    device: str = "cpu"
    whole: bool = False
    for_choice: bool = False

    @property
    def name(self) -> str:
        """Of the way."""
        return self.way.name

    @property
    def dtype(self) -> str:
        """Of its arithmetic."""
        return str(self.way.settings.get("precision", "float64")) if isinstance(self.way, MPMWay) else "float32"

    def scene_of(self, judged: Converged) -> Scene:
        """Return what it runs: the slice where one does."""
        return judged.scene if self.whole else judged.flat

    def run(self, judged: Converged, seed: int) -> Trajectory:
        """Return a run of a scene from one placement."""
        return self.way.run(self.scene_of(judged), interval=judged.interval, seed=seed)


def make_entries(
    ckpt: Sequence[str],
    choice: Mapping[str, Any],
    variants: Mapping[str, Any],
    trivial: float,
    stabilise: Mapping[str, Any],
    device: str,
    solver_device: str,
) -> list[Entry]:
    """Return all settings, MPM's first.

    Args:
        ckpt: checkpoints and correctors besides those of the choice.
        choice: the ways of `simulate.py`, conf/choice.
        variants: more settings of MPM, as `solver_ways`.
        trivial: cells per √(L0 H0) whose particles the trivial baselines move.
        stabilise: arguments of `rollout.stabilise.stabilise`, for learned runs.
        device: of learned simulators, "cpu" or "cuda".
        solver_device: of MPM, likewise.

    Raises:
        InputError: a checkpoint that is not there, two settings of one name, or settings that make none.
    """
    there = [find_checkpoint(each) for each in choice["learned"]]
    checkpoints = [each for each in ckpt if not is_corrector(each)]
    given = [path for path in dict.fromkeys(named_checkpoints(checkpoints).values()) if path not in there]
    corrected = {find_corrector(each): each for each in [*choice["corrected"], *filter(is_corrector, ckpt)][::-1]}
    trained = (choice["learned"], list(corrected.values())[::-1], choice["handed"])
    ways = make_ways(*trained, choice["cells"], choice["mpm"], stabilise=stabilise)
    entries: list[Entry] = []
    solvers = [way for way in ways if isinstance(way, MPMWay)]
    for solver in (*solvers, *solver_ways(choice["mpm"], variants)):
        on = replace(solver, device=solver_device)
        identity = hashed([dict(solver.settings), solver.cells, solver.reduces, solver_version()])
        entries.append(Entry(on, "mpm", identity, solver_device, not solver.reduces, solver in solvers))
    others: list[Way] = [*ways, *(LearnedWay(way_name(path), path, stabilise=stabilise) for path in given)]
    for way in others:
        if isinstance(way, HandedWay):
            parts = [file_sha256(find_checkpoint(way.path)), way.until, solver_version()]
            entries.append(Entry(way, "handed", hashed([*parts, dict(stabilise)]), for_choice=True))
        elif isinstance(way, LearnedWay):
            identity = hashed([file_sha256(find_checkpoint(way.path)), gns_pl.__version__, dict(stabilise)])
            entries.append(Entry(way, "learned", identity, device, for_choice=True))
        elif isinstance(way, CorrectedWay):
            parts = [file_sha256(find_corrector(way.path)), solver_version()]
            entries.append(Entry(way, "corrected", hashed(parts), for_choice=True))
    for still in (Still("nothing_moves", trivial), Ballistic("ballistic", trivial)):
        entries.append(Entry(still, "trivial", hashed([still.name, trivial, gns_pl.__version__])))
    names = [each.name for each in entries]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(f"the chart would hold {', '.join(twice)} twice; rename a file, or leave one out.")
    return entries


def solver_ways(mpm: Mapping[str, Any], variants: Mapping[str, Any]) -> list[MPMWay]:
    """Return settings of MPM beside the sizes of cells of the choice.

    Args:
        mpm: the settings from which they depart.
        variants: {cells, points: {cells, per_direction}, courant: {cells, numbers}, whole: {cells}}, each a list; every
            size of cells with every number of points per direction, or Courant number, or in three dimensions.

    Raises:
        InputError: another key.
    """
    wanted = {"cells": None, "points": ("cells", "per_direction"), "courant": ("cells", "numbers"), "whole": ("cells",)}
    for key, each in variants.items():
        inner = wanted.get(key, ())
        if key not in wanted or (inner is not None and sorted(each) != sorted(inner)):
            raise InputError(
                "variants: takes cells, points.{cells,per_direction}, courant.{cells,numbers} and whole.cells, "
                f"not {key}={each}."
            )
    ways = [MPMWay(f"mpm_{cells:g}", float(cells), mpm) for cells in variants.get("cells", ())]
    points, courant, whole = (variants.get(key) or {"cells": ()} for key in ("points", "courant", "whole"))
    for cells in points["cells"]:
        for number in points["per_direction"]:
            ways.append(MPMWay(f"mpm_{cells:g}_p{number}", float(cells), {**mpm, "points_per_direction": number}))
    for cells in courant["cells"]:
        for number in courant["numbers"]:
            ways.append(MPMWay(f"mpm_{cells:g}_c{number:g}", float(cells), {**mpm, "courant": number}))
    for cells in whole["cells"]:
        ways.append(MPMWay(f"mpm_{cells:g}_whole", float(cells), mpm, reduces=False))
    return ways


def path_of(entry: Entry) -> Path | None:
    """Return the file that a trained entry was read from."""
    if isinstance(entry.way, CorrectedWay):
        return find_corrector(entry.way.path)
    return find_checkpoint(entry.way.path) if isinstance(entry.way, LearnedWay) else None
