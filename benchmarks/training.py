"""Windows per second of a training step, and where its time goes, beside a plain reference loop in the same run.

    python benchmarks/training.py                                              # the quickstart's settings
    python benchmarks/training.py +experiment=cube106_paper training.batch_size=1    # any overrides of conf/train.yaml
    python benchmarks/training.py --blocks 3 --steps 5 --threads 1 …
    python benchmarks/training.py --processes 2 …   # and train.py with the threads shared among two processes

The reference is the same network with the same weights, data, batches, noise, loss and optimiser, written plainly: edge
inputs concatenated from both ends and the edge, `index_add` for the sums, a k-d tree per graph in the training process,
windows loaded there by one thread, memory, AdamW and Muon as PyTorch has them. "step" is this package's, in a bare loop
as well; "train.py" is what a user gets: the same under Lightning, with weight averaging and logging. Reference and step
take turns in blocks, and the medians over all steps are compared. Nothing is timed before both have warmed up.
"""

from __future__ import annotations

import argparse
import copy
import dataclasses
import itertools
import json
import multiprocessing
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import torch
from hydra import compose, initialize_config_dir
from hydra.utils import instantiate
from lightning.pytorch import Callback, Trainer
from lightning.pytorch.loggers import CSVLogger
from omegaconf import OmegaConf
from plain import concatenated_mlp
from torch import Tensor, nn

import gns_pl.models.simulator
from gns_pl.data.datamodule import TrajectoryDataModule
from gns_pl.generation import generate_dataset
from gns_pl.graph import radius_graph
from gns_pl.nn import EncodeProcessDecode
from gns_pl.nn.memory import keep_freed_memory
from gns_pl.training.config import TrainingConfig
from gns_pl.training.module import SimulatorModule
from gns_pl.training.train import build_data, build_module, quieten

PARTS = ("data", "graph", "forward", "backward", "optimiser")


class PlainNetwork(nn.Module):
    """`EncodeProcessDecode` as the papers write it: every edge's first layer on [sender, receiver, edge]."""

    def __init__(self, network: EncodeProcessDecode) -> None:
        super().__init__()
        network = copy.deepcopy(network)
        self.node_encoder, self.edge_encoder = network.node_encoder, network.edge_encoder
        self.static_edges = network.static_edges
        self.edge_mlps, self.node_mlps, self.decoder = nn.ModuleList(), nn.ModuleList(), network.decoder
        for layer in network.processor:
            self.edge_mlps.append(concatenated_mlp(layer))
            self.node_mlps.append(layer.node_mlp)

    def forward(self, node: Tensor, edge: Tensor, edge_index: Tensor) -> Tensor:
        """Return the decoded nodes."""
        sender, receiver = edge_index
        node, edge = self.node_encoder(node), self.edge_encoder(edge)
        for edge_mlp, node_mlp in zip(self.edge_mlps, self.node_mlps, strict=True):
            message = edge_mlp(torch.cat([node[sender], node[receiver], edge], dim=1))
            received = torch.zeros_like(node).index_add(0, receiver, message)
            node = node + node_mlp(torch.cat([received, node], dim=1))
            if not self.static_edges:
                edge = edge + message
        decoded: Tensor = self.decoder(node)
        return decoded


class Clock:
    """Seconds of the parts of one step; on a GPU every reading waits for it."""

    def __init__(self, device: torch.device) -> None:
        self.device = device
        self.seconds = dict.fromkeys(PARTS, 0.0)

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        """Add the time of the block to a part."""
        began = self.now()
        yield
        self.seconds[name] += self.now() - began

    def now(self) -> float:
        """Return the time when all that was asked for is done."""
        if self.device.type == "cuda":
            torch.cuda.synchronize()
        return time.perf_counter()


def plain_optimizers(module: SimulatorModule) -> list[torch.optim.Optimizer]:
    """Return the optimisers of `SimulatorModule` as PyTorch has them."""
    settings = module.optimisation
    rates = {"lr": settings["learning_rate"], "weight_decay": settings["weight_decay"]}
    parameters = list(module.parameters())
    if settings["optimiser"] == "adamw":
        return [torch.optim.AdamW(parameters, **rates)]
    matrices = [parameter for parameter in parameters if parameter.ndim == 2]
    others = [parameter for parameter in parameters if parameter.ndim != 2]
    muon = torch.optim.Muon(matrices, adjust_lr_fn="match_rms_adamw", **rates)
    return [muon, torch.optim.AdamW(others, **rates)]


