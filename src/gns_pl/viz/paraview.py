"""Trajectories as ParaView series: one VTK file per frame, and a list of them with their times.

Points in VTK's XML format are a short header and the bytes of the arrays, put together here: nothing needs to be
installed to write them. Two-dimensional trajectories lie in the plane y = 0. Points are in the coordinates that the
scene came from: its origin is added, in float64 where there is one.
"""

from __future__ import annotations

import glob
import math
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from gns_pl.errors import InputError
from gns_pl.io.atomic import remove_temporary_files, write_atomically
from gns_pl.scene import Scene
from gns_pl.trajectory import Trajectory
from gns_pl.viz.camera import in_space

CELLS = ("Verts", "Lines", "Strips", "Polys")
"""Kinds of cells that a file of points may hold."""

Array = NDArray[np.float32] | NDArray[np.float64] | NDArray[np.int32]


def write_paraview(
    folder: str | Path, trajectory: Trajectory, *, name: str, reference: Trajectory | None = None, every: int = 1
) -> Path:
    """Write `name`.pvd and its frames `name`_00000.vtp, `name`_00001.vtp, … into `folder`.

    A scene's terrain is in `name`_ground.vtp, a surface with its `height` [m], and part of every frame.

    Every frame holds the points [m] with `velocity` [m/s] (backward differences), `displacement` from frame 0 [m],
    `speed` [m/s], `mass` [kg], `particle_type`, each material feature and, with a reference, `error` = x − x_ref [m].
    The list is removed first and written last: a run that is killed leaves whole frames, and no list of them.

    Args:
        folder: made if it is not there; an earlier series of this name in it is replaced.
        trajectory: what to write.
        name: of the series, a word that can stand in a file name.
        reference: the same particles in the same frames; it may go on for longer.
        every: stride of the frames that are written, the first among them. A file's number is that of its frame.

    Returns:
        Path of the list, which is what ParaView opens.

    Raises:
        InputError: a reference of other particles or frames, a stride below one, a name that no file can have.
        StorageError: the disk refused.
    """
    _check(trajectory, name, reference, every)
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    index = folder / f"{name}.pvd"
    index.unlink(missing_ok=True)
    remove_temporary_files(folder, f"{glob.escape(name)}_*.vtp")
    files = {frame: f"{name}_{frame:05d}.vtp" for frame in range(0, trajectory.num_frames, every)}
    earlier = re.compile(re.escape(name) + r"_\d{5,}\.vtp")
    for path in list(folder.iterdir()):
        if earlier.fullmatch(path.name) and path.name not in files.values():
            path.unlink()
    for frame, file in files.items():
        arrays = _arrays(trajectory, frame, reference)
        write_atomically(folder / file, _poly_data(_points(trajectory, frame), arrays))
    ground = _write_ground(folder, trajectory.scene, f"{name}_ground.vtp")
    entries = "".join(
        f'    <DataSet timestep="{frame * trajectory.dt:.10g}" part="{part}" file={quoteattr(file)}/>\n'
        for frame, points in files.items()
        for part, file in enumerate((points, *ground))
    )
    text = f'<VTKFile type="Collection" version="0.1">\n  <Collection>\n{entries}  </Collection>\n</VTKFile>\n'
    write_atomically(index, f'<?xml version="1.0"?>\n{text}'.encode())
    return index


def _check(trajectory: Trajectory, name: str, reference: Trajectory | None, every: int) -> None:
    if every < 1:
        raise InputError(f"ParaView series {name!r}: every must be at least 1, not {every}.")
    if not name or {"/", "\\", "\0"} & set(name):
        raise InputError(f"ParaView series: name must be a word that can stand in a file name, not {name!r}.")
    if reference is None:
        return
    if reference.position.shape[1:] != trajectory.position.shape[1:]:
        raise InputError(
            f"ParaView series {name!r}: the reference has {reference.num_particles} particles in {reference.scene.dim} "
            f"dimensions and the trajectory {trajectory.num_particles} in {trajectory.scene.dim}; give the same ones."
        )
    same_step = math.isclose(reference.dt, trajectory.dt, rel_tol=1e-6)
    if not same_step or reference.num_frames < trajectory.num_frames:
        raise InputError(
            f"ParaView series {name!r}: the reference has {reference.num_frames} frames of {reference.dt:g} s and the "
            f"trajectory {trajectory.num_frames} of {trajectory.dt:g} s; give one with the same frames (`resampled`)."
        )


