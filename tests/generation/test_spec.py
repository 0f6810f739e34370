"""Scenes depend on the seed, their family and their number alone; splits are per family; bad values are named."""

from __future__ import annotations

import hashlib
import json
import math
from collections import Counter
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import pytest
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from gns_pl.errors import InputError
from gns_pl.generation import DatasetSpec, Planned, chosen_every, draw_plan
from gns_pl.mpm.settings import solver_config
from gns_pl.scene import Plane, Wall, fill_scene, read_scene, write_scene
from gns_pl.solvers.training_range import out_of_range
from tests.generation.fake import BLOCKS, DROPS, MPM, make_spec


def plan(**changes: Any) -> list[Planned]:
    return draw_plan(DatasetSpec.from_dict(make_spec(**changes)))


def scenes(planned: list[Planned], family: str) -> list[tuple[Any, int]]:
    return [(p.scene, p.seed) for p in planned if p.scene.name.startswith(family)]


def test_plan_is_the_same_every_time_and_another_seed_another_plan() -> None:
    assert plan() == plan()
    assert all(a.scene != b.scene and a.seed != b.seed for a, b in zip(plan(), plan(seed=8), strict=True))
    seeds = [planned.seed for planned in plan()]
    assert len(set(seeds)) == len(seeds)


def test_nothing_else_changes_a_trajectory() -> None:
    before = scenes(plan(), "cube_drop")
    more = {"cube_drop": {**DROPS, "count": 9, "valid": 3}, "a_new_one": dict(BLOCKS), "low": {**BLOCKS, "count": 7}}
    assert scenes(plan(families=more), "cube_drop")[:5] == before
    assert scenes(plan(families={"cube_drop": DROPS}), "cube_drop") == before


def test_files_are_numbered_through_whatever_the_order_of_the_families() -> None:
    names = [planned.file_name for planned in plan()]
    assert names == [f"trajectory_{number:04d}.h5" for number in range(8)]
    assert plan(families={"low": BLOCKS, "cube_drop": DROPS}) == plan()


def test_splits_are_drawn_in_every_family() -> None:
    drawn = plan()
    drops = Counter(p.split for p in drawn if p.scene.name.startswith("cube_drop"))
    blocks = Counter(p.split for p in drawn if p.scene.name.startswith("low"))
    assert drops == {"train": 3, "valid": 1, "test": 1}
    assert blocks == {"train": 2, "valid": 1}
    held = {tuple(p.split for p in plan(seed=seed)) for seed in range(20)}
    assert len(held) > 5  # and not always the same numbers


def test_a_family_may_have_walls_and_a_material_of_its_own() -> None:
    walls = {face: {"condition": "slip"} for face in ("x-", "x+", "y-", "y+", "z-", "z+")}
    own = {**BLOCKS, "walls": walls, "material": {**make_spec()["material"], "friction_angle_deg": 40}}
    drawn = plan(families={"cube_drop": DROPS, "low": own})
    assert drawn[0].scene.walls["z-"].condition == "friction"
    assert drawn[-1].scene.walls["z-"].condition == "slip"
    assert drawn[-1].scene.materials["sand"].friction_angle_deg == 40


def test_spec_round_trip() -> None:
    spec = DatasetSpec.from_dict({**make_spec(), "root": "anywhere"})
    assert DatasetSpec.from_dict(spec.to_dict()) == spec
    assert "root" not in spec.to_dict()


def test_a_way_to_choose_points_is_stated_only_where_it_is_not_that_of_older_sets() -> None:
    assert {"store_every", "sampling"}.isdisjoint(DatasetSpec.from_dict(make_spec(sampling="lattice")).to_dict())
    drawn = DatasetSpec.from_dict(make_spec(sampling="stratified", store_every=[2]))
    assert DatasetSpec.from_dict(drawn.to_dict()) == drawn
    assert drawn.to_dict()["sampling"] == "stratified"
    lattice, stratified = (plan(sampling=sampling, store_every=[2]) for sampling in ("lattice", "stratified"))
    assert [replace(planned, offsets=None) for planned in lattice] == [
        replace(planned, offsets=None) for planned in stratified
    ]
    assert all(planned.offsets == {2: None} for planned in stratified)


