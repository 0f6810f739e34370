"""What the GPU gives is what the CPU gives. Every truth holds on a GPU and in numba's simulator of one.

`test_in_the_simulator` runs the tests below in a process of their own, where numba simulates the GPU, thread by thread
and in plain Python: slow, so the scenes are tiny there. `make test-gpu` runs the same tests on a GPU, on larger scenes.
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from dataclasses import replace
from typing import Any

import numba
import numpy as np
import pytest

from gns_pl.errors import InputError
from gns_pl.mpm import MPMConfig, SimulationError, has_cuda, simulate, simulate_batch
from gns_pl.mpm.grid import make_advance
from gns_pl.mpm.laws import LAWS
from gns_pl.mpm.plan import Plan, make_plan, make_setting, make_state
from gns_pl.scene import Body, Box, Plane, Scene, Terrain, Wall, fill_scene
from tests.mpm.conftest import make_box, make_mpm, make_sand

SIMULATED = bool(numba.config.ENABLE_CUDASIM)


@pytest.fixture(autouse=True)
def _no_thread_for_a_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the simulator run a block, here of one thread, where it stands, five times as fast as in a real thread."""
    if not SIMULATED:
        return
    from numba.cuda.simulator import kernel

    def run(block: Any, place: tuple[int, ...], *arguments: Any) -> None:
        vars(threading.current_thread()).update(blockIdx=kernel.Dim3(*place), threadIdx=kernel.Dim3(0, 0, 0))
        block._f(*arguments)

    monkeypatch.setattr(kernel.BlockManager, "run", run)


def on_gpu(test: Any) -> Any:
    return pytest.mark.gpu(pytest.mark.skipif(not has_cuda(), reason="numba finds no CUDA device")(test))


DIMS = pytest.mark.parametrize("dim", [2, 3])
CELL = 0.1 if SIMULATED else 0.025
INTERVAL = 0.0025


def make_scene(dim: int, name: str = "box", **changes: Any) -> Scene:
    """Two materials in the corners of a small box, moving, against walls, a slope and a block."""
    heavy = make_sand(density=2700.0, friction_angle_deg=40.0, dilation_angle_deg=10.0, cohesion=200.0)
    bodies = (
        Body((0.0,) * dim, (0.1,) * dim, (1.0,) + (-0.5,) * (dim - 1)),
        Body((0.25,) * dim, (0.15,) * dim, (1.0,) * dim, "heavy"),
    )
    slope = Plane((0.06,) + (0.0,) * (dim - 1), (-0.6,) + (0.0,) * (dim - 2) + (0.8,), Wall("friction", 0.3))
    block = Box((0.35,) * dim, (0.05,) * dim, Wall("stick"))
    scene = make_box((0.4,) * dim, bodies[0], duration=2 * INTERVAL, wall=Wall("friction", 0.4), upper_x=Wall("stick"))
    materials = {"sand": make_sand(), "heavy": heavy}
    scene = scene.replace(name=name, bodies=bodies, materials=materials, obstacles=(slope, block))
    return scene.replace(**changes)


def make_bare(dim: int, name: str = "bare", **changes: Any) -> Scene:
    """One stiffer material in a longer box without obstacles: another grid, and more steps in a frame."""
    body = Body((0.05,) * dim, (0.15,) * dim, (0.5,) * dim)
    box = (0.6,) + (0.3,) * (dim - 1)
    scene = make_box(box, body, duration=INTERVAL, material=make_sand(youngs_modulus=8e6), wall=Wall("friction", 0.2))
    return scene.replace(name=name, **changes)


def make_config(**changes: Any) -> MPMConfig:
    return make_mpm(**({"cell_size": CELL, "points_per_direction": 2, "jitter": 0.5} | changes))


def make_run(scene: Scene, config: MPMConfig) -> tuple[Plan, tuple[Any, ...]]:
    particles = fill_scene(scene, config.spacing, jitter=config.jitter, generator=np.random.default_rng(0))
    plan = make_plan(scene, particles, config, INTERVAL)
    return plan, make_state(scene, particles, plan.grid, config)


