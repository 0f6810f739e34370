"""References: measured once, kept in small files, of any scene."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from gns_pl.errors import InputError
from gns_pl.evaluation.chart import converged as module
from gns_pl.evaluation.chart.converged import OBSERVABLES, Converged, converged, uncertainty_of
from gns_pl.evaluation.chart.kept import SHIPPED, read_kept, write_kept
from gns_pl.evaluation.chart.observed import ERRORS, Observed, errors_of
from gns_pl.evaluation.scenes import build_scenes
from gns_pl.io import read_trajectory
from gns_pl.presets import FOLDER, preset
from gns_pl.scene import Scene, read_scene
from gns_pl.solvers.mpm import MPMSolver
from gns_pl.solvers.selection import FINE_ERRORS, kind_of
from tests.conftest import MPM
from tests.evaluation.made_up import LENGTH, column, spreading, standing
from tests.solvers.test_selection import column as rough_column

SETTINGS = {"mpm": MPM, "placements": 1, "order": 1.7, "interval": 0.02}


@pytest.fixture
def scene() -> Scene:
    return rough_column(1.0)


def made(scene: Scene, cache: Path, cells: tuple[float, ...] = (20, 15)) -> Converged:
    return converged(scene, cells_per_metre=cells, cache=cache, **SETTINGS)  # type: ignore[arg-type]


def test_a_reference_against_itself(scene: Scene, tmp_path: Path) -> None:
    fine = made(scene, tmp_path, (20,))
    [run] = tmp_path.glob("*.h5")
    found = fine.errors(read_trajectory(run))
    assert all(abs(found[name]) < 1e-5 for name in ERRORS)  # kept with six digits
    assert found["front"] == pytest.approx(fine.facts.front) and fine.flat.dim == 2
    assert all(value == math.inf for name, value in fine.errors(None).items() if name != "front")


def test_what_is_kept_is_not_run_again_and_needs_no_run(
    scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fine = made(scene, tmp_path)
    assert set(fine.uncertainty) == set(OBSERVABLES) and all(0 <= value < 1 for value in fine.uncertainty.values())
    assert fine.uncertainty["front"] > 0 and fine.uncertainty["map"] > 0
    [kept] = tmp_path.glob("*.json")
    assert kept.stat().st_size < 10_000
    for run in tmp_path.glob("*.h5"):
        run.unlink()
    monkeypatch.setattr(module, "reference_trajectory", None)
    again = made(scene, tmp_path)
    assert again.facts == fine.facts and np.array_equal(again.observed.volumes, fine.observed.volumes)
    with pytest.raises(TypeError):  # of other cells there is none
        made(scene, tmp_path, (22, 15))
    kept.write_text("{}")
    with pytest.raises(InputError, match=r"is no reference of benchmark\.py"):
        made(scene, tmp_path)


def test_a_run_in_space_is_judged_by_a_slice(scene: Scene, tmp_path: Path) -> None:
    """The same cells in three dimensions differ from the slice by their random places alone."""
    fine = made(scene, tmp_path)
    whole = MPMSolver("whole", 0.0, MPM, reduces=False, cell_size=0.05).run(scene, interval=0.02)
    found = fine.errors(whole)
    assert whole.scene.dim == 3 and fine.observed.volumes.ndim == 1
    assert abs(found["front_error"]) < 0.1 and found["map_error"] < 0.02 and abs(found["height_error"]) < 0.02


def test_a_scene_without_a_law_is_seen_from_above(tmp_path: Path) -> None:
    fine = made(read_scene("step").replace(duration=0.2), tmp_path, (10,))
    assert fine.observed.volumes.shape == (19, 6) and not fine.facts.column and "mirror plane" in fine.words
    sand = 0.3 * 0.4 * 0.45
    assert fine.observed.volumes.sum() == pytest.approx(sand, rel=1e-5)


def test_errors_by_hand() -> None:
    still, spread = (Observed.of(run, column(), None) for run in (standing(frames=30), spreading(frames=30)))
    found = errors_of(still, spread)
    assert found["front"] == 0 and found["front_error"] == -1 and found["arrest_error"] == -1
    assert found["height_error"] == pytest.approx(1.0, abs=1e-5)  # it sinks to half
    assert found["map_error"] == pytest.approx(0.5, abs=0.04)  # half of it goes elsewhere; nodes blur the edge
    assert spread.front[-1] == pytest.approx(LENGTH - 0.025)  # of the outermost particles, from 0.375 to 0.75 m
    assert errors_of(spread, spread) == dict.fromkeys(ERRORS, 0.0) | {"front": spread.front[-1]}


def test_uncertainties_of_maps_are_shares_of_the_volume() -> None:
    one, other = np.array([1.0, 0.0, 0.0]), np.array([0.8, 0.2, 0.0])
    assert uncertainty_of([[one], [other]], [144, 72], 2.0) == pytest.approx(0.2 / 2)
    assert uncertainty_of([[one, other]], [144], 2.0) == pytest.approx(2 * 0.1)


def test_a_mean_is_of_all_placements(tmp_path: Path) -> None:
    runs = [Observed.of(spreading(frames=30, share=share), column(), None) for share in (0.8, 1.0)]
    mean = Observed.mean(runs)
    assert mean.front[-1] == pytest.approx((runs[0].front[-1] + runs[1].front[-1]) / 2)
    write_kept(tmp_path / "mean.json", mean, {"words": "é"})
    again, facts = read_kept(tmp_path / "mean.json", ("words",))
    np.testing.assert_allclose(again.volumes, mean.volumes, rtol=1e-5)
    assert facts == {"words": "é"} and again.arrest == pytest.approx(mean.arrest, rel=1e-5)
    assert replace(again, arrest=0.0).arrest == 0


def test_the_package_s_references_are_of_its_scenes_and_settings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whoever changes a scene of the set, or the settings of the reference, has to make its file anew."""
    monkeypatch.setattr(module, "reference_trajectory", None)  # nothing is run
    settings = yaml.safe_load((FOLDER / "benchmark.yaml").read_text())["reference"]
    mpm, columns = preset("choice/default")["mpm"], preset("evaluation/columns")
    how = {"only": None, "domain": columns["domain"], "duration": columns["duration"], "interval": 0.02}
    scenes = [read_scene(name) for name in preset("evaluation/general")["scenes"]]
    unsure: dict[str, list[float]] = {"map": [], "height": []}
    for sides in ({}, {"y-": {"condition": "slip"}, "y+": {"condition": "slip"}}):
        paper = preset("data/_paper")
        data = {**paper, "walls": {**paper["walls"], **sides}}
        scenes += build_scenes(columns["columns"], None, data=data, **how).values()
    for scene in scenes:
        kept = settings[kind_of(scene)]
        fine = converged(scene, mpm=mpm, interval=0.02, cache=tmp_path, order=settings["order"], **kept)
        assert fine.facts.front > 0 and fine.observed.volumes.ndim == (1 if kind_of(scene) == "plane" else 2)
        assert max(fine.uncertainty[measure] for measure in ("front", "map")) < 0.15
        for measure, values in unsure.items():
            values.append(fine.uncertainty[measure])
    for measure, values in unsure.items():
        assert np.sqrt(np.mean(np.square(values))) == pytest.approx(FINE_ERRORS[measure], abs=1e-3)
    assert len(scenes) == 10 == len(list(SHIPPED.glob("*.json")))
    assert not list(tmp_path.iterdir()) and all(path.stat().st_size < 20_000 for path in SHIPPED.glob("*.json"))
