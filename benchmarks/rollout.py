"""Time of a rollout step and of its parts, against the number of particles, beside a plain PyG reference.

    python benchmarks/rollout.py                                        # what docs/performance.md shows
    python benchmarks/rollout.py --sizes 10000 --networks 10x128 --threads 1 2
    python benchmarks/rollout.py --device cuda --turns 20 --variants plain step captured captured+tf32 captured+bfloat16
    python benchmarks/rollout.py --sizes 1000000 --networks 3x32 --variants step

A step is all of it: neighbours, features, network, integration; not files. Particles fill a column at rest with a
jitter, weights are random. The reference is the same network with the same weights as the papers write it: PyG's
`MessagePassing`, messages from [x_i, x_j, e] concatenated, the same neighbour search. Variants of one size take turns;
medians of several turns are compared, after one to warm up. Beside them stands what the machine gives: the rate of a
large float32 product on the same threads, and of a copy. GFLOP/s counts the products of the split network (the
reference makes more for the same result), GB/s its least traffic: edge states read and written once a layer, both ends
gathered.
"""

from __future__ import annotations

import argparse
import copy
import csv
import dataclasses
import platform
import resource
import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
import torch_geometric
from plain import concatenated_mlp
from torch import Tensor, nn
from torch_geometric.nn import MessagePassing

import gns_pl.models.simulator
from gns_pl.graph import radius_graph
from gns_pl.models.config import SimulatorConfig
from gns_pl.models.simulator import Simulator
from gns_pl.nn import EncodeProcessDecode
from gns_pl.rollout.acceleration import CapturedStepper, accelerate
from gns_pl.rollout.engine import Run, history_of, static_of
from gns_pl.rollout.stepper import SimulatorStepper, Stepper
from gns_pl.scene import FACES, Material, Wall, column_collapse, fill_scene
from gns_pl.trajectory import start_trajectory

SAND = Material(density=1800, youngs_modulus=2e6, poisson_ratio=0.3, friction_angle_deg=30, cohesion=100)
SPACING = 0.0208
PAPER = {
    "dim": 3,
    "dt": 0.0025,
    "spacing": SPACING,
    "particle_types": (6,),
    "material_features": (),
    "connectivity_radius": 0.041,
    "input_sequence_length": 6,
    "num_mlp_layers": 2,
    "output": "acceleration",
    "context": False,
    "neighbours": "auto",
}
SMALL = PAPER | {
    "connectivity_radius": 1.68 * SPACING,
    "input_sequence_length": 2,
    "num_mlp_layers": 1,
    "output": "gated",
    "context": True,
}
NETWORKS = {"10x128": PAPER, "5x64": PAPER, "3x32": SMALL}
VARIANTS = (
    "plain",
    "PyG",
    "step",
    "skin",
    "static",
    "tf32",
    "bfloat16",
    "compiled",
    "compiled+tf32",
    "compiled+bfloat16",
    "captured",
    "captured+tf32",
    "captured+bfloat16",
)
PARTS = ("search", "features", "network")


@dataclass
class Row:
    """One row of the table; times in ms, rates in 10⁹ per second, memory in GB."""

    network: str
    particles: int
    edges: int
    variant: str
    device: str
    threads: int
    step: float
    search: float
    features: float
    network_ms: float
    rest: float
    particles_per_s: float
    gflops: float
    share_of_sgemm: float
    gbytes: float
    share_of_copy: float
    times_plain: float
    difference: float
    peak_memory: float


class PlainLayer(MessagePassing):  # type: ignore[misc]
    """An interaction network in PyG as its documentation suggests."""

    def __init__(self, edge_mlp: nn.Module, node_mlp: nn.Module) -> None:
        super().__init__(aggr="sum")
        self.edge_mlp, self.node_mlp = edge_mlp, node_mlp

    def forward(self, x: Tensor, edge_index: Tensor, e: Tensor) -> tuple[Tensor, Tensor]:
        """Return nodes and edges."""
        updated = self.edge_updater(edge_index, x=x, e=e)
        received = self.propagate(edge_index, updated=updated, size=(len(x), len(x)))
        return x + self.node_mlp(torch.cat([received, x], dim=-1)), e + updated

    def edge_update(self, x_i: Tensor, x_j: Tensor, e: Tensor) -> Tensor:
        """Return the messages."""
        message: Tensor = self.edge_mlp(torch.cat([x_j, x_i, e], dim=-1))
        return message

    def message(self, updated: Tensor) -> Tensor:
        """Return what is summed."""
        return updated


