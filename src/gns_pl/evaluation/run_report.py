"""A report about runs that are compared with nothing: page, table, curves, figures, film and a series for ParaView.

What is compared with a reference stands in `report` and `page`. Both measure and draw by the same functions.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gns_pl import __version__
from gns_pl.errors import InputError
from gns_pl.evaluation import report
from gns_pl.evaluation.checks import check_figures, check_space, make_folder
from gns_pl.evaluation.maps import CAPTIONS, check_maps, maps_of, write_maps
from gns_pl.evaluation.outcome import Outcome, outcome_of
from gns_pl.io.atomic import write_atomically
from gns_pl.metrics.curves import Curves, compute_curves, mobile, write_curves
from gns_pl.metrics.summary import summarise
from gns_pl.scene.extent import characteristic_time
from gns_pl.text import number, without_nan
from gns_pl.trajectory import Trajectory

TEMPLATE = "run_report.html"

FORMAT, FORMAT_VERSION = "gns_pl runs", 1

FILMS = (None, "mp4", "gif")


@dataclass(frozen=True)
class ReportedRun:
    """A run and what is known of it.

    Attributes:
        trajectory: finite in every frame.
        solver: by which it was made, as the figures name it.
        spread: entry of a summary → by how much other cells change it, in its unit; empty if none were run.
        cells: of the other runs, over those of this one.
        reference: what it should be, by fine MPM, drawn beside it; None if there is none.
    """

    trajectory: Trajectory
    solver: str
    spread: Mapping[str, float] = field(default_factory=dict)
    cells: tuple[float, ...] = ()
    reference: Trajectory | None = None


CHECKED = ("figures", "film", "paraview", "maps", "reached")
"""Settings that `check_reporting` looks at."""


def check_reporting(
    *, figures: bool, film: str | None, paraview: bool, maps: bool, reached: float | None, key: str
) -> None:
    """Refuse what cannot be drawn, before anything is run.

    Args:
        figures: are wanted.
        film: ending of the film, or None.
        paraview: a series is wanted.
        maps: are wanted.
        reached: as of `check_maps`.
        key: of these settings on the command line, for messages.

    Raises:
        InputError: packages that are missing, or an unknown film.
    """
    if maps:
        check_maps(figures=figures, reached=reached, key=key)
    if film not in FILMS:
        raise InputError(f"{key}.film must be mp4, gif or null, not {film!r}.")
    if figures:
        check_figures(without=f", or go without: {key}.figures=false")
    if film or paraview:
        check_space(film=bool(film))


def write_report(
    runs: Mapping[str, ReportedRun],
    out: Path,
    *,
    figures: bool = True,
    snapshots: Sequence[float] = (0, 1, 2.5),
    animation: Mapping[str, int] | None = None,
    film: str | None = None,
    paraview: bool = False,
    maps: bool = False,
    reached: float | None = None,
) -> list[Path]:
    """Write everything about runs into a folder and return the files.

    Args:
        runs: name of a scene → its run.
        out: folder; made.
        figures: draw curves, snapshots and animations.
        snapshots: times of the evolution figure [τc]; the last frame comes besides.
        animation: `num_frames` and `width` [pixels].
        film: "mp4" or "gif" for a film and a still in three dimensions; None for neither.
        paraview: write a series for ParaView.
        maps: write rasters, outlines and map figures.
        reached: thickness from which on a cell of a map counts as reached [m]; None for the usual one.

    Raises:
        InputError: a folder that cannot be written.
        StorageError: the disk refuses.
    """
    make_folder(out)
    pictures = dict(animation or {"num_frames": 80, "width": 960})
    scenes: dict[str, dict[str, Any]] = {}
    curves: dict[str, Curves] = {}
    files: list[Path] = []
    for name, run in runs.items():
        outcome = outcome_of(run.trajectory)
        if any(run.trajectory.scene.gravity):  # without it there is no τc, over which curves and figures are
            curves[name] = compute_curves(run.trajectory)
            files.append(out / f"curves_{name}.csv")
            write_curves(files[-1], {run.solver: curves[name]})
        scenes[name] = _content(run, outcome, curves.get(name))
        if paraview:
            from gns_pl.viz import write_paraview

            (out / "paraview").mkdir(exist_ok=True)
            files.append(write_paraview(out / "paraview", run.trajectory, name=name))
        if maps:
            made = maps_of(run.trajectory, reached=reached)
            title, scene = f"{name}: {run.solver}", run.trajectory.scene
            files += write_maps(made, scene, out / "maps", name=name, title=title, figures=figures)
    drawn = {name: run for name, run in runs.items() if name in curves}
    if figures and drawn:
        files += _draw(drawn, curves, out, snapshots, **pictures)
    if film is not None:
        files += _draw_in_space(runs, out, film, **pictures)
    content = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "gns_pl_version": __version__,
        "run": report.run(),
        "scenes": scenes,
    }
    plain = without_nan(json.loads(json.dumps(content, default=str)))
    text = json.dumps(plain, indent=2, allow_nan=False, ensure_ascii=False) + "\n"
    write_atomically(out / "metrics.json", text.encode())
    write_atomically(out / "report.html", _page(plain, runs, out).encode())
    return [out / "report.html", out / "metrics.json", *files]


def report_lines(rows: Sequence[tuple[str, str]]) -> list[str]:
    """Return rows of label and text as they are printed below a name."""
    return [f"  {label:15} {text}" for label, text in rows]


def _content(run: ReportedRun, outcome: Outcome, curves: Curves | None) -> dict[str, Any]:
    trajectory = run.trajectory
    return {
        "scene": trajectory.scene.to_dict(),
        "solver": run.solver,
        "num_particles": trajectory.num_particles,
        "num_frames": trajectory.num_frames,
        "dt": trajectory.dt,
        "outcome": outcome.to_dict(),
        "summary": {} if curves is None else summarise(trajectory, curves),
        "spread": {"cells": list(run.cells), **run.spread},
        "made_by": trajectory.provenance,
    }


def _page(content: Mapping[str, Any], runs: Mapping[str, ReportedRun], out: Path) -> str:
    from jinja2 import Environment, PackageLoader

    environment = Environment(loader=PackageLoader("gns_pl.evaluation", "."), autoescape=True, trim_blocks=True)
    shared = [
        _figure(out / "runout_height.png", "Runout and height over time"),
        _figure(out / "energy.png", "Energy and speed"),
    ]
    scenes = {
        name: {
            "solver": scene["solver"],
            "outcome": outcome_of(runs[name].trajectory).rows(),
            "rows": summary_rows(scene),
            "cells": scene["spread"]["cells"],
            "particles": f"{scene['num_particles']:,} particles, {scene['num_frames']} frames of {scene['dt']:.4g} s",
            "figures": [
                _figure(out / f"evolution_{name}.png", "Snapshots, coloured by displacement"),
                _figure(out / f"still_{name}.png", "The end in three dimensions"),
                _figure(out / f"{name}.gif", "The whole run"),
                *(_figure(out / "maps" / f"{name}_{ending}.png", text) for ending, text in CAPTIONS.items()),
            ],
            "provenance": [(key, str(value)) for key, value in scene["made_by"].items()],
        }
        for name, scene in content["scenes"].items()
    }
    return environment.get_template(TEMPLATE).render(scenes=scenes, shared=shared, run=content["run"])


def summary_rows(scene: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """Return label, value and change on other cells of everything a summary tables; none without curves."""
    summary, spread = scene["summary"], scene["spread"]
    if not summary:
        return []
    return [
        (label, number(summary[key]), number(spread[key]) if key in spread else "")
        for label, key, _ in report.ROWS
        if key in summary
    ]


def _figure(path: Path, caption: str) -> dict[str, str] | None:
    if not path.is_file():
        return None
    kind = path.suffix.removeprefix(".")
    return {"source": f"data:image/{kind};base64,{base64.b64encode(path.read_bytes()).decode()}", "caption": caption}


def _draw(
    runs: Mapping[str, ReportedRun],
    curves: Mapping[str, Curves],
    out: Path,
    snapshots: Sequence[float],
    num_frames: int,
    width: int,
) -> list[Path]:
    from gns_pl.viz import plot_curves, plot_evolution, write_animation

    references = {name: {} if run.reference is None else {"MPM": run.reference} for name, run in runs.items()}
    of_solver = {
        name: {**{solver: compute_curves(flow) for solver, flow in references[name].items()}, run.solver: curves[name]}
        for name, run in runs.items()
    }
    files = [out / "runout_height.png", out / "runout_height.pdf", out / "energy.png"]
    plot_curves(of_solver, ("runout", "height"), files[:2])
    plot_curves(of_solver, ("energy", "speed"), files[2:])
    for name, run in runs.items():
        flow = mobile(run.trajectory)
        shown = {**{solver: mobile(reference) for solver, reference in references[name].items()}, run.solver: flow}
        scale = characteristic_time(flow.scene)
        files += [out / f"evolution_{name}.png", out / f"evolution_{name}.pdf", out / f"{name}.gif"]
        plot_evolution(shown, files[-3:-1], time_scale=scale, times=snapshots, diameter=flow.spacing)
        write_animation(shown, files[-1], time_scale=scale, diameter=flow.spacing, num_frames=num_frames, width=width)
    return files


def _draw_in_space(runs: Mapping[str, ReportedRun], out: Path, film: str, num_frames: int, width: int) -> list[Path]:
    from gns_pl.viz import render_film, render_still

    files = []
    for name, run in runs.items():
        shown = {run.solver: run.trajectory}
        files.append(render_film(out / f"film_{name}.{film}", shown, num_frames=num_frames, width=width - width % 2))
        files.append(render_still(out / f"still_{name}.png", run.trajectory, title=run.solver))
    return files
