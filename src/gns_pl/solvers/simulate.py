"""Scenes in, trajectory files out, by any solver: one that is named, or the cheapest that a tolerance allows.

What was written is never computed again; a run that was broken off goes on. All files of one call have one writer, and
their provenance says which solver made them and how.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gns_pl.errors import InputError
from gns_pl.io.raster import read_crs, scene_crs
from gns_pl.io.stream import add_provenance
from gns_pl.metrics.rasters import check_mappable
from gns_pl.rollout.policy import Policy
from gns_pl.scene import Scene
from gns_pl.scene.extent import compression_notice, frame_interval_of, num_frames
from gns_pl.solvers.catalogue import load_solver, make_solvers
from gns_pl.solvers.configured import checkpoint_solver, configured_scenes
from gns_pl.solvers.folder import alone, prepare
from gns_pl.solvers.forecast import forecast
from gns_pl.solvers.mpm import MPMSolver
from gns_pl.solvers.selection import (
    LEARNED,
    RECORDS,
    WORSE,
    Option,
    check_quantity,
    choose,
    estimate,
    kind_of,
    listed,
    read_records,
    table,
)
from gns_pl.solvers.solver import Solver, characteristic_size
from gns_pl.text import command

if TYPE_CHECKING:
    from omegaconf import DictConfig

END = 0.02
"""From this part of a scene's duration on it is said that the last frame is not at its end."""

CHECK_CELLS = 1.5
"""Cells of the run that checks another one, over those of that one."""


def simulate_config(cfg: DictConfig, *, label: str = "") -> list[Path]:
    """Simulate as a Hydra config says (conf/simulate.yaml).

    All scenes are looked at, and what cannot be run is refused, before the first is run.

    Args:
        cfg: the config.
        label: what tells this job from the others of a sweep; it goes into the names of the files.

    Raises:
        InputError: settings that cannot be used.
    """
    from omegaconf import OmegaConf

    settings: dict[str, Any] = OmegaConf.to_container(cfg, resolve=True)  # type: ignore[assignment]
    named, ckpt, solver, tolerance = (settings[key] for key in ("scene", "ckpt", "solver", "tolerance"))
    cell_size, explain, check, choice = (settings[key] for key in ("cell_size", "explain", "check", "choice"))
    if not named or not (ckpt or solver or tolerance is not None or explain or cell_size is not None):
        raise InputError(
            f"give scene= and either ckpt= or tolerance=: {command('simulate')} scene=column_collapse tolerance=0.05"
        )
    if isinstance(ckpt, list):
        raise InputError(
            f"ckpt={','.join(map(str, ckpt))}: a run takes one checkpoint; -m ckpt=A,B makes a run of each."
        )
    if ckpt and (tolerance is not None or solver or explain or cell_size is not None or check):
        raise InputError(
            "ckpt= names the solver already; leave it out, and tolerance=, solver=, explain= choose one (cell_size= "
            "and check= are MPM's)."
        )
    check_quantity(settings["tolerance_of"])
    if settings["tolerance_of"] != WORSE and tolerance is None:
        raise InputError("tolerance_of= says of which quantity a tolerance is; give one, as tolerance=0.05.")
    if cell_size is not None and not solver:
        raise InputError("cell_size= is that of solver=mpm; tolerance= chooses among choice.cells.")
    policy = Policy(settings["stabilise"], settings["acceleration"], settings["rest_speed"])
    of_ckpt = checkpoint_solver(ckpt, policy, settings["device"], choice) if ckpt else None
    scenes = configured_scenes(settings, label)
    for scene in scenes if settings["maps"] else ():
        check_mappable(scene)
        read_crs(scene_crs(scene))
    how: dict[str, Any] = {"out": Path(settings["out"]), "seed": settings["seed"], "monitor": settings["monitor"]}
    if of_ckpt is not None:
        return simulate(of_ckpt, scenes, interval=choice["frame_interval"], **how)
    how |= {key: settings[key] for key in ("tolerance", "tolerance_of", "explain", "solver", "cell_size", "check")}
    return simulate_by_choice(scenes, choice=choice, policy=policy, device=settings["device"], **how)