def family(**changes: Any) -> dict[str, Any]:
    return {"families": {"cube_drop": {key: value for key, value in {**DROPS, **changes}.items() if value is not ...}}}


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"colour": 1}, "data: unknown key colour"),
        ({"seed": -1}, "seed must be a whole number"),
        ({"seed": 1.5}, "seed must be a whole number"),
        ({"seed": True}, "seed must be a whole number"),
        ({"frame_interval": 0}, "frame_interval must be a positive number"),
        ({"frame_interval": "0.01"}, "frame_interval must be a positive number"),
        ({"gravity": -9.81}, "gravity must be a positive number"),
        ({"gravity": float("nan")}, "plain, finite values"),
        ({"name": object()}, "plain, finite values"),
        ({"mpm": 3}, "mpm must be a mapping"),
        ({"sampling": "random"}, "sampling must be lattice or stratified, not 'random'"),
        ({"families": {}}, "at least one family"),
        ({"families": {"cube_drop": 3}}, "family cube_drop must be a mapping"),
        ({"families": {"drops": DROPS}}, "no kind 'drops' of scenes; known are cube_drop, block_release, column"),
        (family(sped=1), "family cube_drop: unknown key sped"),
        (family(side=...), "family cube_drop: missing key side"),
        (family(count=-1), "count must be a whole number"),
        (family(valid=5, test=1), "valid and test are part of count"),
        (family(valid=4, test=1), "no trajectory is left for training"),
        (family(count=0, valid=0, test=0), "no trajectory is left for training"),
        (family(side=[0.4, 0.2]), "side must be two positive numbers"),
        (family(duration=0), "duration must be"),
        (family(walls={"z-": {"condition": "slip"}}), "walls must name the faces"),
        (family(walls=3), "walls must be a mapping"),
        (family(friction_angle_deg=30), "friction_angle_deg must be a list of numbers"),
        (family(friction_angle_deg=[45, 20]), "friction_angle_deg must be two positive numbers, the smaller first"),
        (family(friction_angle_deg=[20, 95]), "friction_angle_deg must be below 90"),
        (family(walls={"z-": 3}), "wall 'z-' must be a mapping"),
        ({"material": {"density": 1}}, "material: missing key"),
        ({"walls": {}}, "walls must name the faces"),
    ],
)
def test_bad_specifications_are_named(changes: dict[str, Any], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence) as refused:
        plan(**changes)
    assert "\n" not in str(refused.value)


def test_families_of_different_dimensions_are_refused() -> None:
    walls = {face: {"condition": "slip"} for face in ("x-", "x+", "z-", "z+")}
    flat = {**BLOCKS, "domain": [1.0, 1.0], "walls": walls}
    assert plan(families={"low": flat})[0].scene.dim == 2
    with pytest.raises(InputError, match="same number of dimensions"):
        plan(families={"cube_drop": DROPS, "low": flat})


def test_solver_settings_are_checked() -> None:
    assert solver_config(MPM).spacing == 0.125
    with pytest.raises(InputError, match="mpm: unknown key curant"):
        solver_config({**MPM, "curant": 1})
    with pytest.raises(InputError, match="mpm: missing key courant"):
        solver_config({key: value for key, value in MPM.items() if key != "courant"})


def configured(name: str, *overrides: str) -> dict[str, Any]:
    """Return the specification of a data set in conf/."""
    with initialize_config_dir(str(Path(__file__).parents[2] / "conf"), version_base=None):
        composed = compose("generate", [f"data={name}", *overrides])
    data: Any = OmegaConf.to_container(composed.data, resolve=True)
    return dict(data)


FIRST = {
    "cube106_paper": (),
    "quickstart": (
        *(f"~data.families.column_{size}" for size in ("low", "middle", "high")),
        *("data.families.cube_drop.count=18", "data.families.block_low.count=14"),
        *("data.families.block_middle.count=18", "data.families.block_high.count=14"),
    ),
}
"""What makes today's data sets those of their first version."""


