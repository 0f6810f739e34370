"""A foreign format of one's own: one file, and one line that names it."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from gns_pl.convert import exports
from gns_pl.convert.common import Common
from gns_pl.convert.convert import convert
from gns_pl.convert.formats import detect, open_set
from gns_pl.convert.formats.format import Format
from gns_pl.convert.given import Given
from gns_pl.errors import InputError
from gns_pl.io import read_manifest, read_trajectory
from tests.convert.test_convert import ASSUMED
from tests.extend.page import blocks

FRAMES, NUMBER, DT = 12, 20, 0.01
GIVEN = {"dt": DT, "scale": 1.0, "gravity": 9.81, "gravity_axis": "z", "spacing": 0.1}
GIVEN |= {"lower": (0.0,) * 3, "upper": (2.0,) * 3}


@pytest.fixture
def csv(monkeypatch: pytest.MonkeyPatch) -> Format:
    """The format of the page, registered as it says."""
    (text,) = blocks("A foreign format")
    module: Any = ModuleType("csv_tables")
    exec(text, vars(module))
    monkeypatch.setattr(detect, "FORMATS", [*detect.FORMATS, module.FORMAT])
    return module.FORMAT


def write_tables(folder: Path) -> np.ndarray:
    """Two trajectories that fall, with rows in any order; returns their positions [2, T, N, 3]."""
    rng = np.random.default_rng(0)
    start = rng.uniform(1.0, 1.5, (2, 1, NUMBER, 3))
    fall = -0.5 * 9.81 * (DT * np.arange(FRAMES)) ** 2
    position = start + fall[None, :, None, None] * np.array([0.0, 0.0, 1.0])
    folder.mkdir()
    for number, run in enumerate(position):
        rows = [(frame, particle, *run[frame, particle]) for frame in range(FRAMES) for particle in range(NUMBER)]
        rows = [rows[place] for place in rng.permutation(len(rows))]
        np.savetxt(folder / f"run_{number}.csv", rows, delimiter=",", header="frame,id,x,y,z", comments="")
    return position


def test_a_file_and_a_line_are_all_that_a_format_needs(csv: Format, tmp_path: Path) -> None:
    position = write_tables(tmp_path / "theirs")
    found = open_set(tmp_path / "theirs")
    assert found.kind == "CSV tables" and [name for _, name in found.names] == ["run_0.csv", "run_1.csv"]
    target = convert(found, tmp_path / "ours", given=Given(**GIVEN), assumed=ASSUMED, valid=0, test=1)
    manifest = read_manifest(target)
    for split, truth in zip(("train", "test"), position, strict=True):
        (name,) = manifest.splits[split]
        np.testing.assert_allclose(read_trajectory(target / name).position, truth, atol=1e-6)


def test_its_files_are_guarded_as_all_are(csv: Format, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("frame,id,x,y,z\n0,0,a,0,0\n")
    with pytest.raises(InputError, match=r"a\.csv: is truncated, damaged or of another format"), _first(tmp_path):
        pass
    (tmp_path / "b.csv.gz").write_bytes(b"")
    with pytest.raises(InputError, match=r"b\.csv\.gz is packed and would be left out"):
        open_set(tmp_path)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=r"formats that are known: .*plain arrays .*, CSV tables \(\.csv\)\.$"):
        open_set(tmp_path / "empty")


def _first(folder: Path) -> Any:
    return open_set(folder).recording(0)


def test_a_line_is_all_that_a_format_to_write_needs(
    csv: Format, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def write_sizes(export: exports.Export) -> None:
        for _, item, recording, _, blocks_of_frames in export.opened("train"):
            lines = [f"{len(block)} {block.shape[1]}" for block in blocks_of_frames]
            (export.folder / f"{item.name}.txt").write_text(f"{recording.num_frames}: {' '.join(lines)}")

    monkeypatch.setitem(exports.WRITERS, "sizes", (write_sizes, lambda: Common("a list of sizes", {})))
    write_tables(tmp_path / "theirs")
    found, given = open_set(tmp_path / "theirs"), Given(**GIVEN)
    target = convert(found, tmp_path / "sizes", to="sizes", given=given, assumed=ASSUMED, valid=0, test=1)
    assert [path.read_text() for path in target.iterdir()] == [f"{FRAMES}: {FRAMES} {NUMBER}"]
    with pytest.raises(InputError, match="to must be one of gns_pl, geoelements, lagrangebench, vtk, sizes, not 'x'"):
        convert(found, tmp_path / "x", to="x", given=given, assumed=ASSUMED)