def simulate_by_choice(
    scenes: Sequence[Scene],
    *,
    out: Path,
    choice: Mapping[str, Any],
    tolerance: float | None = None,
    tolerance_of: str = WORSE,
    explain: bool = False,
    solver: str | None = None,
    cell_size: float | None = None,
    check: bool = False,
    policy: Policy | None = None,
    device: str = "auto",
    seed: int = 0,
    monitor: bool = True,
) -> list[Path]:
    """Run every scene by the cheapest solver that is accurate enough, or by one that is named, and say which and why.

    Args:
        scenes: what to simulate; their names name the files.
        out: folder; made.
        choice: what there is to choose from (conf/choice).
        tolerance: largest error, relative; None only explains.
        tolerance_of: the quantity it is of, "front", "map", "height", or "worse", that of front and map.
        explain: show the solvers, and run none.
        solver: name of the one to take, whatever it is worth (`load_solver`); None chooses.
        cell_size: of "mpm" [m]; None takes the finest of the choice.
        check: run MPM on coarser cells besides, into the file of `check_path`.
        policy: how learned solvers are run.
        device: "cuda" for MPM and learned simulators on a GPU; "auto" is the CPU, where errors and times were measured.
        seed: of the particles' placement.
        monitor: as of `simulate`.

    Returns:
        The files written, or found, without those of the check.

    Raises:
        InputError: nothing to choose from, or a file of another run in the place of one.
    """
    records = read_records(Path(choice["records"]) if choice.get("records") else RECORDS)
    if solver:
        candidates = [load_solver(solver, policy=policy, choice=choice, cell_size=cell_size)]
    else:
        candidates = make_solvers(choice, policy)
    machine = ", ".join(sorted({f"{record.device}, {record.threads} threads" for record in records}))
    chosen: list[Solver] = []
    notes: list[dict[str, object]] = []
    for scene in scenes:
        options = estimate(scene, candidates, records)
        option = _choose(options, scene, tolerance, tolerance_of, machine, asked=bool(solver))
        if option is not None:
            chosen.append(option.solver)
            promise = {"tolerance": tolerance, "of": tolerance_of, "expected_error": option.errors.get(tolerance_of)}
            notes.append({} if solver else {"choice": promise})
            _tell_notices(option.solver, scene, check)
            interval = frame_interval_of(scene, choice["frame_interval"])
            end = (num_frames(scene, interval) - 1) * interval
            if option.solver.group not in LEARNED and abs(end / scene.duration - 1) > END:
                print(f"{scene.name}: frames {interval:g} s apart end at {end:g} s, not at {scene.duration:g} s.")
            for line in forecast(option.solver, scene, interval):
                print(f"{scene.name}: {line}.", flush=True)
    # One object for each solver, so that scenes of one are stepped together.
    on_device = {one.name: one.on(device) for one in chosen}
    if explain or not chosen:
        return []
    chosen = [on_device[one.name] for one in chosen]
    interval = choice["frame_interval"]
    paths = simulate(chosen, scenes, out=out, seed=seed, interval=interval, monitor=monitor, notes=notes)
    for one, scene, path in zip(chosen, scenes, paths, strict=True):
        if check and isinstance(one, MPMSolver) and one.group == "mpm":
            simulate(one.coarser(CHECK_CELLS), [scene], out=out, files=[check_path(path)], seed=seed, interval=interval)
    return paths