@pytest.mark.parametrize(
    ("name", "place", "split", "seed", "size", "corner", "velocity"),
    [
        ("cube106_paper", 0, "train", 493461003, 0.26171690793640146, 0.3275829355343306, -1.1524623097770004),
        ("cube106_paper", 105, "train", 3430037196, 0.3801465422920359, 0.11356211902370089, -0.46227722652113035),
        ("quickstart", 0, "train", 3536558523, 0.23744954256149903, 0.7625504574385009, 0.0),
        ("quickstart", 63, "train", 1452992514, 0.33904598074383807, 0.41691285866086397, 0.9472453944322285),
    ],
)
def test_what_was_drawn_once_is_drawn_for_ever(
    name: str, place: int, split: str, seed: int, size: float, corner: float, velocity: float
) -> None:
    """Numbers of the plans before data sets could be thinned: sets on disks must still be recognised and completed."""
    planned = draw_plan(DatasetSpec.from_dict(configured(name, *FIRST[name])))[place]
    (body,) = planned.scene.bodies
    assert (planned.file_name, planned.split, planned.seed) == (f"trajectory_{place:04d}.h5", split, seed)
    assert (body.size[0], body.position[0], body.velocity[0]) == (size, corner, velocity)


@pytest.mark.parametrize(
    ("name", "sha256"),
    [
        ("cube106_paper", "e407c9c7c5e738779b6e0aba8197efbf10f2ce80975e9017f922b434c05cc3e1"),
        ("quickstart", "f32003e0315ac328b2210ad6e0d12ee14a3ee7dc5400944fdc1abdca2a6b32af"),
    ],
)
def test_whole_plans_are_what_they_were(name: str, sha256: str) -> None:
    spec = DatasetSpec.from_dict(configured(name, *FIRST[name]))
    plan = [[p.file_name, p.split, p.scene.to_dict(), p.seed] for p in draw_plan(spec)]
    assert hashlib.sha256(json.dumps(plan, sort_keys=True).encode()).hexdigest() == sha256


def columns(drawn: list[Planned]) -> list[Any]:
    return [planned.scene for planned in drawn if not any(planned.scene.bodies[0].velocity)]


@pytest.mark.parametrize(
    ("name", "split", "cell", "spacings"),
    [
        ("quickstart", (53, 7, 7), 1 / 12, [1 / 24]),
        ("cube106", (96, 6, 4), 1 / 36, [1 / 24, 1 / 36]),
        ("cube106_paper", (96, 6, 4), 1 / 12, [1 / 48]),
        ("cube106_fine", (96, 6, 4), 1 / 48, [1 / 48, 1 / 24]),
        ("columns", (60, 6, 6), 1 / 12, [1 / 48]),
        ("columns_fine", (60, 6, 6), 1 / 48, [1 / 48, 1 / 24]),
        ("friction", (78, 9, 9), 1 / 12, [1 / 48]),
    ],
)
def test_configured_sets_can_be_drawn(name: str, split: tuple[int, ...], cell: float, spacings: list[float]) -> None:
    data = configured(name)
    assert data["root"] == f"datasets/{name}"
    spec = DatasetSpec.from_dict(data)
    drawn = draw_plan(spec)
    counts = Counter(planned.split for planned in drawn)
    assert tuple(counts[part] for part in ("train", "valid", "test")) == split
    config = solver_config(data["mpm"])
    assert config.cell_size == pytest.approx(cell)
    assert [every * config.spacing for every in spec.store_every] == pytest.approx(spacings)
    assert chosen_every(data) == spec.store_every[0]
    for planned in drawn:
        (body,) = planned.scene.bodies
        fast = body.velocity[-1] ** 2 + 2 * data["gravity"] * body.position[-1]
        assert fast <= 3.1**2  # m/s: faster cubes spread into layers thinner than a cell
    for scene in columns(drawn):
        ratio = scene.bodies[0].size[-1] / scene.bodies[0].size[0]
        assert abs(ratio - 0.8) > 0.05
        assert abs(ratio - 2.0) > 0.05


def test_the_fine_sets_are_of_the_same_scenes() -> None:
    for names in (("cube106_paper", "cube106_fine"), ("cube106_paper", "cube106"), ("columns", "columns_fine")):
        coarse, fine = (draw_plan(DatasetSpec.from_dict(configured(which))) for which in names)
        assert [(p.scene, p.seed, p.split) for p in coarse] == [(p.scene, p.seed, p.split) for p in fine]


