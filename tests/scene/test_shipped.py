"""The scenes that come with the package, by name from anywhere."""

from __future__ import annotations

from pathlib import Path

import pytest

from gns_pl.errors import InputError
from gns_pl.mpm import MPMConfig, simulate
from gns_pl.presets import preset, scene_names
from gns_pl.scene import Scene, read_scene
from gns_pl.scene.extent import characteristic_time, initial_extent, touching_bodies
from gns_pl.scene.plain import scene_path
from gns_pl.solvers.solver import characteristic_size
from tests.conftest import MPM
from tests.evaluation.made_up import column
from tests.solvers.test_measured_range import sand_over_clay

PAPER = preset("data/_paper")


@pytest.mark.parametrize("name", preset("evaluation/general")["scenes"])
def test_a_scene_of_the_set_is_of_the_papers_sand_between_its_walls(name: str) -> None:
    scene = read_scene(name)
    assert (scene.name, scene.dim) == (name, 3)
    assert {wall.description for wall in scene.walls.values()} == {"friction 0.385"}
    assert {obstacle.wall.description for obstacle in scene.obstacles} <= {"friction 0.385"}
    assert set(scene.materials) == {"sand"} and scene.materials["sand"].youngs_modulus == 2e6
    assert vars(scene.materials["sand"]) == {"dilation_angle_deg": 0.0} | PAPER["material"]
    assert 0.3 <= characteristic_size(scene) <= 0.45 and scene.duration >= 5.8 * characteristic_time(scene)
    frames = scene.duration / 0.02
    assert frames == pytest.approx(round(frames))


@pytest.mark.parametrize("name", scene_names())
def test_nothing_leaves_the_box_and_all_of_it_moves(name: str) -> None:
    scene = read_scene(name)
    cell = 0.1 if scene.terrain is None else characteristic_size(scene) / 4
    run = simulate(scene, MPMConfig(**{**MPM, "cell_size": cell}), frame_interval=scene.duration / 14, seed=0)
    inside = (run.position >= scene.lower) & (run.position <= scene.upper)
    assert inside.all()
    assert run.position[-1, :, -1].mean() < 0.95 * run.position[0, :, -1].mean()


def test_the_evaluations_sets_are_the_package_s() -> None:
    sets = [preset(f"evaluation/{name}")["scenes"] for name in ("general", "terrain")]
    assert sorted([*sets[0], *sets[1], "hillside"]) == scene_names()


def test_a_file_comes_before_a_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert read_scene("corner").name == "corner"
    (tmp_path / "corner").write_text(scene_path("step").read_text())
    assert read_scene("corner").name == "step"
    with pytest.raises(InputError, match="nowhere: cannot be read"):
        read_scene("nowhere")


def test_bodies_that_touch_are_measured_together_and_others_apart() -> None:
    stacked: Scene = sand_over_clay()
    assert [len(group) for group in touching_bodies(stacked)] == [2]
    assert characteristic_size(stacked) == pytest.approx(0.3)
    apart = read_scene("two_columns")
    assert [len(group) for group in touching_bodies(apart)] == [1, 1]
    assert characteristic_size(apart) == pytest.approx((0.3 * 0.45) ** 0.5) and initial_extent(apart)[0] == 1.0
    assert characteristic_size(column()) == pytest.approx((0.4 * 0.2) ** 0.5)
