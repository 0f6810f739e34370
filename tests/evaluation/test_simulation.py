"""`simulate.py` to its last line, and `evaluate.py solver=mpm`: every run is told in metres and reported on request."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hydra import compose, initialize_config_dir
from omegaconf import DictConfig

from gns_pl.errors import InputError
from gns_pl.evaluation import references, solver_alone
from gns_pl.evaluation.evaluate import evaluate_config
from gns_pl.evaluation.run_report import ReportedRun, write_report
from gns_pl.evaluation.simulation import compare_with_check, simulate_and_describe
from gns_pl.io import read_trajectory, write_trajectory
from gns_pl.metrics.curves import read_curves
from gns_pl.metrics.maps import map_error, volume_map
from gns_pl.scene import FACES, Body, Scene, Wall, write_scene
from gns_pl.solvers.simulate import check_path
from tests.evaluation.made_up import column, spreading, standing

CONF = str(Path(__file__).parents[2] / "conf")


def config(name: str, *overrides: str) -> DictConfig:
    with initialize_config_dir(CONF, version_base=None):
        return compose(name, overrides=list(overrides))


@pytest.fixture
def small(tmp_path: Path) -> Path:
    """Two bodies in two dimensions, of another sand above the first: nothing that was learned or measured."""
    rough = dict.fromkeys(FACES[2], Wall("friction", 0.385))
    bodies = (Body((0, 0), (0.4, 0.2), (0, 0)), Body((0, 0.2), (0.4, 0.2), (0, 0)))
    write_scene(column(dim=2).replace(bodies=bodies, duration=0.1, walls=rough), tmp_path / "small.yaml")
    return tmp_path / "small.yaml"


def test_mpm_on_ones_own_scene_is_told_checked_and_reported(
    small: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    settings = ("solver=mpm", "cell_size=0.1", "check=true", "report=true", "reporting.paraview=true")
    settings += ("reporting.animation.num_frames=2",)
    (path,) = simulate_and_describe(config("simulate", f"scene={small}", f"out={tmp_path / 'out'}", *settings))
    run, said = read_trajectory(path), capsys.readouterr().out
    assert run.provenance["mpm"]["cell_size"] == 0.1  # type: ignore[index]
    assert (run.num_particles, run.num_frames) == (8 * 8, 11)
    for words in ("runout  ", "largest height  ", "front           still moving at 0.1 s", "m³ per metre of width"):
        assert words in said
    assert "check: cells of 0.1 m and of 0.15 m give a final runout of" in said
    folder = tmp_path / "out" / "column"
    page, metrics = (folder / "report.html").read_text(), json.loads((folder / "metrics.json").read_text())
    assert page.count("data:image/png") == 3 and "data:image/gif" in page and "still moving" in page
    assert (folder / "paraview" / "column.pvd").is_file()
    curves = read_curves(folder / "curves_column.csv")
    found = metrics["scenes"]["column"]
    assert found["summary"]["runout_99"] == pytest.approx(curves["mpm_0.1m.runout_99"][-1], rel=1e-6)
    assert found["outcome"]["volume"] == pytest.approx(0.16, rel=1e-5)


@pytest.mark.parametrize("dim", [2, 3])
def test_a_check_says_of_each_quantity_what_coarser_cells_change(
    dim: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A deposit that spreads by a fifth less: −20 % in the front, 1.8 / 2 in the height, a tenth or so of it elsewhere.

    In three dimensions it is judged in its slice, to the same numbers.
    """
    volumes = []
    for share in (1.0, 0.8):
        flat = spreading(column(dim=2), share=share)
        volumes.append(volume_map(flat.position[-1].astype(np.float64), flat.volume().astype(np.float64), flat.scene))
    elsewhere = map_error(volumes[1], volumes[0])
    assert elsewhere == pytest.approx(0.1, abs=0.03)
    path = tmp_path / "column.h5"
    for file, share, cell in ((path, 1.0, 0.1), (check_path(path), 0.8, 0.15)):
        run = spreading(column(dim=dim), share=share)
        write_trajectory(file, replace(run, provenance={"mpm": {"cell_size": cell}}))
    for of, tolerance, judged in (
        ("worse", 0.3, "more than the tolerance of 30 % in the worse of front and map; .* solver=mpm cell_size=0.075"),
        ("front", 0.41, "within the tolerance of 41 % in the front"),
        ("map", 0.3, "within the tolerance of 30 % in the map"),
        ("height", 0.2, "more than the tolerance of 20 % in the mean height; .* cell_size=0.09"),
    ):
        compare_with_check(path, tolerance, of)
        found = re.search(
            r"errs by 40\.0 % in the front, (.*) % in the map and 22\.2 % in the mean height, " + judged, told(capsys)
        )
        assert found is not None and float(found[1]) == pytest.approx(200 * elsewhere, abs=0.06)
    compare_with_check(path, None)
    assert told(capsys).endswith("% in the mean height.\n")
    compare_with_check(tmp_path / "none.h5", None)
    assert told(capsys) == ""


def told(capsys: pytest.CaptureFixture[str]) -> str:
    return capsys.readouterr().out


