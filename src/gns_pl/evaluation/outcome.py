"""What became of one run, in metres and seconds: runout, heights, whether it rests, and the deposit.

It is read from the run's file a frame at a time, so that no run is too large for it. No reference is needed, and
nothing is drawn here.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gns_pl.fields import ParticleType
from gns_pl.io import open_trajectory, read_header, read_static, read_window
from gns_pl.metrics.curves import mobile
from gns_pl.metrics.measures import Floats, arrest_time, percentile_front
from gns_pl.metrics.release import is_column, release_distance
from gns_pl.trajectory import Trajectory

NUM_FRAMES = 200
"""At most about so many frames of a run are looked at, evenly spaced, the last among them."""

MOVING = 0.9
"""A front that came to rest only in what follows this share of the run is still moving, as far as the run shows."""


@dataclass(frozen=True)
class Outcome:
    """What became of a run.

    Attributes:
        runout: final, of 99 % of the mass [m]; of what, `measured_from` says.
        measured_from: how the runout is defined for this scene.
        largest_height: of the highest particle's upper face over the floor of the box, in any frame [m].
        largest_height_at: when [s].
        final_height: the same at the end [m].
        mean_height: mass-weighted mean height of the deposit over the floor of the box [m].
        arrest_time: from when on the front has less than 2 % of its advance left [s]; None if it still moves, or never
            moved.
        moving: whether the front still moves at the end.
        front_speed: of the front, over the last tenth of the run [m/s].
        mean_speed: of the particles, between the last two frames [m/s].
        volume: that the particles stand for [m³], in two dimensions [m² = m³ per metre of width].
        extent: horizontal axis → from where to where 99 % of the mass lies [m].
        end: time of the last frame [s].
        ended: why the run ended before its time; empty if it did not.
    """

    runout: float
    measured_from: str
    largest_height: float
    largest_height_at: float
    final_height: float
    mean_height: float
    arrest_time: float | None
    moving: bool
    front_speed: float
    mean_speed: float
    volume: float
    extent: dict[str, tuple[float, float]]
    end: float
    ended: str

    def rows(self) -> list[tuple[str, str]]:
        """Return label and text of what is printed."""
        if self.moving:
            front = f"still moving at {self.end:.3g} s, by {self.front_speed:.2g} m/s"
        elif self.arrest_time is None:
            front = "did not advance"
        else:
            front = f"at rest from {self.arrest_time:.3g} s on"
        places = ", ".join(f"{axis} from {low:.3g} to {high:.3g} m" for axis, (low, high) in self.extent.items())
        unit = "m³" if len(self.extent) == 2 else "m³ per metre of width"
        rows = [
            ("runout", f"{self.runout:.3g} m: {self.measured_from}"),
            (
                "largest height",
                f"{self.largest_height:.3g} m at {self.largest_height_at:.3g} s; at the end {self.final_height:.3g} m",
            ),
            ("front", f"{front}; mean speed at the end {self.mean_speed:.2g} m/s"),
            ("deposit", f"{self.volume:.3g} {unit}, 99 % of it in {places}; mean height {self.mean_height:.3g} m"),
        ]
        return [*rows, ("ended early", self.ended)] if self.ended else rows

    def to_dict(self) -> dict[str, Any]:
        """Return plain values."""
        return asdict(self)


def read_outcome(path: Path) -> Outcome:
    """Return what became of the run in a file.

    Raises:
        InputError: no such file, or one that is no trajectory.
    """
    header, static = read_header(path), read_static(path)
    start = Trajectory(
        position=read_window(path, 0, 1),
        material_features=header.material_features,
        dt=header.dt,
        scene=header.scene,
        provenance=header.provenance,
        observables=None,
        **static,
    )
    every = max(1, math.ceil((header.num_frames - 1) / NUM_FRAMES))
    frames = sorted({*range(0, header.num_frames, every), max(0, header.num_frames - 2), header.num_frames - 1})
    keep = static["particle_type"] != ParticleType.KINEMATIC

    def positions() -> Iterator[Floats]:
        with open_trajectory(path) as file:
            for frame in frames:
                yield read_window(file, frame, 1)[0, keep].astype(np.float64)

    return _outcome(mobile(start), np.array(frames) * header.dt, positions())


def outcome_of(trajectory: Trajectory) -> Outcome:
    """Return what became of a run in memory."""
    flow = mobile(trajectory)
    return _outcome(flow, flow.time, (frame.astype(np.float64) for frame in flow.position))


def _outcome(start: Trajectory, time: Floats, positions: Iterator[Floats]) -> Outcome:
    scene, mass, spacing = start.scene, start.mass.astype(np.float64), start.spacing
    fronts, tops = [], []
    before = position = start.position[0].astype(np.float64)
    for frame in positions:
        before, position = position, frame
        fronts.append(percentile_front(release_distance(position, scene)[None], mass, (99,), spacing)[0, 0])
        tops.append(position[:, -1].max() + spacing / 2 - scene.lower[-1])
    front, top, end = np.array(fronts), np.array(tops), float(time[-1])
    advance, arrest = front - front[0], arrest_time(time, front)
    rested = isinstance(start.provenance.get("at_rest_from"), float)
    moving = math.isfinite(arrest) and arrest > MOVING * end and not rested
    late = int(np.searchsorted(time, MOVING * end * (1 - 1e-9)))
    late = min(late, len(time) - 2) if len(time) > 1 else 0
    lapse = max(float(time[-1] - time[late]), start.dt)
    step = max(float(time[-1] - time[-2]), start.dt) if len(time) > 1 else start.dt
    speed = np.linalg.norm(position - before, axis=1) @ mass / mass.sum() / step
    extent = {}
    for axis, name in enumerate("xy"[: scene.dim - 1]):
        low, high = percentile_front(position[None, :, axis], mass, (0.5, 99.5), spacing)[:, 0]
        # A particle's mass is spread over its spacing, which may reach a little through a wall.
        extent[name] = (max(float(low), scene.lower[axis]), min(float(high), scene.upper[axis]))
    highest = int(top.argmax())
    failed = start.provenance.get("failed_at")
    failure = str(start.provenance.get("failure", "positions were no longer finite"))
    return Outcome(
        runout=float(advance[-1]),
        measured_from="advance of the front along x, behind which 99 % of the mass lies"
        if is_column(scene)
        else "horizontal distance from where the bodies were released, within which 99 % of the mass lies",
        largest_height=float(top[highest]),
        largest_height_at=float(time[highest]),
        final_height=float(top[-1]),
        mean_height=float(position[:, -1] @ mass / mass.sum() - scene.lower[-1]),
        arrest_time=None if moving or not math.isfinite(arrest) else arrest,
        moving=moving,
        front_speed=float((front[-1] - front[late]) / lapse),
        mean_speed=float(speed),
        volume=float(start.volume().sum(dtype=np.float64)),
        extent=extent,
        end=end,
        ended=f"failed at {failed:.3g} s ({failure})" if isinstance(failed, float) else "",
    )