def make_step(
    module: SimulatorModule, data: TrajectoryDataModule, device: torch.device, clip: float, *, plain: bool
) -> Callable[[], dict[str, float]]:
    """Return a function that makes one training step and returns the seconds of its parts."""
    if plain:
        simulator = module.simulator
        simulator.network = PlainNetwork(simulator.network)
        simulator.config = dataclasses.replace(simulator.config, neighbours="kdtree")
    module.to(device)
    optimizers = plain_optimizers(module) if plain else [module.configure_optimizers()["optimizer"]]
    batches = iter(data.train_dataloader())

    def step() -> dict[str, float]:
        clock = Clock(device)
        with clock.part("data"):
            batch = next(batches).to(device)

        def timed_graph(*args: Any, **kwargs: Any) -> Tensor:
            with clock.part("graph"):
                return radius_graph(*args, **kwargs)

        gns_pl.models.simulator.radius_graph = timed_graph
        with clock.part("forward"):
            loss = module.loss(batch)
        gns_pl.models.simulator.radius_graph = radius_graph
        clock.seconds["forward"] -= clock.seconds["graph"]
        with clock.part("backward"):
            loss.backward()
        with clock.part("optimiser"):
            torch.nn.utils.clip_grad_norm_(module.parameters(), clip)
            for optimizer in optimizers:
                optimizer.step()
            module.zero_grad()
        return clock.seconds

    return step


class Pace(Callback):
    """Seconds between the ends of the steps of a Lightning training."""

    def __init__(self) -> None:
        self.ends: list[float] = []

    def on_train_batch_end(self, trainer: Trainer, *args: Any) -> None:
        """Take the time."""
        self.ends.append(time.perf_counter())


def time_whole(cfg: Any, module: SimulatorModule, data: TrajectoryDataModule, steps: int) -> list[float]:
    """Return the seconds of every step of a training under Lightning, with weight averaging and a log file."""
    with tempfile.TemporaryDirectory() as folder:
        pace, average = Pace(), instantiate(cfg.callbacks.average)
        logger = CSVLogger(folder)
        settings = {**cfg.trainer, "max_steps": steps, "limit_val_batches": 0, "enable_progress_bar": False}
        del settings["val_check_interval"]
        trainer = instantiate(settings, callbacks=[average, pace], logger=logger, enable_checkpointing=False)
        trainer.fit(module, datamodule=data)
    return [after - before for before, after in itertools.pairwise(pace.ends)]


