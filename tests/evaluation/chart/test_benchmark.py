"""A whole chart of tiny runs: measured, cut off, gone on with, drawn again, handed to the choice."""

from __future__ import annotations

import csv
import re
from pathlib import Path
from typing import Any

import pytest

from gns_pl.errors import InputError
from gns_pl.evaluation.chart import measure, speed
from gns_pl.evaluation.chart.benchmark import chart, draw_overview, finish
from gns_pl.evaluation.chart.converged import uncertainty_of
from gns_pl.evaluation.chart.entries import make_entries
from gns_pl.evaluation.chart.records import records_of, write_records
from gns_pl.evaluation.chart.tables import Tables
from gns_pl.models.checkpoint import Checkpoint, save_checkpoint
from gns_pl.models.shipped import find_corrector
from gns_pl.scene import Scene, read_scene
from gns_pl.solvers.catalogue import make_solvers
from gns_pl.solvers.measured_range import setup_text
from gns_pl.solvers.selection import choose, estimate, read_records
from gns_pl.solvers.simulate import simulate_by_choice
from tests.conftest import MPM as SETTINGS
from tests.conftest import make_simulator
from tests.evaluation.chart.made_up import folder, row
from tests.solvers.test_selection import DATA, column

MPM = {**SETTINGS, "precision": "float32"}
CHOICE = {"learned": [], "corrected": [], "hybrid": {}, "cells": [3.0, 4.0], "mpm": MPM}


def settings(folder: Path, **changes: Any) -> dict[str, Any]:
    """The smallest chart that has everything."""
    rough = {face: {"condition": "friction", "friction": 0.385} for face in ("x-", "x+", "z-", "z+")}
    values: dict[str, Any] = {
        "out": folder / "chart", "cache": folder / "cache", "ckpt": [], "choice": CHOICE, "frame_interval": 0.02,
        "placements": 2, "threads": [1], "device": "cpu",
        "reference": {"plane": {"cells_per_metre": [20, 15], "placements": 2}, "order": 1.7},
        "variants": {"points": {"cells": [3.0], "per_direction": [3]}, "courant": {"cells": [3.0], "numbers": [0.3]},
                     "whole": {"cells": [3.0]}},
        "extrapolate": {"pairs": [[3.0, 4.0]], "order": 1.0}, "trivial": {"cells": 3.0}, "stabilise": {},
        "law": {"aspect_ratios": [0.8, 1.5], "size": 0.3, "cells": 3.0, "domain": [1.5, 0.5, 0.9],
                "data": {**DATA, "walls": rough | {"y-": {"condition": "slip"}, "y+": {"condition": "slip"}}}},
        "batches": {"sizes": [1, 2], "turns": 1}, "ratios": {"turns": 1}, "costs": {},
    }  # fmt: skip
    return values | changes


@pytest.fixture(autouse=True)
def no_pauses(monkeypatch: pytest.MonkeyPatch) -> None:
    """Times do not matter here."""
    monkeypatch.setattr(speed, "SPIN", 0.0)


@pytest.fixture
def scene() -> Scene:
    return column(1.0)


@pytest.fixture
def flat(tmp_path: Path) -> Path:
    simulator = make_simulator(dim=2, spacing=0.05, dt=0.02, connectivity_radius=0.1)
    path = tmp_path / "flat.ckpt"
    cost = {"data_seconds": 5.0, "train_seconds": 7.0}
    save_checkpoint(path, Checkpoint(simulator, DATA, {"cost": cost}))
    return path


