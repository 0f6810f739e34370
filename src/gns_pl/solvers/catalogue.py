"""Scenes in, trajectory files out, by the way that a tolerance asks for."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import gns_pl
from gns_pl.errors import InputError
from gns_pl.io import read_trajectory, write_trajectory
from gns_pl.models.checkpoint import move
from gns_pl.models.shipped import ALIASES, find_checkpoint, find_corrector, pretrained_names
from gns_pl.mpm import settings as solver
from gns_pl.scene import Scene
from gns_pl.scene.extent import compression_notice
from gns_pl.solvers.folder import alone, prepare
from gns_pl.solvers.learned import CorrectedWay, HandedWay, LearnedWay
from gns_pl.solvers.selection import RECORDS, Option, choose, kind_of, read_records, table, weigh
from gns_pl.solvers.solver import MPMWay, Way, characteristic_size

CHECK_CELLS = 1.5
"""Cells of the run that checks another one, over those of that one."""


def way_name(path: str | Path) -> str:
    """Return what the way of a file is called: its name, or that of its folder if the file is any training's last."""
    path = Path(path)
    every = path.stem in ("last", "best") or path.stem.startswith("step")
    return path.absolute().parent.name if every else path.stem


def make_ways(
    learned: Sequence[str],
    corrected: Sequence[str],
    handed: Mapping[str, Mapping[str, Any]] | None,
    cells: Sequence[float],
    mpm: Mapping[str, Any],
    rest_speed: float = 0.0,
    stabilise: Mapping[str, Any] | None = None,
) -> list[Way]:
    """Return the ways of a config (conf/simulate.yaml).

    Args:
        learned: checkpoints.
        corrected: correctors of coarse MPM.
        handed: name → {learned, until}, as `HandedWay`.
        cells: of MPM, over √(L0 H0).
        mpm: its settings.
        rest_speed: at which learned runs end [m/s]; 0 for never.
        stabilise: arguments of `rollout.stabilise.stabilise`, for learned runs.

    Raises:
        InputError: no such checkpoint.
    """
    ways: list[Way] = []
    kept, handed = dict(stabilise or {}), handed or {}
    for name in [*learned, *(str(each.get("learned")) for each in handed.values())]:
        if not find_checkpoint(name).is_file():
            raise InputError(f"choice.learned: there is no checkpoint {name}.")
    for name in learned:
        ways.append(LearnedWay(way_name(name), name, rest_speed, kept))
    for name in corrected:
        if not find_corrector(name).is_file():
            raise InputError(f"choice.corrected: there is no corrector {name}.")
        ways.append(CorrectedWay(way_name(name), name))
    for name, each in handed.items():
        if set(each) != {"learned", "until"}:
            raise InputError(f"choice.handed.{name}: needs learned, until, not {', '.join(sorted(each))}.")
        ways.append(HandedWay(name, each["learned"], stabilise=kept, until=each["until"]))
    for number in cells:
        ways.append(MPMWay(f"mpm_{number:g}", float(number), mpm))
    return ways


def simulate_by_choice(
    scenes: Sequence[Scene],
    *,
    out: Path,
    tolerance: float | None,
    explain: bool,
    duration: float | None,
    seed: int,
    way: str | None,
    learned: Sequence[str],
    corrected: Sequence[str],
    handed: Mapping[str, Mapping[str, Any]] | None,
    cells: Sequence[float],
    mpm: Mapping[str, Any],
    rest_speed: float,
    stabilise: Mapping[str, Any],
    frame_interval: float,
    records: str | None,
    cell_size: float | None = None,
    check: bool = False,
    device: str = "auto",
) -> list[Path]:
    """Run every scene by the cheapest way that is accurate enough, and say which and why.

    All scenes are weighed, and what cannot be run is refused, before the first is run.

    Args:
        scenes: what to simulate; their names name the files.
        out: folder; made.
        tolerance: largest error of the final 99 % runout, relative; None only explains.
        explain: show the ways, and run none.
        duration: simulated time of every scene [s]; None takes each scene's own.
        seed: of the particles' placement.
        way: name of the one to take, whatever it is worth; "mpm" on cells of `cell_size`; None chooses.
        learned: as `make_ways`.
        corrected: likewise.
        handed: likewise.
        cells: likewise.
        mpm: likewise.
        rest_speed: likewise.
        stabilise: likewise.
        frame_interval: time between the frames written [s].
        records: a table of measured runs; None takes the package's.
        cell_size: of the way "mpm" [m]; None takes the finest of `cells`.
        check: run MPM on coarser cells besides, into the file of `check_path`.
        device: "cuda" for MPM and learned simulators on a GPU; "auto" is the CPU, where errors and times were measured.

    Returns:
        The files written, or found, without those of the check.

    Raises:
        InputError: nothing to choose from, or a file of another run in the place of one.
    """
    measured = read_records(Path(records) if records else RECORDS)
    ways = make_ways(learned, corrected, handed, cells, mpm, rest_speed, stabilise)
    machine = ", ".join(sorted({f"{each.device}, {each.threads} threads" for each in measured}))
    if way is not None:
        name = ALIASES.get(way, way)
        # What ships, or a file, need not be among those to choose from.
        if name not in {each.name for each in ways} and find_checkpoint(name).is_file():
            ways, name = make_ways([name], [], {}, [], mpm, rest_speed, stabilise), way_name(name)
        ways = [_asked_for(name, ways, mpm, cell_size)]
    elif cell_size is not None:
        raise InputError("cell_size= is that of solver=mpm; tolerance= chooses among choice.cells.")
    chosen: list[tuple[Way, Scene]] = []
    for scene in scenes:
        scene = scene if duration is None else scene.replace(duration=duration)
        options = weigh(scene, ways, measured)
        kind = "in plane strain" if kind_of(scene) == "plane" else "in three dimensions"
        print(f"{scene.name}: {kind}, √(L0 H0) = {characteristic_size(scene):.3g} m, {scene.duration:.3g} s")
        if way is not None:
            option, why = options[0], f"as asked for; {_worth(options[0])}"
        else:
            print(f"{table(options, scene)}\nerrors of the final 99 % runout and times as measured on {machine}")
            if tolerance is None:
                continue
            option, why = choose(options, tolerance)
        words = option.way.reduced(scene).words
        print(f"chosen: {option.way.name}, {why}{f'; {words}' if words else ''}", flush=True)
        notice = None if type(option.way) is LearnedWay else compression_notice(scene)
        if notice is not None:
            print(f"{notice}.")
        if check and not isinstance(option.way, MPMWay):
            print(f"check: {option.way.name} has no cells of its own to compare; solver=mpm check=true does.")
        chosen.append((_on(option.way, device), scene))
    if explain or not chosen:
        return []
    written = []
    prepare(out, scenes)
    for taken, scene in chosen:
        path = out / f"{scene.name}.h5"
        with alone(out):
            written.append(_run(taken, scene, path, frame_interval, seed))
            if check and isinstance(taken, MPMWay):
                _run(taken.coarser(CHECK_CELLS), scene, check_path(path), frame_interval, seed)
    return written


