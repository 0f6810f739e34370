"""What every reader returns: a foreign set, its recordings, and what the source says of itself."""

from __future__ import annotations

import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gns_pl.errors import InputError
from gns_pl.fields import ParticleType
from gns_pl.scene import Scene

UNCERTAIN_MATERIAL = "material_property"
"""Name of a material feature of which the source does not say whether it is tan φ, φ or a share of it."""
MOST_TYPES = 1000
"""Numbers of particle types beyond ± this are taken for damage."""


@dataclass(frozen=True)
class Stated:
    """What a source says of itself, in its own units and axes; None where it does not.

    Attributes:
        dt: time between frames [s].
        lower: lower corner of the box [D].
        upper: upper corner of the box [D].
        gravity: acceleration of gravity [D].
        spacing: distance of neighbouring particles.
        density: [kg/m³].
        friction_angle_deg: of the material [degrees].
        radius: connectivity radius its models use.
        periodic: whether each axis is periodic [D]; empty if nothing is said.
        origin: what an earlier conversion took off all positions, to be added on a map [D]; empty for nothing.
        metadata: the file beside the data, as it is: metadata.json, or a manifest of ours.
        questions: name of an argument → sentence that asks for it where it is not given.
        notes: sentences for the report.
    """

    dt: float | None = None
    lower: tuple[float, ...] | None = None
    upper: tuple[float, ...] | None = None
    gravity: tuple[float, ...] | None = None
    spacing: float | None = None
    density: float | None = None
    friction_angle_deg: float | None = None
    radius: float | None = None
    periodic: tuple[bool, ...] = ()
    origin: tuple[float, ...] = ()
    metadata: Mapping[str, Any] = field(default_factory=dict)
    questions: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Recording:
    """One trajectory of a foreign set, its frames read when they are asked for.

    Attributes:
        num_frames: T.
        particle_type: [N] as in the source.
        read: first frame, frame behind the last → positions [n, N, D] in the source's units.
        dim: D.
        material: [N, K].
        material_features: names of the K features.
        initial_velocity: at the first frame [N, D], length units of the source per second; None if it does not say.
        mass: [N] [kg]; None if the source does not say.
        dtype: of the positions in the source.
        notes: sentences for the report.
        stated: what the source says of this trajectory alone; what it leaves open is as in the whole set.
        scene: what was simulated, where the source has it as ours do.
        provenance: how it was made, where the source says so.
    """

    num_frames: int
    particle_type: NDArray[np.int64]
    read: Callable[[int, int], NDArray[Any]]
    dim: int
    material: NDArray[np.float32]
    material_features: tuple[str, ...] = ()
    initial_velocity: NDArray[np.float64] | None = None
    mass: NDArray[np.float64] | None = None
    dtype: str = "float32"
    notes: tuple[str, ...] = ()
    stated: Stated | None = None
    scene: Scene | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.num_frames < 1 or len(self.particle_type) < 1:
            raise InputError(f"holds {self.num_frames} frames of {len(self.particle_type)} particles; it needs both.")
        if self.dim not in (2, 3):
            raise InputError(f"holds positions of {self.dim} components; gns_pl knows 2 and 3 dimensions.")
        if not np.isfinite(self.material).all():
            raise InputError("holds material features that are not finite.")
        if self.initial_velocity is not None and not np.isfinite(self.initial_velocity).all():
            raise InputError("holds initial velocities that are not finite.")
        if self.mass is not None and not (np.isfinite(self.mass).all() and (self.mass > 0).all()):
            raise InputError("holds masses that are not positive.")

    @property
    def num_particles(self) -> int:
        """N."""
        return len(self.particle_type)

    @property
    def moved(self) -> NDArray[np.bool_]:
        """[N]: all but the kinematic particles."""
        return np.asarray(self.particle_type != int(ParticleType.KINEMATIC))

    def frames(self, start: int, stop: int) -> NDArray[Any]:
        """Return checked positions of frames `start` to `stop` − 1 [n, N, D], in the source's units and type.

        Raises:
            InputError: another number of particles or axes than announced, no real numbers, or numbers not finite.
        """
        stop = min(stop, self.num_frames)
        position = np.asarray(self.read(start, stop))
        wanted = (stop - start, self.num_particles, self.dim)
        if position.dtype.kind != "f" or position.dtype.itemsize not in (2, 4, 8):
            raise InputError(f"positions must be floating-point numbers, not {position.dtype}.")
        if position.shape != wanted:
            raise InputError(f"frames {start} to {stop - 1} have the shape {position.shape}, not {wanted}.")
        finite = np.isfinite(position).all(axis=(1, 2))
        if not finite.all():
            raise InputError(f"positions are not finite from frame {start + int(np.argmin(finite))} on.")
        return position


