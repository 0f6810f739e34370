"""The measures in every frame, under fixed names, and their CSV file.

One table, `CURVES`, names every column with its unit and meaning; documentation and figures take them from there.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gns_pl.fields import ParticleType
from gns_pl.metrics import measures
from gns_pl.metrics.measures import Floats
from gns_pl.scene.extent import characteristic_time, initial_extent
from gns_pl.trajectory import Trajectory

Curves = dict[str, Floats]
"""Name in `CURVES` → values in every frame [T]."""


@dataclass(frozen=True)
class Quantity:
    """A number that is reported.

    Attributes:
        name: key in files.
        unit: SI unit; "1", "L0", "τc" or "spacing" where it is a ratio.
        meaning: one line.
    """

    name: str
    unit: str
    meaning: str


CURVES: tuple[Quantity, ...] = (
    Quantity("time", "s", "time of the frame"),
    Quantity("time_tau", "τc", "the same over τc = √(H0/g)"),
    Quantity("runout_99", "L0", "advance of the front behind which 99 % of the mass lies"),
    Quantity("runout_995", "L0", "the same for 99.5 %"),
    Quantity("runout_max", "L0", "the same for the foremost particle"),
    Quantity("height_99", "L0", "height over the floor below which 99 % of the mass lies"),
    Quantity("height_max", "L0", "height of the highest particle's upper face"),
    Quantity("mean_height", "m", "mass-weighted mean height over the floor"),
    Quantity("centre_of_mass_x", "m", "mass-weighted mean distance from the x- wall"),
    Quantity("kinetic_energy", "J", "½ Σ m v², v by backward differences"),
    Quantity("potential_energy", "J", "−Σ m g·x from the lower corner of the box"),
    Quantity("dissipated_energy", "J", "kinetic and potential energy of frame 0 less those of the frame"),
    Quantity("speed_mean", "m/s", "mean speed of the particles"),
    Quantity("speed_99", "m/s", "speed that 99 % of the particles do not exceed"),
    Quantity("penetration", "spacing", "depth outside the box of the particle that is farthest out"),
)
"""Every column of a curves file, in order."""


def mobile(trajectory: Trajectory) -> Trajectory:
    """Return the trajectory without its kinematic particles, which are obstacles and not part of the flow."""
    keep = trajectory.particle_type != ParticleType.KINEMATIC
    if keep.all():
        return trajectory
    return replace(
        trajectory,
        position=trajectory.position[:, keep],
        particle_type=trajectory.particle_type[keep],
        material=trajectory.material[keep],
        mass=trajectory.mass[keep],
        initial_velocity=trajectory.initial_velocity[keep],
    )


def cut(trajectory: Trajectory, num_frames: int) -> Trajectory:
    """Return the first `num_frames` frames, without observables."""
    return replace(trajectory, position=trajectory.position[:num_frames], observables=None)


def num_finite_frames(trajectory: Trajectory) -> int:
    """Return the number of frames before the first one with a position that is not finite."""
    broken = np.flatnonzero(~np.isfinite(trajectory.position).all(axis=(1, 2)))
    return int(broken[0]) if len(broken) else trajectory.num_frames


def compute_curves(trajectory: Trajectory) -> Curves:
    """Compute every entry of `CURVES` in every frame.

    Runout is (front(t) − front(0)) / L0 with L0 the length of the body: zero at the start for every percentile, every
    resolution and every jitter of the particles. Heights are H(t) / L0, and H0/L0 at the start (99 %: 0.99 H0/L0).

    Args:
        trajectory: finite in every frame.

    Returns:
        Name → [T].
    """
    flow = mobile(trajectory)
    scene, mass = flow.scene, flow.mass.astype(np.float64)
    length, _ = initial_extent(scene)
    spacing = measures.particle_spacing(flow)
    distance = flow.position.astype(np.float64) - np.array(scene.lower)
    front = measures.percentile_front(distance[:, :, 0], mass, (99, 99.5, 100), spacing)
    top = measures.percentile_front(distance[:, :, -1], mass, (99, 100), spacing)
    runout = (front - front[:, :1]) / length
    centre = measures.centre_of_mass(flow)
    kinetic, potential = measures.kinetic_energy(flow), measures.potential_energy(flow)
    speed = measures.speeds(flow)
    return {
        "time": flow.time,
        "time_tau": flow.time / (characteristic_time(scene) if any(scene.gravity) else np.nan),
        "runout_99": runout[0],
        "runout_995": runout[1],
        "runout_max": runout[2],
        "height_99": top[0] / length,
        "height_max": top[1] / length,
        "mean_height": centre[:, -1],
        "centre_of_mass_x": centre[:, 0],
        "kinetic_energy": kinetic,
        "potential_energy": potential,
        "dissipated_energy": kinetic[0] + potential[0] - kinetic - potential,
        "speed_mean": speed.mean(axis=1),
        "speed_99": np.percentile(speed, 99, axis=1),
        "penetration": measures.penetration(flow).max(axis=1) / spacing,
    }


def write_curves(path: Path, curves: Mapping[str, Curves]) -> None:
    """Write the curves of several simulators of one scene side by side.

    Args:
        path: a CSV file; its columns are time, time_tau and then `SIMULATOR.NAME`. Where a simulator has no frame any
            more its cells are empty.
        curves: simulator → curves, the one with the most frames first.
    """
    names = [quantity.name for quantity in CURVES if quantity.name not in ("time", "time_tau")]
    first = next(iter(curves.values()))
    columns: dict[str, Floats] = {"time": first["time"], "time_tau": first["time_tau"]}
    columns |= {f"{simulator}.{name}": values[name] for simulator, values in curves.items() for name in names}
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        for frame in range(len(first["time"])):
            writer.writerow([f"{values[frame]:.9g}" if frame < len(values) else "" for values in columns.values()])


def read_curves(path: Path) -> dict[str, Floats]:
    """Read a file of `write_curves`: column → [T], NaN where a cell is empty."""
    with path.open(newline="", encoding="utf-8") as file:
        names, *rows = csv.reader(file)
    table = np.array([[float(cell) if cell else np.nan for cell in row] for row in rows]).reshape(len(rows), len(names))
    return {name: table[:, column] for column, name in enumerate(names)}
