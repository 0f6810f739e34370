"""One measurement of the shipped models: README, docs and cards show it, and an evaluation's page finds it again."""

from __future__ import annotations

import csv
import importlib.util
import re
import sys
from pathlib import Path
from types import ModuleType

import pytest
import yaml

from gns_pl.io import file_sha256

ROOT = Path(__file__).parents[1]


def benchmark(name: str) -> ModuleType:
    """Return a script of benchmarks/ as a module."""
    spec = importlib.util.spec_from_file_location(name, ROOT / "benchmarks" / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def results() -> ModuleType:
    """benchmarks/results.py."""
    return benchmark("results")


def test_every_table_is_that_of_the_measurement(results: ModuleType) -> None:
    rows = results.read(results.RESULTS)
    assert {row.model for row in rows} == set(results.MODELS)
    for row in rows:
        assert row.sha256 == file_sha256(results.file_of(row.model)), f"{row.model} was measured with another file"
    tables = results.tables(rows)
    assert len(tables) == 2 + len(results.MODELS)
    for path, table in tables.items():
        [shown] = re.findall(r"<!-- models -->\n(.*?)\n<!-- /models -->", path.read_text(encoding="utf-8"), re.DOTALL)
        assert shown == table, f"{path}: python benchmarks/results.py --from-table"


def test_every_card_has_the_head_that_the_hub_reads(results: ModuleType) -> None:
    """With the keys that it documents, and those that a result has to have; the values are the measured ones."""
    rows = results.read(results.RESULTS)
    for model in results.MODELS:
        text = results.card(model).read_text(encoding="utf-8")
        assert text.startswith(f"---\n{results.head(model, rows)}---\n"), "python benchmarks/results.py --from-table"
        metadata = yaml.safe_load(text.split("---\n")[1])
        assert [metadata[key] for key in ("library_name", "license", "pipeline_tag")] == ["gns_pl", "mit", "graph-ml"]
        [index] = metadata["model-index"]
        assert index["name"] == results.card(model).stem
        own = [row for row in rows if row.model == model]
        for result, row in zip(index["results"], own, strict=True):
            assert result["task"]["type"] == "graph-ml" and result["dataset"]["type"] == row.scene
            assert result["dataset"]["name"] and result["dataset"]["split"] == row.split
            assert {each["type"]: each["value"] for each in result["metrics"]}["runout"] == row.runout


def test_no_card_gives_a_runout_error_besides_the_measured_table(results: ModuleType) -> None:
    """Numbers against the points that were kept stood there once, and said −1 % where all points say −14 %."""
    for model in results.MODELS:
        text = results.card(model).read_text(encoding="utf-8").split("---\n", 2)[2]
        text = re.sub(r"<!-- models -->.*<!-- /models -->", "", text, flags=re.DOTALL)
        assert not re.search(r"runout[^.]*?[+−-]\d+(\.\d)? %", text), model


def test_every_job_of_a_sweep_was_judged_on_every_column_and_the_page_shows_it(results: ModuleType) -> None:
    sweeps = benchmark("sweep_columns")
    rows = sweeps.read()
    text = (ROOT / "docs" / "results.md").read_text(encoding="utf-8")
    for mark, table in sweeps.tables(rows).items():
        [shown] = re.findall(rf"<!-- {mark} -->\n(.*?)\n<!-- /{mark} -->", text, re.DOTALL)
        assert shown == table, "python benchmarks/sweep_columns.py"
    columns = {f"column_{aspect_ratio}" for aspect_ratio in ("0.8", "1.2", "2.0", "3.0")}
    for sweep in {row.sweep for row in rows}:
        own = [row for row in rows if row.sweep == sweep]
        with (ROOT / "docs" / f"sweep_{sweep}.csv").open(newline="", encoding="utf-8") as file:
            jobs = {(job[own[0].parameter], int(job["seed"])) for job in csv.DictReader(file)}
        starts = {row.given for row in own}
        judged = [(row.value, row.seed, row.given, row.scene) for row in own]
        assert sorted(judged) == sorted((*job, given, each) for job in jobs for given in starts for each in columns)


@pytest.mark.slow
def test_the_page_says_what_the_table_says(
    results: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from gns_pl.evaluation.evaluate import evaluate_all

    monkeypatch.chdir(tmp_path)
    [row] = [
        row for row in results.read(results.RESULTS) if (row.model, row.scene) == ("column-fast-plane", "column_0.8")
    ]
    config = results.settings("columns")
    settings = {**config["evaluation"], "only": "column_0.8", "figures": False, "spread": []}
    folders = {"out": tmp_path / "out", "cache": tmp_path / "cache", "root": None, "logger": None}
    checkpoints = {row.model: results.file_of(row.model)}
    document = evaluate_all(checkpoints, stabilise=config["stabilise"], **folders, **settings)[row.model]
    scene = document["scenes"]["column_0.8"]
    # Processors round differently, and what collapses is chaotic: as much as the scatter of the mean of six.
    assert scene["errors"]["learned"]["runout_99_error"] == pytest.approx(row.runout, abs=0.01)
    assert scene["placements"]["std"]["runout_99_error"] == pytest.approx(row.runout_std, abs=0.01)
    assert scene["errors"]["learned"]["mean_height_error"] == pytest.approx(row.height, abs=0.005)
