"""Scenes, settings and states that the solver's tests share."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gns_pl.mpm import MPMConfig
from gns_pl.mpm.constitutive import material_row
from gns_pl.mpm.shape import WALL_REACH
from gns_pl.scene import FACES, Body, Material, Scene, Wall
from gns_pl.trajectory import Trajectory

SLIP = Wall("slip")
LAYERS: dict[int, tuple[int, ...]] = {2: (0,), 3: (0, 1, 2)}


def make_mpm(**changes: Any) -> MPMConfig:
    values: dict[str, Any] = {
        "cell_size": 1 / 12,
        "points_per_direction": 4,
        "courant": 0.3,
        "transfer": "affine_flip",
        "damping_rate": 20.0,
        "bulk_viscosity": 0.3,
        "jitter": 0.0,
    }
    return MPMConfig(**(values | changes))


def make_sand(**changes: Any) -> Material:
    values: dict[str, Any] = {
        "density": 1800.0,
        "youngs_modulus": 2e6,
        "poisson_ratio": 0.3,
        "friction_angle_deg": 30.0,
    }
    return Material(**(values | changes))


def make_elastic(**changes: Any) -> Material:
    """So strong that it stays elastic."""
    return make_sand(**({"cohesion": 1e12, "tension_cutoff": 1e12} | changes))


def make_box(
    domain: tuple[float, ...],
    *bodies: Body,
    duration: float,
    material: Material | None = None,
    gravity: tuple[float, ...] | None = None,
    wall: Wall = SLIP,
    **faces: Wall,
) -> Scene:
    """A box at the origin; `lower_z=…` and the like set single faces, `wall` the rest."""
    dim = len(domain)
    walls = dict.fromkeys(FACES[dim], wall)
    for name, condition in faces.items():
        side, axis = name.split("_")
        walls[axis + {"lower": "-", "upper": "+"}[side]] = condition
    return Scene(
        name="box",
        lower=(0.0,) * dim,
        upper=domain,
        gravity=gravity or (0.0,) * (dim - 1) + (-9.81,),
        duration=duration,
        materials={"sand": material or make_sand()},
        bodies=bodies,
        walls=walls,
    )


def energy(trajectory: Trajectory) -> NDArray[np.float64]:
    """Kinetic and potential energy of every frame [J]."""
    mass, gravity = trajectory.mass.astype(np.float64), np.array(trajectory.scene.gravity)
    kinetic = 0.5 * (mass[:, None] * trajectory.velocity() ** 2).sum(axis=(1, 2))
    potential: NDArray[np.float64] = -(trajectory.position @ gravity) @ mass
    return np.asarray(kinetic + potential)


def swelling(trajectory: Trajectory, bin_size: float = 1 / 12) -> float:
    """Mean height of the deposit over that of the same mass at the initial density: 1 if no volume was made or lost.

    The floor is cut into square bins. Material that fills a bin to the height v has its middle at v / 2.
    """
    final = trajectory.position[-1].astype(np.float64)
    edge = np.array(trajectory.scene.upper[:-1])
    counts = np.maximum(np.round(edge / bin_size).astype(int), 1)
    index = tuple(np.minimum((final[:, :-1] / edge * counts).astype(int), counts - 1).T)
    height = np.zeros(counts)
    np.add.at(height, index, trajectory.mass / 1800.0)
    height /= np.prod(edge / counts)
    return float(final[:, -1].sum() / (0.5 * height[index]).sum())


@dataclass
class Points:
    """Random points in a small grid, as the kernels want them."""

    dim: int
    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    affine: NDArray[np.float64]
    stress: NDArray[np.float64]
    mass: NDArray[np.float64]
    volume: NDArray[np.float64]
    cells: tuple[int, int, int]
    nodes: tuple[int, int, int]
    cell: tuple[float, float, float]
    grid: NDArray[np.float64]
    gap: NDArray[np.float64]

    @property
    def acting(self) -> NDArray[np.float64]:
        """[N, 3] [m], where the points act on the grid: no nearer to a wall than `WALL_REACH`."""
        lowest = np.where(np.array(self.cells) > 0, WALL_REACH, 0.0)
        inside = np.clip(self.position, lowest, np.array(self.cells) - lowest)
        return np.asarray(inside * np.array(self.cell))

    @property
    def index(self) -> NDArray[np.int64]:
        return np.zeros(len(self.mass), dtype=np.int64)

    @property
    def order(self) -> NDArray[np.int32]:
        return np.arange(len(self.mass), dtype=np.int32)

    @property
    def materials(self) -> NDArray[np.float64]:
        return material_row(make_sand(cohesion=100.0, tension_cutoff=50.0), 0.3, 1 / 12)[None]

    @property
    def inverse_cell(self) -> tuple[float, float, float]:
        return (1 / self.cell[0], 1 / self.cell[1], 1 / self.cell[2])

    @property
    def node_position(self) -> NDArray[np.float64]:
        """[M, 3] [m]."""
        axes = [np.arange(n) * edge for n, edge in zip(self.nodes, self.cell, strict=True)]
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def make_points(dim: int, number: int = 60, seed: int = 0, *, stressed: bool = False) -> Points:
    """Points all over the box, also in the half cells next to the walls; cells differ from axis to axis."""
    rng = np.random.default_rng(seed)
    cells = (5, 0, 6) if dim == 2 else (5, 4, 6)
    nodes = (6, 1, 7) if dim == 2 else (6, 5, 7)
    plane = np.array([1.0, 0.0 if dim == 2 else 1.0, 1.0])
    affine = rng.normal(size=(number, 3, 3)) * plane[:, None] * plane
    stress = np.zeros((number, 7))
    if stressed:
        stress[:] = rng.normal(size=(number, 7)) * 1e3
        stress[:, 2] = -stress[:, 0] - stress[:, 1]
        if dim == 2:
            stress[:, 3:5] = 0.0
    return Points(
        dim=dim,
        position=rng.uniform(0.02, 0.98, (number, 3)) * np.array(cells),
        velocity=rng.normal(size=(number, 3)) * plane,
        affine=affine.reshape(number, 9),
        stress=stress,
        mass=rng.uniform(1, 2, number),
        volume=rng.uniform(1e-3, 2e-3, number),
        cells=cells,
        nodes=nodes,
        cell=(0.1, 1.0 if dim == 2 else 0.15, 0.12),
        grid=np.zeros((math.prod(nodes), 8)),
        gap=np.full((math.prod(nodes), 3), math.inf),
    )
