"""Coarse MPM, corrected by a network, as a solver."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import gns_pl
from gns_pl.io import file_sha256
from gns_pl.models.corrector import CorrectorFile, load_corrector
from gns_pl.models.shipped import find_corrector
from gns_pl.mpm.settings import solver_version
from gns_pl.scene import Scene
from gns_pl.solvers.correction import corrected_frames, corrected_run
from gns_pl.solvers.recording import Recording
from gns_pl.solvers.solver import hashed
from gns_pl.solvers.trained import TrainedSolver
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

    def run(self, scene: Scene, *, interval: float | None = None, seed: int = 0, monitor: bool = True) -> Trajectory:
        """Return the trajectory; arguments as those of `Solver.run`. An unstable run is refused, watched or not."""
        reduction = self.reduced(scene)
        start = self.start(reduction.scene, seed, {**self.facts(scene), "seed": seed})
        trajectory = corrected_run(self.content.corrector, start, self.num_steps(reduction.scene))
        return reduction.lift(trajectory if interval is None else trajectory.resampled(interval, scene.duration))

    def record_one(self, scene: Scene, path: Path, *, interval: float, seed: int, monitor: bool) -> None:
        """Run a scene into its file, frame by frame; arguments and errors as those of `Solver.record`.

        A broken run goes on from its last saved state, to the bits of a single run. Frames are one correction apart,
        whatever `interval` is.
        """
        reduction = self.reduced(scene)
        start = self.start(reduction.scene, seed, {**self.facts(scene), "seed": seed})
        recording = Recording.of(path, start, reduction, self.num_steps(reduction.scene), stateful=True)
        if recording.is_done:
            print(f"{path}: already complete")
            return
        frames = corrected_frames(self.content.corrector, start, recording.made + recording.num_steps, recording.saved)
        recording.write(frames, f"{scene.name}: {self.name}", {})