def test_a_run_without_gravity_keeps_its_result(small: Path, tmp_path: Path) -> None:
    scene = column(dim=2).replace(gravity=(0, 0))
    files = write_report({"free": ReportedRun(standing(scene), "still")}, tmp_path / "free")
    assert [each.name for each in files] == ["report.html", "metrics.json"]


def test_a_film_that_is_none_is_refused_before_the_run(small: Path, tmp_path: Path) -> None:
    settings = (f"scene={small}", "solver=mpm", "report=true", "reporting.film=avi", f"out={tmp_path / 'out'}")
    with pytest.raises(InputError, match=r"reporting\.film must be mp4, gif or null, not 'avi'"):
        simulate_and_describe(config("simulate", *settings))
    assert not (tmp_path / "out").exists()


def test_mpm_is_evaluated_alone_with_what_other_cells_change(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    asked: list[float] = []

    def made_up(scene: Scene, mpm: Any, *, frame_interval: float, seed: int, cache_directory: Path) -> Any:
        asked.append(mpm["cell_size"])
        return spreading(scene, 30, share=1.0 if len(asked) % 2 else 0.8, dt=frame_interval)

    monkeypatch.setattr(solver_alone, "reference_trajectory", made_up)
    settings = ("solver=mpm", "evaluation.only=column_2.0", "evaluation.figures=false", f"out={tmp_path / 'out'}")
    evaluate_config(config("evaluate", *settings, "evaluation.save_trajectories=true"))
    assert asked == pytest.approx([(0.3 * 0.6) ** 0.5 / 20.4, 1.5 * (0.3 * 0.6) ** 0.5 / 20.4])
    content = json.loads((tmp_path / "out" / "metrics.json").read_text())["scenes"]["column_2.0"]
    # The last of the lattice's columns goes from 0.275 m to twice that, or by a fifth less.
    assert content["outcome"]["runout"] == pytest.approx(0.275, rel=1e-4)
    assert content["summary"]["runout_99"] == pytest.approx(0.275 / 0.3, rel=1e-4)
    assert content["spread"]["runout_99"] == pytest.approx(0.055 / 0.3, rel=1e-4) and content["spread"]["cells"] == [
        1.5
    ]
    run = read_trajectory(tmp_path / "out" / "mpm_column_2.0.h5")
    assert run.scene.walls["y-"].friction == 0.385 and run.scene.bodies[0].size == (0.3, 0.5, 0.6)
    assert "other cells     1.5 times as large change the runout by 0.055 m" in capsys.readouterr().out
    asked.clear()
    evaluate_config(config("evaluate", *settings, "cell_size=0.1", "evaluation.spread=[]", "ckpt=column-fast"))
    assert asked == [0.1]
    for options, sentence in (
        (("solver=dem",), "solver: .*dem"),
        (("evaluation.split=test",), "solver=mpm runs columns or scenes"),
        (("ckpt=[collapse,collapse_plane]",), "takes one ckpt"),
        (("evaluation.spread=[-1]",), r"evaluation\.spread: sizes of cells"),
        (("solver=learned", "cell_size=0.1", "ckpt=collapse"), "cell_size= is that of solver=mpm"),
        (("solver=learned", "ckpt=corrected_plane"), "corrects coarse MPM .* simulate.py ckpt=corrected_plane runs it"),
    ):
        with pytest.raises(InputError, match=sentence):
            evaluate_config(config("evaluate", *settings, *options))


def test_a_scene_in_plane_strain_is_judged_in_its_slice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """And one between rough walls, by a simulator of two dimensions, is refused with the reason."""

    def made_up(scene: Scene, *, frame_interval: float, **_: Any) -> Any:
        # One that is thinned to every third point per direction, to the spacing of the simulator.
        return spreading(scene, 4, dt=frame_interval)

    monkeypatch.setattr(references, "reference_trajectory", made_up)
    monkeypatch.setattr(references, "thin_trajectory", lambda whole, *_: whole)
    write_scene(column(), tmp_path / "smooth.yaml")
    settings = ("ckpt=column-fast-plane", "evaluation.figures=false", "evaluation.placements=0", "logger.enabled=false")
    settings += ("evaluation.spread=[]", f"out={tmp_path / 'out'}", f"evaluation.scenes=[{tmp_path / 'smooth.yaml'}]")
    [document] = evaluate_config(config("evaluate", *settings)).values()
    said = capsys.readouterr().out
    assert "column: judged in two dimensions, plane strain: smooth walls at y = const" in said
    scene = document["scenes"]["column"]
    assert len(scene["scene"]["lower"]) == 2 and scene["num_particles"] == 8 * 4
    assert scene["reference"]["mean_height"] == pytest.approx(0.05, rel=0.01)
    write_scene(column().replace(walls=dict.fromkeys(FACES[3], Wall("friction", 0.4))), tmp_path / "smooth.yaml")
    with pytest.raises(InputError, match="3 dimensions and the simulator 2, and it is not in plane strain: wall y- is"):
        evaluate_config(config("evaluate", *settings))
