"""What rebuilds a simulator but its weights and statistics; plain values, as checkpoints and conf/model hold them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from gns_pl.errors import InputError
from gns_pl.nn import DEFAULT_NETWORK

OUTPUTS = ("acceleration", "gated", "switched")
WALLS = ("box", "surfaces", "contacts")


@dataclass(frozen=True)
class SimulatorConfig:
    """Everything that rebuilds a `Simulator` but its weights and statistics.

    Attributes:
        dim: D, 2 or 3.
        dt: time of one step [s].
        spacing: particle spacing of the data [m]; scenes are filled at it.
        particle_types: the types that occur in the data.
        material_features: names of the K material features that are node inputs; may be none.
        connectivity_radius: R [m].
        input_sequence_length: H, positions in the history; H − 1 velocities go in.
        latent_size: width of the states.
        num_mlp_layers: hidden layers of each MLP.
        num_message_passing_steps: number of interaction networks.
        output: "acceleration": the network gives (a − g) / scale. "gated": it gives a gate s in (0, 1) per axis and an
            increment u, with v' = s (v + g Δt) + u; rest (s = 0, u = 0) and free fall (s = 1, u = 0) are then easy.
            "switched": the same with a gate in [0, 1] that gets to its ends, so that what slides far is not slowed down
            a little in every step, and heaps do not creep.
        context: node features beyond the radius: overburden, solid fraction, floor (`graph.context`).
        neighbours: backend of `radius_graph`.
        walls: what is known of walls. "box": distances to the faces of the box, of one condition; "surfaces": distance,
            normal and friction of faces, obstacles and terrain within the radius (`graph.surfaces`); "contacts": these,
            and Coulomb's law of each of them, behind the forces that the network gives (`Surfaces.contacts`).
        network: from features to the output: a registered name, "module.Class", or a mapping of "_target_" and options
            (`nn.network`).

    Raises:
        InputError: values that make no simulator.
    """

    dim: int
    dt: float
    spacing: float
    particle_types: tuple[int, ...]
    material_features: tuple[str, ...]
    connectivity_radius: float
    input_sequence_length: int
    latent_size: int
    num_mlp_layers: int
    num_message_passing_steps: int
    output: str
    context: bool
    neighbours: str
    walls: str = "box"
    network: str | Mapping[str, Any] = DEFAULT_NETWORK

    exact_steps: ClassVar[bool] = False
    """Its steps have to stay equal to another program's, so nothing may stabilise them."""

    self_loops: ClassVar[bool] = False
    """Its graphs have edges from a particle to itself."""

    @property
    def sees_surfaces(self) -> bool:
        """Whether obstacles and terrain are known, and not the faces of the box alone."""
        return self.walls != "box"

    def __post_init__(self) -> None:
        object.__setattr__(self, "particle_types", tuple(self.particle_types))
        object.__setattr__(self, "material_features", tuple(self.material_features))
        lowest = {"input_sequence_length": 2, "latent_size": 1, "num_mlp_layers": 1, "num_message_passing_steps": 0}
        for name, least in lowest.items():
            if getattr(self, name) < least:
                raise InputError(f"model.{name} must be at least {least}, not {getattr(self, name)}.")
        for name in ("dt", "spacing", "connectivity_radius"):
            if not getattr(self, name) > 0:
                raise InputError(f"model.{name} must be positive, not {getattr(self, name)}.")
        for name, values in (("output", OUTPUTS), ("walls", WALLS)):
            if getattr(self, name) not in values:
                raise InputError(f"model.{name} must be one of {', '.join(values)}, not {getattr(self, name)!r}.")

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> SimulatorConfig:
        """Build the config from a mapping; a misspelt or missing key is named in an `InputError`."""
        fields = dataclasses.fields(cls)
        known = [field.name for field in fields]
        unknown = [key for key in data if key not in known]
        missing = [field.name for field in fields if field.default is dataclasses.MISSING and field.name not in data]
        if unknown or missing:
            what = f"unknown key {', '.join(unknown)}" if unknown else f"missing key {', '.join(missing)}"
            raise InputError(f"model: {what}; known are {', '.join(known)}.")
        return cls(**data)

    def to_dict(self) -> dict[str, Any]:
        """Return the config as plain numbers, strings and lists."""
        values = {key: list(v) if isinstance(v, tuple) else v for key, v in dataclasses.asdict(self).items()}
        if self.network == DEFAULT_NETWORK:
            del values["network"]  # as checkpoints were before there were others
        if not self.sees_surfaces:
            del values["walls"]
        return values
