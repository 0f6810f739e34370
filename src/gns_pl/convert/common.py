"""What a format that says things once for many trajectories can say of them: one box, origin, time step, length.

Trajectories are looked at one after another as they are written; the first that does not fit ends the export with a
sentence. What a format has no place for, and what differs, is listed for a warning.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from gns_pl.errors import InputError
from gns_pl.io import SPLITS
from gns_pl.scene import Scene

SHORTEST = 7
"""Frames: the history of six that networks in these programs see, and the next."""
APART = "convert these apart (source=FILE takes one trajectory of a set of ours)"


class Common:
    """Boxes, time steps, lengths and sizes of trajectories, by split.

    Args:
        what: name of the format.
        part_of: split → the part of the metadata that speaks for it; every part has one box, origin and time step.
        equal_lengths: all trajectories of a split have as many frames.
        most_features: material values of a particle; with any, all trajectories have as many. None drops all.

    Attributes:
        frames: T of every trajectory, by split.
        num_particles: of the largest.
        num_features: material values of a particle.
    """

    def __init__(
        self,
        what: str,
        part_of: Mapping[str, str],
        *,
        equal_lengths: bool = False,
        most_features: int | None = None,
    ) -> None:
        self.what, self.part_of, self.equal_lengths = what, part_of, equal_lengths
        self.most_features, self.num_features = most_features, 0
        self.frames: dict[str, list[int]] = {split: [] for split in SPLITS}
        self.num_particles = 0
        self._boxes: dict[str, list[list[float]]] = {}
        self._origins: dict[str, list[float]] = {}
        self._steps: dict[str, float] = {}
        self._seen: dict[str, list[Any]] = {}

    def see(
        self,
        split: str,
        scene: Scene,
        *,
        num_frames: int,
        num_particles: int,
        dt: float,
        num_features: int,
        bounds: list[list[float]] | None = None,
    ) -> None:
        """Look at a trajectory.

        Args:
            split: it is in.
            scene: of it.
            num_frames: T.
            num_particles: N.
            dt: time between frames [s].
            num_features: material values of a particle.
            bounds: lower and upper end of the box along every axis [D, 2] [m]; None takes the scene's.

        Raises:
            InputError: what the format cannot say of it beside those before; the caller names the trajectory.
        """
        part = self.part_of[split]
        where = " and ".join(other for other in SPLITS if self.part_of[other] == part)
        box = [list(pair) for pair in zip(scene.lower, scene.upper, strict=True)] if bounds is None else bounds
        known, step = self._boxes.setdefault(part, box), self._steps.setdefault(part, dt)
        origin = list(scene.origin)
        before = self._origins.setdefault(part, origin)
        if origin != before:
            raise InputError(
                f"its origin is {origin}, that of trajectories before it {before}, and {self.what} has one for "
                f"{where}; {APART}"
            )
        if box != known:
            raise InputError(
                f"its box is {box}, that of trajectories before it {known}, and {self.what} has one for {where}; "
                f"{APART}, or give one box for all: lower=… upper=…"
            )
        if abs(dt - step) > 1e-9 * step:
            raise InputError(
                f"its frames are {dt:g} s apart, those before it {step:g} s, and {self.what} has one time step for "
                f"{where}; {APART}"
            )
        if scene.obstacles:
            raise InputError(
                f"its scene has {len(scene.obstacles)} obstacles, and {self.what} has no place for them, so that "
                f"particles would bounce off nothing; {APART}, those without obstacles"
            )
        if scene.terrain is not None:
            raise InputError(f"its scene has a terrain, and {self.what} has no place for it; {APART}, those without")
        if self.most_features is not None:
            if num_features > self.most_features:
                raise InputError(f"has {num_features} material values, and {self.what} takes {self.most_features}.")
            if num_features != self.num_features and any(self.frames.values()):
                raise InputError(
                    f"has {num_features} material values, those before it {self.num_features}, and {self.what} takes "
                    f"all to have as many; {APART}"
                )
        self.num_features = num_features
        if num_frames < SHORTEST:
            raise InputError(
                f"it has {num_frames} frames, and {self.what} learns from and rolls out {SHORTEST} or more."
            )
        lengths = self.frames[split]
        if self.equal_lengths and lengths and lengths[0] != num_frames:
            raise InputError(
                f"it has {num_frames} frames, those before it {lengths[0]}, and {self.what} takes all trajectories of "
                f"{split} to be as long as the first; write to=geoelements, which knows several lengths, or {APART}"
            )
        lengths.append(num_frames)
        self.num_particles = max(self.num_particles, num_particles)
        self.note(scene)

    def note(self, scene: Scene, **more: Sequence[Any]) -> None:
        """Look at what the format has no place for, of a scene; `more` is such as well, name → values."""
        materials = [asdict(scene.materials[body.material]) for body in scene.bodies]
        values_of: dict[str, Sequence[Any]] = {"gravity": [scene.gravity], "walls": [dict(scene.walls)], **more}
        names = {"density": ("density",), "stiffness": ("youngs_modulus", "poisson_ratio")}
        for name, keys in {**names, "cohesion": ("cohesion", "tension_cutoff", "dilation_angle_deg")}.items():
            values_of[name] = [[material[key] for key in keys] for material in materials]
        for name, values in values_of.items():
            known = self._seen.setdefault(name.replace("_", " "), [])
            known += [value for value in values if value not in known]

    def warning(self) -> str | None:
        """Return what differs between trajectories and cannot be told by the format, in a sentence; None if nothing."""
        names = [name for name, values in self._seen.items() if len(values) > 1]
        if not names:
            return None
        return (
            f"Warning: {self.what} has no place for {', '.join(names)}, which differ in these trajectories, so that "
            "nobody there can tell which is which."
        )

    def said(self) -> dict[str, Any]:
        """Return "bounds", "dt" and "sequence_length" of all trajectories, or of each part where boxes or steps differ.

        Where there is one, "origin" is beside them: whoever trains reads float32, so that positions there stay less it.
        Rollouts are made of as many steps as the sequence is long, so that of several lengths it is the shortest: of
        what is rolled out, which is not the training.
        """
        parts = {}
        for part, bounds in self._boxes.items():
            lengths = [length for split in SPLITS if self.part_of[split] == part for length in self.frames[split]]
            parts[part] = {"bounds": bounds, "dt": self._steps[part], "sequence_length": min(lengths)}
            if any(self._origins[part]):
                parts[part]["origin"] = self._origins[part]
        first = next(iter(parts.values()))
        if any(part.get(key) != first.get(key) for part in parts.values() for key in ("bounds", "dt", "origin")):
            return parts
        rolled = self.frames["valid"] + self.frames["test"]
        return {**first, "sequence_length": min(rolled or self.frames["train"])}
