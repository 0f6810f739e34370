"""Files of solvers with fitted scalars, one a solver: YAML with the settings under a key that names the kind."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from gns_pl.errors import InputError
from gns_pl.io.atomic import write_atomically
from gns_pl.models.shipped import find_fitted
from gns_pl.mpm.settings import solver_config
from gns_pl.scene import part_from_dict
from gns_pl.scene.checks import checked_number
from gns_pl.solvers.fitted import FittedSolver
from gns_pl.solvers.retuned import MPMFactors, RetunedMPMSolver
from gns_pl.solvers.shallow import FittedShallowSolver, ShallowFactors

KEYS = ("cells", "factors", "range", "fitted")
"""What the file of a fitted solver holds besides its settings."""

KINDS: dict[str, tuple[type[FittedSolver], type[Any]]] = {
    "mpm": (RetunedMPMSolver, MPMFactors),
    "shallow": (FittedShallowSolver, ShallowFactors),
}
"""Key of the settings in a file → the solver, and its factors."""


def kind_of_solver(solver: FittedSolver) -> str:
    """Return the key of `KINDS` of a solver."""
    return next(kind for kind, (type_of_it, _) in KINDS.items() if isinstance(solver, type_of_it))


def read_fitted(path: str | Path) -> FittedSolver:
    """Return the solver of a file, by the file's name.

    Args:
        path: the file, or the name of one that comes with the package, as "mpm-retuned-5".

    Raises:
        InputError: no such file, or it holds something else.
    """
    path = find_fitted(path)
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}).") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: is not YAML; python fit.py writes such files.") from error
    kinds = [kind for kind in KINDS if isinstance(content, Mapping) and kind in content]
    if len(kinds) != 1 or not set(KEYS) <= set(content):
        raise InputError(
            f"{path}: is no fitted solver, which has {', '.join(KEYS)} and {' or '.join(KINDS)}; python fit.py writes "
            "such files."
        )
    (kind,) = kinds
    make, factors = KINDS[kind]
    try:
        cells = checked_number("fitted solver", "cells", content["cells"], 0.0, above=True)
        if kind == "mpm":
            solver_config({**content[kind], "cell_size": 1.0})
        return make(
            path.stem,
            cells,
            content[kind],
            factors=part_from_dict(factors, "factors", content["factors"]),
            fitted_range=content["range"],
            path=path,
        )
    except (InputError, TypeError) as error:
        raise InputError(f"{path}: {error}") from error


def write_fitted(path: Path, solver: FittedSolver, fitted: Mapping[str, Any]) -> None:
    """Write a solver's file.

    Args:
        path: whose stem is the solver's name.
        solver: that was fitted.
        fitted: how: the provenance, as plain values.

    Raises:
        StorageError: the disk refuses.
    """
    content = {
        "cells": solver.cells,
        kind_of_solver(solver): dict(solver.settings),
        "factors": dict(vars(solver.factors)),
        "range": dict(solver.fitted_range),
        "fitted": dict(fitted),
    }
    write_atomically(
        path, yaml.safe_dump(content, sort_keys=False, default_flow_style=None, allow_unicode=True, width=120).encode()
    )