class PlainNetwork(nn.Module):
    """The network of a simulator, with its weights, of `PlainLayer`s."""

    def __init__(self, network: EncodeProcessDecode) -> None:
        super().__init__()
        self.node_encoder, self.edge_encoder, self.decoder = network.node_encoder, network.edge_encoder, network.decoder
        self.layers = nn.ModuleList()
        for layer in network.processor:
            self.layers.append(PlainLayer(concatenated_mlp(layer), layer.node_mlp))

    def forward(self, node: Tensor, edge: Tensor, edge_index: Tensor) -> Tensor:
        """Return the decoded nodes."""
        node, edge = self.node_encoder(node), self.edge_encoder(edge)
        for layer in self.layers:
            node, edge = layer(node, edge_index, edge)
        return cast(Tensor, self.decoder(node))


def make_simulator(name: str) -> Simulator:
    """Return a simulator of random weights."""
    layers, width = map(int, name.split("x"))
    torch.manual_seed(0)
    config = NETWORKS.get(name, PAPER) | {"num_message_passing_steps": layers, "latent_size": width}
    simulator = Simulator(SimulatorConfig.from_dict(config)).eval()
    simulator.set_statistics(velocity=0.8, acceleration=6.0, material=torch.zeros(2, 0))
    return simulator


def make_variant(name: str, simulator: Simulator) -> Stepper:
    """Return what makes the same steps in another way."""
    if name == "plain":
        return SimulatorStepper(simulator, radius_graph, PlainNetwork(simulator.network).to(simulator.device))
    if name in ("PyG", "static"):
        network = copy.copy(simulator.network)
        network.compiled_edges = name != "PyG"  # else the first layer split is all there is
        network.static_edges = name == "static"
        return SimulatorStepper(simulator, radius_graph, network)
    words = name.split("+")
    precision = precision_of(name)
    return accelerate(
        simulator,
        skin=0.25 * ("skin" in words),
        precision=precision,
        compiled="compiled" in words,
        captured="captured" in words,
    )


def make_start(simulator: Simulator, size: int) -> Run:
    """Return a column of about so many particles."""
    edge = SPACING * size ** (1 / 3)
    box = (3 * edge, edge, 1.2 * edge)
    walls = dict.fromkeys(FACES[3], Wall("friction", 0.385))
    scene = column_collapse(domain=box, length=edge, height=edge, gravity=9.81, duration=1, material=SAND, walls=walls)
    particles = fill_scene(scene, SPACING, jitter=0.4, generator=np.random.default_rng(0))
    return Run(start_trajectory(scene, particles, simulator.config.dt, {}), 1)


