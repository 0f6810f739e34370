"""Scenes, states and small simulators that several rooms test with."""

from __future__ import annotations

import multiprocessing
import socket
from collections.abc import Callable, Iterator
from dataclasses import replace
from multiprocessing.process import BaseProcess
from typing import Any

import numpy as np
import pytest
import torch
import torch.multiprocessing

from gns_pl.graph import SceneBatch, WindowRandom
from gns_pl.models.config import SimulatorConfig
from gns_pl.models.simulator import Simulator
from gns_pl.scene import Material, Scene, Wall, column_collapse, cube_drop, fill_scene
from gns_pl.scene.definition import FACES
from gns_pl.trajectory import Trajectory, start_trajectory

torch.set_num_threads(1)  # the tensors are small, and the machine may be busy

MPM: dict[str, Any] = {
    "points_per_direction": 2,
    "courant": 0.5,
    "transfer": "affine_flip",
    "damping_rate": 20,
    "bulk_viscosity": 0.86,
    "jitter": 0.0,
}
"""Settings of a run but for its cells."""

SAND = Material(density=1800, youngs_modulus=2e6, poisson_ratio=0.3, friction_angle_deg=30, cohesion=100)


def start_processes(work: Callable[..., None], arguments: tuple[Any, ...], number: int) -> None:
    """Call `work(rank, *arguments)` in processes of their own, forked from one that has imported what takes seconds."""
    _import_once()
    torch.multiprocessing.start_processes(work, arguments, nprocs=number, start_method="forkserver")


def start_process(work: Callable[..., object], *arguments: Any) -> BaseProcess:
    """Call `work(*arguments)` in a process of its own, which may be killed; forked as those of `start_processes`."""
    _import_once()
    process = multiprocessing.get_context("forkserver").Process(target=work, args=arguments)
    process.start()
    return process


def free_port() -> int:
    """Return a port of this machine at which processes can meet."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


def _import_once() -> None:
    multiprocessing.set_forkserver_preload(["gns_pl.training.train"])


@pytest.fixture(autouse=True, scope="module")
def _generate_in_this_process(request: pytest.FixtureRequest) -> Iterator[None]:
    """Sets so small are made sooner than processes for them, and only tests of the generation need such processes."""
    with pytest.MonkeyPatch.context() as patch:
        if not request.module.__name__.startswith("tests.generation"):
            patch.setattr("gns_pl.generation.dataset.available_cores", lambda: 1)
        yield


@pytest.fixture
def sand() -> Material:
    return SAND


@pytest.fixture
def drop() -> Scene:
    """A cube in the air of a 1 m box, moving."""
    walls = {face: Wall("friction", 0.385) for face in FACES[3]}
    return cube_drop(
        domain=(1, 1, 1),
        side=0.3,
        position=(0.3, 0.2, 0.4),
        velocity=(0.5, -0.25, 1.0),
        gravity=9.81,
        duration=0.2,
        material=SAND,
        walls=walls,
    )


@pytest.fixture
def column() -> Scene:
    walls = {face: Wall("friction", 0.385) for face in FACES[3]}
    return column_collapse(
        domain=(1.5, 0.5, 0.7), length=0.3, height=0.3, gravity=9.81, duration=0.5, material=SAND, walls=walls
    )


def make_config(**changes: object) -> SimulatorConfig:
    values: dict[str, object] = {
        "dim": 3,
        "dt": 0.01,
        "spacing": 0.05,
        "particle_types": (6,),
        "material_features": ("tan_friction_angle",),
        "connectivity_radius": 0.11,
        "input_sequence_length": 4,
        "latent_size": 16,
        "num_mlp_layers": 1,
        "num_message_passing_steps": 2,
        "output": "acceleration",
        "context": False,
        "neighbours": "auto",
    }
    return SimulatorConfig.from_dict(values | changes)


def make_simulator(**changes: object) -> Simulator:
    torch.manual_seed(0)
    simulator = Simulator(make_config(**changes))
    simulator.set_statistics(velocity=0.8, acceleration=6.0, material=torch.tensor([[0.5], [0.1]]))
    return simulator.eval()


class CallStepper:
    """A stepper of a function of history and scenes, in the place of a simulator's step."""

    def __init__(self, simulator: Simulator, step: Callable[[torch.Tensor, SceneBatch], torch.Tensor]) -> None:
        self.step = step
        self.config, self.device, self.history_length = simulator.config, simulator.device, simulator.history_length

    def __call__(self, history: torch.Tensor, static: SceneBatch) -> torch.Tensor:
        return self.step(history, static)


def make_static(number: int, *, graphs: int = 1, gravity: tuple[float, ...] = (0.0, 0.0, -9.81)) -> SceneBatch:
    """What stays the same in a run, of `graphs` equal scenes of `number` particles each, in a unit box."""
    dim = len(gravity)
    return SceneBatch(
        particle_type=torch.full((number * graphs,), 6),
        material=torch.full((number * graphs, 1), 0.577),
        volume=torch.full((number * graphs,), 1e-3),
        lower=torch.zeros(graphs, dim),
        upper=torch.ones(graphs, dim),
        gravity=torch.tensor([gravity] * graphs),
        batch=torch.arange(graphs).repeat_interleave(number),
    )


def make_random(static: SceneBatch, seed: int = 0) -> WindowRandom:
    """Random numbers of the windows 0, 1, … for the scenes of `make_static`."""
    return WindowRandom(seed, torch.arange(static.num_graphs), static.batch)


def make_start(scene: Scene, spacing: float = 0.05, dt: float = 0.01) -> Trajectory:
    return start_trajectory(scene, fill_scene(scene, spacing), dt, {})


def make_moving(scene: Scene, *, frames: int, spacing: float = 0.05, dt: float = 0.01, seed: int = 0) -> Trajectory:
    """A made-up smooth motion of a scene's particles: the truth for tests that need no physics."""
    start = make_start(scene, spacing, dt)
    generator = np.random.default_rng(seed)
    number, dim = start.position.shape[1:]
    velocity = start.initial_velocity.astype(np.float64)
    position, frames_made = start.position[0].astype(np.float64), [start.position[0]]
    for _ in range(frames - 1):
        velocity = velocity + generator.normal(0, 0.05, (number, dim)) - 0.02 * velocity
        position = position + velocity * dt
        frames_made.append(position.astype(np.float32))
    return replace(start, position=np.stack(frames_made))
