"""A checkpoint's step as a program that runs without gns_pl: `torch.export` (.pt2) or ONNX (.onnx).

What is exported is one step of one scene, its edges given: features, network, integration. Neither the loop nor the
search for neighbours nor what stabilises a run is in it; whoever runs it provides them (docs/export.md).
"""

from __future__ import annotations

import importlib.util
import io
import json
import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch.export import Dim, ExportedProgram

import gns_pl
from gns_pl.errors import InputError
from gns_pl.graph import SceneBatch, edge_width
from gns_pl.io.atomic import write_atomically
from gns_pl.models.registry import kind_of
from gns_pl.models.simulator import Simulator

TORCH, ONNX = ".pt2", ".onnx"
PARTS = ("step", "network")
METADATA = "gns_pl"
"""Key of the metadata in an ONNX file; name of the extra file in a .pt2."""


class Step(nn.Module):
    """A simulator's step of one scene, with plain tensors in the place of `SceneBatch` and of the search."""

    def __init__(self, simulator: Simulator) -> None:
        super().__init__()
        self.simulator = simulator

    def forward(
        self,
        history: Tensor,
        edge_index: Tensor,
        particle_type: Tensor,
        material: Tensor,
        volume: Tensor,
        lower: Tensor,
        upper: Tensor,
        gravity: Tensor,
    ) -> Tensor:
        """Return the positions one step later [N, D] [m].

        Args:
            history: positions of the last H frames, the latest last [N, H, D] [m].
            edge_index: both directions of all pairs closer than the radius, sender and receiver [2, E].
            particle_type: [N] `ParticleType`.
            material: the config's material features [N, K].
            volume: volume that every particle stands for [N] [m^D].
            lower: lower corner of the box [D] [m].
            upper: upper corner of the box [D] [m].
            gravity: [D] [m/s²].
        """
        box = (lower[None], upper[None], gravity[None])
        static = SceneBatch(particle_type, material, volume, *box, batch=torch.zeros_like(particle_type))
        next_position: Tensor = self.simulator(history, static, search=lambda *_, **__: edge_index)
        return next_position


def export_program(simulator: Simulator, target: str | Path, *, part: str = "step") -> Path:
    """Write a step, or its network alone, for any number of particles and edges; config and version are in the file.

    Args:
        simulator: whose step it is; it is not changed.
        target: file ending in .pt2 for `torch.export` or in .onnx; must not be there yet.
        part: "step", as `Step`; or "network": normalised node features [N, F], edge features [E, F'] and edges [2, E] →
            the network's output.

    Returns:
        The target.

    Raises:
        InputError: another ending or part, a target that is there, a library that is not, or a network that cannot be
            exported.
    """
    target = Path(target)
    if target.suffix not in (TORCH, ONNX):
        raise InputError(f"target={target} must end in {TORCH} for torch.export, or in {ONNX}.")
    if target.exists():
        raise InputError(f"{target}: exists already; remove it or choose another target=.")
    missing = [name for name in ("onnx", "onnxscript") if importlib.util.find_spec(name) is None]
    if target.suffix == ONNX and missing:
        raise InputError(f"target={target} needs {' and '.join(missing)}: pip install 'gns_pl[export]'.")
    content = {"gns_pl": gns_pl.__version__, "part": part, "kind": kind_of(simulator)} | simulator.config.to_dict()
    metadata = json.dumps(content)
    with _quiet():
        try:
            program = trace(simulator, part)
            if target.suffix == TORCH:
                buffer = io.BytesIO()
                torch.export.save(program, buffer, extra_files={METADATA: metadata})
                data = buffer.getvalue()
            else:
                data = _onnx(program, "next_position" if part == "step" else "output", metadata)
        except RuntimeError as error:
            reason = str(error).strip().partition("\n")[0].rstrip(".")
            raise InputError(f"{target}: this model cannot be exported ({reason}).") from error
    target.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(target, data)
    return target


def trace(simulator: Simulator, part: str) -> ExportedProgram:
    """Return a step, or its network alone, as an exported program with any number of particles N and edges E.

    Args:
        simulator: on the CPU.
        part: as of `export_program`.

    Raises:
        InputError: another part, or the step of a simulator that sees surfaces.
    """
    config, (number, edges) = simulator.config, (5, 7)  # traced with; neither 0 nor 1, which torch takes for constants
    dim, num_features = config.dim, len(config.material_features)
    edge_index = torch.arange(2 * edges).view(2, edges) % number
    of_particles, of_edges = Dim("particles", min=0), Dim("edges", min=0)
    module: nn.Module
    inputs: dict[str, tuple[Tensor, Any]]
    if part == "network":
        module = simulator.network
        inputs = {
            "node": (torch.zeros(number, simulator.node_width()), {0: of_particles}),
            "edge": (torch.zeros(edges, edge_width(dim)), {0: of_edges}),
            "edge_index": (edge_index, {1: of_edges}),
        }
    elif part == "step":
        if config.sees_surfaces:
            raise InputError("a simulator that sees surfaces is exported by its network alone: part=network.")
        module = Step(simulator)
        history = torch.rand(number, config.input_sequence_length, dim)
        inputs = {
            "history": (history, {0: of_particles}),
            "edge_index": (edge_index, {1: of_edges}),
            "particle_type": (torch.zeros(number, dtype=torch.int64), {0: of_particles}),
            "material": (torch.zeros(number, num_features), {0: of_particles}),
            "volume": (torch.ones(number), {0: of_particles}),
            "lower": (torch.zeros(dim), None),
            "upper": (torch.ones(dim), None),
            "gravity": (torch.zeros(dim), None),
        }
    else:
        raise InputError(f"part must be one of {', '.join(PARTS)}, not {part!r}.")
    arguments = tuple(value for value, _ in inputs.values())
    with torch.no_grad():
        # Strict: the other way takes `len(tensor)` for a constant, which networks of one's own may well contain.
        return torch.export.export(
            module.eval(), arguments, dynamic_shapes={name: sizes for name, (_, sizes) in inputs.items()}, strict=True
        )


def _onnx(program: ExportedProgram, output: str, metadata: str) -> bytes:
    """Return the content of an ONNX file; its inputs are called as the program's.

    Args:
        program: what it computes.
        output: name of its result.
        metadata: is put into the file.
    """
    exported = torch.onnx.export(program, dynamo=True, verbose=False)
    assert exported is not None
    exported.model.graph.outputs[0].name = output
    exported.model.metadata_props[METADATA] = metadata
    content: bytes = exported.model_proto.SerializeToString()
    return content


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep back what the exporters warn of by themselves: operators of packages that are not there, their own calls."""
    before = logging.root.manager.disable
    logging.disable(logging.WARNING)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logging.disable(before)
