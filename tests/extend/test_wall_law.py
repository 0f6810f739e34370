"""A wall law of one's own: two files are edited."""

from __future__ import annotations

from pathlib import Path

import pytest

from gns_pl.mpm.walls import NUMBERS
from gns_pl.scene.boundaries import WALL_CONDITIONS
from tests.extend.overlay import Overlay
from tests.extend.page import blocks

PROGRAM = """
from gns_pl.mpm import MPMConfig
from gns_pl.mpm.obstacles import obstacle_table
from gns_pl.mpm.plan import make_plan, make_setting
from gns_pl.mpm.walls import hold_at_walls
from gns_pl.scene import Body, Box, Wall, fill_scene, scene_from_dict
from tests.mpm.conftest import make_box, make_mpm

wall = Wall("weakening", 0.4)
block = Box((0.6, 0.0), (0.1, 0.1), wall)
scene = make_box((1.0, 1.0), Body((0.1, 0.0), (0.2, 0.2), (1.0, 0.0)), duration=0.1, lower_z=wall)
scene = scene_from_dict(scene.replace(obstacles=(block,)).to_dict())
config = make_mpm()
plan = make_plan(scene, fill_scene(scene, config.spacing), config, 0.01)
_, _, _, _, friction, _, obstacles, *_ = make_setting(scene, plan.grid, config, plan.dt)
vx, _, vz = hold_at_walls(1.0, 0.0, -0.5, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, friction[2, 0])
print(wall.description, vx, vz, obstacles[0, 7] == friction[2, 0], friction[2, 1])
"""


def test_two_edits_are_all_that_a_wall_law_needs(tmp_path: Path) -> None:
    condition, number, law = blocks("A wall law")
    overlay = Overlay(tmp_path)
    overlay.edit("scene/boundaries.py", ('    "friction": True,\n', f'    "friction": True,\n{condition}'))
    last, first = (
        '    "friction": lambda coefficient: coefficient,\n',
        "    if friction == STICK:\n        return 0.0\n    taken",
    )
    overlay.edit("mpm/walls.py", (last, last + number), (first, law + first))
    description, coefficient, *numbers = overlay.run(PROGRAM, NUMBA_CACHE_DIR=str(tmp_path)).split()
    assert (description, coefficient) == ("weakening", "0.4")
    along, through = map(float, numbers[:2])
    assert through == 0.0
    assert along == pytest.approx(1.0 - 0.4 / (1.0 + 1.0 / 0.5) * 0.5)
    assert numbers[2:] == ["True", "0.0"]


def test_every_condition_has_a_law() -> None:
    assert set(WALL_CONDITIONS) == set(NUMBERS)
