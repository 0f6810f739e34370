"""The material point method as a solver: cells are a part of the bodies' size, slices and halves are taken."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import gns_pl
from gns_pl.machine import available_cores
from gns_pl.mpm import MPMConfig
from gns_pl.mpm import settings as mpm_settings
from gns_pl.scene import Scene
from gns_pl.scene.extent import frame_interval_of, num_frames
from gns_pl.solvers.recording import Recording
from gns_pl.solvers.reduction import Reduction, reduce_scene
from gns_pl.solvers.solver import Solver, characteristic_size, hashed
from gns_pl.trajectory import Trajectory, start_trajectory


@dataclass(frozen=True)
class MPMSolver(Solver):
    """The material point method.

    Attributes:
        name: of the solver.
        cells: over √(L0 H0); of no account with `cell_size`.
        settings: of the method but for the cells, as in conf/data/.
        reduces: take slices and halves where they hold.
        device: "cpu" or "cuda".
        cell_size: edge of a cell [m]; None takes `cells`.
        selectable: a tolerance may choose it, once it was measured.
        num_threads: that share a step; None takes as many as are best.
    """

    name: str
    cells: float
    settings: Mapping[str, Any]
    reduces: bool = True
    device: str = "cpu"
    cell_size: float | None = None
    selectable: bool = True
    num_threads: int | None = None
    group: str = field(default="mpm", init=False)

    @classmethod
    def preset(cls, name: str = "paper", *, cell_size: float, device: str = "cpu", **changes: Any) -> MPMSolver:
        """Return the method as the paper's data were made, or as it is fastest for its error.

        Args:
            name: of the preset, "paper" or "fast" (`MPMConfig.preset`).
            cell_size: edge of a cell [m].
            device: "cpu", "cuda" or "auto".
            changes: of the settings (`mpm.MPMConfig`).

        Raises:
            InputError: another name, or settings that are refused.
        """
        settings = vars(MPMConfig.preset(name, cell_size=cell_size, **changes))
        settings = {key: value for key, value in settings.items() if key != "cell_size"}
        return cls(f"mpm_{cell_size:g}m", 0.0, settings, cell_size=float(cell_size)).on(device)

    @property
    def dtype(self) -> str:  # type: ignore[override]
        """Of its arithmetic."""
        return str(self.settings.get("precision", "float64"))

    def identity(self) -> str:
        """Return a hash of all that decides what a run gives."""
        parts = [dict(self.settings), self.cells, self.reduces, mpm_settings.solver_version(self.settings)]
        return hashed(parts if self.cell_size is None else [*parts, self.cell_size])

    def facts(self, scene: Scene) -> dict[str, object]:
        """Return name, version and settings."""
        settings = self.settings_of(scene)
        law = mpm_settings.law_digest(settings)  # a run is not gone on with under an edited law
        own = {"law": law} if law else {}
        return {"solver": self.name, "version": gns_pl.__version__, "mpm": settings, **own}

    def reduced(self, scene: Scene) -> Reduction:
        """Return the scene's slice, half, or the scene itself."""
        return reduce_scene(scene) if self.reduces else super().reduced(scene)

    def unsupported_reason(self, scene: Scene) -> str | None:
        """Return that a whole run was asked for of a scene that is a slice itself; it knows every other scene."""
        return "the scene has two dimensions" if not self.reduces and scene.dim == 2 else None

    def coarser(self, factor: float) -> MPMSolver:
        """Return the same on cells so many times as large."""
        size = None if self.cell_size is None else self.cell_size * factor
        return replace(self, name=f"{self.name}_coarser", cells=self.cells / factor, cell_size=size)

    def settings_of(self, scene: Scene) -> dict[str, Any]:
        """Return the method's settings for a scene."""
        size = self.cell_size or characteristic_size(scene) / self.cells
        return {**self.settings, "cell_size": size}

    def size(self, scene: Scene) -> tuple[int, int]:
        """Return the number of points and about that of steps."""
        reduced_scene, settings = self.reduced(scene).scene, self.settings_of(scene)
        cell = settings["cell_size"]
        fastest = max(material.p_wave_speed for material in reduced_scene.materials.values())
        drop = max(body.upper[-1] for body in reduced_scene.bodies) - reduced_scene.lower[-1]
        fastest += math.sqrt(2 * math.hypot(*reduced_scene.gravity) * drop)
        points_per_direction = mpm_settings.solver_config(settings).points_per_direction
        volume = sum(body.volume for body in reduced_scene.bodies)
        number = round(volume / (cell / points_per_direction) ** reduced_scene.dim)
        return number, math.ceil(reduced_scene.duration * fastest / (settings["courant"] * cell))

    def run(self, scene: Scene, *, interval: float | None = None, seed: int = 0, monitor: bool = True) -> Trajectory:
        """Return the trajectory; arguments as those of `Solver.run`. An unstable run is refused, watched or not."""
        interval = frame_interval_of(scene, interval)
        num_frames(scene, interval)  # refuses one that leaves nothing to run
        reduction, settings = self.reduced(scene), self.settings_of(scene)
        trajectory = mpm_settings.run_solver(
            reduction.scene,
            settings,
            frame_interval=interval,
            seed=seed,
            device=self.device,
            num_threads=self._threads(reduction.scene, settings),
        )
        return reduction.lift(trajectory)

    def run_many(
        self,
        scenes: Sequence[Scene],
        *,
        interval: float | None = None,
        seed: int | Sequence[int] = 0,
        monitor: bool = True,
    ) -> list[Trajectory]:
        """Return what becomes of every scene: one a core, or, on a GPU, in one launch for each size of cells.

        Arguments and errors as those of `run`; several seeds are one for each scene.
        """
        seeds = [seed] * len(scenes) if isinstance(seed, int) else list(seed)
        if self.device == "cpu":
            single = replace(self, num_threads=1)
            with ThreadPoolExecutor(available_cores()) as pool:  # the kernels let other threads run
                jobs = zip(scenes, seeds, strict=True)
                return list(pool.map(lambda job: single.run(job[0], interval=interval, seed=job[1]), jobs))
        reductions = [self.reduced(scene) for scene in scenes]
        settings = [self.settings_of(scene) for scene in scenes]
        trajectories: dict[int, Trajectory] = {}
        intervals = [frame_interval_of(scene, interval) for scene in scenes]
        for scene, every in zip(scenes, intervals, strict=True):
            num_frames(scene, every)
        keys = [(own["cell_size"], every) for own, every in zip(settings, intervals, strict=True)]
        for key in dict.fromkeys(keys):
            numbers = [number for number, each in enumerate(keys) if each == key]
            runs = mpm_settings.run_batch(
                [reductions[number].scene for number in numbers],
                settings[numbers[0]],
                frame_interval=key[1],
                seeds=[seeds[number] for number in numbers],
            )
            trajectories |= {number: reductions[number].lift(run) for number, run in zip(numbers, runs, strict=True)}
        return [trajectories[number] for number in range(len(scenes))]

    def _threads(self, scene: Scene, settings: Mapping[str, Any]) -> int:
        return self.num_threads or mpm_settings.num_threads_alone(scene, settings)

    def on(self, device: str) -> MPMSolver:
        """Return the solver on another device; arguments and errors as those of `Solver.on`."""
        return self if device in ("auto", "cpu") else replace(self, device=mpm_settings.choose_device(device))

    def record_one(self, scene: Scene, path: Path, *, interval: float, seed: int, monitor: bool) -> None:
        """Run a scene into its file, frame by frame; arguments and errors as those of `Solver.record`.

        A broken run goes on from its last saved state, to the bits of a single run. On a GPU it runs whole.
        """
        if self.device == "cuda":
            super().record_one(scene, path, interval=interval, seed=seed, monitor=monitor)
            return
        from gns_pl.mpm.solver import advance_frames, start_run

        reduction, settings = self.reduced(scene), self.settings_of(scene)
        config = mpm_settings.solver_config(settings)
        particles, plan = start_run(reduction.scene, config, interval, seed)
        facts = {**self.facts(scene), "seed": seed}
        start = start_trajectory(reduction.scene, particles, interval, facts)
        recording = Recording.of(path, start, reduction, plan.num_frames - 1, stateful=True)
        if recording.is_done:
            print(f"{path}: already complete")
            return
        threads = self._threads(reduction.scene, settings)
        frames = (
            (progress.frame, progress.position(), progress.saved)
            for progress in advance_frames(plan, particles, num_threads=threads, saved=recording.saved)
        )
        provenance = plan.provenance(seed) | {"device": "cpu", "num_threads": threads, **facts}
        recording.write(frames, f"{scene.name}: {self.name}", provenance)
