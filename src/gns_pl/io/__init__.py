"""Trajectories on disk: the HDF5 format and the manifest of a data set.

`schema` holds the format as data, `hdf5` writes and reads one file per trajectory, `manifest` says what a folder of
them is, `atomic` makes a file appear whole or not at all. Nothing here simulates, learns or knows what a file is for.
"""

from gns_pl.io.atomic import StorageError, atomic_path, remove_temporary_files
from gns_pl.io.hdf5 import (
    TrajectoryHeader,
    open_trajectory,
    read_header,
    read_observables,
    read_static,
    read_trajectory,
    read_window,
    write_trajectory,
)
from gns_pl.io.manifest import (
    MANIFEST_NAME,
    SPLITS,
    FileRecord,
    Manifest,
    file_sha256,
    manifest_sha256,
    read_manifest,
    verify_dataset,
    write_manifest,
)
from gns_pl.io.schema import FORMAT_VERSION, render_schema

__all__ = [
    "FORMAT_VERSION",
    "MANIFEST_NAME",
    "SPLITS",
    "FileRecord",
    "Manifest",
    "StorageError",
    "TrajectoryHeader",
    "atomic_path",
    "file_sha256",
    "manifest_sha256",
    "open_trajectory",
    "read_header",
    "read_manifest",
    "read_observables",
    "read_static",
    "read_trajectory",
    "read_window",
    "remove_temporary_files",
    "render_schema",
    "verify_dataset",
    "write_manifest",
    "write_trajectory",
]
