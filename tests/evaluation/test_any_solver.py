"""Any solver is judged by fine MPM: MPM by itself errs by nothing, a still heap by all of its runout."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from gns_pl.errors import InputError
from gns_pl.evaluation.evaluate import evaluate_config
from gns_pl.scene import write_scene
from tests.evaluation.test_simulation import config
from tests.solvers.test_selection import column

QUICK = (
    *("evaluation.figures=false", "evaluation.placements=2", "choice.cells=[5,8]", "logger.enabled=false"),
    *("choice.frame_interval=0.04", "evaluation.duration=2"),
)


@pytest.fixture
def scene(tmp_path: Path) -> str:
    write_scene(column(duration=0.4), tmp_path / "smooth.yaml")
    return f"evaluation.scenes=[{tmp_path / 'smooth.yaml'}]"


def test_mpm_on_the_reference_cells_is_the_reference(scene: str, tmp_path: Path) -> None:
    folders = (f"out={tmp_path / 'out'}", f"cache={tmp_path / 'cache'}")
    (errors,) = evaluate_config(config("evaluate", "solver=mpm_8", scene, *QUICK, *folders)).values()
    assert abs(errors["runout_99_error"]) < 0.2 and abs(errors["mean_height_error"]) < 0.05
    (coarse,) = evaluate_config(config("evaluate", "solver=mpm_5", scene, *QUICK, *folders)).values()
    assert coarse["runout_99_error"] < errors["runout_99_error"] - 0.1
    rows = list(csv.DictReader((tmp_path / "out" / "errors.csv").open()))
    (front,) = [row for row in rows if row["quantity"] == "runout_99_error"]
    assert float(front["mean"]) == pytest.approx(coarse["runout_99_error"], rel=1e-4) and front["failed"] == "0"
    assert abs(float(front["largest"])) >= abs(float(front["mean"])) and (tmp_path / "out" / "report.html").is_file()


def test_a_solver_of_ones_own_is_judged(scene: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "still_solver.py").write_text(
        "import gns_pl\nfrom gns_pl.solvers.trivial import Still\n\n\n"
        'class Mine(gns_pl.Solver):\n    name = "mine"\n\n'
        '    def run(self, scene, **settings):\n        return Still("still", 8.0).run(scene, **settings)\n'
    )
    monkeypatch.chdir(tmp_path)
    (errors,) = evaluate_config(config("evaluate", "solver=still_solver.Mine", scene, *QUICK, "cache=cache")).values()
    assert errors["runout_99_error"] == pytest.approx(-1.0, abs=0.01)
    assert (tmp_path / "runs" / "mine" / "evaluation" / "errors.csv").is_file()


def test_what_cannot_be_judged_is_refused(tmp_path: Path) -> None:
    for options, message in (
        (("solver=shallow", "ckpt=collapse"), "give one"),
        (("solver=shallow", "evaluation.split=test"), "solver= runs columns or scenes"),
        (("solver=shallow", "evaluation.placements=0"), "placements must be 1 or more"),
        (("solver=nothing",), "there is no nothing"),
    ):
        with pytest.raises(InputError, match=message):
            evaluate_config(config("evaluate", *options, *QUICK[:1], f"out={tmp_path / 'none'}"))
    with pytest.raises(InputError, match=r"not in plane strain|plane strain only"):
        evaluate_config(config("evaluate", "solver=corrected_plane", *QUICK, f"out={tmp_path / 'none'}"))
    assert not (tmp_path / "none").exists()