@pytest.mark.parametrize(
    ("name", "farthest"),
    [("columns", 3.3), ("friction", 4.2)],  # longest runout over a^(2/3) L0: published; with 20° and cells of 1/12 m
)
def test_columns_keep_away_from_the_tests_and_from_the_far_wall(name: str, farthest: float) -> None:
    scenes = columns(draw_plan(DatasetSpec.from_dict(configured(name))))
    seen = Counter[tuple[str, str]]()
    for scene in scenes:
        (body,) = scene.bodies
        length, height = body.size[0], body.size[-1]
        ratio = height / length
        ranges = {"low": (0.5, 0.7), "middle": (0.95, 1.75), "high": (2.3, 4.0)}
        (which,) = [key for key, (low, high) in ranges.items() if low - 1e-9 <= ratio <= high + 1e-9]
        seen[which, scene.walls["y-"].condition] += 1
        assert (1 + farthest * ratio ** (2 / 3)) * length < scene.upper[0]
        assert height < 0.96 * scene.upper[-1]
        assert {scene.walls[face].friction for face in ("x-", "x+", "z-", "z+")} == {0.385}
    assert len(seen) == 6
    assert len(set(seen.values())) == 1  # half of each rub against the side walls, half slip


def test_friction_angles_are_drawn_for_every_trajectory_and_become_features() -> None:
    drawn = draw_plan(DatasetSpec.from_dict(configured("friction", "data.families.cube_drop.count=200")))
    angles = [planned.scene.materials["sand"].friction_angle_deg for planned in drawn]
    assert len(set(angles)) == len(drawn) == 248
    assert 20 <= min(angles) < 21 < 44 < max(angles) <= 45
    for planned, angle in zip(drawn, angles, strict=True):
        tangent = fill_scene(planned.scene, 0.1).material
        assert tangent == pytest.approx(math.tan(math.radians(angle)))


def test_a_range_of_friction_angles_changes_nothing_else() -> None:
    plain, varied = plan(), plan(families={"cube_drop": {**DROPS, "friction_angle_deg": [20, 45]}, "low": BLOCKS})
    for before, after in zip(plain, varied, strict=True):
        assert after.seed == before.seed
        assert after.scene.replace(materials=before.scene.materials) == before.scene
    assert varied[0].scene != plain[0].scene
    assert varied[-1] == plain[-1]


@pytest.mark.parametrize("every", [2, 3])
def test_every_shifted_lattice_occurs_before_any_comes_again(every: int) -> None:
    families = {"cube_drop": {**DROPS, "count": 3 * every**3}, "low": BLOCKS}
    drawn = [p.offsets[every] for p in plan(families=families, store_every=[every]) if "drop" in p.scene.name]
    assert Counter(drawn) == dict.fromkeys(product(range(every), repeat=3), 3)


def test_which_lattice_to_use_is_chosen_on_the_command_line() -> None:
    assert chosen_every(configured("cube106_fine")) == 2
    assert chosen_every(configured("cube106_fine", "data.every=4")) == 4
    assert chosen_every(configured("cube106_fine", "data.store_every=[3,2]")) == 3
    assert chosen_every(configured("cube106_paper")) == 1
    spec = DatasetSpec.from_dict(configured("cube106_fine", "data.every=4"))
    assert spec == DatasetSpec.from_dict(configured("cube106_fine"))


def test_which_lattices_are_stored_changes_nothing_else() -> None:
    for before, after in zip(plan(), plan(store_every=[4, 2]), strict=True):
        assert replace(after, offsets=before.offsets) == before
        assert after.offsets.keys() == {4, 2}
    first, second = plan(store_every=[4, 2]), plan(store_every=[2])
    assert [p.offsets[2] for p in first] == [p.offsets[2] for p in second]
    assert [p.offsets[4] for p in first] != [p.offsets[4] for p in plan(store_every=[4], seed=8)]


