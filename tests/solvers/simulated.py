"""Learned runs into files, with a policy that is spelt out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from gns_pl.rollout.policy import Policy
from gns_pl.scene import Scene
from gns_pl.solvers.catalogue import load_solver
from gns_pl.solvers.simulate import simulate


def simulate_learned(
    ckpt: str | Path,
    scenes: Sequence[Scene],
    *,
    out: Path,
    duration: float | None = None,
    rest_speed: float = 0.0,
    stabilise: Mapping[str, Any] | None = None,
    **settings: Any,
) -> list[Path]:
    """Run scenes by a checkpoint, by default its bare network: nothing stabilised."""
    if duration is not None:
        scenes = [scene.replace(duration=duration) for scene in scenes]
    solver = load_solver(ckpt, policy=Policy(stabilise or {}, rest_speed=rest_speed))
    return simulate(solver, scenes, out=out, **settings)
