"""Frames that were written are there, whatever ended the writing."""

from __future__ import annotations

import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from gns_pl.errors import InputError
from gns_pl.io import StorageError, read_header, read_trajectory, write_trajectory
from gns_pl.io.hdf5 import GROWING
from gns_pl.io.stream import TrajectoryStream, add_provenance, find_frames, go_on
from gns_pl.scene import Scene
from gns_pl.trajectory import Trajectory
from tests.conftest import make_moving


@pytest.fixture
def moving(drop: Scene) -> Trajectory:
    return make_moving(drop, frames=60, spacing=0.06)


def test_a_streamed_trajectory_is_one_written_whole(moving: Trajectory, tmp_path: Path) -> None:
    stream = TrajectoryStream(tmp_path / "a.h5", replace(moving, provenance={"as": "started"}))
    for frame in moving.position:
        stream.append(frame[None])
    assert not (tmp_path / "a.h5").exists()
    stream.finish({"as": "ended"})
    assert [file.name for file in tmp_path.iterdir()] == ["a.h5"]
    back = read_trajectory(tmp_path / "a.h5")
    np.testing.assert_array_equal(back.position, moving.position)
    np.testing.assert_array_equal(back.mass, moving.mass)
    assert back.provenance == {"as": "ended"} and back.scene == moving.scene


def test_a_growing_file_can_be_read_along(moving: Trajectory, tmp_path: Path) -> None:
    stream = TrajectoryStream(tmp_path / "a.h5", moving)
    stream.append(moving.position[:50])
    found = find_frames(tmp_path / "a.h5")
    assert found is not None and 40 <= found[1].num_frames <= 50
    part = read_trajectory(found[0], num_frames=found[1].num_frames)
    np.testing.assert_array_equal(part.position, moving.position[: part.num_frames])
    stream.close()
    assert read_header(tmp_path / f"a.h5{GROWING}").num_frames == 50


def test_going_on_takes_every_whole_frame(moving: Trajectory, tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    assert find_frames(path) is None
    stream = TrajectoryStream(path, moving)
    stream.append(moving.position[:33])
    stream.close()
    found = find_frames(path)
    assert found is not None and found[1].num_frames == 33
    stream = go_on(path, moving, found[0], 33)
    assert stream.num_frames == 33
    stream.append(moving.position[33:])
    stream.finish({})
    np.testing.assert_array_equal(read_trajectory(path).position, moving.position)
    assert [file.name for file in tmp_path.iterdir()] == ["a.h5"]


def test_provenance_can_be_added_to_and_nothing_else_changes(moving: Trajectory, tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    write_trajectory(path, replace(moving, provenance={"solver": "x", "choice": 1}))
    add_provenance(path, {"choice": {"of": "front"}})
    back = read_trajectory(path)
    assert back.provenance == {"solver": "x", "choice": {"of": "front"}} and back.scene == moving.scene
    np.testing.assert_array_equal(back.position, moving.position)
    before = path.stat()
    add_provenance(path, {"choice": {"of": "front"}})
    add_provenance(path, {})
    assert path.stat() == before and [file.name for file in tmp_path.iterdir()] == ["a.h5"]


def test_a_finished_file_can_be_lengthened_and_stays_until_it_is(moving: Trajectory, tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    write_trajectory(path, replace(moving, position=moving.position[:20]))
    found = find_frames(path)
    assert found is not None
    stream = go_on(path, moving, *[found[0], found[1].num_frames])
    assert read_header(path).num_frames == 20
    stream.append(moving.position[20:])
    stream.finish({})
    np.testing.assert_array_equal(read_trajectory(path).position, moving.position)


def test_what_is_torn_at_the_end_is_left_out(moving: Trajectory, tmp_path: Path) -> None:
    stream = TrajectoryStream(tmp_path / "a.h5", moving)
    stream.append(moving.position)
    stream.close()
    growing = tmp_path / f"a.h5{GROWING}"
    content = bytearray(growing.read_bytes())
    place = content.rfind(moving.position[-1].tobytes()[:64])
    content[place : place + 64] = bytes(64)
    growing.write_bytes(content)
    found = find_frames(tmp_path / "a.h5")
    assert found is not None and 40 < found[1].num_frames < 60


def test_a_kill_loses_at_most_a_chunk(tmp_path: Path) -> None:
    code = f"""
import itertools, numpy as np
from tests.conftest import SAND, make_start
from gns_pl.io.stream import TrajectoryStream
from gns_pl.scene import FACES, Wall, cube_drop
scene = cube_drop(domain=(1, 1, 1), side=0.5, position=(0.3, 0.2, 0.4), velocity=(0, 0, 0), gravity=9.81, duration=1,
                  material=SAND, walls=dict.fromkeys(FACES[3], Wall("slip")))
start = make_start(scene)
stream = TrajectoryStream({str(tmp_path / "a.h5")!r}, start)
for number in itertools.count():
    stream.append(np.full_like(start.position, number))
    if number == 200:
        print("under way", flush=True)
"""
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, cwd=Path(__file__).parents[2])
    assert process.stdout is not None and process.stdout.readline()
    process.send_signal(signal.SIGKILL)
    process.wait()
    process.stdout.close()
    found = find_frames(tmp_path / "a.h5")
    assert found is not None and found[1].num_frames > 190
    position = read_trajectory(found[0], num_frames=found[1].num_frames).position
    np.testing.assert_array_equal(position[:, 0, 0], np.arange(len(position)))


def test_a_full_disk_is_one_sentence_and_keeps_the_frames(
    moving: Trajectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stream = TrajectoryStream(tmp_path / "a.h5", moving)
    stream.append(moving.position[:50])
    full = SimpleNamespace(free=2**20)
    monkeypatch.setattr("shutil.disk_usage", lambda path: full)
    with pytest.raises(StorageError, match=r"a\.h5\.growing: the disk is full; make room"):
        stream.append(moving.position)  # more than a chunk
    stream.close()
    found = find_frames(tmp_path / "a.h5")
    assert found is not None and 40 <= found[1].num_frames <= 50


def test_another_file_in_the_place_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.h5").write_text("something else")
    with pytest.raises(InputError, match=r"a\.h5: is not an HDF5 file"):
        find_frames(tmp_path / "a.h5")
