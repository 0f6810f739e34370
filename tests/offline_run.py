"""What an offline run of W&B holds: its file is a log in LevelDB's format of records in W&B's own protocol buffers."""

from __future__ import annotations

import json
import struct
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

HEADER, BLOCK = 7, 32768
"""Bytes before a file's first record and before every part of one; bytes of a block, which no part crosses."""

WHOLE, FIRST, LAST = 1, 2, 4
"""Kinds of parts of a record; 3 stands between the first and the last."""


@dataclass(frozen=True)
class OfflineRun:
    """One run.

    Attributes:
        group: its W&B group; "" for none.
        job_type: of the run.
        config: what was told of it.
        summary: the last value of everything logged, by its name; of an image "NAME/path" and more, of images in a list
            "NAME/filenames".
    """

    group: str
    job_type: str
    config: dict[str, Any]
    summary: dict[str, Any]


def read_offline_run(folder: Path) -> OfflineRun:
    """Return what stands in the folder `offline-run-…`, when its end does: W&B's own process writes behind `finish`."""
    from wandb.proto.wandb_internal_pb2 import Record

    deadline, whole = time.monotonic() + 20, False
    while not whole and time.monotonic() < deadline:
        found = [
            Record.FromString(content) for path in folder.glob("run-*.wandb") for content in records(path.read_bytes())
        ]
        whole = any(record.HasField("exit") for record in found)
        time.sleep(0.0 if whole else 0.1)
    assert whole, f"{folder}: W&B did not write the run to its end"
    group, job_type, config, summary = "", "", dict[str, Any](), dict[str, Any]()
    for record in found:
        if record.HasField("run"):
            group, job_type = record.run.run_group, record.run.job_type
        config |= {item.key: json.loads(item.value_json) for item in record.config.update}
        for item in (*record.history.item, *record.summary.update):
            summary["/".join(item.nested_key) or item.key] = json.loads(item.value_json)
    return OfflineRun(group, job_type, config, summary)


def media(folder: Path, run: OfflineRun) -> set[str]:
    """Return the names of what was logged as images, videos and tables, having made sure that their files are there."""
    paths: dict[str, list[str]] = {}
    for key, value in run.summary.items():
        name, _, what = key.rpartition("/")
        if what in ("path", "filenames"):
            paths[name] = [value] if what == "path" else value
    assert all((folder / "files" / path).stat().st_size > 100 for some in paths.values() for path in some)
    return set(paths)


def records(content: bytes) -> Iterator[bytes]:
    """Yield the records of a file, as far as they are written, put together from their parts."""
    place, parts = HEADER, list[bytes]()
    while place + HEADER <= len(content):
        if BLOCK - place % BLOCK < HEADER:  # too little room for a part: the next block
            place += BLOCK - place % BLOCK
            continue
        _, length, kind = struct.unpack("<IHB", content[place : place + HEADER])
        place += HEADER
        if place + length > len(content):  # it is being written
            return
        parts = [*(() if kind in (WHOLE, FIRST) else parts), content[place : place + length]]
        place += length
        if kind in (WHOLE, LAST):
            yield b"".join(parts)
