"""`simulate.py … ensemble.KEY=[LOW,HIGH]`: a band of runs on all cores, and how often what is reached.

Every member is a run of its own scene, placed with its own seed. Of a finished one its maps stay, a file each, so the
same command goes on where it was, and one with more members keeps those that there are.
"""

from __future__ import annotations

import contextlib
import csv
import io
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import gns_pl
from gns_pl.errors import InputError
from gns_pl.evaluation.checks import make_folder
from gns_pl.evaluation.ensemble_maps import write_ensemble
from gns_pl.evaluation.maps import check_mapped_scene, check_maps, maps_of
from gns_pl.evaluation.run_report import report_lines
from gns_pl.generation.pool import Failure, run_jobs
from gns_pl.generation.progress import GenerationProgress
from gns_pl.io import StorageError, read_header
from gns_pl.io.atomic import atomic_path, write_atomically
from gns_pl.machine import available_cores
from gns_pl.metrics.exceedance import combine
from gns_pl.metrics.rasters import REACHED, FlowMaps, MapGrid, map_grid
from gns_pl.scene import Scene
from gns_pl.scene.changes import decoded
from gns_pl.scene.extent import frame_interval_of
from gns_pl.scene.variation import VARIATIONS, drawn_values, grid_values
from gns_pl.solvers.configured import configured_scenes, configured_solver
from gns_pl.solvers.folder import alone
from gns_pl.solvers.solver import Solver, hashed
from gns_pl.text import command

ARRAYS = ("release", "max_thickness", "max_velocity", "deposit", "arrival_time")
"""Rasters of a member that its file holds."""


@dataclass(frozen=True)
class Member:
    """A run of an ensemble.

    Attributes:
        number: from 0.
        values: name of what is varied → its value.
        scene: with these values.
        seed: of the particles' placement.
        path: of the file with its maps.
        grid: the cells of all members.
        reached: thickness from which on a cell counts as reached [m].
        settings: the config, as plain values, from which its process makes the solver.
    """

    number: int
    values: Mapping[str, float]
    scene: Scene
    seed: int
    path: Path
    grid: MapGrid
    reached: float
    settings: Mapping[str, Any]

    def key(self, solver: Solver) -> str:
        """Return a hash of all that decides its maps."""
        scene = {**self.scene.to_dict(), "name": ""}
        interval = interval_of(self.scene, self.settings)
        facts = [scene, solver.facts(self.scene), gns_pl.__version__, self.seed, interval]
        return hashed([*facts, repr(self.grid), self.reached])


def run_ensemble(settings: Mapping[str, Any], label: str = "") -> list[Path]:
    """Run an ensemble as a config says (conf/simulate.yaml), write its maps and return their files.

    Args:
        settings: the config, as plain values.
        label: what tells this job from the others of a sweep; it goes into the name.

    Raises:
        InputError: settings or a member that cannot be used, before any is run; or members that failed, after the maps
            of the others were written.
        StorageError: the disk refuses.
    """
    bands = checked_bands(settings)
    reporting = settings["reporting"]
    check_maps(figures=reporting["figures"], reached=reporting["reached"], key="reporting")
    solver = configured_solver(settings)
    base, scenes, values = _scenes(settings, bands, label)
    for scene in scenes:
        check_mapped_scene(scene)
        solver.reduced(scene)  # refuses what cannot be run, before anything is
    folder = Path(settings["out"]) / base.name / "ensemble"
    make_folder(folder / "members")
    with alone(folder):
        grid, reached = _cells(base, solver, settings)
        members = [
            Member(n, values[n], scene, settings["seed"] + n, _file(folder, n), grid, reached, settings)
            for n, scene in enumerate(scenes)
        ]
        failures = _run(base.name, members, solver)
        done = [member for member in members if member.number not in failures]
        files = [write_table(folder / "members.csv", members, failures)]
        if done:
            thresholds = [float(each) for each in settings["ensemble"]["thresholds"]] or [reached]
            maps = combine((read_member(member.path) for member in done), thresholds)
            files += write_ensemble(maps, base, folder, figures=reporting["figures"])
    print(*report_lines(list(_rows(bands, members, failures))), "Made:", sep="\n")
    print(*(f"  {file}" for file in files), sep="\n", flush=True)
    if failures:
        number, first = next(iter(sorted(failures.items())))
        raise InputError(
            f"{folder}: {len(failures)} of {len(members)} members failed (member {number}: {first.rstrip('.')}), so "
            f"the maps are of the other {len(done)}; the same command tries them again, and members.csv says more."
        )
    return files


