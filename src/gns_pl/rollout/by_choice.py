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
from gns_pl.pretrained import find_checkpoint, find_corrector
from gns_pl.rollout.choice import RECORDS, choose, kind_of, named, read_records, table, weigh
from gns_pl.rollout.fitted import CorrectedWay, HandedWay, LearnedWay
from gns_pl.rollout.simulate import alone, prepare
from gns_pl.rollout.ways import MPMWay, Way, characteristic_size
from gns_pl.scene import Scene


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
        handed: name → {learned, first, until, finer}, as `HandedWay`.
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
        keys = {"learned", "first", "until", "finer"}
        if set(each) != keys:
            raise InputError(f"choice.handed.{name}: needs {', '.join(sorted(keys))}, not {', '.join(sorted(each))}.")
        handing = {key: each[key] for key in ("first", "until", "finer")}
        ways.append(HandedWay(name, each["learned"], stabilise=kept, **handing))
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
) -> list[Path]:
    """Run every scene by the cheapest way that is accurate enough, and say which and why.

    Args:
        scenes: what to simulate; their names name the files.
        out: folder; made.
        tolerance: largest error of the final 99 % runout, relative; None only explains.
        explain: show the ways, and run none.
        duration: simulated time of every scene [s]; None takes each scene's own.
        seed: of the particles' placement.
        way: name of the one to take, whatever it is worth; None chooses.
        learned: as `make_ways`.
        corrected: likewise.
        handed: likewise.
        cells: likewise.
        mpm: likewise.
        rest_speed: likewise.
        stabilise: likewise.
        frame_interval: time between the frames written [s].
        records: a table of measured runs; None takes the package's.

    Returns:
        The files written, or found.

    Raises:
        InputError: nothing to choose from, or a file of another run in the place of one.
    """
    measured = read_records(Path(records) if records else RECORDS)
    ways, written = make_ways(learned, corrected, handed, cells, mpm, rest_speed, stabilise), []
    machine = ", ".join(sorted({f"{each.device}, {each.threads} threads" for each in measured}))
    for scene in scenes:
        scene = scene if duration is None else scene.replace(duration=duration)
        options = weigh(scene, ways, measured)
        kind = "in plane strain" if kind_of(scene) == "plane" else "in three dimensions"
        print(f"{scene.name}: {kind}, √(L0 H0) = {characteristic_size(scene):.3g} m, {scene.duration:.3g} s")
        print(f"{table(options, scene)}\nerrors of the final 99 % runout and times as measured on {machine}")
        if way is not None:
            chosen, why = named(options, way), "as asked for"
        elif tolerance is None:
            continue
        else:
            chosen, why = choose(options, tolerance)
        words = chosen.way.reduced(scene).words
        print(f"chosen: {chosen.way.name}, {why}{f'; {words}' if words else ''}", flush=True)
        if explain:
            continue
        prepare(out, scenes)
        with alone(out):
            written.append(_run(chosen.way, scene, out, frame_interval, seed))
    return written


def _run(way: Way, scene: Scene, out: Path, interval: float, seed: int) -> Path:
    """Run a scene into its file, unless that is there."""
    path = out / f"{scene.name}.h5"
    identity = {"solver": way.name, "version": gns_pl.__version__, "seed": seed}
    if path.exists():
        there = read_trajectory(path)
        same = there.scene == scene and all(there.provenance.get(key) == value for key, value in identity.items())
        if not same or not math.isclose(there.dt, interval, rel_tol=1e-6):
            raise InputError(
                f"{path}: is of another scene, way, frame interval or seed; remove it or choose another out=."
            )
        print(f"{path}: is there whole")
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