def test_a_chart_goes_on_where_it_was_cut_and_feeds_the_choice(
    scene: Scene, flat: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    said: list[str] = []

    def cut(text: str) -> None:
        said.append(text)
        if text.startswith("[5/"):
            raise KeyboardInterrupt

    monkeypatch.setattr(measure, "say", cut)
    with pytest.raises(KeyboardInterrupt):
        chart([scene], **settings(tmp_path, ckpt=[str(flat)]))
    out = tmp_path / "chart"
    kept = list(Tables(out).runs)
    assert len(kept) == 5

    monkeypatch.setattr(measure, "say", said.append)
    made = chart(
        [scene], **settings(tmp_path, ckpt=[str(flat)], records=tmp_path / "mine.csv", publish=tmp_path / "docs")
    )
    rows = list(Tables(out).runs)
    assert rows[:5] == kept, "what was measured is not measured again"
    names = {row.name for row in rows}
    assert names == {
        "mpm_3", "mpm_4", "mpm_3_p3", "mpm_3_c0.3", "mpm_3_whole", "flat", "nothing_moves", "ballistic",
    }  # fmt: skip
    assert len(rows) == 2 * len(names) and sum(text.startswith("[") for text in said) == 2 * len(names)
    assert {row.dim for row in rows if row.name == "mpm_3_whole"} == {3}
    assert {row.dim for row in rows if row.name == "mpm_3"} == {2}
    assert len(Tables(out).batches) == 2 * 3
    assert {row.name for row in Tables(out).ratios} <= {"flat"}
    assert all(path.exists() for path in made)
    published = {path.name for path in (tmp_path / "docs").iterdir()} - {"ratios.csv"}
    drawn = {"chart.csv", "chart.md", "chart.png", "chart.svg", "details.png", "details.svg"}
    assert published == drawn | {"plan.json", "runs.csv", "batches.csv"}
    again = list(Tables(tmp_path / "docs").runs)
    assert [row.seconds for row in again] == pytest.approx([row.seconds for row in rows], rel=1e-4)
    with (out / "chart.csv").open() as file:
        points = {each["name"]: each for each in csv.DictReader(file)}
    assert (float(points["flat"]["data_seconds"]), float(points["flat"]["train_seconds"])) == (5.0, 7.0)
    assert {"extrapolated_3_4", "law_lube", "law_fitted"} < set(points)

    # Nothing is left to measure, and nothing is run.
    monkeypatch.setattr(speed, "timed_run", None)
    chart([scene], **settings(tmp_path, ckpt=[str(flat)]))
    # Nor is anything needed to draw again: neither the checkpoint nor the reference.
    flat.unlink()
    page = (out / "chart.md").read_text()
    (out / "chart.md").unlink()
    finish(out, records=None, publish=None, logger=None)
    assert (out / "chart.md").read_text().splitlines()[:6] == page.splitlines()[:6]

    # One page of several charts is made of the published folders alone.
    draw_overview([tmp_path / "docs"], tmp_path / "all", records=None)
    page = (tmp_path / "all" / "chart.md").read_text()
    assert "## Columns in plane strain" in page and "[../docs/chart.md](../docs/chart.md)" in page
    assert "**`mpm_" in page and (tmp_path / "all" / "chart.png").stat().st_size > 10_000

    # The choice goes by it.
    for table in (out / "records.csv", tmp_path / "mine.csv"):
        records = read_records(table)
        assert {each.solver for each in records} == {"mpm_3", "mpm_4", "flat"}
    ways = make_solvers({"cells": [3.0, 4.0], "mpm": MPM})
    options = {each.solver.name: each for each in estimate(scene, ways, records)}
    worst = max(max(abs(row.front_error), row.map_error) for row in rows if row.name == "mpm_4")
    assert options["mpm_4"].error == pytest.approx(worst) and options["mpm_4"].seconds is not None
    capsys.readouterr()
    choice = CHOICE | {"frame_interval": 0.02, "records": str(out / "records.csv")}
    simulate_by_choice([scene], out=tmp_path / "flows", choice=choice, tolerance=2.0, explain=True)
    assert re.search(r"chosen: mpm_[34], the cheapest of 2", capsys.readouterr().out)


def test_a_checkpoint_trained_anew_is_measured_anew(scene: Scene, flat: Path, tmp_path: Path) -> None:
    small = settings(tmp_path, ckpt=[str(flat)], variants={}, placements=1, batches={"sizes": []}, ratios={"turns": 0})
    chart([scene], **small)
    before = {row.identity for row in Tables(tmp_path / "chart").runs if row.name == "flat"}
    simulator = make_simulator(dim=2, spacing=0.05, dt=0.02, connectivity_radius=0.1, latent_size=8)
    save_checkpoint(flat, Checkpoint(simulator, DATA, {}))
    chart([scene], **small)
    after = [row.identity for row in Tables(tmp_path / "chart").runs if row.name == "flat"]
    assert len(after) == 2 and before < set(after)
    assert len(Tables(tmp_path / "chart").runs) == 5 + 1


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"device": "tpu"}, "device must be auto, cpu or cuda, not 'tpu'"),
        ({"threads": [10_000]}, "threads must lie between 1 and"),
        ({"threads": [1, 10_000]}, "threads must lie between 1 and"),
        ({"extrapolate": {"pairs": [[4.0, 3.0]], "order": 1.0}}, "the coarser first"),
        ({"reference": {"plane": {}, "order": 1.0}}, "reference.plane: needs cells_per_metre and placements"),
        ({"variants": {"cell": [3.0]}}, "variants: takes cells"),
        ({"variants": {"cells": [3.0]}}, "the chart would hold mpm_3 twice"),
        (
            {"reference": {"plane": {"cells_per_metre": [], "placements": 1}, "order": 1.0}},
            "one cells_per_metre at least",
        ),
        (
            {"reference": {"plane": {"cells_per_metre": [8, 12], "placements": 1}, "order": 1.0}},
            "the finest comes first",
        ),
    ],
)
def test_what_cannot_be_charted_is_refused(changes: dict[str, Any], message: str, scene: Scene, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=message):
        chart([scene], **settings(tmp_path, **changes))
    assert not list(Tables(tmp_path / "chart").runs)