def time_processes(overrides: list[str], processes: int, threads: int, steps: int) -> float:
    """Return the median seconds of a step of train.py in which processes share windows and threads."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, str(Path(__file__).resolve().parents[1] / "train.py"), *overrides]
        command += [f"hydra.run.dir={folder}", "trainer.accelerator=cpu", f"trainer.devices={processes}"]
        command += [f"trainer.max_steps={steps}", "trainer.log_every_n_steps=10", "+trainer.limit_val_batches=0"]
        command += ["~logger.wandb", "~callbacks.progress", "trainer.enable_progress_bar=false"]
        environment = os.environ | {"OMP_NUM_THREADS": str(threads // processes)}
        subprocess.run(command, check=True, env=environment, stdout=subprocess.DEVNULL)
        paces = json.loads((Path(folder) / "summary.json").read_text())["step_seconds"]
    return float(paces)


def largest_difference(module: SimulatorModule) -> float:
    """Return the largest difference of the two networks' outputs, relative to the outputs' root mean square."""
    generator = torch.Generator().manual_seed(0)
    network = module.simulator.network
    position = 0.1 * torch.rand(500, module.simulator.config.dim, generator=generator)
    edge_index = radius_graph(position, 0.03)
    node = torch.randn(500, network.node_encoder[0].in_features, generator=generator)
    edge = torch.randn(edge_index.shape[1], network.edge_encoder[0].in_features, generator=generator)
    with torch.no_grad():
        ours, plain = network(node, edge, edge_index), PlainNetwork(network)(node, edge, edge_index)
    return float((ours - plain).abs().max() / plain.square().mean().sqrt())


def prepare(overrides: list[str], threads: int) -> tuple[Any, SimulatorModule, TrajectoryDataModule]:
    """Return config, module and data of a training with these overrides; the data are generated if missing."""
    torch.set_num_threads(threads)
    quieten()
    with initialize_config_dir(str(Path(__file__).resolve().parents[1] / "conf"), version_base=None):
        cfg = compose("train", overrides)
    parts = {key: OmegaConf.to_container(cfg[key], resolve=True) for key in ("model", "data", "training")}
    settings: dict[str, Any] = {**parts, "seed": cfg.seed, "description": ""}
    training = TrainingConfig.from_dict(settings["training"])
    directory = generate_dataset(settings["data"], device="auto")
    data = build_data(directory, training, settings["model"], cfg.seed)
    torch.manual_seed(cfg.seed)
    return cfg, build_module(settings, training, data), data


def work(pipe: Connection, overrides: list[str], threads: int, plain: bool) -> None:
    """Make as many steps as the pipe asks for, and answer with their times; a process of its own for each kind."""
    if not plain:
        keep_freed_memory()
    cfg, module, data = prepare(overrides, threads)
    device = torch.device("cuda" if torch.cuda.is_available() and cfg.trainer.accelerator != "cpu" else "cpu")
    step = make_step(module, data, device, cfg.trainer.gradient_clip_val, plain=plain)
    while steps := pipe.recv():
        pipe.send([step() for _ in range(steps)])


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--blocks", type=int, default=5)
    parser.add_argument("--steps", type=int, default=20, help="steps per block")
    parser.add_argument("--threads", type=int, default=torch.get_num_threads())
    parser.add_argument("--processes", type=int, help="also train.py with so many; they share the threads")
    parser.add_argument("overrides", nargs="*", default=["+experiment=quickstart"], help="of conf/train.yaml")
    arguments = parser.parse_args()
    cfg, module, data = prepare(arguments.overrides, arguments.threads)
    print(f"outputs of the two networks differ by {largest_difference(module):.1e} of their root mean square")
    spawn = multiprocessing.get_context("spawn")
    pipes = {}
    for kind in ("reference", "step"):
        pipes[kind], theirs = spawn.Pipe()
        given = (theirs, arguments.overrides, arguments.threads, kind == "reference")
        spawn.Process(target=work, args=given, daemon=True).start()
    times: dict[str, list[dict[str, float]]] = {"reference": [], "step": []}
    for block in range(arguments.blocks + 1):
        for kind, pipe in pipes.items():
            pipe.send(arguments.steps)
            measured = pipe.recv()
            times[kind] += measured if block else []  # the first block warms up
    for pipe in pipes.values():
        pipe.send(0)
    keep_freed_memory()
    whole = time_whole(cfg, module, data, arguments.steps * (arguments.blocks + 1))[arguments.steps :]
    particles = statistics.fmean(len(constant["material"]) for constant in data.train_set.constant)
    windows = cfg.training.batch_size
    name = torch.cuda.get_device_name() if torch.cuda.is_available() else platform.machine()
    print(
        f"{name}, {arguments.threads} threads, {cfg.trainer.precision}; {windows} windows of {particles:.0f} particles "
        f"a step; network of {cfg.model.num_message_passing_steps} x {cfg.model.latent_size}"
    )
    print(f"{'':10} {'ms a step':>10} {'windows/s':>10}  " + "".join(f"{part:>11}" for part in PARTS) + "   [ms]")
    medians = {}
    for kind, steps in times.items():
        medians[kind] = statistics.median(sum(step.values()) for step in steps)
        split = "".join(f"{1e3 * statistics.median(step[part] for step in steps):11.2f}" for part in PARTS)
        print(f"{kind:10} {1e3 * medians[kind]:10.2f} {windows / medians[kind]:10.1f}  {split}")
    medians["train.py"] = statistics.median(whole)
    print(f"{'train.py':10} {1e3 * medians['train.py']:10.2f} {windows / medians['train.py']:10.1f}")
    if arguments.processes:
        kind, steps = f"train.py, {arguments.processes} processes", arguments.steps * (arguments.blocks + 1)
        medians[kind] = time_processes(arguments.overrides, arguments.processes, arguments.threads, steps)
        print(f"{kind:21} {1e3 * medians[kind]:.2f} {windows / medians[kind]:10.1f}")
    for kind in list(medians)[1:]:
        print(f"{kind} over reference: {medians['reference'] / medians[kind]:.2f} times as fast")


if __name__ == "__main__":
    main()