def given(tmp_path: Path, **changes: Any) -> dict[str, Any]:
    """A family of two scene files, of which each is filled three times."""
    planned = plan()[0].scene
    for name in ("first", "second"):
        write_scene(planned.replace(name=name, **changes), tmp_path / f"{name}.yaml")
    files = [str(tmp_path / f"{name}.yaml") for name in ("first", "second")]
    return {"kind": "scenes", "files": files, "placements": 3, "valid": 1}


def test_scenes_of_files_are_a_family_and_the_specification_holds_them_whole(tmp_path: Path) -> None:
    family = given(tmp_path)
    spec = DatasetSpec.from_dict(make_spec(families={"mine": family, "cube_drop": DROPS}))
    planned = [each for each in draw_plan(spec) if not each.scene.name.startswith("cube_drop")]
    assert [each.scene.name for each in planned] == [
        f"{name}_{number:04d}" for number in range(3) for name in ("first", "second")
    ]
    assert len({each.seed for each in planned}) == 6 and [each.split for each in planned].count("valid") == 1
    assert planned[0].scene == read_scene(Path(family["files"][0])).replace(name="first_0000")
    for file in family["files"]:
        Path(file).unlink()  # the specification, as a manifest keeps it, needs the files no more
    assert draw_plan(DatasetSpec.from_dict(spec.to_dict())) == draw_plan(spec)


def test_given_scenes_that_cannot_be_learned_are_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"scene 'first' has the gravity \[0\.0, 0\.0, -1\.0\], and the data set"):
        plan(families={"mine": given(tmp_path, gravity=(0.0, 0.0, -1.0))})
    slope = Plane((0, 0, 0.1), (1, 0, 3), Wall("slip"))
    with_slope = plan(families={"mine": given(tmp_path, obstacles=(slope,))})  # for simulators that see surfaces
    assert all(planned.scene.obstacles == (slope,) for planned in with_slope)
    with pytest.raises(InputError, match="valid and test are part of its 6 trajectories"):
        plan(families={"mine": given(tmp_path) | {"valid": 7}})
    with pytest.raises(InputError, match="unknown key count; a family of scenes has files, placements, valid, test"):
        plan(families={"mine": given(tmp_path) | {"count": 7}})
    with pytest.raises(InputError, match="files must list scene files"):
        plan(families={"mine": {"kind": "scenes", "files": "a.yaml"}})


def test_what_given_scenes_hold_is_within_their_range(tmp_path: Path) -> None:
    spec = DatasetSpec.from_dict(make_spec(families={"mine": given(tmp_path)}))
    scene = plan()[0].scene
    assert list(out_of_range(scene, spec.to_dict())) == []
    body = replace(scene.bodies[0], size=tuple(0.5 * edge for edge in scene.bodies[0].size))
    assert next(out_of_range(scene.replace(bodies=(body,)), spec.to_dict())).startswith("trained on lengths from")


def test_a_family_on_slopes_tilts_gravity_and_changes_nothing_else() -> None:
    level = plan()
    blocks = {**BLOCKS, "slope_deg": [2.0, 15.0]}
    tilted = plan(families={"cube_drop": dict(DROPS), "low": blocks})
    slopes = []
    for before, now in zip(level, tilted, strict=True):
        assert now.scene.replace(gravity=before.scene.gravity) == before.scene and now.seed == before.seed
        if now.scene.name.startswith("low"):
            along, across, down = now.scene.gravity
            assert across == 0 and math.hypot(along, down) == pytest.approx(9.81, rel=1e-12) and along > 0 > down
            slopes.append(math.degrees(math.atan2(along, -down)))
        else:
            assert now == before
    assert len(set(slopes)) == len(slopes) and 2 <= min(slopes) <= max(slopes) <= 15
    spec = make_spec(families={"cube_drop": dict(DROPS), "low": blocks})
    assert list(out_of_range(tilted[-1].scene, spec)) == []
    steep = tilted[-1].scene.replace(gravity=(9.81 * math.sin(0.3), 0.0, -9.81 * math.cos(0.3)))
    assert list(out_of_range(steep, spec)) == ["trained at a gravity of 9.81 m/s² on slopes of up to 15°"]
    with pytest.raises(InputError, match="slope_deg must lie below 90"):
        plan(families={"low": {**BLOCKS, "slope_deg": [2.0, 95.0]}})
