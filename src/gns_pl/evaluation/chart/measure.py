"""All measuring of a chart: reference, law, runs, ratios, batches, into the tables and the plan of a folder."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from gns_pl.errors import InputError
from gns_pl.evaluation.chart import speed
from gns_pl.evaluation.chart.batches import can_batch, measure_batches
from gns_pl.evaluation.chart.converged import converged
from gns_pl.evaluation.chart.costs import cost_of_entry
from gns_pl.evaluation.chart.entries import make_entries, runs_whole
from gns_pl.evaluation.chart.plan import LEARNED, MEASURES, WHERE, EntryFacts, Plan, write_plan
from gns_pl.evaluation.chart.points import points_of, rows_by_name
from gns_pl.evaluation.chart.tables import Tables
from gns_pl.evaluation.chart.verdicts import verdicts
from gns_pl.evaluation.report import run
from gns_pl.evaluation.scenes import build_scenes
from gns_pl.generation import reference_trajectory
from gns_pl.machine import available_cores
from gns_pl.metrics.curves import compute_curves
from gns_pl.mpm.settings import choose_device
from gns_pl.scene import Scene
from gns_pl.solvers.reduction import reduce_scene
from gns_pl.solvers.selection import kind_of
from gns_pl.solvers.solver import Solver
from gns_pl.solvers.trivial import FittedLaw


def measure(
    scenes: Sequence[Scene],
    tables: Tables,
    plan_path: Path,
    *,
    ckpt: Sequence[str],
    choice: Mapping[str, Any],
    cache: Path,
    frame_interval: float,
    placements: int,
    threads: Sequence[int | None],
    device: str,
    reference: Mapping[str, Any],
    variants: Mapping[str, Any],
    extrapolate: Mapping[str, Any],
    trivial: Mapping[str, Any],
    stabilise: Mapping[str, Any],
    law: Mapping[str, Any],
    batches: Mapping[str, Any],
    ratios: Mapping[str, Any],
    costs: Mapping[str, Any],
) -> None:
    """Measure what the tables lack.

    Args:
        scenes: on which all settings are run, as far as they can; all of one kind (`selection.kind_of`).
        tables: filled, row by row.
        plan_path: where the plan is written, once it is known what there is to measure.
        ckpt: checkpoints besides those of the choice.
        choice: the solvers of `simulate.py` (conf/choice).
        cache: folder of reference runs.
        frame_interval: time between frames [s].
        placements: of each setting and scene, one timed run each.
        threads: of a run; None for all cores. The chart is about the first number, of the others are times alone.
        device: "auto", "cpu" or "cuda".
        reference: {plane, space, terrain: {cells_per_metre, placements}, order}, as `converged.converged`.
        variants: of MPM, as `entries.mpm_variants`.
        extrapolate: {pairs of cells, order}.
        trivial: {cells} whose particles the trivial baselines have.
        stabilise: arguments of `rollout.stabilise.stabilise`, for learned runs.
        law: as `fit_law`.
        batches: {sizes, turns}; no sizes, no throughput.
        ratios: {turns} of trained solvers and MPM; 0 for none.
        costs: name → {data_seconds, train_seconds} that checkpoints do not know.

    Raises:
        InputError: settings that cannot be used.
    """
    kinds = {kind_of(scene) for scene in scenes}
    if len(kinds) > 1:
        raise InputError(
            f"scenes {' and '.join(WHERE[kind] for kind in sorted(kinds))}: chart them apart, each with another out=."
        )
    [kind] = kinds
    if set(reference.get(kind) or {}) != {"cells_per_metre", "placements"}:
        raise InputError(f"reference.{kind}: needs cells_per_metre and placements.")
    pairs = tuple((float(coarse), float(fine)) for coarse, fine in extrapolate["pairs"])
    if any(not fine > coarse > 0 for coarse, fine in pairs):
        raise InputError(f"extrapolate.pairs: each is two numbers of cells, the coarser first, not {list(pairs)}.")
    on = learned_device(device)
    solver_on = choose_device("auto") if on == "cuda" else "cpu"
    entries, left_out, beyond = runnable(
        make_entries(ckpt, choice, variants, float(trivial["cells"]), stabilise, on, solver_on), scenes
    )
    spent = {entry.name: cost_of_entry(entry, costs) for entry in entries if entry.group in LEARNED}
    first, *more = (number or available_cores() for number in threads)
    for other in more:
        with speed.on_threads(other):  # refused before anything is measured, as the first number is
            pass
    with speed.on_threads(first) as number:
        places = {each: speed.place_of(each, number) for each in sorted({entry.device for entry in entries})}
        judged = []
        for scene in scenes:
            say(f"{scene.name}: the reference, where it is not kept from before …")
            fine = converged(
                scene,
                mpm=choice["mpm"],
                order=float(reference["order"]),
                interval=frame_interval,
                cache=cache,
                **reference[kind],
            )
            within = ", ".join(f"{name} {100 * value:.1f} %" for name, value in fine.uncertainty.items())
            say(f"  front {fine.observed.front[-1]:.4f} m; within {within}; {fine.seconds:.1f} s a run")
            judged.append(fine)
        fitted: tuple[float, ...] = ()
        law_seconds = 0.0
        if all(fine.facts.column for fine in judged):
            fitted, law_seconds = fit_law(law, choice["mpm"], frame_interval, cache)
        plan = Plan(
            command=f"python {run()['command']}",
            kind=kind,
            scenes=tuple(each.facts for each in judged),
            entries=tuple(EntryFacts(e.name, e.group, e.identity(), e.device, e.selectable) for e in entries),
            left_out=left_out,
            beyond=beyond,
            places=places,
            more_threads=tuple(more),
            placements=placements,
            pairs=pairs,
            order=float(extrapolate["order"]),
            law=fitted,
            law_seconds=law_seconds,
            costs=spent,
        )
        write_plan(plan_path, plan)
        for line in plan.told():
            say(line)
        speed.measure_runs(entries, judged, tables.runs, places, placements=placements, left_out=left_out, say=say)
        if ratios["turns"]:
            named, rows, points = (
                {e.name: e for e in entries},
                rows_by_name(plan, tables.runs),
                points_of(plan, tables.runs),
            )
            found = [
                each for measure in MEASURES for each in verdicts(points, rows, plan.ratios(tables.ratios), measure)
            ]
            pairs_of_names = dict.fromkeys((each.own.name, name) for each in found for name in each.others())
            wanted_pairs = [(named[own], named[other]) for own, other in pairs_of_names]
            turns = int(ratios["turns"])
            speed.measure_ratios(wanted_pairs, judged, left_out, tables.ratios, places, turns=turns, say=say)
        if batches["sizes"]:
            together = [entry for entry in entries if can_batch(entry) and entry.name not in left_out]
            sizes, turns = list(batches["sizes"]), int(batches["turns"])
            measure_batches(together, judged, tables.batches, places, sizes=sizes, turns=turns, say=say)
    for other in more:
        with speed.on_threads(other) as number:
            places = {each: speed.place_of(each, number) for each in places}
            speed.measure_runs(entries, judged, tables.runs, places, placements=placements, left_out=left_out, say=say)


def say(text: str) -> None:
    """Print a line at once."""
    print(text, flush=True)


def learned_device(device: str) -> str:
    """Return "cpu" or "cuda": that of learned simulators.

    Raises:
        InputError: another device, or a GPU that is not there.
    """
    import torch

    if device not in ("auto", "cpu", "cuda"):
        raise InputError(f"device must be auto, cpu or cuda, not {device!r}.")
    if device == "cuda" and not torch.cuda.is_available():
        raise InputError("device=cuda: torch finds no GPU here; choose device=cpu, or auto.")
    return "cuda" if device != "cpu" and torch.cuda.is_available() else "cpu"


Reasons = dict[str, dict[str, str]]
"""Name of a solver → scene → why not."""


def runnable(entries: Sequence[Solver], scenes: Sequence[Scene]) -> tuple[list[Solver], Reasons, Reasons]:
    """Return the solvers that can run a scene at least, what they cannot run, and what is outside of their range.

    What is outside of the range that a solver was made for is run and judged all the same, and said.
    """
    left_out: Reasons = {}
    beyond: Reasons = {}
    for entry in entries:
        for scene in scenes:
            reduced = reduce_scene(scene).scene
            flat = reduced if reduced.dim < scene.dim else scene
            reason = entry.unsupported_reason(scene if runs_whole(entry) else flat)
            if reason is not None:
                left_out.setdefault(entry.name, {})[scene.name] = reason
            elif (outside := entry.out_of_range_reason(scene)) is not None:
                beyond.setdefault(entry.name, {})[scene.name] = outside
    return [entry for entry in entries if len(left_out.get(entry.name, {})) < len(scenes)], left_out, beyond


def fit_law(
    law: Mapping[str, Any], mpm: Mapping[str, Any], interval: float, cache: Path
) -> tuple[tuple[float, ...], float]:
    """Return a law's coefficients, fitted to MPM's columns of other aspect ratios than the test's, and their time [s].

    Args:
        law: {aspect_ratios, size, cells, domain, data}: H0/L0, √(L0 H0) [m], cells over it, box [m], sand and walls.
        mpm: settings of the solver but for the cells.
        interval: time between frames [s].
        cache: folder of reference runs.
    """
    size, found, spent = float(law["size"]), {}, 0.0
    ratios = [float(each) for each in law["aspect_ratios"]]
    columns = {f"law_{a:g}": {"length": size / math.sqrt(a), "height": size * math.sqrt(a)} for a in ratios}
    scenes = build_scenes(
        columns, None, only=None, domain=law["domain"], duration=6.0, interval=interval, data=law["data"]
    )
    settings = {**mpm, "cell_size": size / float(law["cells"])}
    for ratio, scene in zip(ratios, scenes.values(), strict=True):
        reduced = reduce_scene(scene).scene
        made = reference_trajectory(reduced, settings, frame_interval=interval, seed=0, cache_directory=cache)
        found[ratio] = float(compute_curves(made)["runout_99"][-1])
        spent += float(made.provenance["wall_seconds"])  # type: ignore[arg-type]
    return FittedLaw.to_runs(found).coefficients, spent
