"""Which figures an evaluation draws, and where they go; how they are drawn is in `viz`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from gns_pl.evaluation.measures import characteristic_time, particle_spacing

if TYPE_CHECKING:
    from gns_pl.evaluation.evaluate import SceneResult

TITLES = {"reference": "MPM", "learned": "learned"}


def draw(
    results: Mapping[str, SceneResult], out: Path, *, snapshots: Sequence[float], num_frames: int, width: int
) -> list[Path]:
    """Draw curves of all scenes, and an evolution and an animation of each, into `out`.

    Args:
        results: scene → its result.
        out: folder.
        snapshots: times of the evolution [τc]; the last frame comes besides.
        num_frames: of an animation.
        width: of an animation [pixels].

    Returns:
        Paths of the files.
    """
    from gns_pl.viz import plot_curves, plot_evolution, write_animation

    curves = {name: {TITLES[key]: values for key, values in result.curves.items()} for name, result in results.items()}
    files = [out / "runout_height.png", out / "runout_height.pdf", out / "energy.png"]
    plot_curves(curves, ("runout", "height"), files[:2])
    plot_curves(curves, ("energy", "speed"), files[2:])
    for name, result in results.items():
        shown = {TITLES[key]: result.trajectories[key] for key in ("learned", "reference")}
        reference = result.trajectories["reference"]
        scale, spacing = characteristic_time(reference.scene), particle_spacing(reference)
        files += [out / f"evolution_{name}.png", out / f"{name}.gif"]
        plot_evolution(shown, files[-2], time_scale=scale, times=snapshots, diameter=spacing)
        write_animation(shown, files[-1], time_scale=scale, diameter=spacing, num_frames=num_frames, width=width)
    return files
