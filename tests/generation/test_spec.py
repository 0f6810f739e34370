"""Scenes depend on the seed, their family and their number alone; splits are per family; bad values are named."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from gns_pl.errors import InputError
from gns_pl.generation import DatasetSpec, Planned, draw_plan
from gns_pl.generation.solver import solver_config
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
        ({"families": {}}, "at least one family"),
        ({"families": {"cube_drop": 3}}, "family cube_drop must be a mapping"),
        ({"families": {"drops": DROPS}}, "no kind 'drops' of scenes; known are cube_drop, block_release"),
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


@pytest.mark.parametrize(("name", "count"), [("cube106", 106), ("quickstart", None)])
def test_configured_sets_can_be_drawn(name: str, count: int | None) -> None:
    with initialize_config_dir(str(Path(__file__).parents[2] / "conf"), version_base=None):
        data: Any = OmegaConf.to_container(compose("generate", [f"data={name}"]).data, resolve=True)
    assert data["root"] == f"datasets/{name}"
    drawn = draw_plan(DatasetSpec.from_dict(data))
    assert count is None or len(drawn) == count
    assert {planned.split for planned in drawn} == {"train", "valid", "test"}
    assert solver_config(data["mpm"]).cell_size == pytest.approx(1 / 12)
    for planned in drawn:
        (body,) = planned.scene.bodies
        fast = body.velocity[-1] ** 2 + 2 * data["gravity"] * body.position[-1]
        assert fast <= 3.1**2  # m/s: faster cubes spread into layers thinner than a cell
        if not any(body.velocity):
            ratio = body.size[-1] / body.size[0]
            assert abs(ratio - 0.8) > 0.05
            assert abs(ratio - 2.0) > 0.05
