"""Tiny files of every foreign format, put together from the formats' descriptions and not by the code under test."""

from __future__ import annotations

import io
import json
import pickle
import struct
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

METADATA: dict[str, Any] = {
    "bounds": [[0.0, 1.0], [0.0, 1.0], [0.0, 1.0]],
    "sequence_length": 5,
    "default_connectivity_radius": 0.15,
    "dim": 3,
    "dt": 0.01,
    "vel_mean": [0.0, 0.0, -0.001],
    "vel_std": [0.002, 0.002, 0.003],
    "acc_mean": [0.0, 0.0, -1e-4],
    "acc_std": [1e-4, 1e-4, 2e-4],
}


def falling(
    frames: int = 6, *, dim: int = 3, side: int = 4, seed: int = 0, gravity: float = 9.81, dt: float = 0.01
) -> NDArray[np.float32]:
    """A lattice of side^dim particles 0.1 apart, in free fall with random horizontal velocities [T, N, D]."""
    generator = np.random.default_rng(seed)
    lattice = np.stack(np.meshgrid(*[np.arange(side)] * dim, indexing="ij"), axis=-1).reshape(-1, dim)
    start = 0.3 + 0.1 * lattice + generator.uniform(-0.005, 0.005, lattice.shape)
    velocity = np.zeros(dim)
    velocity[:-1] = generator.uniform(-0.1, 0.1, dim - 1)
    time = dt * np.arange(frames)[:, None, None]
    fall = np.zeros(dim)
    fall[-1] = -gravity / 2
    return (start + velocity * time + fall * time**2).astype(np.float32)


def write_metadata(folder: Path, **changes: Any) -> None:
    content = {key: value for key, value in {**METADATA, **changes}.items() if value is not None}
    (folder / "metadata.json").write_text(json.dumps(content))


def npy_bytes(array: NDArray[Any], *, shape: Sequence[int] | None = None, descr: str | None = None) -> bytes:
    """An .npy file of numbers; the header may claim another shape or type."""
    text = (
        f"{{'descr': '{descr or array.dtype.str}', 'fortran_order': False, 'shape': {tuple(shape or array.shape)}, }}"
    )
    text += " " * (-(len(text) + 11) % 64) + "\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text.encode() + np.ascontiguousarray(array).tobytes()


def pickled_npy(value: object, shape: tuple[int, ...], protocol: int = 4) -> bytes:
    """An .npy file of objects: a header and a pickle."""
    text = f"{{'descr': '|O', 'fortran_order': False, 'shape': {shape}, }}\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text.encode() + pickle.dumps(value, protocol)


def write_zip(path: Path, members: Mapping[str, bytes]) -> None:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(f"{name}.npy", content)


def objects(*parts: object) -> NDArray[Any]:
    row = np.empty(len(parts), dtype=object)
    for place, part in enumerate(parts):
        row[place] = part
    return row


def write_geoelements(folder: Path, positions: Mapping[str, Sequence[NDArray[Any]]], *more: object) -> Path:
    """A folder of .npz files by split; `more` are particle types and maybe material values of every trajectory."""
    folder.mkdir(exist_ok=True)
    for split, trajectories in positions.items():
        members = {}
        for number, position in enumerate(trajectories):
            row = objects(position, *(more or (np.full(position.shape[1], 6),)))
            members[f"simulation_trajectory_{number}"] = pickled_npy(row, row.shape)
        write_zip(folder / f"{split}.npz", members)
    write_metadata(folder, **_bounds_of(positions))
    return folder


def _bounds_of(positions: Mapping[str, Sequence[NDArray[Any]]]) -> dict[str, Any]:
    dim = next(iter(positions.values()))[0].shape[2]
    cut = {key: METADATA[key][-dim:] for key in ("bounds", "vel_mean", "vel_std", "acc_mean", "acc_std")}
    return {**cut, "dim": dim}


def write_geoelements_hdf5(path: Path, positions: Sequence[NDArray[Any]], types: NDArray[Any], material: float) -> None:
    with h5py.File(path, "w") as file:
        for number, position in enumerate(positions):
            group = file.create_group(f"trajectory_{number}")
            group["positions"], group["particle_type"], group["material_property"] = position, types, material