def checked_bands(settings: Mapping[str, Any]) -> dict[str, tuple[float, float]]:
    """Return what is varied → least and largest value.

    Raises:
        InputError: settings of an ensemble that cannot be used.
    """
    ensemble, bands = settings["ensemble"], {}
    if not settings["scene"]:
        raise InputError(f"give scene=: {command('simulate')} scene=slope solver=shallow-k0 ensemble.release=[0.8,1.2]")
    for key, band in decoded(ensemble["vary"]).items():
        numbers = isinstance(band, list) and len(band) == 2 and all(type(end) in (int, float) for end in band)
        if not numbers or not -np.inf < band[0] < band[1] < np.inf:
            raise InputError(f"ensemble.{key}=[LOW,HIGH] takes two numbers, the smaller first, not {band}.")
        bands[key] = (float(band[0]), float(band[1]))
    if any(not threshold > 0 for threshold in ensemble["thresholds"]):
        raise InputError(f"ensemble.thresholds must be thicknesses above 0 m, not {ensemble['thresholds']}.")
    if isinstance(settings["scene"], list) and len(settings["scene"]) > 1:
        raise InputError("an ensemble is of one scene; -m scene=A,B makes one of each.")
    if settings["tolerance"] is not None or settings["explain"] or settings["check"]:
        raise InputError("an ensemble runs one solver: give solver= or ckpt=, and no tolerance=, explain= or check=.")
    return bands


def _scenes(
    settings: Mapping[str, Any], bands: Mapping[str, tuple[float, float]], label: str
) -> tuple[Scene, list[Scene], list[dict[str, float]]]:
    """Return the scene itself, that of every member, and their values."""
    ensemble, seed = settings["ensemble"], settings["seed"]
    values = (
        drawn_values(bands, ensemble["members"], seed)
        if ensemble["grid"] is None
        else grid_values(bands, ensemble["grid"])
    )
    [base] = configured_scenes(settings, label)
    scenes: list[Scene] = []
    for some in values:
        try:
            keys = {key: value for key, value in some.items() if key not in VARIATIONS}
            [scene] = configured_scenes(settings, label, keys) if keys else [base]
            for key, value in some.items():
                scene = VARIATIONS[key](scene, value) if key in VARIATIONS else scene
        except InputError as error:
            described = ", ".join(f"{key} {value:.4g}" for key, value in some.items())
            raise InputError(f"member {len(scenes)} ({described}): {error}") from error
        scenes.append(scene.replace(name=base.name))
    return base, scenes, values


def _cells(base: Scene, solver: Solver, settings: Mapping[str, Any]) -> tuple[MapGrid, float]:
    """Return the cells and the thickness that counts as reached, by the spacing of the scene itself.

    Its first frame is run, which besides compiles what the processes need.
    """
    interval = interval_of(base, settings)
    start = solver.run(base.replace(duration=min(interval, base.duration)), interval=interval, seed=settings["seed"])
    reached, grid = settings["reporting"]["reached"], map_grid(base, start.spacing)
    return grid, REACHED * start.spacing if reached is None else float(reached)


def interval_of(scene: Scene, settings: Mapping[str, Any]) -> float:
    """Return the time between frames of a member [s]."""
    return float(frame_interval_of(scene, settings["choice"]["frame_interval"]))


def _file(folder: Path, number: int) -> Path:
    return folder / "members" / f"{number:04d}.npz"


