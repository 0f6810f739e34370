"""The commands and the Python of docs/terrain.md, as they stand there, on coarser cells and for a shorter time."""

from __future__ import annotations

import re
import runpy
import shlex
from pathlib import Path

import numpy as np
import pytest

from gns_pl.evaluation import ensemble
from gns_pl.scene import read_raster, read_scene
from tests.commands.in_process import ROOT, call
from tests.evaluation.made_up import spreading

SMALLER = {
    "runs/terrain": ["runs/terrain", "--cell=50"],
    "cell_size=25": ["cell_size=80", "duration=8"],
    "cell_size=40": ["cell_size=80", "duration=4"],
    "ensemble.members=16": ["ensemble.members=2"],
    "runs/solvers": [
        "runs/solvers",
        "--scene",
        "runs/terrain/landslide.yaml",
        "--cell-size=80",
        "--solvers",
        "shallow-k0",
        "mpm",
    ],
    "scene=mine.yaml": ["scene=runs/terrain/landslide.yaml"],
    "scene=barrier": ["scene=barrier", "duration=0.2"],
}
"""Argument of the page → those in its place."""


def blocks(language: str) -> list[str]:
    page = (ROOT / "docs" / "terrain.md").read_text(encoding="utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```", page, re.DOTALL | re.MULTILINE)


def test_the_commands_lead_from_a_raster_to_maps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ensemble, "available_cores", lambda: 1)
    commands, compared, chosen, learned, _ = blocks("bash")  # the last needs AvaFrame
    for line in (commands + compared + chosen + learned).splitlines():
        python, name, *arguments = shlex.split(line)
        smaller = [each for argument in arguments for each in SMALLER.get(argument, [argument])]
        done = call(tmp_path, name, *smaller)
        assert python == "python" and done.returncode == 0, done.stderr
    scene = read_scene(tmp_path / "runs/terrain/landslide.yaml")
    assert scene.terrain is not None and scene.origin[1] > 4e6
    folder = tmp_path / "runs/landslide/landslide"
    deposit = read_raster(folder / "maps/landslide_deposit.asc")
    assert deposit.cell == 50 and deposit.values.shape == scene.terrain.heights.shape
    assert deposit.corner == read_raster(tmp_path / "runs/terrain/elevation.asc").corner
    # Material that starts inside rough ground is left out, so a little less than the release is there.
    volume = deposit.values.sum() * deposit.cell**2
    assert volume == pytest.approx(np.pi * 170 * 230 * 25, rel=0.1)
    # It slid down, which is to the east.
    release = read_raster(folder / "maps/landslide_max_thickness.asc")
    x = np.arange(len(deposit.values)) * 50.0
    assert x @ deposit.values.sum(axis=1) / deposit.values.sum() > x @ release.values.sum(axis=1) / release.values.sum()
    share = read_raster(folder / "ensemble/landslide_exceedance_5m.asc").values
    assert set(np.unique(share)) <= {0.0, 0.5, 1.0} and share.max() == 1.0
    rows = (tmp_path / "runs/solvers/terrain_solvers.csv").read_text().splitlines()
    assert [row.split(",")[0] for row in rows] == ["solver", "shallow-k0", "mpm"]
    assert (tmp_path / "runs/solvers/terrain_solvers.png").is_file() and "chosen: " in done.stdout
    assert (folder / "ensemble/landslide_ensemble.png").is_file() and (folder / "maps/landslide_map.png").is_file()


def test_the_python_measures_any_trajectory(capsys: pytest.CaptureFixture[str]) -> None:
    [code] = blocks("python")
    exec(compile(code, "docs/terrain.md", "exec"), {"flow": spreading()})
    area, volume = map(float, capsys.readouterr().out.split())
    assert area > 0.4 and volume == pytest.approx(0.04, rel=1e-5)


@pytest.mark.parametrize(("script", "arguments"), [("terrain_records", []), ("dense_flow", ["--from-table"])])
def test_the_tables_of_the_page_are_those_of_the_files(
    script: str, arguments: list[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    module = runpy.run_path(str(ROOT / "benchmarks" / f"{script}.py"))
    page = tmp_path / "terrain.md"
    page.write_text((ROOT / "docs" / "terrain.md").read_text(encoding="utf-8"), encoding="utf-8")
    module["main"].__globals__["PAGE"] = page
    monkeypatch.setattr("sys.argv", [script, *arguments])
    module["main"]()
    assert page.read_text(encoding="utf-8") == (ROOT / "docs" / "terrain.md").read_text(encoding="utf-8")
