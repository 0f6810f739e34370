"""A sweep's table and figure from what its jobs left, good or bad."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import yaml
from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.utils import JobReturn, JobStatus
from omegaconf import OmegaConf

from gns_pl.training.summary import FORMAT
from gns_pl.training.sweep import SweepReport, close_sweep, group_name, report_sweep, shortened, sweep_reported
from gns_pl.training.sweep_table import (
    PANELS,
    measured,
    over_seeds,
    read_jobs,
    shown_tables,
    sweep_points,
    swept_names,
    table_rows,
)
from tests.training.conftest import CONF


def make_job(folder: Path, number: int, overrides: list[str], error: float | None = 1.0, **changes: Any) -> Path:
    """A folder as a job leaves it; without a summary if `error` is None."""
    job = folder / f"{number}-job"
    (job / ".hydra").mkdir(parents=True)
    (job / ".hydra" / "overrides.yaml").write_text(yaml.safe_dump(["+experiment=quickstart", *overrides]))
    if error is not None:
        best = {"step": 50, "position_error": error, "runout_99_error": -error / 10, "mean_height_error": None}
        summary = {
            "format": FORMAT, "status": "finished", "steps": 100, "best": best, "final": {"position_error": 2 * error},
            "step_seconds": 0.025, "rollout_step_seconds": 0.01, "windows_per_s": 80.0, "wall_seconds": 7200.0,
            "num_parameters": 10, "num_threads": 1, "data": {"num_train": 56},
        }  # fmt: skip
        (job / "summary.json").write_text(json.dumps(summary | changes))
    return job


def test_every_job_has_a_row_whatever_became_of_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    make_job(tmp_path, 0, ["training.noise_std=0.0001"], 4.0)
    make_job(tmp_path, 1, ["training.noise_std=-1"], None)
    (tmp_path / "1-job" / "failed.txt").write_text("InputError: must not be | negative\n")
    make_job(tmp_path, 2, ["training.noise_std=0.01"], None)  # killed
    make_job(tmp_path, 10, ["training.noise_std=0.1"], 3.0, status="stopped")
    files = report_sweep(tmp_path, name="quickstart", tracking=None)
    assert [path.name for path in files] == ["sweep.csv", "sweep.md", "sweep.png", "sweep.pdf"]
    assert all(path.stat().st_size > 100 for path in files)
    with files[0].open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["job"] for row in rows] == ["0", "1", "2", "10"]
    assert [row["status"] for row in rows] == ["finished", "failed", "unfinished", "stopped"]
    assert [row["position_error"] for row in rows] == ["4.0", "", "", "3.0"]
    assert rows[0]["step_ms"] == "25.0" and rows[0]["rollout_step_ms"] == "10.0" and rows[0]["hours"] == "2.0"
    assert rows[0]["runout_99_error"] == "-0.4" and rows[1]["error"] == "InputError: must not be | negative"
    page = files[1].read_text()
    assert len({line.count("|") for line in page.splitlines() if line.startswith("|")}) == 1
    printed = capsys.readouterr().out
    assert "unfinished" in printed and "job 1-job failed: InputError: must not be" in printed


def test_a_failed_job_does_not_show_what_an_earlier_start_left(tmp_path: Path) -> None:
    job = make_job(tmp_path, 0, ["seed=0"], 4.0)
    (job / "failed.txt").write_text("OutOfMemoryError: no room\n")
    (read,) = read_jobs(tmp_path)
    assert read.status == "failed" and set(measured(read).values()) == {None}
    assert sweep_points([read]) == []
    assert [path.name for path in report_sweep(tmp_path, name="all failed", tracking=None)] == ["sweep.csv", "sweep.md"]


def test_one_line_per_value_of_the_second_parameter(tmp_path: Path) -> None:
    for number, (steps, noise) in enumerate([(1, 0.1), (1, 0.2), (5, 0.1), (5, 0.2)]):
        given = ["model.latent_size=8", f"model.num_message_passing_steps={steps}", f"training.noise_std={noise}"]
        make_job(tmp_path, number, given, 1.0 + number)
    jobs = read_jobs(tmp_path)
    assert swept_names(jobs) == ["model.num_message_passing_steps", "training.noise_std"]
    points = sweep_points(jobs)
    assert [(point.x, point.line) for point in points] == [
        (1.0, "noise_std = 0.1"), (1.0, "noise_std = 0.2"), (5.0, "noise_std = 0.1"), (5.0, "noise_std = 0.2")
    ]  # fmt: skip
    assert [point.values["position_error"] for point in points] == [1, 2, 3, 4]
    assert PANELS.keys() - points[0].values.keys() == {"deposit_error_percent", "height_rms_percent"}
    assert points[0].values["runout_99_error_percent"] == -10
    assert table_rows(jobs)[0][1:3] == swept_names(jobs)


def test_seeds_are_repetitions(tmp_path: Path) -> None:
    for number, (seed, noise) in enumerate([(0, 0.1), (0, 0.2), (1, 0.1), (1, 0.2)]):
        make_job(tmp_path, number, [f"seed={seed}", f"training.noise_std={noise}"], 1.0 + number)
    points = sweep_points(read_jobs(tmp_path))
    assert [(point.x, point.line) for point in points] == [(0.1, ""), (0.2, ""), (0.1, ""), (0.2, "")]


def test_seeds_are_put_together_in_the_first_table(tmp_path: Path) -> None:
    """Mean and standard deviation of those that have finished; the jobs follow one by one."""
    for number, (seed, noise) in enumerate([(0, 0.1), (0, 0.2), (1, 0.1), (1, 0.2)]):
        best = {"step": 50, "runout_99_error": 0.02 * number, "deposit_error": 0.1, "front_rms": 0.1, "map_rms": 0.05}
        status = "stopped" if number == 3 else "finished"
        make_job(tmp_path, number, [f"seed={seed}", f"training.noise_std={noise}"], best=best, status=status)
    jobs = read_jobs(tmp_path)
    table, every = shown_tables(jobs)
    assert table[0][:2] == ["training.noise_std", "seeds"] and len(every) == 1 + len(jobs)
    first, second = (dict(zip(table[0], row, strict=True)) for row in table[1:])
    assert (first["seeds"], first["runout"]) == ("2 of 2", "+2.0 ± 2.8 %")  # of 0 and 4 %
    assert (second["seeds"], second["runout"]) == ("1 of 2", "+2.0 %")
    assert first["deposits: front [%]"] == "10" and "error [spacing]" not in first  # nobody knows it
    assert over_seeds(jobs[::2])["runout_99_error"] == pytest.approx((0.02, 0.02 * 2**0.5))
    page = report_sweep(tmp_path, name="quickstart", tracking=None)[1].read_text()
    assert page.index("| training.noise_std | seeds |") < page.index("| job | seed |")


def test_all_trajectories_stand_at_their_number(tmp_path: Path) -> None:
    make_job(tmp_path, 0, ["training.num_train=10"])
    make_job(tmp_path, 1, ["training.num_train=null"])
    assert [point.x for point in sweep_points(read_jobs(tmp_path))] == [10, 56]


def test_words_and_groups_are_swept_too(tmp_path: Path) -> None:
    make_job(tmp_path, 0, ["model=small"])
    make_job(tmp_path, 1, ["model=paper"])
    make_job(tmp_path, 2, ["model=3"])
    assert [point.x for point in sweep_points(read_jobs(tmp_path))] == ["small", "paper", "3"]


def test_what_hydra_imports_before_anything_runs_is_light() -> None:
    code = "import sys, gns_pl.training.sweep, gns_pl.commands.train; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def config(folder: Path, **more: Any) -> Any:
    places = {"sweep": {"dir": str(folder)}, "runtime": {"output_dir": str(folder / "0-job")}}
    return OmegaConf.create({"name": "quickstart", "hydra": {"mode": "MULTIRUN", **places}, **more})


def test_a_failure_is_noted_and_forgotten_when_tried_again(tmp_path: Path) -> None:
    from hydra.types import RunMode

    job, cfg = make_job(tmp_path, 0, []), config(tmp_path)
    cfg.hydra.mode = RunMode.MULTIRUN
    report = SweepReport()
    report.on_job_end(cfg, JobReturn(status=JobStatus.FAILED, _return_value=ValueError("no")))
    assert (job / "failed.txt").read_text() == "ValueError: no\n"
    report.on_job_start(cfg, task_function=lambda cfg: None)
    report.on_job_end(cfg, JobReturn(status=JobStatus.COMPLETED, _return_value=None))
    assert not (job / "failed.txt").exists()
    cfg.hydra.mode = RunMode.RUN
    report.on_job_end(cfg, JobReturn(status=JobStatus.FAILED, _return_value=ValueError("no")))
    assert not (job / "failed.txt").exists()


def test_a_sweep_is_reported_once_also_if_it_ends_badly(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    reported = []
    monkeypatch.setattr("gns_pl.training.sweep.report_sweep", lambda folder, **rest: reported.append((folder, rest)))
    logger = {"offline": True, "wandb": {"project": "sand"}}
    with pytest.raises(SystemExit), sweep_reported():
        SweepReport().on_multirun_start(config(tmp_path, logger=logger))
        raise SystemExit(1)
    assert reported == [(tmp_path, {"name": "quickstart", "tracking": {"project": "sand", "offline": True}})]
    with sweep_reported():  # a single run
        pass
    with sweep_reported():
        SweepReport().on_multirun_start(config(tmp_path))
        SweepReport().on_multirun_end(config(tmp_path))
    close_sweep()
    assert len(reported) == 2 and reported[1][1]["tracking"] is None


def test_a_report_that_fails_hides_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(folder: Path, **rest: Any) -> None:
        raise OSError("disk full")

    monkeypatch.setattr("gns_pl.training.sweep.report_sweep", refuse)
    with pytest.raises(KeyError, match="the job's own"), sweep_reported():
        SweepReport().on_multirun_start(config(tmp_path))
        raise KeyError("the job's own")
    assert "report failed: OSError: disk full" in capsys.readouterr().err


def test_a_sweep_is_a_run_of_its_own_in_the_group_of_its_jobs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Everything that would go to W&B, with a stand-in for it."""
    seen: dict[str, Any] = {"rows": []}
    run = SimpleNamespace(dir=str(tmp_path / "wandb" / "run" / "files"), log=seen.update, summary=seen)
    monkeypatch.setattr("wandb.init", lambda **given: seen.update(given) or run)
    monkeypatch.setattr("wandb.finish", lambda: seen.update(finished=True))
    monkeypatch.setattr("wandb.Image", lambda path: path)
    table = SimpleNamespace(add_data=lambda *cells: seen["rows"].append(cells))
    monkeypatch.setattr("wandb.Table", lambda columns: seen.update(columns=columns) or table)
    folder = tmp_path / "runs" / "sand" / "now"
    make_job(folder, 0, ["seed=0"], 4.0)
    make_job(folder, 1, ["seed=1"], None)
    files = report_sweep(folder, name="sand", tracking={"project": "p", "offline": True})
    assert files[-1] == tmp_path / "wandb" / "run"
    assert (seen["group"], seen["job_type"], seen["mode"], seen["dir"]) == ("sand_now", "sweep", "offline", str(folder))
    assert seen["sweep_figure"] == str(folder / "sweep.png") and seen["finished"]
    first, second = (dict(zip(seen["columns"], row, strict=True)) for row in seen["rows"])
    assert first["position_error"] == 4.0 and second["position_error"] is None and second["status"] == "unfinished"
    assert seen["num_jobs"] == 2 and seen["num_failed"] == 0 and seen["all/position_error"] == 4.0