def simulate(
    solver: Solver | str | Path | Sequence[Solver],
    scenes: Sequence[Scene],
    *,
    out: Path,
    seed: int = 0,
    interval: float | None = None,
    monitor: bool = True,
    files: Sequence[Path] | None = None,
    notes: Sequence[Mapping[str, object]] = (),
) -> list[Path]:
    """Run scenes, every frame into `out`/NAME.h5 as soon as it is made.

    A file that is there, finished or broken off, is gone on with from its last frame or saved state, if it is of the
    same scene, solver and seed; the result is then the one of a single run.

    Args:
        solver: runs all scenes; or its name or file (`load_solver`); or one solver for every scene.
        scenes: what to simulate; their names name the files.
        out: folder; made.
        seed: of the particles' placement.
        interval: time between frames, of solvers that have none of their own [s]; None: of each scene
            `extent.frame_interval_of`.
        monitor: what fails ends with a message; False goes on as long as numbers are finite.
        files: in the place of `out`/NAME.h5.
        notes: of every scene, what the provenance of its file says besides; it does not tell runs apart.

    Returns:
        The files, in the order of the scenes.

    Raises:
        InputError: a solver or a scene that cannot be used, or a file of another run in the place of one.
        StorageError: the disk refuses; the frames written stay.
    """
    solvers = (
        [load_solver(solver)] if isinstance(solver, str | Path) else [solver] if isinstance(solver, Solver) else solver
    )
    solvers = list(solvers) * (len(scenes) if len(solvers) == 1 else 1)
    prepare(out, scenes)
    paths = [out / f"{scene.name}.h5" for scene in scenes] if files is None else list(files)
    intervals = [frame_interval_of(scene, interval) for scene in scenes]
    for one, scene, every in zip(solvers, scenes, intervals, strict=True):
        one.reduced(scene)  # refuses what cannot be run, before anything is
        num_frames(scene, every)
    try:
        jobs = {(id(one), every): one for one, every in zip(solvers, intervals, strict=True)}
        for (_, every), runner in jobs.items():
            numbers = [n for n, one in enumerate(solvers) if one is runner and intervals[n] == every]
            with runner.processes() as rank, alone(out) if rank == 0 else nullcontext():
                runner.record(
                    [scenes[number] for number in numbers],
                    [paths[number] for number in numbers],
                    interval=every,
                    seed=seed,
                    monitor=monitor,
                    rank=rank,
                )
                for number in numbers if rank == 0 and notes else ():
                    add_provenance(paths[number], notes[number])
    except KeyboardInterrupt:
        raise SystemExit("simulate.py: stopped; the same command goes on where it was.") from None
    return paths


def check_path(path: Path) -> Path:
    """Return where the run on coarser cells is, beside the run that it checks."""
    return path.with_suffix(".coarser.h5")


def _choose(
    options: Sequence[Option], scene: Scene, tolerance: float | None, of: str, machine: str, *, asked: bool
) -> Option | None:
    """Print what there is to choose from, and return what is taken, or None where nothing has to be."""
    where = {"plane": "in plane strain", "space": "in three dimensions", "terrain": "on a terrain"}[kind_of(scene)]
    print(f"{scene.name}: {where}, √(L0 H0) = {characteristic_size(scene):.3g} m, {scene.duration:.3g} s")
    if asked:
        option, why = options[0], f"as asked for; {_worth(options[0])}"
    else:
        print(f"{table(options, scene)}\nerrors of final front, map and mean height, and times measured on {machine}")
        if tolerance is None:
            return None
        option, why = choose(options, tolerance, of)
    description = option.solver.reduced(scene).description
    print(f"chosen: {option.solver.name}, {why}{f'; {description}' if description else ''}", flush=True)
    if option.solver.leaves_out:
        print(f"{option.solver.name} leaves out: {option.solver.leaves_out}", flush=True)
    return option


def _tell_notices(solver: Solver, scene: Scene, check: bool) -> None:
    notice = None if solver.group == "learned" else compression_notice(scene)
    if notice is not None:
        print(f"{notice}.")
    if check and solver.group != "mpm":
        print(f"check: {solver.name} has no cells of its own to compare; solver=mpm check=true does.")


def _worth(option: Option) -> str:
    """Return in words what is known of a solver's error on a scene."""
    if option.reason is not None:
        return f"its error on this scene is unmeasured ({option.reason})"
    if option.error is None:
        return f"its error on this scene is unmeasured ({option.unmeasured})"
    return f"on scenes like this one it erred by up to {listed(option.errors)}"
