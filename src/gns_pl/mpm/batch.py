"""Scenes in the memory of a GPU: laid out behind each other, sorted by cell before every frame, stepped all at once."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import Any

import numba
import numpy as np
from numba import cuda
from numpy.typing import NDArray

from gns_pl.mpm.cuda import FIRST_NODE, LEFT, make_kernels
from gns_pl.mpm.laws import find_law
from gns_pl.mpm.plan import Plan, make_setting, num_surfaces

THREADS = 1 if numba.config.ENABLE_CUDASIM else 128
"""In a block; numba's simulator cannot run device functions on several at a time."""

CHANGING = 4
"""The first arrays of a state, which a step changes: position, velocity, affine, stress."""

State = tuple[NDArray[Any], ...]


def gpu_name() -> str:
    """Return the name of the GPU in use."""
    if numba.config.ENABLE_CUDASIM:
        return "simulator"
    name = cuda.get_current_device().name
    return name.decode() if isinstance(name, bytes) else str(name)


class Batch:
    """Scenes of one dimension and configuration on the GPU.

    Each keeps its own grid, time step and number of steps in a frame; one that has made its steps rests until the
    others have made theirs.

    The points are sorted at the start of a frame into a second set of arrays, so that the first keeps what was before
    the frame. One sorting costs about as much as a step, and in the some tens of steps of a frame points hardly leave
    the cells of their neighbours.

    Args:
        plans: of the scenes.
        states: from `plan.make_state`, of which only points and materials are used.
    """

    def __init__(self, plans: Sequence[Plan], states: Sequence[State]) -> None:
        self.plans = tuple(plans)
        config, dim = plans[0].config, plans[0].scene.dim
        terrain = any(plan.scene.terrain is not None for plan in plans)
        self._kernels = make_kernels(config.shape, config.precision, dim, find_law(config.law), terrain)
        self.first = np.cumsum([0, *(len(state[0]) for state in states)])
        self.num_points = int(self.first[-1])
        self._points = [cuda.to_device(array) for array in _join_points(states)]
        self._before = [cuda.device_array_like(array) for array in self._points]
        self._materials = cuda.to_device(np.concatenate([state[7] for state in states]))
        whole, measure, friction, obstacles, box, largest = _tables(self.plans)
        self._setting = [cuda.to_device(array) for array in (whole, measure, friction, obstacles)]
        self._box, self._largest = cuda.to_device(box), cuda.to_device(largest)
        self.num_nodes = int(whole[-1, FIRST_NODE])
        real = np.dtype(config.precision)
        self._node_scene = cuda.to_device(
            np.repeat(np.arange(len(plans), dtype=np.int32), np.diff(whole[:, FIRST_NODE]))
        )
        self._grid = cuda.device_array((self.num_nodes, 8), dtype=real)
        self._gap = cuda.device_array((self.num_nodes, 3 + _most_obstacles(self.plans)), dtype=real)
        self._count = cuda.device_array(self.num_nodes, dtype=np.int32)
        self._free = cuda.device_array(1, dtype=np.int32)
        self._place = cuda.device_array((self.num_points, 3), dtype=np.float32)
        self._flags = cuda.device_array((len(plans), 2), dtype=np.int32)
        self._steps = cuda.device_array(len(plans), dtype=np.int32)

    def advance(self, steps: Sequence[int]) -> NDArray[np.int32]:
        """Make a frame.

        Args:
            steps: of each scene in this frame.

        Returns:
            [S, 2] number of coordinates put back into the box (`LEFT`) and whether a point is too fast, or its velocity
            not finite, at the end (`FAST`).
        """
        self._sort()
        scene, _, *changing, mass, volume, material_index = self._points
        position, velocity, affine, stress = changing
        whole, measure, friction, obstacles = self._setting
        self._steps.copy_to_device(np.array(steps, dtype=np.int32))
        self._flags.copy_to_device(np.zeros((len(self.plans), 2), dtype=np.int32))
        clear, move = self._on_nodes("clear_node"), self._on_nodes("move_one_node")
        scatter, gather = self._on_points("scatter_point"), self._on_points("gather_point")
        for step in range(max(steps)):
            clear(step, self._steps, self._node_scene, self._grid, self._gap)
            scatter(
                step, self._steps, scene, position, velocity, affine, stress, mass, volume, material_index,
                self._materials, self._grid, self._gap, whole, measure, obstacles,
            )  # fmt: skip
            move(step, self._steps, self._node_scene, self._grid, self._gap, whole, measure, friction, obstacles)
            gather(
                step, self._steps, scene, position, velocity, affine, stress, material_index, self._materials,
                self._grid, whole, measure, obstacles, self._flags,
            )  # fmt: skip
        self._on_points("judge_point")(scene, velocity, self._largest, self._flags)
        return np.asarray(self._flags.copy_to_host())

    def places(self) -> NDArray[np.float32]:
        """Return the positions [N, 3] of all scenes' points in their order at the start [m]."""
        scene, original, position = self._points[:3]
        self._on_points("place_point")(scene, original, position, self._box, self._place)
        return np.asarray(self._place.copy_to_host())

    def state(self, index: int, *, before: bool = False) -> list[NDArray[Any]]:
        """Return position, velocity, affine and stress of one scene in its order at the start, as in `transfer`.

        Args:
            index: of the scene.
            before: the last frame, instead of now.
        """
        arrays = self._before if before else self._points
        original = arrays[1].copy_to_host()
        order = np.argsort(original)[self.first[index] : self.first[index + 1]]
        return [np.ascontiguousarray(array.copy_to_host()[order]) for array in arrays[2 : 2 + CHANGING]]

    def replay(self, index: int, start: State) -> tuple[State, Callable[[], int]]:
        """Return one scene's state before the last frame, and what makes one step of it in place, on its own.

        Args:
            index: of the scene.
            start: its state at the start.
        """
        state: State = (*self.state(index, before=True), *start[CHANGING:])
        alone = Batch([self.plans[index]], [state])

        def make_step() -> int:
            flags = alone.advance([1])
            for array, new in zip(state, alone.state(0), strict=False):
                array[:] = new
            return int(flags[0, LEFT])

        return state, make_step

    def _sort(self) -> None:
        whole, (scene, _, position) = self._setting[0], self._points[:3]
        self._on_nodes("clear_counts")(self._count, self._free)
        self._on_points("count_points")(scene, position, whole, self._count)
        self._on_nodes("claim_places")(self._count, self._free)
        self._on_points("carry_point")(whole, self._count, *self._points, *self._before)
        self._points, self._before = self._before, self._points

    def _on_points(self, name: str) -> Any:
        return self._launcher(name, self.num_points)

    def _on_nodes(self, name: str) -> Any:
        return self._launcher(name, self.num_nodes)

    def _launcher(self, name: str, number: int) -> Any:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="Grid size")  # numba's advice on small scenes, every time anew
            return self._kernels[name][-(-number // THREADS), THREADS]


def _most_obstacles(plans: Sequence[Plan]) -> int:
    return max(num_surfaces(plan.scene) for plan in plans)


def _join_points(states: Sequence[State]) -> list[NDArray[Any]]:
    """Return scene and original index, position, velocity, affine, stress, mass, volume and material of all points.

    Arrays with several components have one component after the other in memory.
    """
    sizes = [len(state[0]) for state in states]
    floating = [np.concatenate([state[i] for state in states]) for i in range(6)]
    before = np.cumsum([0, *(len(state[7]) for state in states)])
    material_index = np.concatenate([state[6] + first for state, first in zip(states, before, strict=False)])
    return [
        np.repeat(np.arange(len(states), dtype=np.int32), sizes),
        np.arange(sum(sizes), dtype=np.int32),
        *(np.asfortranarray(array) for array in floating),
        material_index.astype(np.int32),
    ]


def _tables(plans: Sequence[Plan]) -> tuple[NDArray[Any], ...]:
    """Return the tables of `cuda`, obstacles [O + 1, 8 or more], `box` [S, 6] and `largest` [S]."""
    whole, measure, friction, obstacles, box = [], [], [], [], []
    first_node = first_obstacle = 0
    for plan in plans:
        grid = plan.grid
        setting = make_setting(plan.scene, grid, plan.config, plan.dt)
        cells, nodes, inverse_cell, gravity, rubbing, radius, table, _, *rest = setting
        whole.append([*cells, *nodes, first_node, first_obstacle])
        measure.append([*inverse_cell, *gravity, *radius, *rest])
        friction.append(rubbing)
        obstacles.append(table)
        box.append([*grid.lower, *grid.cell])
        first_node += nodes[0] * nodes[1] * nodes[2]
        first_obstacle += len(table)
    whole.append([0] * 6 + [first_node, first_obstacle])
    obstacles.append(np.zeros_like(obstacles[0], shape=(1, 8)))  # no array on the GPU is empty
    width = max(table.shape[1] for table in obstacles)
    obstacles = [np.pad(table, ((0, 0), (0, width - table.shape[1]))) for table in obstacles]
    return (
        np.array(whole, dtype=np.int64),
        np.array(measure, dtype=plans[0].config.precision),
        np.stack(friction),
        np.concatenate(obstacles),
        np.array(box),
        np.array([plan.speed_limit for plan in plans]),
    )