@on_gpu
@DIMS
@pytest.mark.parametrize(
    ("changes", "tolerance"),
    [
        ({}, 1e-10),
        ({"transfer": "apic", "local_damping": 0.1}, 1e-10),
        *([] if SIMULATED else [({"shape": "linear"}, 1e-10)]),  # spares the compilation of its CPU kernel
        ({"precision": "float32"}, 1e-5),
    ],
)
def test_two_frames_equal_the_cpu_in_double_precision(dim: int, changes: dict[str, Any], tolerance: float) -> None:
    from gns_pl.mpm.batch import Batch

    plan, state = make_run(make_scene(dim), make_config(**changes))
    batch = Batch([plan], [state[:8]])
    for _ in range(2):
        assert not batch.advance([plan.steps]).any()
    config = replace(plan.config, precision="float64")
    twin, exact = make_run(plan.scene, config)
    advance = make_advance(config.shape, config.precision, False)
    advance(*exact, *make_setting(twin.scene, twin.grid, config, twin.dt), 1, 2 * twin.steps)
    for name, got, expected in zip(("position", "velocity", "affine", "stress"), batch.state(0), exact, strict=False):
        assert got.dtype == plan.config.precision
        size = np.abs(expected).max()
        assert size > 0
        assert np.abs(got - expected).max() < tolerance * size, name
    assert np.abs(batch.places()[:, list(plan.grid.axes)] - twin.place(exact[0])).max() < max(1e-7, tolerance)


@on_gpu
@DIMS
def test_ground_gives_what_it_gives_on_the_cpu_beside_scenes_without(dim: int) -> None:
    heights = 0.05 + np.random.default_rng(2).uniform(-0.02, 0.02, (6, 6)[: dim - 1])
    ground = Terrain(heights, (-0.04,) * (dim - 1), 0.1, Wall("friction", 0.3))
    scene = make_scene(dim, duration=INTERVAL, terrain=ground)
    config = make_config()
    there = simulate_batch([make_bare(dim), scene], config, frame_interval=INTERVAL, seeds=[5, 6])[1]
    here = simulate(scene, config, frame_interval=INTERVAL, seed=6)
    assert np.abs(there.position - here.position).max() < 1e-6
    if dim == 2:
        bare = simulate(scene.replace(terrain=None), config, frame_interval=INTERVAL, seed=6)
        assert bare.num_particles > here.num_particles  # the ground carves the body on the floor


@on_gpu
@pytest.mark.parametrize("dim", [2] if SIMULATED else [2, 3])
def test_a_scene_does_not_depend_on_its_batch(dim: int) -> None:
    scenes = [make_bare(dim), make_scene(dim), make_bare(dim, "later", duration=2 * INTERVAL)]
    config = make_config()
    seen: list[tuple[int, int]] = []
    together = simulate_batch(
        scenes, config, frame_interval=INTERVAL, seeds=[5, 6, 7], on_frame=lambda *at: seen.append(at)
    )
    assert seen == [(0, 3), (1, 3), (2, 3)]
    assert [run.num_frames for run in together] == [2, 3, 3]
    assert together[0].provenance["time_step"] != together[1].provenance["time_step"]
    for scene, seed, run in zip(scenes, [5, 6, 7], together, strict=True):
        alone = simulate(scene, config, frame_interval=INTERVAL, seed=seed, device="cuda")
        assert alone.provenance == run.provenance
        assert np.abs(alone.position - run.position).max() <= (0 if SIMULATED else 1e-7)


@on_gpu
def test_a_trajectory_is_the_one_of_the_cpu() -> None:
    there, here = (
        simulate(make_scene(2), make_config(), frame_interval=INTERVAL, seed=3, device=device)
        for device in ("cuda", "cpu")
    )
    assert np.abs(there.position - here.position).max() < 1e-6
    assert np.array_equal(there.mass, here.mass)
    assert {**there.provenance, "device": "cpu", "num_threads": 1} == {
        **here.provenance,
        "gpu": there.provenance["gpu"],
    }
    assert there.provenance["device"] == "cuda"


def weak(pressure, root_j2, shear_rate, dt, shear, bulk, friction_slope, cohesion_intercept, dilation_slope, tension):  # type: ignore[no-untyped-def]
    """A law of one's own: half the friction, and more where it flows fast."""
    if pressure <= 0.0:
        return pressure, 0.0
    slope = 0.5 * friction_slope * (1.0 + 0.01 * shear_rate)
    return pressure, min(1.0, slope * pressure / max(root_j2, 1e-9))