@dataclass(frozen=True)
class ForeignSet:
    """A foreign source.

    Attributes:
        kind: the format, in words.
        path: file or folder.
        names: split ("train", "valid", "test", or "" where the source has none) and name of every recording.
        open: number of a recording → the recording, for as long as the block lasts.
        stated: what the source says of itself.
        of_split: split → what it says of that split alone, where splits differ.
        si: its units are metres, seconds and kilograms by definition.
    """

    kind: str
    path: Path
    names: tuple[tuple[str, str], ...]
    open: Callable[[int], AbstractContextManager[Recording]]
    stated: Stated
    of_split: Mapping[str, Stated] = field(default_factory=dict)
    si: bool = False

    def __post_init__(self) -> None:
        if not self.names:
            raise InputError(f"{self.path}: holds no trajectory.")

    @contextmanager
    def recording(self, number: int) -> Iterator[Recording]:
        """Yield a recording; whatever goes wrong with it is an `InputError` that names it."""
        split, name = self.names[number]
        with reading(f"{self.path}, {name}"), self.open(number) as recording:
            own = recording.stated or self.of_split.get(split)
            yield recording if own is None else replace(recording, stated=own)


@contextmanager
def reading(what: str | Path) -> Iterator[None]:
    """Turn every way in which reading a foreign file fails into an `InputError` of one sentence that names it."""
    try:
        yield
    except InputError as error:
        text = str(error)
        raise (error if text.startswith(str(what)) else type(error)(f"{what}: {text}")) from error
    except FileNotFoundError as error:
        raise InputError(f"{what}: no such file.") from error
    except PermissionError as error:
        raise InputError(f"{what}: may not be read.") from error
    except MemoryError as error:
        raise InputError(f"{what}: does not fit into memory; split it.") from error
    except (
        OSError, RuntimeError, KeyError, ValueError, TypeError, IndexError, AttributeError, ArithmeticError,
        EOFError, SyntaxError, struct.error, zipfile.BadZipFile, zlib.error,
    ) as error:  # fmt: skip
        raise InputError(f"{what}: is truncated, damaged or of another format.") from error


def checked_types(values: NDArray[Any], number: int) -> NDArray[np.int64]:
    """Return particle types [N] from numbers or one number for all.

    Args:
        values: [N], [N, 1] or a scalar.
        number: N.

    Raises:
        InputError: another number of them, or no whole numbers.
    """
    flat = np.asarray(values).reshape(-1)
    if flat.size not in (1, number):
        raise InputError(f"has {flat.size} particle types for {number} particles.")
    if flat.dtype.kind not in "iuf" or not (np.isfinite(flat) & (np.abs(flat.astype(np.float64)) <= MOST_TYPES)).all():
        raise InputError(f"particle types must be whole numbers of a few digits, not {flat.dtype}.")
    whole = flat.astype(np.int64)
    if (whole != flat).any():
        raise InputError("particle types must be whole numbers.")
    return np.array(np.broadcast_to(whole, number))


def checked_material(values: NDArray[Any], number: int) -> NDArray[np.float32]:
    """Return a material feature [N, 1] from numbers or one number for all.

    Args:
        values: [N], [N, 1] or a scalar.
        number: N.

    Raises:
        InputError: another number of them, or no real numbers.
    """
    flat = np.asarray(values).reshape(-1)
    if flat.size not in (1, number) or flat.dtype.kind not in "iuf":
        raise InputError(f"has {flat.size} material values of type {flat.dtype} for {number} particles.")
    return np.array(np.broadcast_to(flat.astype(np.float32), number))[:, None]


def without_material(number: int) -> NDArray[np.float32]:
    """Return material features of which there are none [N, 0]."""
    return np.zeros((number, 0), dtype=np.float32)
