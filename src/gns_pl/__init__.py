"""gns_pl: learned simulators of three-dimensional granular flow, trained on the material point method.

A `Scene` goes in, a `Trajectory` comes out, and whatever leads across is a solver. Importing this package stays light:
the public names are imported when they are first used.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

PUBLIC = {
    "Scene": "scene",
    "read_scene": "scene",
    "Trajectory": "trajectory",
    "read_trajectory": "io",
    "write_trajectory": "io",
    "load_checkpoint": "models.checkpoint",
    "register_model": "models.registry",
    "register_network": "nn",
    "generate_dataset": "generation",
    "load_solver": "solvers.catalogue",
    "register_solver": "solvers.catalogue",
    "Solver": "solvers.solver",
    "MPM": "solvers.mpm:MPMSolver",
    "compare": "metrics.summary:compare_runs",
    "InputError": "errors",
}
"""Public name → module that defines it, and its name there if that is another."""

if TYPE_CHECKING:
    from gns_pl.errors import InputError as InputError
    from gns_pl.generation import generate_dataset as generate_dataset
    from gns_pl.io import read_trajectory as read_trajectory
    from gns_pl.io import write_trajectory as write_trajectory
    from gns_pl.metrics.summary import compare_runs as compare  # noqa: F401
    from gns_pl.models.checkpoint import load_checkpoint as load_checkpoint
    from gns_pl.models.registry import register_model as register_model
    from gns_pl.nn import register_network as register_network
    from gns_pl.scene import Scene as Scene
    from gns_pl.scene import read_scene as read_scene
    from gns_pl.solvers.catalogue import load_solver as load_solver
    from gns_pl.solvers.catalogue import register_solver as register_solver
    from gns_pl.solvers.mpm import MPMSolver as MPM  # noqa: F401
    from gns_pl.solvers.solver import Solver as Solver
    from gns_pl.trajectory import Trajectory as Trajectory


def __getattr__(name: str) -> Any:
    if name not in PUBLIC:
        raise AttributeError(f"module 'gns_pl' has no attribute {name!r}")
    module, _, attribute = PUBLIC[name].partition(":")
    value = getattr(importlib.import_module(f"gns_pl.{module}"), attribute or name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *PUBLIC})
