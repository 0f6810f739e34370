"""A kind of scene of one's own, from a file in the working folder: nothing of the package is edited."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from gns_pl.errors import InputError
from gns_pl.generation import draw_plan
from gns_pl.generation.spec import DatasetSpec
from gns_pl.io import read_trajectory
from gns_pl.solvers.named_scene import named_scene
from tests.commands.in_process import call
from tests.extend.page import ROOT, blocks
from tests.generation.test_spec import make_spec

SHARED = {"gravity": 9.81, "material": make_spec()["material"]}
SHARED["walls"] = {face: {"condition": "slip"} for face in ("x-", "x+", "y-", "y+", "z-", "z+")}
CATALOGUE = {"column_collapse": {**SHARED, "length": 1}}


@pytest.fixture(autouse=True)
def own_scenes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with the file of the page, and some functions that are none."""
    (text,) = blocks("A kind of scene")
    more = "\n\ndef nothing(): return 1\n\n\ndef draws_nothing(generator): return 1\n"
    (tmp_path / "own_scenes.py").write_text(text + more)
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "own_scenes", raising=False)
    importlib.invalidate_caches()
    return tmp_path


def plan(**changes: Any) -> Any:
    (text,) = blocks("A kind of scene", "yaml")
    family = yaml.safe_load(text)["families"]["towers"] | changes
    given = {key: value for key, value in family.items() if value is not ...}
    return draw_plan(DatasetSpec.from_dict({**make_spec(), "families": {"towers": given}}))


def test_a_family_draws_scenes_of_ones_own() -> None:
    drawn = plan()
    assert [planned.split for planned in drawn].count("valid") == 2 and len(drawn) == 20
    gaps = [planned.scene.bodies[1].position[0] - planned.scene.bodies[0].upper[0] for planned in drawn]
    heights = [planned.scene.bodies[0].size[2] for planned in drawn]
    assert 0.1 <= min(gaps) < 0.2 and 0.4 < max(gaps) <= 0.5 and 0.2 <= min(heights) < max(heights) <= 0.5
    assert [planned.scene for planned in plan(count=5)] == [planned.scene for planned in drawn[:5]]
    assert plan(material={**make_spec()["material"], "density": 900.0})[0].scene.materials["sand"].density == 900


def test_a_scene_of_ones_own_by_its_function() -> None:
    scene = named_scene("own_scenes.towers", CATALOGUE, {"gap": 0.1, "walls.x-.condition": "stick"})
    assert scene.name == "towers_gap_0.1_walls.x-.condition_stick"
    assert scene.bodies[1].position[0] - scene.bodies[0].upper[0] == pytest.approx(0.1)
    assert (scene.walls["x-"].condition, scene.walls["x+"].condition) == ("stick", "slip")
    entry = {"kind": "own_scenes.towers", "gap": 0.2, **SHARED}
    assert named_scene("pair", {"pair": entry}, {}).name == "pair"


def test_the_command_of_the_page(own_scenes: Path) -> None:
    """With MPM on coarse cells in the place of a checkpoint, and a short time."""
    typed = ["scene=own_scenes.towers", "scene.gap=0.2", "solver=mpm", "cell_size=0.1", "duration=0.02"]
    done = call(ROOT, "simulate.py", *typed, f"out={own_scenes}")
    assert done.returncode == 2 and "No module named 'own_scenes'" in done.stderr
    done = call(own_scenes, "simulate.py", *typed, "out=out")
    assert done.returncode == 0, done.stderr
    run = read_trajectory(own_scenes / "out" / "towers_gap_0.2.h5")
    assert run.num_frames == 3 and np.isfinite(run.position).all()


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"gap": ...}, "family towers: missing key gap"),
        ({"width": 1}, r"own_scenes.sample_towers: towers\(\) got an unexpected keyword argument 'width'"),
        ({"kind": "own_scenes.towers"}, "own_scenes.towers must take a random generator first"),
        ({"kind": "own_scenes.nothing"}, "own_scenes.nothing must take a random generator first"),
        ({"kind": "own_scenes.draws_nothing", "gap": ..., "height": ...}, "must return a Scene, not int"),
        ({"kind": "own_scenes.draws_nothing"}, "unknown key gap, height"),
        ({"kind": "nowhere.sample"}, "family towers: kind=nowhere.sample: No module named 'nowhere'"),
    ],
)
def test_what_is_no_kind_is_told(changes: dict[str, Any], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence) as refused:
        plan(**changes)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("name", "changes", "sentence"),
    [
        (
            "own_scenes.towers",
            {"width": 1},
            r"scene\.width: towers has no such key; there are gravity, material, walls",
        ),
        ("own_scenes.nothing", {}, "scene 'nothing': own_scenes.nothing: "),
        ("own_scenes.missing", {}, "scene=own_scenes.missing: .* has no attribute 'missing'"),
        ("towers", {}, "towers: there is no such scene file"),
    ],
)
def test_what_is_no_scene_is_told(name: str, changes: dict[str, Any], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        named_scene(name, CATALOGUE, changes)
