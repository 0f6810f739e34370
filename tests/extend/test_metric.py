"""A number of one's own in the report: one entry in one file."""

from __future__ import annotations

import json
from pathlib import Path

from tests.extend.overlay import Overlay
from tests.extend.page import blocks

PROGRAM = """
from pathlib import Path

from gns_pl.evaluation import references
from gns_pl.evaluation.evaluate import evaluate_all
from gns_pl.evaluation.tracking import _table
from gns_pl.models.checkpoint import Checkpoint, save_checkpoint
from gns_pl.training.validation import NAMES
from tests.conftest import make_simulator
from tests.evaluation.made_up import spreading
from tests.evaluation.test_evaluate import DATA, SETTINGS, Tables

references.reference_trajectory = lambda scene, *, frame_interval, **_: spreading(scene, 11, dt=frame_interval)
data = DATA | {"mpm": {"cell_size": 0.1}}
save_checkpoint(Path("last.ckpt"), Checkpoint(make_simulator(dt=0.02), data, {"steps": 0}))
settings = SETTINGS | {"only": "short", "duration": 0.2, "placements": 2}
document = evaluate_all({"run": Path("last.ckpt")}, out=Path("out"), cache=Path("cache"), **settings)["run"]
assert {"reach", "reach_error"} <= {row[1] for row in _table(Tables, document).rows}
assert {"reach", "reach_error"} <= set(NAMES)
"""


def test_one_entry_is_all_that_a_number_needs(tmp_path: Path) -> None:
    (entry,) = blocks("A number in the report")
    overlay = Overlay(tmp_path)
    end = ')\n"""Every number about one run'
    overlay.edit("metrics/quantities.py", (end, f"{entry},\n{end}"))
    printed = overlay.run(PROGRAM)
    scene = json.loads((tmp_path / "out" / "metrics.json").read_text())["scenes"]["short"]
    reach, truth = scene["learned"]["reach"], scene["reference"]["reach"]
    assert 0 < reach < 1.5 and scene["errors"]["learned"]["reach_error"] != 0
    assert truth == 0.4 * 2 * (1 - 0.5 * 0.05 / 0.4) and scene["placements"]["std"]["reach"] >= 0
    shown = [(tmp_path / "out" / name).read_text() for name in ("table.md", "report.html")]
    assert all("farthest reach [m]" in text for text in (*shown, printed))
