"""Which models there are, by the name that stands in conf/model and in checkpoints: "kind", and the class behind it.

A model of one's own is a `Simulator`, named as "module.Class"; `config_class` says what rebuilds it (docs/extend.md).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gns_pl.extensions import imported
from gns_pl.models.config import SimulatorConfig
from gns_pl.models.geoelements import FrameSimulator
from gns_pl.models.simulator import Simulator

MODELS: dict[str, type[Simulator]] = {"simulator": Simulator, "frames": FrameSimulator}
"""Name → class; `register_model` adds."""

DEFAULT = "simulator"
"""The kind of a model that does not say its own."""


def register_model(name: str, model: type[Simulator]) -> type[Simulator]:
    """Make a model known by a name, and return it."""
    MODELS[name] = model
    return model


def model_class(kind: str) -> type[Simulator]:
    """Return the class of a kind: a registered name, or "module.Class".

    Raises:
        InputError: there is none, or it is no `Simulator`.
    """
    return MODELS[kind] if kind in MODELS else imported(kind, Simulator, "model.kind", sorted(MODELS))


def kind_of(simulator: Simulator) -> str:
    """Return the kind by which a model is built again."""
    model = type(simulator)
    return next(
        (name for name, registered in MODELS.items() if registered is model), f"{model.__module__}.{model.__qualname__}"
    )


def simulator_config(model: Mapping[str, Any]) -> SimulatorConfig:
    """Return the config of a model as conf/model has it; "kind" says of which one, the usual one without it.

    Raises:
        InputError: an unknown kind, or keys and values that make no config.
    """
    kind = model_class(model.get("kind", DEFAULT))
    return kind.config_class.from_dict({key: value for key, value in model.items() if key != "kind"})


def build_simulator(model: Mapping[str, Any]) -> Simulator:
    """Return a model as conf/model has it, with random weights.

    Raises:
        InputError: as `simulator_config`.
    """
    return model_class(model.get("kind", DEFAULT))(simulator_config(model))