def test_scenes_of_two_kinds_are_refused(scene: Scene, tmp_path: Path) -> None:
    rough = column(1.0, sides=scene.walls["z-"], name="rough")
    with pytest.raises(InputError, match="chart them apart"):
        chart([scene, rough], **settings(tmp_path))


def test_scenes_without_a_law_are_charted_as_far_as_a_solver_can_run_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A network that knows no obstacles is compared with MPM where there are none, and the page says so."""
    path = tmp_path / "space.ckpt"
    save_checkpoint(path, Checkpoint(make_simulator(dim=3, spacing=0.1, dt=0.02, connectivity_radius=0.15), DATA, {}))
    scenes = [read_scene(name).replace(duration=0.1) for name in ("two_columns", "barrier")]
    small = settings(tmp_path, ckpt=[str(path)], variants={}, placements=1, batches={"sizes": [1], "turns": 1})
    space = {"cells_per_metre": [12, 10], "placements": 1}
    chart(scenes, **small | {"reference": {"space": space, "order": 1.7}})
    rows = list(Tables(tmp_path / "chart").runs)
    ran = {name: {row.scene for row in rows if row.name == name} for name in ("space", "mpm_3")}
    assert ran == {"space": {"two_columns"}, "mpm_3": {"two_columns", "barrier"}}
    page = (tmp_path / "chart" / "chart.md").read_text()
    assert "- `space` is not run on barrier: knows no obstacles." in page and "`space` is run outside" in page
    assert "law_" not in page and "mpm_3" in page
    assert {row.name for row in Tables(tmp_path / "chart").batches} == {"mpm_3", "mpm_4"}
    records = read_records(tmp_path / "chart" / "records.csv")
    assert all(each.map_error >= 0 for each in records)
    options = estimate(scenes[1], make_solvers({"cells": [3.0, 4.0], "mpm": MPM}), records)
    assert all(option.error is not None for option in options)


def test_nothing_measured_nothing_drawn(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"run python benchmark\.py without from_table=true"):
        finish(tmp_path, records=None, publish=None, logger=None)


def test_the_uncertainty_is_the_largest_of_its_estimates() -> None:
    assert uncertainty_of([[2.0]], [144], 2.0) == 0
    assert uncertainty_of([[2.0, 2.2]], [144], 2.0) == pytest.approx(0.2 / 2.1)  # twice the scatter
    assert uncertainty_of([[2.0], [1.9]], [144, 72], 2.0) == pytest.approx(0.05 / 2)  # half the range
    assert uncertainty_of([[2.0], [1.9]], [144, 96], 2.0) == pytest.approx(1.25 * 0.1 / 1.25 / 2)  # Roache's index


def test_records_take_the_place_of_those_of_the_same_way(tmp_path: Path) -> None:
    new = records_of(folder(tmp_path).runs, dict.fromkeys(("low fine", "high fine"), setup_text(column())))
    worst = next(each for each in new if (each.solver, each.scene) == ("mpm_5", "low"))
    assert worst.runout_error == pytest.approx(-0.44) and worst.seconds == 0.1 and worst.device == "a machine"
    path = tmp_path / "deep" / "records.csv"
    others = records_of(
        [row("mpm_5", "mpm", 9.0, 9.0), row("mpm_5", "mpm", 9.0, 9.0, kind="space"), row("gone", "mpm", 0.0, 1.0)]
    )
    assert write_records(path, others) == 3
    assert write_records(path, new) == len(new) + 2
    assert {(each.solver, each.kind) for each in read_records(path)} >= {("mpm_5", "space"), ("gone", "plane")}
    assert max(abs(each.runout_error) for each in read_records(path) if each.kind == "plane") < 2
    assert worst.map_error == pytest.approx(0.11) and worst.error == pytest.approx(0.44)
    assert write_records(path, records_of([row("mpm_5", "mpm", 0.1, 1.0, scene="another")])) == len(new) + 3
    best, why = choose(
        estimate(column(), make_solvers({"cells": [5.0, 10.0, 20.0], "mpm": MPM}), read_records(path)), 0.25
    )
    assert best.solver.name == "mpm_10" and "cheapest of 2" in why
    (tmp_path / "other.csv").write_text("way,kind\na,b\n")
    with pytest.raises(InputError, match="is no table of"):
        write_records(tmp_path / "other.csv", new)


def test_a_corrector_is_named_like_a_checkpoint(flat: Path, tmp_path: Path) -> None:
    """`benchmark.py ckpt=[…]` takes what ships, once, and correctors of one's own."""
    mine = tmp_path / "mine.corrector"
    mine.write_bytes(find_corrector("corrected_plane").read_bytes())
    choice = CHOICE | {"corrected": ["corrected_plane"]}
    ckpt = ["corrected_plane", str(flat), str(mine)]
    entries = make_entries(ckpt, choice, {}, 3.0, {}, "cpu", "cpu")
    groups = {each.name: each.group for each in entries if each.group in ("learned", "corrected")}
    assert groups == {"corrected_plane": "corrected", "mine": "corrected", "flat": "learned"}
