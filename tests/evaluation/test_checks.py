"""evaluate.py as a user runs it: its refusals and its configuration."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from gns_pl.evaluation.checks import default_folder, named_checkpoints
from gns_pl.models.checkpoint import Checkpoint, save_checkpoint
from gns_pl.models.shipped import FOLDER
from tests.commands.in_process import call
from tests.conftest import make_simulator
from tests.evaluation.test_scenes import DATA

DOOR = Path(__file__).parents[2] / "evaluate.py"


def process(folder, *arguments, **environment):
    return subprocess.run(
        [sys.executable, str(DOOR), *arguments],
        cwd=folder,
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "which checkpoint? Name one: python evaluate.py ckpt=runs/…/last.ckpt"),
        (
            ("ckpt=nowhere/last.ckpt",),
            "nowhere/last.ckpt: there is no such checkpoint; those that come with gns_pl are collapse, ",
        ),
        (("ckpt=foreign.ckpt", "evaluation.figures=false"), "foreign.ckpt: is not a readable checkpoint"),
    ],
)
def test_refusals_are_one_sentence_and_leave_nothing_behind(tmp_path, arguments, message) -> None:
    (tmp_path / "foreign.ckpt").write_text("not a checkpoint")
    done = call(tmp_path, "evaluate.py", *arguments)
    assert done.returncode == 2
    assert done.stderr.strip().startswith(f"evaluate.py: {message}")
    assert len(done.stderr.strip().splitlines()) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["foreign.ckpt"]


def test_a_missing_checkpoint_is_refused_before_torch_is_imported(tmp_path) -> None:
    done = process(tmp_path, "ckpt=nowhere.ckpt", PYTHONPROFILEIMPORTTIME="1")
    assert "omegaconf" in done.stderr
    assert not any(line.endswith((" torch", " matplotlib", " wandb")) for line in done.stderr.splitlines())


def test_config_composes_with_the_documented_overrides() -> None:
    from hydra import compose, initialize_config_dir

    overrides = ["ckpt=a/last.ckpt", "evaluation.scenes=[scene.yaml,b.yaml]", "evaluation.only=[mine,column_0.8]"]
    with initialize_config_dir(str(DOOR.parent / "conf"), version_base=None):
        cfg = compose("evaluate", overrides=[*overrides, "logger.offline=false", "logger.enabled=false"])
    assert list(cfg.evaluation.only) == ["mine", "column_0.8"]
    assert list(cfg.evaluation.scenes) == ["scene.yaml", "b.yaml"]
    assert len(DOOR.read_text().splitlines()) <= 30


@pytest.mark.slow
def test_a_whole_run_from_two_folders_gives_the_same_numbers(tmp_path) -> None:
    mpm = {
        "cell_size": 1 / 12,
        "points_per_direction": 2,
        "courant": 0.3,
        "transfer": "affine_flip",
        "damping_rate": 20.0,
    }
    data = DATA | {"mpm": mpm | {"bulk_viscosity": 0.3, "jitter": 0.7}}
    simulator = make_simulator(dt=0.02, connectivity_radius=0.08, output="gated")
    settings = ("evaluation.only=column_2.0", "evaluation.duration=3", "logger.enabled=false")
    documents = []
    for folder in ("here", "there"):
        (tmp_path / folder).mkdir()
        if documents:
            shutil.copy(tmp_path / "here" / "a.ckpt", tmp_path / "there" / "a.ckpt")
        else:
            save_checkpoint(tmp_path / "here" / "a.ckpt", Checkpoint(simulator, data, {}))
        done = process(tmp_path / folder, "ckpt=a.ckpt", *settings)
        assert done.returncode == 0, done.stderr
        made = tmp_path / folder / "evaluation"
        assert {"table.md", "report.html", "column_2.0.gif", "runout_height.pdf"} <= {
            path.name for path in made.iterdir()
        }
        document = json.loads((made / "metrics.json").read_text())
        assert document.pop("run")["command"].startswith("evaluate.py ckpt=a.ckpt")
        scene = document["scenes"]["column_2.0"]
        assert scene.pop("wall_seconds").keys() == scene.pop("made_by").keys() == {"reference", "learned"}
        documents.append(document)
    first, second = (document["scenes"]["column_2.0"] for document in documents)
    for key in ("reference", "learned", "no_motion", "errors"):
        assert first[key] == second[key], key
    assert documents[0] == documents[1]
    assert scene["reference"]["runout_99"] > 1


def test_the_name_that_was_typed_is_the_name_everywhere(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert named_checkpoints(["column-fast"]) == {"column-fast": FOLDER / "column-fast.ckpt"}
    assert named_checkpoints(["collapse"]) == {"collapse": FOLDER / "collapse.ckpt"}
    assert default_folder("column-fast", named_checkpoints(["column-fast"])) == Path("runs/column-fast/evaluation")
    paths = [tmp_path / name for name in ("a/best.ckpt", "a/last.ckpt", "b/a/last.ckpt", "mine.ckpt")]
    for path in paths:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    found = named_checkpoints([*map(str, paths[:3]), "mine.ckpt", str(paths[0]), "column-fast", "collapse"])
    assert list(found) == ["a", "a_last", "a_last_3", "mine", "column-fast", "collapse"]


def test_where_the_data_lie_now_is_passed_on(tmp_path, monkeypatch) -> None:
    from hydra import compose, initialize_config_dir

    from gns_pl.evaluation import evaluate

    passed = {}
    monkeypatch.setattr(evaluate, "evaluate_all", lambda checkpoints, **settings: passed.update(settings))
    overrides = ["ckpt=collapse", "data.root=some/folder", "evaluation.start=frames", "evaluation.figures=false"]
    with initialize_config_dir(str(DOOR.parent / "conf"), version_base=None):
        evaluate.evaluate_config(compose("evaluate", overrides=overrides))
    assert (passed["root"], passed["start"], passed["placements"], passed["speed"]) == (
        "some/folder",
        "frames",
        6,
        False,
    )