def _write_ground(folder: Path, scene: Scene, file: str) -> list[str]:
    """Write a scene's terrain and return the names of its files; one of an earlier scene is removed."""
    (folder / file).unlink(missing_ok=True)
    terrain = scene.terrain
    if terrain is None:
        return []
    places = [low + terrain.cell * np.arange(n) for low, n in zip(terrain.corner, terrain.heights.shape, strict=True)]
    points = np.stack([*np.meshgrid(*places, indexing="ij"), terrain.heights], axis=-1).reshape(-1, scene.dim)
    number = np.arange(len(points), dtype=np.int32).reshape(terrain.heights.shape)
    if scene.dim == 2:
        cells = np.stack([number[:-1], number[1:]], axis=-1)
    else:
        corners = (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:])
        cells = np.stack(corners, axis=-1).reshape(-1, 4)
    placed = _placed(in_space(points), np.array(scene.origin))
    kind = "Lines" if scene.dim == 2 else "Polys"
    write_atomically(folder / file, _poly_data(placed, {"height": placed[:, 2]}, cells, kind))
    return [file]


def _points(trajectory: Trajectory, frame: int) -> Array:
    """Return the positions of a frame with the scene's origin [N, 3] [m]."""
    return _placed(in_space(trajectory.position[frame]), np.array(trajectory.scene.origin))


def _placed(points: Array, origin: NDArray[np.float64]) -> Array:
    """Return points [N, 3] with the scene's origin [D] [m], in float64 where there is one."""
    if not origin.any():
        return points
    axes = (0, 2) if len(origin) == 2 else (0, 1, 2)
    placed = points.astype(np.float64)
    placed[:, axes] += origin
    return placed


def _arrays(trajectory: Trajectory, frame: int, reference: Trajectory | None) -> dict[str, Array]:
    """Return what the points of a frame carry, by name."""
    position = trajectory.position[frame].astype(np.float64)
    around = replace(trajectory, position=trajectory.position[max(frame - 1, 0) : frame + 1], observables=None)
    velocity = around.velocity()[-1]  # of two frames: those of all would take three times the trajectory's memory
    arrays: dict[str, Array] = {
        "velocity": in_space(velocity),
        "displacement": in_space(position - trajectory.position[0]),
        "speed": np.linalg.norm(velocity, axis=1).astype(np.float32),
        "mass": trajectory.mass.astype(np.float32),
        "particle_type": trajectory.particle_type.astype(np.int32),
    }
    for feature, values in zip(trajectory.material_features, trajectory.material.T, strict=True):
        arrays[feature] = values.astype(np.float32)
    if reference is not None:
        arrays["error"] = in_space(position - reference.position[frame])
    return arrays


def _poly_data(
    points: Array, arrays: Mapping[str, Array], cells: NDArray[np.int32] | None = None, kind: str = "Verts"
) -> bytes:
    """Return the content of a .vtp file: points [N, 3], what they carry, and cells of them [C, K]; None: one each."""
    cells = np.arange(len(points), dtype=np.int32)[:, None] if cells is None else cells
    blocks: list[bytes] = []
    offset = 0

    def declare(array: Array, name: str) -> str:
        """Put an array behind those before it, after its length in bytes, and return the tag that refers to it."""
        nonlocal offset
        content = array.astype(array.dtype.newbyteorder("<")).tobytes()
        blocks.append(len(content).to_bytes(8, "little") + content)
        kind = {"f4": "Float32", "f8": "Float64", "i4": "Int32"}[array.dtype.str[1:]]
        components = array.shape[1] if array.ndim == 2 else 1
        tag = (
            f'<DataArray type="{kind}" Name={quoteattr(name)} NumberOfComponents="{components}" '
            f'format="appended" offset="{offset}"/>\n'
        )
        offset += len(blocks[-1])
        return tag

    of_points = "".join(declare(array, name) for name, array in arrays.items())
    places = declare(points, "Points")
    ends = cells.shape[1] * np.arange(1, len(cells) + 1, dtype=np.int32)
    listed = declare(cells.ravel(), "connectivity") + declare(ends, "offsets")
    numbers = " ".join(f'NumberOf{each}="{len(cells) if each == kind else 0}"' for each in CELLS)
    shown = 'Vectors="velocity" Scalars="speed"' if "speed" in arrays else f'Scalars="{next(iter(arrays))}"'
    header = (
        '<?xml version="1.0"?>\n'
        '<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian" header_type="UInt64">\n'
        f'<PolyData>\n<Piece NumberOfPoints="{len(points)}" {numbers}>\n'
        f"<PointData {shown}>\n{of_points}</PointData>\n"
        f"<Points>\n{places}</Points>\n<{kind}>\n{listed}</{kind}>\n"
        '</Piece>\n</PolyData>\n<AppendedData encoding="raw">\n_'
    )
    return header.encode() + b"".join(blocks) + b"\n</AppendedData>\n</VTKFile>\n"
