"""The manifest of a data set: which files it has, how they are split, what they hold and how they were made."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gns_pl.errors import InputError
from gns_pl.io.atomic import write_atomically
from gns_pl.io.regular import regular_size

MANIFEST_NAME = "manifest.json"
"""Name of the manifest in the folder of a data set."""
MANIFEST_VERSION = 1
SPLITS = ("train", "valid", "test")
"""The parts of a data set; every trajectory is in one."""


@dataclass(frozen=True)
class FileRecord:
    """One file of a data set.

    Attributes:
        sha256: of its bytes.
        num_frames: T.
        num_particles: N.
    """

    sha256: str
    num_frames: int
    num_particles: int


@dataclass(frozen=True)
class Manifest:
    """What a folder of trajectories is.

    Attributes:
        format_version: version of this form.
        name: of the data set.
        dt: time between frames, the same in every file [s].
        dim: D.
        spacing: nominal distance of neighbouring particles at the start [m].
        particle_types: the numbers of `ParticleType` that occur, rising.
        material_features: names of the K material features.
        splits: "train", "valid", "test" → file names, each file in one of them.
        files: file name → `FileRecord`.
        statistics: quantity → "mean" and "std" per axis and "count", over the training files.
        seed: from which every scene was drawn.
        spec: the whole generation spec, plain values.
    """

    format_version: int
    name: str
    dt: float
    dim: int
    spacing: float
    particle_types: tuple[int, ...]
    material_features: tuple[str, ...]
    splits: Mapping[str, tuple[str, ...]]
    files: Mapping[str, FileRecord]
    statistics: Mapping[str, Any]
    seed: int
    spec: Mapping[str, Any]

    def __post_init__(self) -> None:
        if sorted(self.splits) != sorted(SPLITS):
            raise InputError(f"splits must be {', '.join(SPLITS)}, not {', '.join(self.splits)}.")
        listed = sorted(name for names in self.splits.values() for name in names)
        if listed != sorted(self.files):
            raise InputError("every file must stand in one split, and every file of a split in files.")
        for name in listed:
            if name != Path(name).name or name in {"", ".", ".."}:
                raise InputError(f"{name!r} is not a plain file name.")


def write_manifest(directory: str | Path, manifest: Manifest) -> None:
    """Write `manifest` into `directory`, whole or not at all.

    Raises:
        StorageError: the disk refuses; an older manifest is as it was.
    """
    text = json.dumps(dataclasses.asdict(manifest), indent=1, allow_nan=False) + "\n"
    write_atomically(Path(directory) / MANIFEST_NAME, text.encode())


def read_manifest(directory: str | Path) -> Manifest:
    """Read the manifest of the data set in `directory`; its trajectories are not looked at.

    Raises:
        InputError: there is none, or it is damaged, foreign or of a newer version; the file is named.
    """
    path = Path(directory) / MANIFEST_NAME
    try:
        regular_size(path)
        data = json.loads(path.read_text(encoding="utf-8"))
        version = data["format_version"]
        if version > MANIFEST_VERSION:
            raise InputError(f"is in version {version}, newer than {MANIFEST_VERSION}; update gns_pl.")
        splits = {str(split): tuple(map(str, names)) for split, names in data.pop("splits").items()}
        files = {str(name): FileRecord(**record) for name, record in data.pop("files").items()}
        types, features = tuple(map(int, data.pop("particle_types"))), tuple(map(str, data.pop("material_features")))
        return Manifest(**data, splits=splits, files=files, particle_types=types, material_features=features)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    except FileNotFoundError as error:
        raise InputError(f"{directory}: holds no data set (there is no {MANIFEST_NAME}).") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}).") from error
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise InputError(f"{path}: is damaged or not a manifest of gns_pl.") from error


def verify_dataset(directory: str | Path) -> Manifest:
    """Read the manifest and compare the sha256 of every file with it.

    Raises:
        InputError: as `read_manifest`, or a file that is missing or has changed; the first such file is named.
    """
    manifest = read_manifest(directory)
    for name, record in manifest.files.items():
        path = Path(directory) / name
        if not path.is_file():
            raise InputError(f"{path}: is in the manifest, but missing.")
        if file_sha256(path) != record.sha256:
            raise InputError(f"{path}: has changed since the manifest was written (its sha256 differs).")
    return manifest


def manifest_sha256(directory: str | Path) -> str:
    """Return the sha256 of the manifest, which through the sums in it identifies the whole data set.

    Raises:
        InputError: there is no manifest.
    """
    read_manifest(directory)
    return file_sha256(Path(directory) / MANIFEST_NAME)


def file_sha256(path: str | Path) -> str:
    """Return the sha256 of a file's bytes, in hexadecimal."""
    with Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
