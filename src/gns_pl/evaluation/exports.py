"""What an evaluation leaves of its runs for other programs: trajectories, series for ParaView, maps."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from gns_pl.metrics.curves import cut

if TYPE_CHECKING:
    from gns_pl.evaluation.judge import SceneResult


def write_trajectories(name: str, result: SceneResult, out: Path) -> list[Path]:
    """Write reference and rollouts of a scene as HDF5, and return the files."""
    from gns_pl.io import write_trajectory

    paths = []
    for key, trajectory in result.trajectories.items():
        paths.append(out / f"{key}_{name}.h5")
        write_trajectory(paths[-1], trajectory)
    return paths


def write_paraview_series(name: str, result: SceneResult, out: Path) -> list[Path]:
    """Write a series for ParaView of each, those of rollouts with their error, and return their lists."""
    from gns_pl.viz import write_paraview

    truth = result.trajectories["reference"]
    paths = []
    for key, trajectory in result.trajectories.items():
        reference = cut(truth, trajectory.num_frames) if key != "reference" else None
        folder = out / "paraview"
        folder.mkdir(exist_ok=True)
        paths.append(write_paraview(folder, trajectory, name=f"{key}_{name}", reference=reference))
    return paths


def write_all_maps(name: str, result: SceneResult, out: Path, *, figures: bool, reached: float | None) -> list[Path]:
    """Write the maps of each, all on the cells of the reference, and return the files; arguments as `write_maps`."""
    from gns_pl.evaluation.maps import maps_of, write_maps

    truth = maps_of(result.trajectories["reference"], reached=reached)
    paths = []
    for key, trajectory in result.trajectories.items():
        made = truth if key == "reference" else maps_of(trajectory, truth.grid, truth.reached)
        folder, title = out / "maps", f"{name}: {key}"
        paths += write_maps(made, trajectory.scene, folder, name=f"{key}_{name}", title=title, figures=figures)
    return paths
