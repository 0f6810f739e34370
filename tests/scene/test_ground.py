"""Scene files with a terrain and releases: read, cropped, moved near zero, filled, written, and told what is wrong."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from gns_pl.errors import InputError
from gns_pl.io import read_trajectory, write_trajectory
from gns_pl.scene import (
    Raster,
    Scene,
    Wall,
    fill_scene,
    make_release,
    near_origin,
    read_scene,
    scene_from_dict,
    write_scene,
)
from gns_pl.scene.release import Release
from gns_pl.solvers.catalogue import load_solver
from gns_pl.trajectory import start_trajectory

EXAMPLE = Path(__file__).parents[2] / "scenes" / "landslide.yaml"


@pytest.fixture(scope="module")
def hill() -> Scene:
    return read_scene(EXAMPLE)


def changed(tmp_path: Path, **changes: Any) -> Path:
    """The example with other entries, beside copies of its files."""
    data = yaml.safe_load(EXAMPLE.read_text()) | changes
    for name in ("hill.asc", "hill_release.geojson"):
        (tmp_path / name).write_bytes((EXAMPLE.parent / name).read_bytes())
    path = tmp_path / "hill.yaml"
    path.write_text(yaml.safe_dump(data))
    return path


def test_a_hill_on_the_map_is_read_near_zero_and_remembers_where_it_was(hill: Scene) -> None:
    assert hill.terrain is not None
    assert hill.origin == (600000.0, 5100000.0, 0.0)
    assert (hill.lower[:2], hill.upper[:2]) == ((0.0, 0.0), (320.0, 200.0))
    assert (hill.terrain.corner, hill.terrain.cell, hill.terrain.crs) == ((2.5, 2.5), 5.0, "EPSG:32632")
    first = EXAMPLE.with_name("hill.asc").read_text().splitlines()[6].split()  # the north-west corner
    assert hill.terrain.heights[0, -1] == float(first[0])
    [release] = hill.bodies
    assert isinstance(release, Release)
    assert release.outline[0][0] == (20.0, 80.0)
    assert release.volume == pytest.approx(8414.0)
    assert near_origin(hill) is hill


@pytest.mark.parametrize("ending", [".yaml", ".json"])
def test_it_comes_back_to_the_bit(hill: Scene, tmp_path: Path, ending: str) -> None:
    depth = Raster(np.random.default_rng(0).uniform(0.5, 2, (3, 4)), (200.0, 100.0), 5.0)
    assert hill.terrain is not None
    scene = hill.replace(bodies=(*hill.bodies, make_release(hill.terrain, thickness=depth)))
    write_scene(scene, tmp_path / f"again{ending}")
    assert read_scene(tmp_path / f"again{ending}") == scene
    assert scene_from_dict(json.loads(json.dumps(scene.to_dict()))) == scene
    assert hash(scene.terrain) == hash(scene_from_dict(scene.to_dict()).terrain)


def test_a_trajectory_holds_its_ground(hill: Scene, tmp_path: Path) -> None:
    start = start_trajectory(hill, fill_scene(hill, 5.0), 0.1, {})
    write_trajectory(tmp_path / "run.h5", start)
    assert read_trajectory(tmp_path / "run.h5").scene == hill


@pytest.mark.parametrize("jitter", [0.0, 0.5])
def test_a_release_is_filled_between_the_ground_and_its_surface(hill: Scene, jitter: float) -> None:
    points = fill_scene(hill, 1.0, jitter=jitter, generator=np.random.default_rng(0))
    assert hill.terrain is not None
    above = points.position[:, 2] - hill.terrain.height(points.position)
    assert points.volume.sum() == pytest.approx(hill.bodies[0].volume, rel=1e-12)
    assert above.min() > 0 and above.max() < 4.0
    assert above.mean() == pytest.approx(2.0, abs=0.01)
    assert np.median(points.volume) == pytest.approx(1.0, rel=0.02)
    lattice, counts = np.unique(points.lattice[:, :2], axis=0, return_counts=True)
    assert (counts == 4).all() and len(lattice) == len(above) / 4


def test_a_raster_of_thicknesses_keeps_its_volume_and_a_hole_stays_empty(hill: Scene) -> None:
    assert hill.terrain is not None
    values = np.full((8, 8), 2.0)
    values[3:5, 3:5] = np.nan
    release = make_release(hill.terrain, thickness=Raster(values, (102.5, 82.5), 5.0))
    ring = [[(100, 80), (140, 80), (140, 120), (100, 120)], [(115, 95), (125, 95), (125, 105), (115, 105)]]
    same = make_release(hill.terrain, thickness=2.0, outline=ring)
    assert release.volume == same.volume == pytest.approx(60 * 25 * 2.0)
    for body in (release, same):
        points = fill_scene(hill.replace(bodies=(body,)), 2.5)
        assert points.volume.sum() == pytest.approx(body.volume)
        middle = (np.abs(points.position[:, :2] - [120, 100]) < 5).all(axis=1)
        assert not middle.any()
    edges = [np.arange(100.0, 141.0, 10.0), np.arange(80.0, 121.0, 10.0)]
    assert np.allclose(release.means(edges), same.means(edges), atol=1e-12)


def test_a_box_crops_and_resample_makes_cells_larger(hill: Scene, tmp_path: Path) -> None:
    box = {"lower": [600040.0, 5100020.0, 380.0], "upper": [600240.0, 5100180.0, 600.0]}
    body = [{"outline": [[[600060, 5100080], [600080, 5100080], [600080, 5100100]]], "thickness": 3.0}]
    small = read_scene(changed(tmp_path, **box, bodies=body))
    assert small.terrain is not None and hill.terrain is not None
    assert small.terrain.heights.shape == (42, 34) and small.origin == (600040.0, 5100020.0, 0.0)
    places = np.random.default_rng(0).uniform(0, 150, (20, 2))
    assert np.allclose(small.terrain.height(places), hill.terrain.height(places + np.array([40, 20])), atol=1e-9)
    terrain = {"file": "hill.asc", "wall": {"condition": "slip"}, "resample": 10.0}
    coarse = read_scene(changed(tmp_path, **box, bodies=body, terrain=terrain))
    assert coarse.terrain is not None and coarse.terrain.cell == pytest.approx(10.0, rel=0.05)
    assert coarse.terrain.heights.mean() == pytest.approx(small.terrain.heights.mean(), rel=0.02)


def test_a_profile_in_plane_strain(tmp_path: Path) -> None:
    np.save(tmp_path / "profile.npy", np.linspace(3.0, 1.0, 11))
    data = yaml.safe_load(EXAMPLE.read_text()) | {
        "gravity": [0.0, -9.81],
        "walls": {face: {"condition": "slip"} for face in ("x-", "x+", "z-", "z+")},
        "terrain": {"file": "profile.npy", "corner": [0.5], "cell": 1.0, "wall": {"condition": "stick"}},
        "bodies": [{"position": [1.0, 2.0], "size": [2.0, 2.0], "velocity": [0.0, 0.0]}],
    }
    scene = scene_from_dict(data, tmp_path)
    assert (scene.lower, scene.upper) == ((0.0, 0.0), (11.0, 5.0))
    particles = fill_scene(scene, 0.1)
    assert scene.terrain is not None and scene.terrain.wall == Wall("stick")
    assert (particles.position[:, 1] >= scene.terrain.height(particles.position)).all()
    assert 200 < len(particles.position) < 400


BOX = {"lower": [600000.0, 5100000.0, 380.0], "upper": [600320.0, 5100200.0, 600.0]}
WALL = {"condition": "friction", "friction": 0.3}


BOW_TIE = [[600060, 5100060], [600080, 5100080], [600080, 5100060], [600060, 5100080]]
LINE = [[600060, 5100060], [600070, 5100070], [600080, 5100080]]


def square(x: int) -> list[list[int]]:
    return [[600000 + x, 5100060], [600020 + x, 5100060], [600020 + x, 5100080], [600000 + x, 5100080]]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"terrain": {"file": "no.asc", "wall": WALL}}, r"no\.asc: no such file"),
        ({"terrain": {"file": "hill.asc", "wal": WALL}}, r"unknown key wal \(did you mean wall\?\)"),
        ({"terrain": {"file": "hill.asc"}}, "terrain: wall must be a mapping"),
        ({"terrain": {"file": "hill.asc", "wall": WALL, "resample": 500}}, "cells of 500 m are too large"),
        ({"terrain": {"heights": {"shape": [2, 2], "zlib": "AAAA"}, "wall": WALL}}, "numbers are damaged"),
        (
            {**BOX, "lower": [599000.0, 5100000.0, 380.0]},
            "the domain reaches from x = 599000 .*; choose a domain on it",
        ),
        ({**BOX, "upper": [600320.0, 5100200.0, 450.0]}, "ground reaches up to 518.* the lid at 450"),
        ({"bodies": [{"outline": "hill_release.geojson"}]}, "body 0: a release needs a thickness"),
        ({"bodies": [{"outline": "hill.asc", "thickness": 1.0}]}, "is not GeoJSON"),
        ({"bodies": [{"outline": [[[7.1, 45.2], [7.2, 45.2], [7.2, 45.3]]], "thickness": 1}]}, "one system of coord"),
        ({"bodies": [{"outline": [[[600060, 5100080], [600080, 5100080]]], "thickness": 1}]}, "needs three corners"),
        (
            {"bodies": [{"outline": [BOW_TIE], "thickness": 1}]},
            "body 0: its outline crosses itself, or its",
        ),
        ({"bodies": [{"outline": [square(80), square(90)], "thickness": 1}]}, "or its rings overlap"),
        ({"bodies": [{"outline": [square(80), square(80)], "thickness": 1}]}, "or its rings overlap"),
        ({"bodies": [{"outline": [[square(80)[0], square(80)[2], square(80)[0]]], "thickness": 1}]}, "three corners"),
        ({"bodies": [{"outline": [LINE], "thickness": 1}]}, "or nothing is inside"),
        ({"bodies": [{"outline": "hill_release.geojson", "thickness": -1}]}, "thickness must be a finite number above"),
        ({"bodies": [{"thickness": 2.0}]}, "one thickness needs an outline"),
        (
            {**BOX, "bodies": [{"position": [600000, 5100000, 390], "size": [50, 50, 40], "velocity": [0, 0, 0]}]},
            "body 0: it starts inside the ground, .* m deep; raise it",
        ),
        ({"terrain": None, **BOX}, "a release lies on a terrain, and the scene has none"),
        ({"bodies": 2 * [{"outline": "hill_release.geojson", "thickness": 1.0}]}, "bodies 0 and 1 overlap"),
    ],
)
def test_what_is_wrong_is_told_in_a_sentence(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_scene(changed(tmp_path, **changes))


def test_missing_heights_in_the_box_are_told_and_others_cropped_away(tmp_path: Path) -> None:
    path = changed(tmp_path)
    grid = tmp_path / "hill.asc"
    lines = grid.read_text().splitlines()
    lines[-1] = " ".join(["-9999"] * 3 + lines[-1].split()[3:])
    grid.write_text("\n".join(lines))
    with pytest.raises(InputError, match=r"3 of its heights are missing, the first at \[600002\.5, 5100002\.5\] m"):
        read_scene(path)
    changed(tmp_path, **{**BOX, "lower": [600000.0, 5100010.0, 380.0]})
    grid.write_text("\n".join(lines))
    assert read_scene(path).lower[:2] == (0.0, 0.0)


@pytest.mark.parametrize("name", ["column-fast", "collapse"])
def test_who_knows_no_terrain_says_who_does(hill: Scene, name: str) -> None:
    solver = load_solver(name)
    assert "takes no terrain (solver=ground, mpm and shallow do)" in str(solver.unsupported_reason(hill))
    with pytest.raises(InputError, match=r"has a terrain, which .* does not take; use solver=ground or mpm\."):
        solver.run(hill)


@pytest.mark.parametrize("name", ["mpm", "shallow", "shallow-k0"])
def test_who_knows_one_runs_it(hill: Scene, name: str) -> None:
    solver = load_solver(name, cell_size=10.0 if name == "mpm" else None)
    scene = hill.replace(duration=6.0)
    assert solver.unsupported_reason(scene) is None
    run = solver.run(scene, interval=0.5)
    centre = run.position.mean(axis=1, dtype=np.float64)
    assert run.scene == scene and hill.terrain is not None
    assert centre[-1, 0] > centre[0, 0] + 20
    assert centre[-1, 2] < centre[0, 2] - 10
    above = run.position[..., 2] - hill.terrain.height(run.position.reshape(-1, 3)).reshape(run.position.shape[:2])
    assert above.min() > (-1.0 if name == "mpm" else -1e-3)  # MPM's ground is smoothed over its cells of 10 m