def test_names_are_what_folders_and_checkpoint_paths_can_take() -> None:
    assert group_name("runs/cube106_noise/2026-01-02_03-04-05") == "cube106_noise_2026-01-02_03-04-05"
    assert shortened("a=b,[c]/d e") == "a_b_c_d_e" and len(shortened("x" * 500)) == 120


@pytest.mark.parametrize(
    ("experiment", "sweep"),
    [
        *product(["quickstart", "cube106", "cube106_paper", "cube106_fine"], ["data_size", "noise", "message_passing"]),
        *product(["corrected_plane"], ["data_size", "message_passing"]),  # it has no noise
    ],
)
def test_every_sweep_fits_every_experiment(experiment: str, sweep: str) -> None:
    """What is swept exists in the config, and each value takes the place of the one there."""
    GlobalHydra.instance().clear()
    with initialize_config_dir(str(CONF), version_base=None):
        given = [f"+experiment={experiment}", f"+sweep={sweep}"]
        hydra = compose("train", given, return_hydra_config=True).hydra
        assert (
            hydra.mode.name == "MULTIRUN"
            and f"_{sweep}/" in OmegaConf.to_container(hydra, resolve=False)["sweep"]["dir"]
        )
        ((key, values),) = hydra.sweeper.params.items()
        first, *others = str(values).split(",")
        assert is_value(OmegaConf.select(compose("train", [*given, f"{key}={first}"]), key), first)
    parser = OverridesParser.create()
    assert all(is_value(parser.parse_override(f"{key}={value}").value(), value) for value in others)


def is_value(read: object, typed: str) -> bool:
    return read == yaml.safe_load(typed) or float(typed) == read


def test_the_fine_experiment_sees_as_far_as_the_coarse_one() -> None:
    GlobalHydra.instance().clear()
    with initialize_config_dir(str(CONF), version_base=None):
        coarse, fine = (compose("train", [f"+experiment={name}"]) for name in ("cube106_paper", "cube106_fine"))
    spacing = [
        cfg.data.mpm.cell_size / cfg.data.mpm.points_per_direction * cfg.data.get("every", 1) for cfg in (coarse, fine)
    ]
    assert spacing[0] == pytest.approx(spacing[1]) and coarse.model == fine.model and fine.name != coarse.name
