"""Which solvers there are: those that a configuration names, and any by its name, its file or its class."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from gns_pl.errors import InputError
from gns_pl.extensions import imported
from gns_pl.models.shipped import (
    corrector_names,
    existing_checkpoint,
    find_checkpoint,
    find_corrector,
    fitted_names,
    is_corrector,
    is_fitted,
    pretrained_names,
)
from gns_pl.mpm import settings as mpm_settings
from gns_pl.presets import preset
from gns_pl.rollout.policy import Policy
from gns_pl.solvers.corrected import CorrectedSolver
from gns_pl.solvers.fitted_files import read_fitted
from gns_pl.solvers.hybrid import HybridSolver
from gns_pl.solvers.learned import LearnedSolver
from gns_pl.solvers.mpm import MPMSolver
from gns_pl.solvers.shallow import ShallowSolver
from gns_pl.solvers.solver import Solver
from gns_pl.text import did_you_mean

CLASS = re.compile(r"[^\W\d]\w*(\.[^\W\d]\w*)+")
"""What a class is named by, "module.Class"."""

REGISTERED: dict[str, Callable[[], Solver]] = {}
"""Name → what makes the solver; `register_solver` adds."""


def register_solver(name: str, make: Callable[[], Solver]) -> None:
    """Make a solver known by a name, to `load_solver`, the commands and the configuration (`choice.others`).

    Args:
        name: by which it is asked for.
        make: returns it; a class whose arguments all have defaults will do.
    """
    REGISTERED[name] = make


def solver_name(path: str | Path) -> str:
    """Return what the solver of a file is called: its name, or its folder's if it is any training's last."""
    path = Path(path)
    every = path.stem in ("last", "best") or path.stem.startswith("step")
    return path.absolute().parent.name if every else path.stem


def make_solvers(choice: Mapping[str, Any], policy: Policy | None = None) -> list[Solver]:
    """Return the solvers that a configuration names (conf/choice).

    Args:
        choice: {learned, corrected, hybrid, cells, mpm, fitted, shallow, others}; what is missing names none.
        policy: how learned ones are run.

    Raises:
        InputError: no such file or class.
    """
    policy, solvers = policy or Policy(), list[Solver]()
    hybrids: Mapping[str, Mapping[str, Any]] = choice.get("hybrid") or {}
    for path in [*choice.get("learned", ()), *(str(parts.get("learned")) for parts in hybrids.values())]:
        if not find_checkpoint(path).is_file():
            raise InputError(f"choice.learned: there is no checkpoint {path}.")
    for path in choice.get("learned", ()):
        solvers.append(LearnedSolver(solver_name(path), path, policy))
    for path in choice.get("corrected", ()):
        if not find_corrector(path).is_file():
            raise InputError(f"choice.corrected: there is no corrector {path}.")
        solvers.append(CorrectedSolver(solver_name(path), path))
    for name, parts in hybrids.items():
        if set(parts) != {"learned", "until"}:
            raise InputError(f"choice.hybrid.{name}: needs learned, until, not {', '.join(sorted(parts))}.")
        learned = LearnedSolver(solver_name(parts["learned"]), parts["learned"], policy)
        solvers.append(HybridSolver(name, learned, parts["until"]))
    for cells in choice.get("cells", ()):
        solvers.append(MPMSolver(f"mpm_{cells:g}", float(cells), choice["mpm"]))
    solvers += map(read_fitted, choice.get("fitted", ()))
    for name, parts in (choice.get("shallow") or {}).items():
        if "cells" not in parts:
            raise InputError(f"choice.shallow.{name}: needs cells, over √(L0 H0).")
        settings = {key: value for key, value in parts.items() if key != "cells"}
        solvers.append(ShallowSolver(name, float(parts["cells"]), settings))
    for name in choice.get("others", ()):
        solvers.append(_own(name))
    return solvers


def load_solver(
    name: str | Path,
    *,
    device: str = "auto",
    policy: Policy | None = None,
    choice: Mapping[str, Any] | None = None,
    cell_size: float | None = None,
) -> Solver:
    """Return a solver by its name, ready to run.

    Args:
        name: of what comes with the package ("column-fast", "corrected_plane", "mpm_10.2", "mpm-retuned-5"), a
            checkpoint's, corrector's or fitted solver's file, "mpm", a registered name, or "module.Class" of one of
            your own.
        device: "cpu", "cuda", or "auto": where it is measured to run best.
        policy: how a learned one is run.
        choice: the configuration whose names are known besides; None takes the package's (conf/choice/default.yaml).
        cell_size: of "mpm" [m]; None takes the finest that `choice` names.

    Raises:
        InputError: there is no such solver, a size of cells that cannot be, or a device that is not there.
    """
    name, choice = str(name), preset("choice/default") if choice is None else choice
    if name == "mpm":
        return _mpm(choice, cell_size).on(device)
    if cell_size is not None:
        raise InputError(f"cell_size= is that of solver=mpm, not of {name}.")
    if name in REGISTERED or (CLASS.fullmatch(name) and Path(name).suffix not in (".ckpt", ".corrector", ".yaml")):
        return _own(name).on(device)
    if is_corrector(name):
        if not find_corrector(name).is_file():
            raise InputError(f"{name}: there is no such corrector.")
        return CorrectedSolver(solver_name(name), name).on(device)
    if is_fitted(name):
        return read_fitted(name).on(device)
    if find_checkpoint(name).is_file():
        return LearnedSolver(solver_name(find_checkpoint(name)), name, policy or Policy()).on(device)
    solvers = {solver.name: solver for solver in make_solvers({**choice, "learned": [], "corrected": []}, policy)}
    if name in solvers:
        return solvers[name].on(device)
    if Path(name).suffix == ".ckpt":
        existing_checkpoint(name, known_names(choice))
    known = known_names(choice)
    raise InputError(f"solver: there is no {name}{did_you_mean(name, known)}; there are {', '.join(known)}.")


def known_names(choice: Mapping[str, Any]) -> list[str]:
    """Return the names by which solvers can be asked for."""
    cells = [f"mpm_{cells:g}" for cells in choice.get("cells", ())]
    shipped = [*pretrained_names(), *corrector_names(), *fitted_names(), *(choice.get("hybrid") or {})]
    return list(dict.fromkeys(["mpm", *cells, *shipped, *(choice.get("shallow") or {}), *REGISTERED]))


def _own(name: str) -> Solver:
    """Return a registered solver, or one of a class that is named as "module.Class"."""
    if name in REGISTERED:
        return REGISTERED[name]()
    own: type[Solver] = imported(name, Solver, "solver", sorted(REGISTERED))  # type: ignore[type-abstract]
    return own()


def _mpm(choice: Mapping[str, Any], cell_size: float | None) -> MPMSolver:
    settings = choice["mpm"]
    if cell_size is not None:
        mpm_settings.solver_config({**settings, "cell_size": cell_size})  # refuses a size that cannot be
        return MPMSolver(f"mpm_{cell_size:g}m", 0.0, settings, cell_size=float(cell_size))
    if not choice.get("cells"):
        raise InputError("solver=mpm: choice.cells names no cells; give their size in metres, as cell_size=0.02.")
    finest = max(choice["cells"])
    return MPMSolver(f"mpm_{finest:g}", float(finest), settings)