@on_gpu
def test_a_law_of_ones_own_gives_what_it_gives_on_the_cpu(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(LAWS, "weak", weak)
    config = make_config(law="weak")
    there, here, other = (
        simulate(make_scene(2), settings, frame_interval=INTERVAL, seed=3, device=device).position
        for settings, device in ((config, "cuda"), (config, "cpu"), (make_config(), "cpu"))
    )
    assert np.abs(there - here).max() < 1e-6
    assert np.abs(there - other).max() > 1e-6


@on_gpu
@DIMS
def test_the_grid_has_the_mass_of_the_points(dim: int) -> None:
    from gns_pl.mpm.batch import Batch

    runs = [make_run(scene, make_config()) for scene in (make_scene(dim), make_bare(dim))]
    batch = Batch([plan for plan, _ in runs], [state[:8] for _, state in runs])
    batch.advance([2, 2])
    mass = batch._grid.copy_to_host()[:, 3]
    parts = np.split(mass, [int(np.prod(runs[0][0].grid.nodes))])
    for (_, state), part in zip(runs, parts, strict=True):
        assert part.sum() == pytest.approx(state[4].sum(), rel=1e-12)


@on_gpu
def test_sorting_puts_the_points_of_a_cell_together_and_changes_nothing() -> None:
    from gns_pl.mpm.batch import Batch

    runs = [make_run(scene, make_config(jitter=0.9)) for scene in (make_scene(3), make_bare(3))]
    batch = Batch([plan for plan, _ in runs], [state[:8] for _, state in runs])
    before = batch.places()
    batch.advance([0, 0])
    assert np.array_equal(batch.places(), before)
    for index, (_, state) in enumerate(runs):
        for array, same in zip(batch.state(index), state, strict=False):
            assert np.array_equal(array, same)
    scene, _, position = (array.copy_to_host() for array in batch._points[:3])
    home = np.column_stack([scene, position.astype(int)])
    changes = 1 + np.any(home[1:] != home[:-1], axis=1).sum()
    assert changes == len(np.unique(home, axis=0))


@on_gpu
def test_a_failure_is_told_as_on_the_cpu_and_names_the_scene() -> None:
    config = make_config(courant=50, allow_large_courant=True)
    good = make_box((0.4, 0.4), Body((0.1, 0.1), (0.1, 0.1), (0.0, 0.0)), duration=0.1, gravity=(0.0, 0.0))
    bad = make_scene(2, "bad", duration=0.6)
    with pytest.raises(SimulationError, match=r"'bad'.*unstable") as here:
        simulate(bad, config, frame_interval=0.3)
    with pytest.raises(SimulationError, match=r"'bad'.*unstable.* in step \d+ at .* s, point \d+ at") as there:
        simulate_batch([good, bad], config, frame_interval=0.3, seeds=[0, 0])
    if SIMULATED:  # a run that blows up blows up the differences of rounding too
        assert str(there.value) == str(here.value)


@pytest.mark.parametrize("chosen", ["not changes0", pytest.param("changes0", marks=pytest.mark.slow)])
def test_in_the_simulator(chosen: str) -> None:
    """The tests above, see there; `changes0` is the slowest."""
    command = [sys.executable, "-m", "pytest", "-m", "gpu", "-k", chosen, "-p", "no:cacheprovider", __file__]
    environment = os.environ | {"NUMBA_ENABLE_CUDASIM": "1"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "skipped" not in done.stdout
    print(done.stdout)


def test_without_a_gpu_a_sentence_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("numba.cuda.is_available", lambda: False)
    with pytest.raises(InputError, match=r"^mpm: numba finds no CUDA device; choose device=cpu, or, .* install"):
        simulate(make_scene(2), make_config(), frame_interval=INTERVAL, device="cuda")
    with pytest.raises(InputError, match="device must be one of cpu, cuda, not 'gpu'"):
        simulate(make_scene(2), make_config(), frame_interval=INTERVAL, device="gpu")


def test_a_batch_is_checked() -> None:
    with pytest.raises(InputError, match="2 scenes need as many seeds, not 1"):
        simulate_batch([make_scene(2), make_bare(2)], make_config(), frame_interval=INTERVAL, seeds=[0])
    with pytest.raises(InputError, match="all be of one dimension"):
        simulate_batch([make_scene(2), make_scene(3)], make_config(), frame_interval=INTERVAL, seeds=[0, 0])
    assert simulate_batch([], make_config(), frame_interval=INTERVAL, seeds=[]) == []
