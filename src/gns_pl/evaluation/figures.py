"""Which figures an evaluation draws, and where they go; how they are drawn is in `viz`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gns_pl.metrics.laws import LAWS
from gns_pl.metrics.measures import particle_spacing
from gns_pl.scene.extent import characteristic_time

if TYPE_CHECKING:
    from gns_pl.evaluation.judge import SceneResult
    from gns_pl.scene import Scene

LEAST_COLUMNS = 3
"""From so many columns on their runouts are drawn beside published laws."""

TITLES = {"reference": "MPM", "learned": "learned"}


def draw(
    results: Mapping[str, SceneResult], out: Path, *, snapshots: Sequence[float], num_frames: int, width: int
) -> list[Path]:
    """Draw curves of all scenes, their runouts beside published laws, an evolution and an animation of each.

    Args:
        results: scene → its result.
        out: folder.
        snapshots: times of the evolution [τc]; the last frame comes besides.
        num_frames: of an animation.
        width: of an animation [pixels].

    Returns:
        Paths of the files.
    """
    from gns_pl.solvers.ood import LIMIT
    from gns_pl.viz import plot_curves, plot_evolution, plot_laws, plot_ood, write_animation

    curves = {name: {TITLES[key]: values for key, values in result.curves.items()} for name, result in results.items()}
    bands = {name: {TITLES["learned"]: result.band} for name, result in results.items()}
    files = [out / "runout_height.png", out / "runout_height.pdf", out / "energy.png"]
    plot_curves(curves, ("runout", "height"), files[:2], bands)
    plot_curves(curves, ("energy", "speed"), files[2:], bands)
    far = {name: result.ood for name, result in results.items() if result.ood is not None}
    if far:
        files.append(out / "ood.png")
        distances = {
            name: (
                ood.time / characteristic_time(results[name].trajectories["reference"].scene),
                ood.mean,
                ood.share,
            )
            for name, ood in far.items()
        }
        plot_ood(distances, LIMIT, files[-1])
    columns = [result.report for result in results.values() if is_column(result.trajectories["reference"].scene)]
    if len(columns) >= LEAST_COLUMNS:
        files += [out / "laws.png", out / "laws.pdf"]
        plot_laws(of_columns(columns), {law.source: law for law in LAWS}, files[-2:])
    for name, result in results.items():
        shown = {TITLES[key]: result.trajectories[key] for key in ("learned", "reference")}
        reference = result.trajectories["reference"]
        scale, spacing = characteristic_time(reference.scene), particle_spacing(reference)
        files += [out / f"evolution_{name}.png", out / f"evolution_{name}.pdf", out / f"{name}.gif"]
        plot_evolution(shown, files[-3:-1], time_scale=scale, times=snapshots, diameter=spacing)
        write_animation(shown, files[-1], time_scale=scale, diameter=spacing, num_frames=num_frames, width=width)
    return files


def draw_in_space(
    results: Mapping[str, SceneResult], out: Path, *, film: str, num_frames: int, width: int
) -> list[Path]:
    """Write a film and a still of the last frame of every scene in three dimensions, learned beside MPM.

    Args:
        results: scene → its result.
        out: folder.
        film: ending of the films, "mp4" or "gif".
        num_frames: of a film.
        width: of a film [pixels]; made even.

    Returns:
        Paths of the files.
    """
    from gns_pl.viz import render_film, render_still
    from gns_pl.viz.colouring import material_names

    files = []
    for name, result in results.items():
        learned, reference = (result.trajectories[key] for key in ("learned", "reference"))
        shown = {TITLES["learned"]: learned, TITLES["reference"]: reference}
        colour, path = "material" if material_names(reference) else "displacement", out / f"film_{name}.{film}"
        files.append(render_film(path, shown, colour=colour, num_frames=num_frames, width=width - width % 2))
        still, beside = out / f"still_{name}.png", {TITLES["reference"]: reference}
        files.append(render_still(still, learned, colour=colour, title=TITLES["learned"], side_by_side=beside))
    return files


def is_column(scene: Scene) -> bool:
    """Return whether a scene is one column at rest against the x- wall, on the floor, as the laws are about."""
    [body, *others] = scene.bodies
    at_wall = abs(body.position[0] - scene.lower[0]) + abs(body.position[-1] - scene.lower[-1]) < 1e-6
    return not others and at_wall and not any(body.velocity)


def of_columns(reports: Sequence[Mapping[str, Any]]) -> dict[str, list[tuple[float, float, float]]]:
    """Return simulator → aspect ratio, runout of 99 % of the mass and its uncertainty, both in L0, of every column."""
    nothing = float("nan")
    return {
        TITLES[key]: [
            (
                report["aspect_ratio"],
                report[key]["runout_99"] if report[key]["runout_99"] is not None else nothing,
                (report["reference_spread"] if key == "reference" else report["placements"]["std"]).get(
                    "runout_99", 0.0
                ),
            )
            for report in reports
        ]
        for key in TITLES
    }
