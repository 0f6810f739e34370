"""`simulate`: a scene's layer, from frame to frame, as a trajectory of particles."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

import gns_pl
from gns_pl.errors import InputError
from gns_pl.fields import MATERIAL_FEATURES, ParticleType
from gns_pl.scene import Scene
from gns_pl.scene.arrays import encoded_array
from gns_pl.scene.extent import num_frames
from gns_pl.shallow.config import NUM_PARTICLES, ShallowConfig
from gns_pl.shallow.plan import (
    Floats,
    Grid,
    Ground,
    make_grid,
    make_ground,
    make_layer,
    unsupported_reason,
    with_bodies,
)
from gns_pl.shallow.terrain import lift_onto_terrain, mean_heights
from gns_pl.trajectory import Trajectory

THIN = 0.5
"""A thinner layer has no velocity on a map, in spacings of the particles: nobody calls such a cell reached."""


class Layer:
    """A layer on a grid that goes on from time to time.

    Args:
        grid: its cells.
        ground: what it flows over.
        thickness: at the start [C] [m].
        momentum: thickness times velocity, along x and y [2, C] [m²/s].
        rain: thickness that falls onto every cell [C] [m]; None for none.
        fall: gravity of the fall [m/s²].
        courant: Courant number.

    Attributes:
        time: reached [s].
        num_steps: taken.
        at_rest: True once nothing will ever move again.
    """

    def __init__(
        self,
        grid: Grid,
        ground: Ground,
        thickness: Floats,
        momentum: Floats,
        *,
        rain: Floats | None = None,
        fall: float = 9.81,
        courant: float = 0.45,
    ) -> None:
        self.grid, self.ground, self.courant, self.fall = grid, ground, courant, fall
        self.thickness = np.array(thickness, dtype=np.float64)
        self.momentum = np.array(momentum, dtype=np.float64)
        self.rain = np.zeros_like(self.thickness) if rain is None else rain
        self.time, self.num_steps, self.at_rest = 0.0, 0, False

    @property
    def falling(self) -> Floats:
        """Thickness that has not come down yet [C] [m]."""
        return np.maximum(self.rain - 0.5 * self.fall * self.time**2, 0.0)

    def speed(self, least: float) -> Floats:
        """Return the speed along the ground of all cells where the layer is at least so thick [m], else 0 [C] [m/s]."""
        along, across = self.momentum / np.where(self.thickness < least, np.inf, self.thickness)
        up = np.zeros_like(along)
        if len(self.ground.curve):
            up = along * self.ground.curve[:, 0] + across * self.ground.curve[:, 1]
        return np.asarray(np.sqrt(along**2 + across**2 + up**2))

    def advance(self, end: float) -> None:
        """Go on to a time [s].

        Raises:
            FloatingPointError: a thickness became negative or not finite, however short the step.
        """
        from gns_pl.shallow.stepping import advance

        if not self.at_rest:
            state = (self.thickness, *self.momentum)
            ground = tuple(
                getattr(self.ground, name) for name in ("bed", "gravity", "friction", "curve", "drag", "cliff")
            )
            settings = (self.rain, self.fall, self.grid.shape, self.grid.sizes, self.courant, self.time, end)
            steps, self.at_rest = advance(state, ground, *settings)
            if steps < 0:
                raise FloatingPointError(f"shallow: the layer failed between {self.time:.4g} and {end:.4g} s.")
            self.num_steps += steps
        self.time = end


def make_start(scene: Scene, config: ShallowConfig) -> Layer:
    """Return a scene's layer at the start.

    Raises:
        InputError: a scene that cannot be run; the sentence says why.
    """
    reason = unsupported_reason(scene)
    if reason is not None:
        raise InputError(f"scene {scene.name!r}: {reason}")
    grid = make_grid(scene, config.cell_size)
    ground = make_ground(scene, grid, config)
    thickness, *momentum, rain = make_layer(scene, grid, ground.height, config.rain)
    if not thickness.sum() + rain.sum() > 0:
        raise InputError(f"scene {scene.name!r}: obstacles leave nothing of its bodies; move them.")
    fall = -scene.gravity[-1]
    return Layer(grid, ground, thickness, np.array(momentum), rain=rain, fall=fall, courant=config.courant)


def simulate(scene: Scene, config: ShallowConfig, *, frame_interval: float, seed: int = 0) -> Trajectory:
    """Run `scene` from its start over its duration; the same arguments give the same bits on the same machine.

    Args:
        scene: what to simulate, in two or three dimensions.
        config: how.
        frame_interval: time between the frames kept [s].
        seed: of the shift of the particles that show the layer; the flow does not depend on it.

    Returns:
        round(duration / frame_interval) + 1 frames of particles of equal volume.

    Raises:
        InputError: a scene that cannot be run, or a frame interval that is not positive or longer than it.
    """
    from gns_pl.shallow.particles import hammersley, place

    number_of_frames = num_frames(scene, frame_interval)
    layer = make_start(scene, config)
    grid, height = layer.grid, layer.ground.height
    number = config.num_particles or NUM_PARTICLES[scene.dim]
    standing, means = layer.thickness.copy(), mean_heights(scene, grid)
    axes = [0, 2] if scene.dim == 2 else [0, 1, 2]
    frames = np.empty((number_of_frames, number, scene.dim), dtype=np.float32)
    shares, position = hammersley(number, seed), np.empty((number, 3))
    # At the start bodies end where they do and not where cells do; fronts are measured from there.
    exact = with_bodies(scene, grid)
    ground = height[grid.parents(exact)]
    start, _, _, rain = make_layer(scene, exact, ground, config.rain)
    place(shares, start, rain, start, ground, *exact.edges, position)
    lift_onto_terrain(scene, grid, height, means, position)
    volume = float((layer.thickness + layer.rain).sum()) * grid.sizes[0] * grid.sizes[1]
    thin = THIN * (volume / number) ** (1 / scene.dim)
    fastest = layer.speed(thin)
    frames[0] = position[:, axes]
    body = nearest_body(scene, position[:, axes])
    for frame in range(1, number_of_frames):
        if layer.at_rest:
            frames[frame] = frames[frame - 1]
            continue
        layer.advance(frame * frame_interval)
        np.maximum(fastest, layer.speed(thin), out=fastest)
        place(shares, layer.thickness, layer.falling, standing, height, *grid.edges, position)
        lift_onto_terrain(scene, grid, height, means, position)
        frames[frame] = position[:, axes]
    volume = float((layer.thickness + layer.falling).sum()) * grid.sizes[0] * grid.sizes[1]
    materials = [scene.materials[each.material] for each in scene.bodies]
    features = np.array([[getattr(material, name) for name in MATERIAL_FEATURES] for material in materials])
    return Trajectory(
        position=frames,
        particle_type=np.full(number, int(ParticleType.SAND)),
        material=features[body].astype(np.float32),
        material_features=MATERIAL_FEATURES,
        mass=np.full(number, volume / number * materials[0].density, dtype=np.float32),
        initial_velocity=np.array([each.velocity for each in scene.bodies], dtype=np.float32)[body],
        dt=frame_interval,
        scene=scene,
        provenance=provenance(config, layer, seed) | ({} if scene.terrain is None else velocity_map(grid, fastest)),
    )


def velocity_map(grid: Grid, fastest: Floats) -> dict[str, object]:
    """Return what a trajectory says about the layer's largest speed, which its particles do not show.

    Args:
        grid: the cells.
        fastest: largest speed of every cell in any frame [C] [m/s].
    """
    place = {"lower": [float(edges[0]) for edges in grid.edges], "sizes": list(grid.sizes)}
    return {"largest_velocity": {"values": encoded_array(np.round(fastest, 3).reshape(grid.shape)), **place}}


def provenance(config: ShallowConfig, layer: Layer, seed: int) -> dict[str, object]:
    """Return what a trajectory says about its making."""
    return {
        "solver": "gns_pl.shallow",
        "version": gns_pl.__version__,
        "config": asdict(config),
        "seed": seed,
        "num_steps": layer.num_steps,
        "cell": list(layer.grid.sizes),
        "at_rest": layer.at_rest,
    }


def nearest_body(scene: Scene, position: NDArray[Any]) -> NDArray[np.int64]:
    """Return in, or nearest to, which body every particle starts [N]."""
    distance = [
        np.linalg.norm(np.maximum(np.maximum(body.position - position, position - np.array(body.upper)), 0.0), axis=1)
        for body in scene.bodies
    ]
    return np.asarray(np.argmin(distance, axis=0))
