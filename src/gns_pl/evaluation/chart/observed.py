"""What a chart compares of a run, and by how much two runs differ in it. Particles are forgotten here."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gns_pl.metrics import measures
from gns_pl.metrics.curves import cut, mobile
from gns_pl.metrics.maps import map_cell, map_error, volume_map
from gns_pl.metrics.measures import Floats
from gns_pl.metrics.release import front_advance
from gns_pl.scene import Scene
from gns_pl.trajectory import Trajectory

ERRORS = ("front_error", "map_error", "height_error", "arrest_error", "curve_error", "profile_error")
"""Keys of `errors_of`, as in `rows.RunRow`."""


@dataclass(frozen=True)
class Observed:
    """What is compared of a run, measured with all its particles.

    Attributes:
        front: advance of the front within which 99 % of the mass lies (`metrics.release.front_advance`) [T] [m].
        height: mass-weighted mean height over the floor of the box, or over the terrain [T] [m].
        arrest: time after which the flow is over (`measures.energy_arrest_time`) [s].
        volumes: final volume at the nodes of a horizontal grid (`metrics.maps.volume_map`) [X, Y] [m³]; in plane strain
            its profile [X] [m²].
        profile: final height of the deposit along x, over floor or terrain (`measures.deposit_profile`) [B] [m].
    """

    front: Floats
    height: Floats
    arrest: float
    volumes: Floats
    profile: Floats

    @classmethod
    def of(cls, run: Trajectory, judged: Scene, across: int | None, num_frames: int | None = None) -> Observed:
        """Measure a run.

        Args:
            run: finite in every frame.
            judged: the scene in whose dimensions deposits are compared: a slice where the run may be one.
            across: the axis that the slice lacks; None if it is none.
            num_frames: of the run that count; None for all.
        """
        flow = mobile(run if num_frames is None else cut(run, num_frames))
        raised = over_ground(flow)
        place, volume = raised.position[-1].astype(np.float64), flow.volume().astype(np.float64)
        mass = flow.mass.astype(np.float64)
        if flow.scene.dim > judged.dim and across is not None:
            volume = volume / (flow.scene.upper[across] - flow.scene.lower[across])
            place = np.delete(place, across, axis=1)
        return cls(
            front=front_advance(flow),
            height=measures.centre_of_mass(raised)[:, -1],
            arrest=measures.energy_arrest_time(flow.time, measures.kinetic_energy(flow)),
            volumes=volume_map(place, volume, judged),
            profile=measures.deposit_profile(place, mass, judged, map_cell(judged))[1],
        )

    @classmethod
    def mean(cls, runs: Sequence[Observed]) -> Observed:
        """Return the mean of runs of one scene from several placements."""
        names = ("front", "height", "volumes", "profile")
        arrays = {name: np.mean([getattr(run, name) for run in runs], axis=0) for name in names}
        return cls(arrest=float(np.mean([run.arrest for run in runs])), **arrays)


def over_ground(flow: Trajectory) -> Trajectory:
    """Return a run whose heights are those over its terrain, on the floor of the box; as it is without a terrain."""
    if flow.scene.terrain is None:
        return flow
    position = flow.position.astype(np.float64)
    ground = flow.scene.terrain.height(position.reshape(-1, flow.scene.dim)).reshape(position.shape[:2])
    position[..., -1] += flow.scene.lower[-1] - ground
    return replace(flow, position=position.astype(np.float32))


def errors_of(run: Observed | None, reference: Observed) -> dict[str, float]:
    """Return the errors of a run by their names in `ERRORS`, infinite if it failed, and its "front" [m].

    Args:
        run: with as many frames as the reference; None if it did not reach the end.
        reference: what it should be.
    """
    if run is None:
        return dict.fromkeys(ERRORS, math.inf) | {"front": math.nan}
    end = reference.front[-1]
    return {
        "front": float(run.front[-1]),
        "front_error": float(run.front[-1] / end - 1),
        "map_error": map_error(run.volumes, reference.volumes),
        "height_error": float(run.height[-1] / reference.height[-1] - 1),
        "arrest_error": run.arrest / reference.arrest - 1,
        "curve_error": float(np.abs(run.front - reference.front).mean() / end),
        "profile_error": float(np.abs(run.profile - reference.profile).sum() / reference.profile.sum()),
    }