def write_lagrangebench(folder: Path, positions: Mapping[str, Sequence[NDArray[Any]]], types: NDArray[Any]) -> Path:
    folder.mkdir(exist_ok=True)
    for split, trajectories in positions.items():
        with h5py.File(folder / f"{split}.h5", "w") as file:
            for number, position in enumerate(trajectories):
                file[f"{number:05d}/position"], file[f"{number:05d}/particle_type"] = position, types
    bounds = _bounds_of(positions)
    periodic = [False] * bounds["dim"]
    write_metadata(folder, **bounds, dt=0.0005, write_every=20, dx=0.1, periodic_boundary_conditions=periodic)
    return folder


def varint(number: int) -> bytes:
    out = b""
    while number > 0x7F:
        out += bytes([number & 0x7F | 0x80])
        number >>= 7
    return out + bytes([number])


def field(number: int, content: bytes) -> bytes:
    return varint(number << 3 | 2) + varint(len(content)) + content


def slow_crc32c(content: bytes) -> int:
    """Bit by bit, from the polynomial."""
    value = 0xFFFFFFFF
    for byte in content:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ (0x82F63B78 if value & 1 else 0)
    return value ^ 0xFFFFFFFF


def record(content: bytes) -> bytes:
    def mask(value: int) -> bytes:
        return struct.pack("<I", ((value >> 15 | value << 17) + 0xA282EAD8) % 2**32)

    length = struct.pack("<Q", len(content))
    return length + mask(slow_crc32c(length)) + content + mask(slow_crc32c(content))


def sequence_example(frames: Sequence[bytes], types: bytes, *, step_context: bool = False) -> bytes:
    def feature(content: bytes) -> bytes:
        return field(1, field(1, content))

    def entry(name: str, content: bytes) -> bytes:
        return field(1, field(1, name.encode()) + field(2, content))

    key = field(3, field(1, varint(7)))  # an Int64List, packed
    context = entry("particle_type", feature(types)) + entry("key", key)
    lists = entry("position", b"".join(field(1, feature(frame)) for frame in frames))
    if step_context:
        lists += entry("step_context", b"".join(field(1, feature(struct.pack("<f", 1.0))) for _ in frames))
    return field(1, context) + field(2, lists)


def write_tfrecord(
    path: Path, positions: Sequence[NDArray[np.float32]], types: NDArray[np.int64], *, step_context: bool = False
) -> None:
    examples = [
        sequence_example([frame.tobytes() for frame in position], types.tobytes(), step_context=step_context)
        for position in positions
    ]
    path.write_bytes(b"".join(map(record, examples)))


NAMES = [
    "id", "mass", "volume", "pressure", *(f"coord_{a}" for a in "xyz"), *(f"displacement_{a}" for a in "xyz"),
    *(f"nsize_{a}" for a in "xyz"), *(f"velocity_{a}" for a in "xyz"),
    *(f"{q}_{c}" for q in ("stress",) for c in ("xx", "yy", "zz")), *(f"tau_{c}" for c in ("xy", "yz", "xz")),
    *(f"strain_{c}" for c in ("xx", "yy", "zz")), *(f"gamma_{c}" for c in ("xy", "yz", "xz")), "epsilon_v", "status",
    "cell_id", "material_id", "nstate_vars", *(f"svars_{k}" for k in range(20)),
]  # fmt: skip
INTEGERS = {"id": "<u8", "status": "u1", "cell_id": "<u8", "material_id": "<u4", "nstate_vars": "<u4"}


