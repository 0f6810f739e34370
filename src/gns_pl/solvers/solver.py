"""The ways from a scene to a trajectory: what all of them can say and do, and the material point method.

Every way says whether it can be trusted with a scene, about how much work it is, and runs it. What that is worth is
not known here but measured (`records`), and `choice` picks. Those that learned from data stand in `fitted`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Protocol

from gns_pl.mpm import settings as solver
from gns_pl.scene import Scene
from gns_pl.scene.extent import initial_extent
from gns_pl.solvers.reduction import Reduction, reduce_scene
from gns_pl.trajectory import Trajectory


class Way(Protocol):
    """One way from a scene to a trajectory."""

    @property
    def name(self) -> str:
        """By which its measured runs are found."""

    def why_not(self, scene: Scene) -> str | None:
        """Return why a scene is beyond what this way was made for, or None."""

    def reduced(self, scene: Scene) -> Reduction:
        """Return the scene that is run in its place."""

    def size(self, scene: Scene) -> tuple[int, int]:
        """Return the numbers of particles and of steps of a run."""

    def work(self, scene: Scene) -> float:
        """Return what a run's time is proportional to."""

    def run(self, scene: Scene, *, interval: float, seed: int) -> Trajectory:
        """Return the trajectory, with frames `interval` [s] apart."""


def characteristic_size(scene: Scene) -> float:
    """Return √(L0 H0) of all bodies together, their extent along x and z [m]."""
    return math.sqrt(math.prod(initial_extent(scene)))


@dataclass(frozen=True)
class MPMWay:
    """The material point method on cells that are a part of the bodies' size, in two dimensions where that holds.

    Attributes:
        name: of the way.
        cells: over √(L0 H0); of no account with `cell_size`.
        settings: of the solver but for the cells, as in conf/data/.
        reduces: take slices and halves where they hold.
        device: "cpu" or "cuda".
        cell_size: edge of a cell [m]; None takes `cells`.
    """

    name: str
    cells: float
    settings: Mapping[str, Any]
    reduces: bool = True
    device: str = "cpu"
    cell_size: float | None = None

    def why_not(self, scene: Scene) -> str | None:
        """Return None: it knows every scene."""
        return None

    def reduced(self, scene: Scene) -> Reduction:
        """Return the scene's slice, half, or the scene itself."""
        return reduce_scene(scene) if self.reduces else Reduction(scene, lambda trajectory: trajectory, "")

    def coarser(self, factor: float) -> MPMWay:
        """Return the same on cells so many times as large."""
        size = None if self.cell_size is None else self.cell_size * factor
        return replace(self, name=f"{self.name}_coarser", cells=self.cells / factor, cell_size=size)

    def settings_of(self, scene: Scene) -> dict[str, Any]:
        """Return the solver's settings for a scene."""
        size = self.cell_size or characteristic_size(scene) / self.cells
        return {**self.settings, "cell_size": size}

    def size(self, scene: Scene) -> tuple[int, int]:
        """Return the number of points and about that of steps."""
        less, settings = self.reduced(scene).scene, self.settings_of(scene)
        cell = settings["cell_size"]
        fastest = max(each.p_wave_speed for each in less.materials.values())
        drop = max(body.upper[-1] for body in less.bodies) - less.lower[-1]
        fastest += math.sqrt(2 * math.hypot(*less.gravity) * drop)
        spacing = cell / settings["points_per_direction"]
        volume = sum(math.prod(body.size) for body in less.bodies)
        return round(volume / spacing**less.dim), math.ceil(less.duration * fastest / (settings["courant"] * cell))

    def work(self, scene: Scene) -> float:
        """Return points × steps."""
        return float(math.prod(self.size(scene)))

    def run(self, scene: Scene, *, interval: float, seed: int) -> Trajectory:
        """Return the trajectory; arguments as those of `Way`."""
        less, settings = self.reduced(scene), self.settings_of(scene)
        threads = solver.num_threads_alone(less.scene, settings)
        made = solver.run_solver(
            less.scene, settings, frame_interval=interval, seed=seed, device=self.device, num_threads=threads
        )
        return less.lift(made)