def _run(name: str, members: Sequence[Member], solver: Solver) -> dict[int, str]:
    """Run the members that are not there, and return why some could not be: number → message."""
    waiting = [member for member in members if not is_made(member, solver)]
    workers = 1 if solver.device == "cuda" else max(1, min(available_cores(), len(waiting)))
    work = {member.path.name: solver.cost(member.scene) for member in waiting}
    failures: dict[int, str] = {}
    progress = GenerationProgress(name, work, workers, enabled=True, noun="members")
    progress.log(f"{name}: {len(members)} members, {len(waiting)} of them to run, {workers} at a time.")
    with progress, closing(run_jobs(run_member, waiting, workers)) as outcomes:
        for index, outcome in outcomes:
            member = waiting[index]
            if isinstance(outcome, Failure):
                if outcome.final:
                    raise StorageError(outcome.message)
                failures[member.number] = outcome.message
                progress.log(f"{name}: member {member.number} failed: {outcome.message}")
            progress.finish(member.path.name)
    return failures


def is_made(member: Member, solver: Solver) -> bool:
    """Return whether the maps of a member are there.

    Raises:
        InputError: those of another run are.
    """
    if not member.path.exists():
        return False
    with np.load(member.path) as content:
        same = str(content["key"]) == member.key(solver)
    if not same:
        raise InputError(
            f"{member.path}: is of another scene, solver, seed or version; remove its folder or choose another out=."
        )
    return True


def run_member(member: Member) -> None:
    """Run a member and write its maps.

    Raises:
        InputError: a run that could not be, or that failed.
        StorageError: the disk refuses.
    """
    solver = configured_solver(member.settings)
    run = member.path.with_suffix(".h5")
    interval, monitor = interval_of(member.scene, member.settings), member.settings["monitor"]
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        solver.record([member.scene], [run], interval=interval, seed=member.seed, monitor=monitor)
    failure = read_header(run).provenance.get("failure")
    if failure:
        raise InputError(f"unphysical state: {failure}")
    maps = maps_of(run, member.grid, member.reached)
    arrays = {name: getattr(maps, name) for name in ARRAYS}
    content: dict[str, Any] = {name: each.astype(np.float32) for name, each in arrays.items() if each is not None}
    content |= {"lower": maps.grid.lower, "cell": maps.grid.cell, "reached": maps.reached, "key": member.key(solver)}
    with atomic_path(member.path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **content)
    run.unlink()


def read_member(path: Path) -> FlowMaps:
    """Return the maps of a member."""
    with np.load(path) as content:
        arrays: dict[str, Any] = {"max_velocity": None}
        arrays |= {name: content[name].astype(np.float64) for name in ARRAYS if name in content}
        (x, y), (columns, rows) = map(float, content["lower"]), arrays["deposit"].shape
        grid, reached = MapGrid((x, y), float(content["cell"]), (columns, rows)), float(content["reached"])
    return FlowMaps(grid, reached, **arrays)


def write_table(path: Path, members: Sequence[Member], failures: Mapping[int, str]) -> Path:
    """Write a row for every member: values, seed, and what its maps say; or why it failed."""
    text = io.StringIO()
    writer = csv.writer(text)
    measured = ("area_reached_m2", "max_thickness_m", "max_velocity_m_s", "deposit_max_m")
    writer.writerow(["member", "seed", *members[0].values, *measured, "status"])
    for member in members:
        row: list[Any] = [member.number, member.seed, *(f"{value:.6g}" for value in member.values.values())]
        if member.number in failures:
            writer.writerow([*row, *[""] * len(measured), failures[member.number]])
            continue
        maps = read_member(member.path)
        fastest = "" if maps.max_velocity is None else f"{maps.max_velocity.max():.5g}"
        thickest = f"{maps.max_thickness.max():.5g}", fastest, f"{maps.deposit.max():.5g}"
        writer.writerow([*row, f"{maps.area():.5g}", *thickest, "done"])
    write_atomically(path, text.getvalue().encode())
    return path


def _rows(
    bands: Mapping[str, tuple[float, float]], members: Sequence[Member], failures: Mapping[int, str]
) -> Iterator[tuple[str, str]]:
    """Yield label and text of what is printed at the end."""
    yield "members", f"{len(members) - len(failures)} of {len(members)}, seeds {members[0].seed} to {members[-1].seed}"
    for key, (low, high) in bands.items():
        yield "varied", f"{key} from {low:.4g} to {high:.4g}"