class Clock:
    """Seconds of the parts of a step; a GPU is waited for at each reading."""

    def __init__(self, stepper: Stepper) -> None:
        self.cuda = stepper.device.type == "cuda"
        self.seconds = dict.fromkeys(PARTS, 0.0)

    def now(self) -> float:
        """Return the time."""
        if self.cuda:
            torch.cuda.synchronize()
        return time.perf_counter()

    def timed(self, part: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """Return the function, timed."""

        def call(*args: Any, **kwargs: Any) -> Any:
            began = self.now()
            result = function(*args, **kwargs)
            self.seconds[part] += self.now() - began
            return result

        return call

    @contextmanager
    def watching(self, stepper: Stepper) -> Iterator[Stepper]:
        """Yield the stepper with the parts of its steps timed; a CUDA graph has none."""
        module = gns_pl.models.simulator
        before = module.node_features, module.edge_features
        module.node_features, module.edge_features = (self.timed("features", each) for each in before)
        if isinstance(stepper, SimulatorStepper):
            search, network = self.timed("search", stepper.search), self.timed("network", stepper.network)
            stepper = dataclasses.replace(stepper, search=search, network=network)
        try:
            yield stepper
        finally:
            module.node_features, module.edge_features = before


def flops(simulator: Simulator, nodes: int, edges: int) -> float:
    """Return the products' operations of one forward pass, the first layer split."""
    network, total = simulator.network, 0
    for name, part in network.named_modules():
        if isinstance(part, nn.Linear):
            of_edges = name.startswith("edge_encoder") or ".edge_mlp." in name
            total += 2 * part.weight.numel() * (edges if of_edges else nodes)
    return float(total)


def least_bytes(simulator: Simulator, nodes: int, edges: int) -> float:
    """Return the least traffic of edge states and gathered ends [bytes]."""
    config = simulator.config
    layers, row = config.num_message_passing_steps, 4 * config.latent_size
    return float(layers * row * (edges * 3 + nodes * 6))


class Machine:
    """What the machine gives at the time: products [FLOP/s], and copies, read and write [B/s]."""

    def __init__(self, device: str) -> None:
        self.device = device
        self.size = 8192 if device == "cuda" else 2048
        self.matrix, self.array = torch.randn(self.size, self.size, device=device), torch.ones(2**25, device=device)
        self.into = torch.empty_like(self.array)
        self.products: dict[str, list[float]] = {}
        self.copy: list[float] = []

    def measure(self, precision: str) -> None:
        """Take one more sample of a product in a precision, and of a copy."""
        matrix = self.matrix.bfloat16() if precision == "bfloat16" else self.matrix
        torch.set_float32_matmul_precision("high" if precision == "tf32" else "highest")
        rate = 2 * self.size**3 / self._seconds(lambda: matrix @ matrix)
        torch.set_float32_matmul_precision("highest")
        self.products.setdefault(precision, []).append(rate)
        self.copy.append(8 * self.array.numel() / self._seconds(lambda: self.into.copy_(self.array)))

    def product(self, precision: str) -> float:
        """Return the median rate; the first sample warmed up."""
        return statistics.median(self.products[precision][1:])

    def _seconds(self, work: Callable[[], object]) -> float:
        if self.device == "cuda":
            torch.cuda.synchronize()
        began = time.perf_counter()
        work()
        if self.device == "cuda":
            torch.cuda.synchronize()
        return time.perf_counter() - began


def precision_of(variant: str) -> str:
    """Return what a variant's products are made in."""
    return next((word for word in variant.split("+") if word in ("tf32", "bfloat16")), "float32")


def measure(
    name: str, size: int, variants: Sequence[str], device: str, threads: int, *, turns: int, plain_up_to: int
) -> list[Row]:
    """Return the rows of one network and size."""
    torch.set_num_threads(threads)
    simulator = make_simulator(name).to(device)
    run = make_start(simulator, size)
    history, static = history_of(run, simulator.config).to(device), static_of(run.start).to(device)
    number = run.start.num_particles
    variants = [each for each in variants if each != "plain" or number <= plain_up_to]
    made = {each: make_variant(each, simulator) for each in variants}
    times: dict[str, list[dict[str, float]]] = {each: [] for each in variants}
    outputs: dict[str, Tensor] = {}
    peaks: dict[str, float] = {}
    with torch.inference_mode():
        edges = int(radius_graph(history[:, -1], simulator.config.connectivity_radius).shape[1])
        machine = Machine(device)
        for turn in range(turns + 1):
            for each, variant in made.items():
                machine.measure(precision_of(each))
                clock = Clock(variant)
                if device == "cuda":
                    torch.cuda.reset_peak_memory_stats()
                began = clock.now()
                if isinstance(variant, SimulatorStepper):
                    outputs[each] = variant.normalised_acceleration(history, static)
                    simulator.integrate(history, outputs[each], static)
                elif isinstance(variant, CapturedStepper):
                    variant(history, static)
                    outputs[each] = variant.normalised
                whole = clock.now() - began
                if turn == 0:
                    continue  # warms up
                # Parts in a step of their own, so that waiting for a GPU between them does not count in the whole.
                with clock.watching(variant) as watched:
                    began = clock.now()
                    watched(history, static)
                    rest = clock.now() - began - sum(clock.seconds.values())
                times[each].append({**clock.seconds, "rest": rest, "step": whole})
                on_gpu = torch.cuda.max_memory_allocated() if device == "cuda" else 0
                peaks[each] = (on_gpu or resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024) / 1e9
    copied = statistics.median(machine.copy[1:])
    medians = {each: {key: statistics.median(t[key] for t in ts) for key in ts[0]} for each, ts in times.items()}
    work, traffic = flops(simulator, number, edges), least_bytes(simulator, number, edges)
    rows = []
    for each, median in medians.items():
        captured = each.startswith("captured")  # one graph: its parts are not told apart
        network = median["step"] if captured else median["network"]
        reference = outputs.get("plain", outputs.get("step"))
        difference = float("nan")
        if reference is not None and each != "static":
            difference = float((outputs[each] - reference).abs().max() / reference.square().mean().sqrt())
        rows.append(
            Row(
                network=name,
                particles=number,
                edges=edges,
                variant=each,
                device=torch.cuda.get_device_name() if device == "cuda" else "cpu",
                threads=threads,
                step=1e3 * median["step"],
                search=float("nan") if captured else 1e3 * median["search"],
                features=float("nan") if captured else 1e3 * median["features"],
                network_ms=1e3 * network,
                rest=1e3 * median["rest"],
                particles_per_s=number / median["step"],
                gflops=work / network / 1e9,
                share_of_sgemm=work / network / machine.product(precision_of(each)),
                gbytes=traffic / network / 1e9,
                share_of_copy=traffic / network / copied,
                times_plain=medians["plain"]["step"] / median["step"] if "plain" in medians else float("nan"),
                difference=difference,
                peak_memory=peaks[each],
            )
        )
    return rows


def show(row: Row) -> str:
    """Return a row of the printed table."""
    share = (
        f"{row.gflops:7.1f} ({100 * row.share_of_sgemm:3.0f} %) {row.gbytes:6.1f} ({100 * row.share_of_copy:3.0f} %)"
    )
    parts = f"{row.search:8.2f} {row.features:8.2f} {row.network_ms:9.2f} {row.rest:7.2f}"
    return (
        f"{row.network:7} {row.particles:8} {row.edges:9} {row.variant:18} {row.threads:2} {row.step:10.2f} {parts} "
        f"{row.particles_per_s:10.3g} {share} {row.times_plain:6.2f} {row.difference:8.1e} {row.peak_memory:5.1f}"
    )


HEAD = (
    f"{'network':7} {'N':>8} {'E':>9} {'variant':18} th {'ms a step':>10} {'search':>8} {'features':>8} {'network':>9} "
    f"{'rest':>7} {'N / s':>10} {'GFLOP/s (of sgemm)':>15} {'GB/s (of copy)':>14} {'x plain':>6} {'differs':>8}    GB"
)


def draw(table: Path) -> Path:
    """Draw the table's time of a step against the number of particles, beside it, and return the figure's path."""
    import matplotlib.pyplot as plt

    with table.open() as file:
        rows = list(csv.DictReader(file))
    figure, axes = plt.subplots(1, 2, figsize=(11, 4.8), layout="constrained")
    series: dict[tuple[str, str, str], list[tuple[float, float, float]]] = {}
    for row in rows:
        key = (row["network"], row["threads"], row["variant"])
        values = (float(row["particles"]), float(row["step"]), 100 * float(row["share_of_sgemm"]))
        series.setdefault(key, []).append(values)
    colours = {name: f"C{index}" for index, name in enumerate(dict.fromkeys(row["network"] for row in rows))}
    for (name, threads, variant), values in sorted(series.items()):
        if variant not in ("plain", "step"):
            continue
        number, step, share = zip(*sorted(values), strict=True)
        style = {"color": colours[name], "linestyle": "-" if variant == "step" else ":", "linewidth": float(threads)}
        label = f"{name}, {threads} threads{', plain PyG' if variant == 'plain' else ''}"
        axes[0].loglog(number, step, "o", markersize=4, label=label, **style)
        axes[1].semilogx(number, share, "o", markersize=4, **style)
    axes[0].set(xlabel="particles", ylabel="ms a step")
    figure.legend(fontsize=7, ncols=4, loc="outside lower center")
    axes[1].set(xlabel="particles", ylabel="network's products, % of the rate of a large one", ylim=(0, None))
    for axis in axes:
        axis.grid(alpha=0.3)
    path = table.with_suffix(".png")
    figure.savefig(path, dpi=130)
    return path


def main() -> None:
    """Measure, print, and write a table if asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", type=int, nargs="+", default=[1000, 10_000, 100_000])
    parser.add_argument("--networks", nargs="+", default=list(NETWORKS), help="layers x width")
    parser.add_argument("--variants", nargs="+", choices=VARIANTS, default=["plain", "step"])
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--device", default="cpu", choices=["cpu", "cuda"])
    parser.add_argument("--turns", type=int, default=5)
    parser.add_argument("--plain-up-to", type=int, default=20_000, help="no reference above so many particles")
    parser.add_argument("--out", type=Path, help="CSV file; rows are added to it, and a figure is drawn beside it")
    args = parser.parse_args()
    versions = f"torch {torch.__version__}, PyG {torch_geometric.__version__}"
    print(f"{platform.machine()}, {versions}, float32 unless the variant says otherwise, turns: {args.turns}")
    print(HEAD, flush=True)
    for threads in args.threads if args.device == "cpu" else [torch.get_num_threads()]:
        for name in args.networks:
            for size in args.sizes:
                rows = measure(
                    name, size, args.variants, args.device, threads, turns=args.turns, plain_up_to=args.plain_up_to
                )
                print(*map(show, rows), sep="\n", flush=True)
                if args.out:
                    new = not args.out.exists()
                    with args.out.open("a", newline="") as file:
                        writer = csv.DictWriter(file, [field.name for field in fields(Row)])
                        writer.writeheader() if new else None
                        writer.writerows(asdict(row) for row in rows)
    if args.out:
        print(draw(args.out))


if __name__ == "__main__":
    main()
