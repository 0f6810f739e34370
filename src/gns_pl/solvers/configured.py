"""What the config of `simulate.py` names: its scenes, and the solver that runs them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gns_pl.errors import InputError
from gns_pl.models.shipped import existing_checkpoint
from gns_pl.rollout.policy import Policy
from gns_pl.scene import Scene
from gns_pl.scene.changes import decoded
from gns_pl.solvers.catalogue import load_solver
from gns_pl.solvers.named_scene import named_scene
from gns_pl.solvers.solver import Solver
from gns_pl.text import command


def configured_scenes(settings: Mapping[str, Any], label: str, more: Mapping[str, Any] | None = None) -> list[Scene]:
    """Return the scenes of a config.

    Args:
        settings: the config (conf/simulate.yaml), as plain values.
        label: as of `simulate_config`.
        more: changes besides those of the config, dotted key → value.

    Raises:
        InputError: no such scene, or a key that it has not.
    """
    named, changes = settings["scene"], {**decoded(settings["changes"]), **(more or {})}
    scenes = [
        named_scene(name, settings["catalogue"], changes, label)
        for name in ([named] if isinstance(named, str) else named)
    ]
    if settings["duration"] is not None:
        scenes = [scene.replace(duration=settings["duration"]) for scene in scenes]
    return scenes


def configured_solver(settings: Mapping[str, Any]) -> Solver:
    """Return the solver that a config names by `solver` or `ckpt`; arguments as those of `configured_scenes`.

    Raises:
        InputError: it names none, or one that is not there.
    """
    policy = Policy(settings["stabilise"], settings["acceleration"], settings["rest_speed"])
    choice, device = settings["choice"], settings["device"]
    if settings["ckpt"]:
        return checkpoint_solver(settings["ckpt"], policy, device, choice)
    if not settings["solver"]:
        raise InputError(f"name a solver: {command('simulate')} scene=… solver=shallow-k0 (docs/simulate.md)")
    solver = load_solver(settings["solver"], policy=policy, choice=choice, cell_size=settings["cell_size"])
    return solver.on(device)


def checkpoint_solver(ckpt: str, policy: Policy, device: str, choice: Mapping[str, Any]) -> Solver:
    """Return the solver that `ckpt=` names: a checkpoint, a corrector, or a hybrid of the choice."""
    import torch

    solver = load_solver(existing_file(ckpt, choice), policy=policy, choice=choice)
    if device == "auto" and solver.group == "learned" and torch.cuda.is_available():
        device = "cuda"
    return solver.on(device)


def existing_file(ckpt: str, choice: Mapping[str, Any]) -> str:
    """Return what `ckpt=` names, if it is there.

    Raises:
        InputError: it is not; names that may have been meant are told.
    """
    from gns_pl.models.shipped import corrector_names, find_corrector, is_corrector

    hybrids = choice.get("hybrid") or {}
    if ckpt not in hybrids and not (is_corrector(ckpt) and find_corrector(ckpt).is_file()):
        existing_checkpoint(ckpt, [*corrector_names(), *hybrids])
    return ckpt
