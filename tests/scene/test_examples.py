"""The scene files that come with the project."""

from __future__ import annotations

from pathlib import Path

import pytest

from gns_pl.scene import fill_scene, read_scene

FILES = sorted((Path(__file__).parents[2] / "scenes").glob("*.yaml"))


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_it_can_be_read_and_filled(path: Path) -> None:
    scene = read_scene(path)
    spacing = 1 / 24 if scene.terrain is None else scene.terrain.cell / 4
    assert len(fill_scene(scene, spacing).position) > 100


def test_there_are_some() -> None:
    assert FILES
