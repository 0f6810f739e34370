"""An error is promised only of scenes like those that were measured; of all others it is unmeasured, and said so."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from gns_pl.errors import InputError
from gns_pl.io import read_trajectory
from gns_pl.scene import Body, Box, Plane, Scene, Wall, read_scene
from gns_pl.solvers.measured_range import setup_of, setup_text, unmeasured_reasons
from gns_pl.solvers.mpm import MPMSolver
from gns_pl.solvers.reduction import to_plane
from gns_pl.solvers.selection import RECORDS, Record, choose, estimate, read_records, table
from gns_pl.solvers.simulate import check_path, simulate_by_choice
from tests.solvers.test_selection import MPM, ROUGH, SLIP, column

CLAY = replace(column().materials["sand"], friction_angle_deg=10.0, cohesion=1000.0)
MATERIAL = {"tension_cutoff": 50.0}


def with_time(scene: Scene, tau: float = 6.0) -> Scene:
    """The scene for so many √(H0/g)."""
    return scene.replace(duration=tau * (scene.bodies[0].size[-1] / 9.81) ** 0.5)


def measured_column(ratio: float = 1.0) -> Scene:
    return with_time(column(ratio))


def scaled(factor: float) -> Scene:
    scene = column()
    body = replace(scene.bodies[0], size=(0.3 * factor, 0.5, 0.3 * factor))
    upper = (1.5 * factor, 0.5, 0.9 * factor)
    return with_time(scene.replace(upper=upper, bodies=(body,)))


def sand_over_clay() -> Scene:
    scene = column()
    lower, upper = (Body((0, 0, z), (0.3, 0.5, 0.15), (0, 0, 0), name) for z, name in ((0, "clay"), (0.15, "sand")))
    return with_time(scene.replace(bodies=(lower, upper), materials={**scene.materials, "clay": CLAY}))


@pytest.mark.parametrize(
    ("scene", "reason"),
    [
        (measured_column(), None),
        (to_plane(measured_column()).scene, None),
        (measured_column(1.5), None),
        (measured_column().replace(walls=column().walls | {"x+": SLIP, "z+": SLIP}), None),  # too far away to matter
        (scaled(1.08), None),
        (sand_over_clay(), "measured with one body at the x- wall, at rest, here 2 bodies"),
        (
            measured_column().replace(obstacles=(Box((0.8, 0, 0), (0.1, 0.5, 0.1), ROUGH),)),
            "measured with no obstacle, here 1 obstacle",
        ),
        (
            measured_column().replace(obstacles=(Plane((1.4, 0, 0), (-1, 0, 1), ROUGH),)),
            "measured with no obstacle, here 1 obstacle",
        ),
        (measured_column().replace(materials={"sand": CLAY}), "measured with friction_angle_deg 30, here 10"),
        (
            measured_column().replace(walls=column().walls | {"z-": Wall("friction", 0.2)}),
            "measured with wall z- friction 0.385, here friction 0.2",
        ),
        (measured_column().replace(gravity=(0, 0, -1.62)), "measured with gravity 0 -9.81 m/s², here 0 -1.62 m/s²"),
        (measured_column(3.0).replace(upper=(9, 0.5, 2)), "measured with aspect ratio 1 to 2, here 3"),
        (scaled(1.7), "measured with √(L0 H0) 0.3 to 0.424 m, here 0.51"),
        (scaled(0.5), "measured with √(L0 H0) 0.3 to 0.424 m, here 0.15"),
        (measured_column().replace(upper=(0.5, 0.5, 0.9)), "measured with free length in front "),
        (with_time(column(), 2.0), "measured with duration 6 √(H0/g), here 2"),
        (
            measured_column().replace(bodies=(Body((0.6, 0, 0), (0.3, 0.5, 0.3), (0, 0, 0)),)),
            "here one body away from the x- wall, at rest",
        ),
        (
            measured_column().replace(bodies=(Body((0, 0, 0.2), (0.3, 0.5, 0.3), (0, 0, 0)),)),
            "here one body at the x- wall, above the floor, at rest",
        ),
        (
            measured_column().replace(bodies=(Body((0, 0, 0), (0.3, 0.5, 0.3), (1, 0, 0)),)),
            "here one body at the x- wall, in motion",
        ),
    ],
)
def test_what_a_measured_error_holds_for(scene: Scene, reason: str | None) -> None:
    measured = [setup_text(measured_column(ratio)) for ratio in (1.0, 2.0)]
    reasons = unmeasured_reasons(scene, measured)
    assert reasons == [] if reason is None else reason in "; ".join(reasons), reasons


def test_a_channel_between_rough_walls_is_measured_by_its_width() -> None:
    scene = with_time(column(sides=ROUGH))
    assert setup_of(scene)["width"] == pytest.approx(0.5 / 0.3)
    wide = scene.replace(upper=(1.5, 1.0, 0.9), bodies=(Body((0, 0, 0), (0.3, 1.0, 0.3), (0, 0, 0)),))
    assert unmeasured_reasons(wide, [setup_text(scene)]) == ["measured with width 1.67 √(L0 H0), here 3.33"]


def moved(scene: Scene, *places: tuple[float, ...]) -> Scene:
    bodies = tuple(replace(body, position=place) for body, place in zip(scene.bodies, places, strict=True))
    return scene.replace(bodies=bodies)


def test_scenes_without_a_law_are_like_those_of_the_same_places() -> None:
    corner, pair, barrier = (read_scene(name) for name in ("corner", "two_columns", "barrier"))
    measured = [setup_text(scene) for scene in (measured_column(), corner, pair, barrier)]
    for scene in (corner, pair, barrier, moved(pair, (0.0, 0.0, 0.0), (0.695, 0.0, 0.0))):
        assert unmeasured_reasons(scene, measured) == []
    other_corner = moved(corner, (0.0, 0.95, 0.0))
    assert unmeasured_reasons(other_corner, measured) == []
    for scene, reason in (
        (moved(corner, (0.0, 0.4, 0.0)), "here one body at the x- wall, narrower than the box, at rest"),
        (moved(pair, (0.0, 0.0, 0.0), (0.5, 0.0, 0.0)), "measured with other places of bodies and obstacles"),
        (corner.replace(gravity=(2.0, 0.0, -9.6)), "measured with gravity"),
        (barrier.replace(obstacles=(Box((0.505, 0.0, 0.0), (0.24, 0.245, 0.245), ROUGH),)), "other places of bodies"),
        (barrier.replace(obstacles=(Plane((0.6, 0.0, 0.0), (-1, 0, 1), ROUGH),)), "other places of bodies"),
    ):
        assert reason in "; ".join(unmeasured_reasons(scene, measured))


def test_an_error_is_that_of_scenes_of_the_same_kind(tmp_path: Path) -> None:
    """What MPM errs by on a corner says nothing of a column, and the worse of front and map counts."""
    corner, other = read_scene("corner"), column(sides=ROUGH)
    values = [("corner", corner, 0.02, 0.2), ("column", with_time(other), -0.1, 0.05)]
    records = [
        Record(
            "mpm_10.2", "space", name, error, 0, 0, 0, 1.0, 1e6, 100, 1, "here",
            setup=setup_text(scene), map_error=map_error,
        )
        for name, scene, error, map_error in values
    ]  # fmt: skip
    ways = [MPMSolver("mpm_10.2", 10.2, MPM)]
    for scene, error in ((corner, 0.2), (with_time(other), 0.1)):
        [option] = estimate(scene, ways, records)
        assert (option.error, option.measured_errors["worse"]) == (error, 0.2)
        assert choose([option], error)[0] is option
        with pytest.raises(InputError, match="the smallest tolerance that can be met"):
            choose([option], 0.9 * error)


def test_old_tables_promise_nothing(tmp_path: Path) -> None:
    text = RECORDS.read_text()
    lines = [line.split(',"{')[0].removesuffix(",setup,map_error") for line in text.splitlines()]
    (tmp_path / "old.csv").write_text("\n".join(lines) + "\n")
    records = read_records(tmp_path / "old.csv")
    assert len(records) == len(read_records(RECORDS)) and records[0].setup == ""
    (option,) = estimate(measured_column(), [MPMSolver("mpm_10.2", 10.2, MPM)], records)
    assert option.error is None and "does not say on which scenes" in str(option.unmeasured)


@pytest.mark.parametrize("make", [sand_over_clay, lambda: scaled(100.0)])
def test_no_error_is_promised_where_none_was_measured(make: Callable[[], Scene]) -> None:
    """Sand over clay errs by 10.7 % where columns err by 7.0 %, and 30 m of E = 2 MPa sink by a tenth."""
    scene, ways = make(), [MPMSolver(f"mpm_{cells:g}", cells, MPM) for cells in (5.09, 12.7, 20.4)]
    options = estimate(scene, ways, read_records(RECORDS))
    assert [each.error for each in options] == [None] * 3 and all(each.seconds for each in options)
    assert "unmeasured" in table(options, scene) and "%" not in table(options, scene)
    chosen, why = choose(options, 0.1)
    assert chosen.solver.name == "mpm_12.7" and "the error on this scene is unmeasured (measured with" in why
    with pytest.raises(
        InputError, match=r"on the scenes that were measured; the smallest .* is 0\.044 \(by mpm_20\.4\)"
    ):
        choose(options, 0.02)


def test_the_packages_columns_are_within_their_own_range() -> None:
    records = [each for each in read_records(RECORDS) if each.kind == "plane"]
    sand = replace(column().materials["sand"], **MATERIAL)
    for ratio, length in ((0.8, 0.475), (3.0, 0.25), (1.5, 0.35)):
        body = Body((0, 0, 0), (length, 0.5, ratio * length), (0, 0, 0))
        scene = column().replace(upper=(2.5, 0.5, 1.1), bodies=(body,), materials={"sand": sand})
        (option,) = estimate(with_time(scene), [MPMSolver("mpm_12.7", 12.7, MPM)], records)
        assert option.error == pytest.approx(0.0704, abs=5e-4)


def test_two_sizes_of_cells_check_a_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    choice = {"cells": [4.0], "mpm": MPM, "frame_interval": 0.05}
    (path,) = simulate_by_choice([column()], out=tmp_path, choice=choice, solver="mpm", check=True)
    fine, coarse = read_trajectory(path), read_trajectory(check_path(path))
    cells = [each.provenance["mpm"]["cell_size"] for each in (fine, coarse)]  # type: ignore[index]
    assert cells == pytest.approx([0.075, 0.1125])
    assert "chosen: mpm_4, as asked for; its error on this scene is unmeasured" in capsys.readouterr().out
    with pytest.raises(InputError, match="of another scene, solver or checkpoint, settings"):
        other = choice | {"mpm": MPM | {"courant": 0.3}}
        simulate_by_choice([column()], out=tmp_path, choice=other, solver="mpm")
    for options, sentence in (
        ({"solver": "mpm", "cell_size": -1.0}, "cell_size"),
        ({"solver": "mpm_4", "cell_size": 0.1}, "cell_size= is that of solver=mpm, not of mpm_4"),
        ({"solver": "nothing"}, "there is no nothing; there are mpm, mpm_4, collapse,"),
        ({"solver": "mpm", "device": "tpu"}, "device must be one of"),
    ):
        with pytest.raises(InputError, match=sentence):
            simulate_by_choice([column()], out=tmp_path / "none", choice=choice, **options)
    assert not (tmp_path / "none").exists()
