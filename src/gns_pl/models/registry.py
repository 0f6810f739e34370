"""Which models there are, by the name that stands in conf/model and in checkpoints."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gns_pl.errors import InputError
from gns_pl.models.geoelements import FrameConfig, FrameSimulator
from gns_pl.models.simulator import Simulator, SimulatorConfig


def simulator_config(model: Mapping[str, Any]) -> SimulatorConfig:
    """Return the config of a model as conf/model has it; "kind" says of which simulator, the usual one without it.

    Raises:
        InputError: an unknown kind, or keys and values that make no config.
    """
    kind = model.get("kind", "simulator")
    if kind not in KINDS:
        raise InputError(f"model.kind must be one of {', '.join(KINDS)}, not {kind!r}.")
    return KINDS[kind].from_dict({key: value for key, value in model.items() if key != "kind"})


def build_simulator(config: SimulatorConfig) -> Simulator:
    """Return a simulator of the kind of its config, with random weights."""
    return FrameSimulator(config) if isinstance(config, FrameConfig) else Simulator(config)


KINDS: dict[str, type[SimulatorConfig]] = {"simulator": SimulatorConfig, "frames": FrameConfig}
"""Kind of simulator, in checkpoints and in conf/model → its config."""