def check_path(path: Path) -> Path:
    """Return where the run on coarser cells is, beside the run that it checks."""
    return path.with_suffix(".coarser.h5")


def _asked_for(name: str, ways: Sequence[Way], mpm: Mapping[str, Any], cell_size: float | None) -> Way:
    """Return the way of a name; "mpm" has cells of a size, or the finest of those that there are.

    Raises:
        InputError: no such way, a size of cells for another way than MPM, or one that the solver refuses.
    """
    if name != "mpm":
        if cell_size is not None:
            raise InputError(f"cell_size= is that of solver=mpm, not of {name}.")
        found = next((each for each in ways if each.name == name), None)
        if found is None:
            known = ", ".join(dict.fromkeys(["mpm", *(each.name for each in ways), *pretrained_names(), *ALIASES]))
            raise InputError(f"solver: there is no {name}; there are {known}.")
        return found
    if cell_size is not None:
        solver.solver_config({**mpm, "cell_size": cell_size})  # refuses a size that cannot be
        return MPMWay(f"mpm_{cell_size:g}m", 0.0, mpm, cell_size=float(cell_size))
    finest = max((each for each in ways if isinstance(each, MPMWay)), key=lambda each: each.cells, default=None)
    if finest is None:
        raise InputError("solver=mpm: choice.cells names no cells; give their size in metres, as cell_size=0.02.")
    return finest


def _worth(option: Option) -> str:
    """Return in words what is known of a way's error on a scene."""
    if option.reason is not None:
        return f"its error on this scene is unmeasured ({option.reason})"
    if option.error is None:
        return f"its error on this scene is unmeasured ({option.unmeasured})"
    return f"on scenes like this one its final runout erred by up to {100 * option.error:.1f} %"


def _on(way: Way, device: str) -> Way:
    """Return a way on the device that is asked for.

    Raises:
        InputError: a GPU for what has none, or a device that is not there.
    """
    if device in ("auto", "cpu"):
        return way
    if isinstance(way, MPMWay):
        return replace(way, device=solver.choose_device(device))
    if type(way) is LearnedWay:
        move(way.checkpoint, device, "device")
        return way
    raise InputError(f"device={device}: {way.name} runs on the CPU alone; choose device=cpu.")


def _run(way: Way, scene: Scene, path: Path, interval: float, seed: int) -> Path:
    """Run a scene into its file, unless that is there."""
    identity: dict[str, object] = {"solver": way.name, "version": gns_pl.__version__, "seed": seed}
    if isinstance(way, MPMWay):
        identity["mpm"] = way.settings_of(scene)
    if path.exists():
        there = read_trajectory(path)
        same = there.scene == scene and all(there.provenance.get(key) == value for key, value in identity.items())
        if not same or not math.isclose(there.dt, interval, rel_tol=1e-6):
            raise InputError(
                f"{path}: is of another scene, way, settings, frame interval or seed; remove it or choose another out=."
            )
        print(f"{path}: already complete")
        return path
    began = time.perf_counter()
    made = way.run(scene, interval=interval, seed=seed)
    seconds = time.perf_counter() - began
    write_trajectory(path, replace(made, provenance={**made.provenance, **identity, "wall_seconds": seconds}))
    rest, failed = (made.provenance.get(key) for key in ("at_rest_from", "failed_at"))
    ended = f", at rest from {rest:.3g} s" if isinstance(rest, float) else ""
    why = made.provenance.get("failure", "not finite")
    ended = f", failed at {failed:.3g} s ({why}); ended there" if isinstance(failed, float) else ended
    print(f"{path}: {made.num_frames} frames in {seconds:.2f} s, what is compiled at first use included{ended}")
    return path
