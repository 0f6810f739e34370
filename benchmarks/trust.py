"""Whether a learned run can be told to be wrong without MPM: what is known early against the true error, many scenes.

    OMP_NUM_THREADS=1 NUMBA_NUM_THREADS=1 python benchmarks/trust.py --members CKPT …    # as in docs/trust.md
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gns_pl.scene import Body, Material, Scene, Wall

SAND = Material(
    density=1800, youngs_modulus=2e6, poisson_ratio=0.3, friction_angle_deg=30, cohesion=100, tension_cutoff=50
)
FRICTION, GRAVITY = 0.385, 9.81


@dataclass(frozen=True)
class Trial:
    """A scene to be judged on.

    Attributes:
        group: what of it may be beyond the data.
        scene: the scene.
        coarseness: spacing over that of the data.
    """

    group: str
    scene: Scene
    coarseness: float = 1.0


def scene_of(
    name: str,
    bodies: list[Body],
    *,
    box: tuple[float, float],
    duration: float,
    floor: Wall | None = None,
    tilt: float = 0.0,
    gravity: float = GRAVITY,
    angle: float = 30.0,
) -> Scene:
    """Return a scene in plane strain; `tilt` [degrees] turns gravity towards x+, `angle` is the sand's friction."""
    rough = Wall("friction", FRICTION)
    tilt = math.radians(tilt)
    sand = Material(**{**vars(SAND), "friction_angle_deg": angle})
    return Scene(
        name=name, lower=(0.0, 0.0), upper=box, duration=0.02 * math.ceil(duration / 0.02),
        gravity=(gravity * math.sin(tilt), -gravity * math.cos(tilt)), materials={"sand": sand}, bodies=tuple(bodies),
        walls={"x-": rough, "x+": rough, "z-": floor or rough, "z+": rough},
    )  # fmt: skip


def column(name: str, length: float, ratio: float, taus: float = 7.0, **other: object) -> Scene:
    """Return a column against the x- wall in a box that it cannot cross."""
    height = length * ratio
    box = (max(2.5, length * (1.5 + 3 * ratio)), max(1.1, height + 0.2))
    taken = taus * math.sqrt(height / float(other.get("gravity", GRAVITY)))  # type: ignore[arg-type]
    body = Body((0.0, 0.0), (length, height), (0.0, 0.0))
    return scene_of(name, [body], box=box, duration=taken, **other)  # type: ignore[arg-type]


def trials() -> Iterator[Trial]:
    """Yield the scenes, those of a group one after the other, drawn from a seed."""
    draw = np.random.default_rng(5).uniform
    for number in range(14):
        yield Trial("inside", column(f"inside_column_{number}", draw(0.22, 0.36), [0.5, 1, 1.5, 2.5, 3.5, 0.7, 2][number % 7] * draw(0.95, 1.05)))  # fmt: skip  # noqa: E501
    for number in range(6):
        length = draw(0.2, 0.35)
        body = Body((draw(0.2, 0.8), 0.0), (length, length * draw(0.6, 1.7)), (0.0, 0.0))
        yield Trial("inside", scene_of(f"inside_block_{number}", [body], box=(1.5, 1.0), duration=1.2))
    for number in range(6):
        side = draw(0.25, 0.4)
        body = Body((draw(0.1, 0.5), draw(0, 0.2)), (side, side), (draw(-1, 1), draw(-1, 1)))
        yield Trial("inside", scene_of(f"inside_drop_{number}", [body], box=(1.0, 1.0), duration=1.0))
    for number, ratio in enumerate((0.3, 0.3, 4.5, 4.5, 5.0, 5.0, 6.0, 6.0)):
        length = draw(0.3, 0.5) if ratio < 1 else draw(0.2, 0.24)
        yield Trial("aspect ratio", column(f"ratio_{number}", length, ratio))
    for number, (length, ratio) in enumerate(
        ((0.12, 1), (0.15, 1), (0.12, 2), (0.15, 2), (0.7, 0.5), (0.7, 1), (0.9, 0.5), (0.9, 1), (0.6, 2), (0.6, 1.5))
    ):
        yield Trial("size", column(f"size_{number}", length, ratio))
    for number, height in enumerate((0.35, 0.35, 0.5, 0.5, 0.7, 0.7, 0.9, 0.9)):
        side = draw(0.25, 0.4)
        body = Body((draw(0.4, 0.8), height), (side, side), (0.0, 0.0))
        yield Trial("drop height", scene_of(f"height_{number}", [body], box=(1.6, 1.4), duration=1.3))
    for number, speed in enumerate((1.7, 1.7, 2.5, 2.5, 3.5, 3.5, 4.5, 4.5)):
        side = draw(0.25, 0.4)
        body = Body((draw(0.1, 0.3), draw(0, 0.2)), (side, side), (speed, draw(-1, 0.5)))
        yield Trial("speed", scene_of(f"speed_{number}", [body], box=(2.5, 1.1), duration=1.2))
    floors = [Wall("slip"), Wall("slip"), *(Wall("friction", each) for each in (0.1, 0.1, 0.2, 0.2, 0.6, 0.6))]
    for number, floor in enumerate([*floors, Wall("stick"), Wall("stick")]):
        yield Trial("floor", column(f"floor_{number}", draw(0.25, 0.35), draw(0.8, 2.5), floor=floor))
    for number, tilt in enumerate((-15, -15, 5, 5, 10, 10, 15, 15, 20, 20)):
        yield Trial("tilt", column(f"tilt_{number}", draw(0.25, 0.35), draw(0.8, 2.5), tilt=tilt))
    for number, gravity in enumerate((1.62, 1.62, 3.7, 3.7, 20.0, 20.0)):
        yield Trial("gravity", column(f"gravity_{number}", draw(0.25, 0.35), draw(0.8, 2.5), gravity=gravity))
    for number, angle in enumerate((18, 18, 23, 23, 26, 26, 35, 35, 42, 42)):
        yield Trial("sand", column(f"sand_{number}", draw(0.25, 0.35), draw(0.8, 2.5), angle=angle))
    for number in range(8):
        length, gap = draw(0.22, 0.3), draw(0.05, 0.5)
        first = Body((0.0, 0.0), (length, length * draw(0.8, 2)), (0.0, 0.0))
        corner = (length + gap, 0.0) if number // 2 % 2 else (draw(0.0, length), first.size[1] + draw(0.05, 0.2))
        second = Body(corner, (draw(0.2, 0.3), draw(0.2, 0.3)), (0.0, 0.0))
        yield Trial("two bodies", scene_of(f"bodies_{number}", [first, second], box=(2.5, 1.3), duration=1.4))
    for number, coarseness in enumerate((0.8, 0.8, 0.9, 0.9, 1.1, 1.1, 1.2, 1.2)):
        scene = column(f"spacing_{number}", draw(0.25, 0.4), draw(0.6, 3.0))
        yield Trial("spacing", scene, coarseness)