def cb_geo_type() -> np.dtype[Any]:
    """53 columns in 416 bytes, mass before id, so that offsets do not rise with the columns."""
    kinds = [INTEGERS.get(name, "<f8") for name in NAMES]
    offsets, place = [], 0
    for kind in kinds:
        width = np.dtype(kind).itemsize
        place = -(-place // width) * width
        offsets.append(place)
        place += width
    offsets[0], offsets[1] = offsets[1], offsets[0]
    return np.dtype({"names": NAMES, "formats": kinds, "offsets": offsets, "itemsize": 416})


def write_cb_geo(
    folder: Path,
    position: NDArray[np.float64],
    *,
    steps: int = 10,
    ranks: int = 1,
    lost: Sequence[int] = (),
    late: Sequence[int] = (),
    columns: Mapping[str, Any] | None = None,
) -> Path:
    """A run whose files hold frames [T, N, 3] `steps` solver steps apart, rows in an order of their own in each.

    Particles whose ids are in `lost` are missing in the last file, those in `late` in the first one; `columns` are
    values of the table, one or [N], in all files.
    """
    folder.mkdir(parents=True, exist_ok=True)
    generator = np.random.default_rng(1)
    number = position.shape[1]
    for frame, places in enumerate(position):
        rows = np.zeros(number, dtype=cb_geo_type())
        rows["id"], rows["mass"], rows["volume"] = np.arange(number), 1.8, 0.001
        for axis, name in enumerate("xyz"):
            rows[f"coord_{name}"] = places[:, axis]
            rows[f"displacement_{name}"] = 0.001 * (axis + 1) if frame == 0 else 7.0
        for name, values in (columns or {}).items():
            rows[name] = values
        rows = rows[generator.permutation(number)]
        missing = [*(lost if frame == len(position) - 1 else ()), *(late if frame == 0 else ())]
        rows = rows[~np.isin(rows["id"], missing)]
        for rank in range(ranks):
            middle = f"-{rank}_{ranks}-" if ranks > 1 else ""
            with h5py.File(folder / f"particles{middle}{frame * steps:05d}.h5", "w") as file:
                file["table"] = rows[rank::ranks]
    return folder


def write_deck(
    folder: Path,
    *,
    dim: int = 3,
    dt: float = 0.001,
    steps: int = 10,
    gravity: float = 9.81,
    size: float = 1.0,
    frictions: Mapping[int, float] | None = None,
    name: str = "mpm.json",
    uuid: str = "run",
    corner: Sequence[float] = (0.0, 0.0, 0.0),
) -> Path:
    """A deck with its mesh, a cube of one cell from a corner on; `frictions` are material id → φ in degrees."""
    folder.mkdir(parents=True, exist_ok=True)
    corners = np.stack(np.meshgrid(*[[0.0, size]] * dim, indexing="ij"), axis=-1).reshape(-1, dim)
    corners = corners + np.array(corner[:dim])
    lines = ["# a cell", f"{len(corners)} 1", *(" ".join(map(str, corner)) for corner in corners)]
    lines.append(" ".join(map(str, range(len(corners)))))
    (folder / "mesh.txt").write_text("\n".join(lines) + "\n")
    deck = {
        "mesh": {"mesh": "mesh.txt"},
        "analysis": {"dt": dt, "nsteps": 100, "uuid": uuid},
        "post_processing": {"output_steps": steps},
        "materials": [
            {"id": number, "type": "MohrCoulomb3D", "density": 1800, "friction": friction}
            for number, friction in (frictions or {0: 30}).items()
        ],
        "external_loading_conditions": {"gravity": [0.0] * (dim - 1) + [-gravity]},
    }
    path = folder / name
    path.write_text(json.dumps(deck))
    return path


def vtp(points: NDArray[Any], types: NDArray[Any] | None = None) -> bytes:
    """Points as text, as a person would write them."""
    carried = ""
    if types is not None:
        numbers = " ".join(map(str, types))
        carried = f'<DataArray type="Int64" Name="particle_type" format="ascii">{numbers}</DataArray>'
    places = " ".join(repr(float(each)) for each in points.reshape(-1))
    return (
        '<?xml version="1.0"?><VTKFile type="PolyData" version="0.1" byte_order="LittleEndian"><PolyData>'
        f'<Piece NumberOfPoints="{len(points)}"><PointData>{carried}</PointData><Points>'
        f'<DataArray type="Float32" Name="Points" NumberOfComponents="3" format="ascii">{places}</DataArray>'
        "</Points></Piece></PolyData></VTKFile>"
    ).encode()


def write_vtk(folder: Path, position: NDArray[Any], *, dt: float | None = 0.01, name: str = "run") -> Path:
    folder.mkdir(exist_ok=True)
    types = np.full(position.shape[1], 6)
    for frame, points in enumerate(position):
        (folder / f"{name}_{frame}.vtp").write_bytes(vtp(points, types))
    if dt is not None:
        entries = "".join(f'<DataSet timestep="{k * dt}" file="{name}_{k}.vtp"/>' for k in range(len(position)))
        text = f'<VTKFile type="Collection"><Collection>{entries}</Collection></VTKFile>'
        (folder / f"{name}.pvd").write_text(text)
    return folder


def saved_npy(array: NDArray[Any]) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, array)
    return buffer.getvalue()
