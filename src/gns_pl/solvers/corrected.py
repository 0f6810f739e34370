"""Coarse MPM, corrected by a network, as a solver."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import gns_pl
from gns_pl.errors import InputError
from gns_pl.io import file_sha256
from gns_pl.models.corrector import CorrectorFile, load_corrector
from gns_pl.models.shipped import find_corrector
from gns_pl.mpm.settings import solver_config, solver_version
from gns_pl.scene import Scene
from gns_pl.scene.extent import num_frames
from gns_pl.scene.refusals import refused_terrain
from gns_pl.solvers.correction import CoarseStart, coarse_solver, corrected_frames, corrected_run
from gns_pl.solvers.recording import Recording
from gns_pl.solvers.reduction import Reduction, halve_scene
from gns_pl.solvers.retuned import RetunedMPMSolver
from gns_pl.solvers.solver import hashed
from gns_pl.solvers.trained import TrainedSolver
from gns_pl.solvers.training_range import out_of_range
from gns_pl.trajectory import Trajectory


@dataclass(frozen=True)
class CorrectedSolver(TrainedSolver):
    """Coarse MPM, corrected by a network.

    Attributes:
        name: of the solver.
        path: of the corrector's file, or the name of one that comes with the package.
    """

    name: str
    path: str | Path
    group: str = field(default="corrected", init=False)

    @cached_property
    def content(self) -> CorrectorFile:
        """What the corrector's file holds, read when first needed."""
        return load_corrector(find_corrector(self.path))

    @cached_property
    def sha256(self) -> str:
        """Hash of the corrector's file, computed once: the provenance of every run has it."""
        return file_sha256(self.file())

    @property
    def dim(self) -> int:  # type: ignore[override]
        """D."""
        return self.content.corrector.config.dim

    @property
    def spacing(self) -> float:  # type: ignore[override]
        """Of the points [m]."""
        return self.content.corrector.config.spacing

    @property
    def interval(self) -> float:  # type: ignore[override]
        """Time between corrections [s]."""
        return self.content.corrector.config.interval

    @property
    def data(self) -> Mapping[str, Any]:  # type: ignore[override]
        """The specification of the data."""
        return self.content.data

    @property
    def provenance(self) -> Mapping[str, Any]:  # type: ignore[override]
        """Of the training."""
        return self.content.provenance

    def file(self) -> Path:
        """Return the corrector's file."""
        return find_corrector(self.path)

    def identity(self) -> str:
        """Return a hash of the corrector's file and of the material point method's sources."""
        return hashed([self.sha256, solver_version()])

    def facts(self, scene: Scene) -> dict[str, object]:
        """Return name, version and the corrector's file."""
        known = {"corrector": self.file().name, "corrector_sha256": self.sha256}
        return {"solver": self.name, "version": gns_pl.__version__, **known}

    @cached_property
    def coarse(self) -> RetunedMPMSolver | None:
        """The retuned coarse run that is corrected; None where it is a run on cells of one size."""
        config = self.content.corrector.config
        return None if config.coarse is None else coarse_solver(config)

    def unsupported_reason(self, scene: Scene) -> str | None:
        """Return what of a scene it has no means for, or None; a retuned coarse run takes obstacles."""
        if self.coarse is None:
            return super().unsupported_reason(scene)
        if scene.dim != self.dim:  # nor are slices run: the retuned run's scalars are of one dimension
            return f"has {self.dim} dimensions, the scene {scene.dim}"
        return super().unsupported_reason(scene.replace(obstacles=()))

    def out_of_range_reason(self, scene: Scene) -> str | None:
        """Return what of a scene was not in the data, or None."""
        return next(out_of_range(scene, self.data), None) if self.coarse else super().out_of_range_reason(scene)

    def reduced(self, scene: Scene) -> Reduction:
        """Return the scene that is run: of a retuned coarse run a half with its scalars, else a slice where wanted."""
        if self.coarse is None:
            return super().reduced(scene)
        if scene.terrain is not None:
            raise InputError(refused_terrain(f"scene {scene.name!r}", self.name))
        if scene.dim != self.dim:
            raise InputError(f"scene {scene.name!r} has {scene.dim} dimensions, {self.name} {self.dim}.")
        return self.coarse.retuned(halve_scene(scene), scene)

    def size(self, scene: Scene) -> tuple[int, int]:
        """Return the numbers of points and of corrections."""
        if self.coarse is None:
            return super().size(scene)
        reduced_scene, spacing = self.reduced(scene).scene, solver_config(self.coarse.settings_of(scene)).spacing
        volume = sum(math.prod(body.size) for body in reduced_scene.bodies)
        return round(volume / spacing**reduced_scene.dim), self.num_steps(reduced_scene)

    def coarse_start(self, scene: Scene, seed: int) -> CoarseStart:
        """Return the start of a scene's run; arguments as those of `run`."""
        facts, corrector = {**self.facts(scene), "seed": seed}, self.content.corrector
        reduction = self.reduced(scene)  # or it is refused
        if self.coarse is not None:
            return CoarseStart.retuned(corrector.config, scene, seed, facts)
        return replace(CoarseStart.of(corrector, self.start(reduction.scene, seed, facts)), reduction=reduction)

    def run(self, scene: Scene, *, interval: float | None = None, seed: int = 0, monitor: bool = True) -> Trajectory:
        """Return the trajectory; arguments as those of `Solver.run`. An unstable run is refused, watched or not."""
        if interval is not None:
            num_frames(scene, interval)  # refuses one that leaves nothing to show
        start = self.coarse_start(scene, seed)
        trajectory = corrected_run(self.content.corrector, start, self.num_steps(scene))
        return start.reduction.lift(trajectory if interval is None else trajectory.resampled(interval, scene.duration))

    def record_one(self, scene: Scene, path: Path, *, interval: float, seed: int, monitor: bool) -> None:
        """Run a scene into its file, frame by frame; arguments and errors as those of `Solver.record`.

        A broken run goes on from its last saved state, to the bits of a single run. Frames are one correction apart,
        whatever `interval` is.
        """
        start = self.coarse_start(scene, seed)
        recording = Recording.of(path, start.first, start.reduction, self.num_steps(scene), stateful=True)
        if recording.is_done:
            print(f"{path}: already complete")
            return
        frames = corrected_frames(self.content.corrector, start, recording.made + recording.num_steps, recording.saved)
        recording.write(frames, f"{scene.name}: {self.name}", {})
