"""The adviser: its numbers against hand computations and the real noise, its suggestions against their causes."""

from __future__ import annotations

import json
import re
import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from omegaconf import OmegaConf

from gns_pl.data.survey import survey_dataset
from gns_pl.data.survey_record import Kept
from gns_pl.errors import InputError
from gns_pl.generation import DatasetSpec, draw_plan, missing_bytes
from gns_pl.graph import WindowRandom
from gns_pl.training.advice import advise
from gns_pl.training.advice.data_errors import Suggestion
from gns_pl.training.advice.derived import Advice, compute_advice, target_noise
from gns_pl.training.advice.report import rows, suggestion_lines
from gns_pl.training.advice.suggestions import suggest
from gns_pl.training.config import TrainingConfig
from gns_pl.training.perturbation import Perturbation
from tests.conftest import make_config as make_model
from tests.conftest import make_static
from tests.data.sets import make_flight, make_scene, moved, write_set
from tests.training.conftest import CONF, make_config

TRAINING: dict[str, Any] = {
    "batch_size": 2,
    "num_workers": 0,
    "memory_limit": 1e9,
    "num_train": None,
    "stride": 1,
    "start_repeats": 2,
    "moving_repeats": 1,
    "noise_std": 2e-4,
    "noise_free": 0.4,
    "strain_std": 0.06,
    "strain_length": 0.1,
    "restore": 0.2,
    "optimisation": {
        "num_steps": 1000,
        "optimiser": "adamw",
        "learning_rate": 1e-3,
        "final_factor": 0.1,
        "weight_decay": 0.0,
        "warmup_steps": 0,
        "column_weight": 0.0,
        "huber_delta": 0.3,
        "symmetry": True,
        "unroll_steps": 1,
        "unroll_from": 0.5,
    },
    "rollout": {
        "num_steps": 0,
        "scenes": 1,
        "learning_rate": 1e-3,
        "whole_from": 0.0,
        "placements": 1,
        "weights": {"map": 1.0, "height": 0.0, "front": 0.0, "energy": 0.0, "rise": 0.0, "windows": 1.0},
    },
}


def collapses() -> list[Any]:
    """Three bodies that stand, slide apart and stop: a set that leaves nothing to wish for."""
    made = []
    for height in (0.3, 0.4, 0.6, 0.3):
        scene = make_scene(position=(0.0, 0.0, 0.0), size=(0.3, 0.3, height))
        made.append(moved(scene, lambda t: np.array([0.3 * min(t, 0.15) ** 2, 0.0, 0.0]), 21))
    return made


def advice_on(
    folder: Path, trajectories: list[Any], data_errors: dict[str, Any] | None = None, **settings: Any
) -> Advice:
    manifest = write_set(folder, trajectories, **(data_errors or {}))
    model = make_model(connectivity_radius=settings.pop("radius", 0.11), context=settings.pop("context", True))
    survey = survey_dataset(folder, manifest, manifest.splits["train"], radius=model.connectivity_radius)
    memory, gravity = settings.pop("memory", 8e9), settings.pop("gravity", 9.81)
    delta = settings.pop("huber_delta", 0.3)
    steps = settings.pop("num_steps", 1000)
    optimisation = {**TRAINING["optimisation"], "huber_delta": delta, "num_steps": steps}
    training = TrainingConfig.from_dict({**TRAINING, "optimisation": optimisation, **settings})
    return compute_advice(survey, model, training, memory=memory, gravity=gravity)


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Advice:
    return advice_on(tmp_path_factory.mktemp("sound"), collapses())


def changes(advice: Advice) -> list[str | None]:
    return [suggestion.change for suggestion in suggest(advice)]


@pytest.mark.parametrize(("restore", "strain"), [(0.0, 0.06), (0.2, 0.06), (0.5, 0.0)])
def test_noise_of_the_target_is_that_of_the_perturbation(restore: float, strain: float) -> None:
    """Drawn many times, the perturbation's second differences have the variance that the formula says."""
    perturbation = Perturbation(noise_std=1e-2, noise_free=0.4, strain_std=strain, strain_length=0.1, restore=restore)
    graphs, particles, length, dim = 4000, 3, 4, 3
    static = make_static(particles, graphs=graphs)
    generator = torch.Generator().manual_seed(0)
    history = torch.rand((graphs * particles, length, dim), generator=generator)
    target = torch.zeros(len(history), dim)
    moved_history, moved_target = perturbation(
        history, target, static, WindowRandom(0, torch.arange(graphs), static.batch)
    )
    change = moved_history - history
    second = (moved_target - target) - 2 * change[:, -1] + change[:, -2]
    expected = sum(target_noise(perturbation, length))
    assert float(second.square().mean()) == pytest.approx(expected, rel=0.05)


def test_noise_by_hand(sound: Advice) -> None:
    """H = 4 positions, so three increments of variance σ²/3, with 1 + κ m in front of them."""
    motion = sound.survey.motion
    walk = 0.6 * (2e-4) ** 2 / 3 * (1.2**2 + 1.4**2 + 1.6**2)
    coherent = 0.6 * (0.2 * 0.06 * 0.1) ** 2 / 3
    truth = (motion.acceleration_std * 0.01**2) ** 2
    assert sound.noise_share == pytest.approx(walk / (walk + coherent + truth))
    assert sound.restore_share == pytest.approx(coherent / (walk + coherent + truth))
    assert sound.noise_over_velocity == pytest.approx(2e-4 / 0.01 / motion.velocity_std)
    assert sound.strain_over_spacing == pytest.approx(0.06 * 0.1 / 0.05)


def test_a_pass_by_hand(sound: Advice) -> None:
    """3 × 20 windows, of which 3 × 14 lie before the fastest step and come twice."""
    assert sound.windows == 102 and sound.steps_per_pass == 51 and sound.passes == pytest.approx(2000 / 102)
    assert sound.cold_start_share == pytest.approx(84 / 102)
    assert sound.reach == pytest.approx(0.22) and sound.wave == pytest.approx(0.3867, rel=1e-3)


def test_nothing_to_change(sound: Advice) -> None:
    assert suggest(sound) == []
    assert suggestion_lines([]) == ["Nothing to change."]


@pytest.mark.parametrize(
    ("settings", "change"),
    [
        ({"radius": 0.055}, "model.connectivity_radius=0.105"),
        ({"radius": 0.2}, "model.connectivity_radius=0.105"),
        ({"context": False}, "model.context=true"),
        ({"noise_std": 1e-6}, "training.noise_std=0.0002"),
        ({"noise_std": 4e-3}, None),
        ({"strain_std": 0.3, "restore": 0.0}, "training.strain_std=0.075"),
        ({"memory_limit": 1e4}, "training.memory_limit=2.5e+05"),
        ({"memory_limit": 1e4, "memory": 2e5}, "training.num_workers=2"),
        ({"memory": 2e5}, "training.memory_limit=1.0e+05"),
        ({"num_steps": 10}, "training.optimisation.num_steps=51"),
        ({"gravity": 1.62}, "data.gravity=9.81"),
    ],
)
def test_a_setting_that_asks_for_a_change(tmp_path: Path, settings: dict[str, Any], change: str | None) -> None:
    """One setting of a sound set is spoilt, and exactly that one is to be changed."""
    found = changes(advice_on(tmp_path, collapses(), **settings))
    assert len(found) == 1 and found[0] is not None
    if change is not None:
        assert found == [change]


def test_the_suggested_noise_is_the_usual_share(tmp_path: Path) -> None:
    """Following the advice ends it, and leaves 85 % of noise in the target."""
    asked = changes(advice_on(tmp_path, collapses(), noise_std=2e-3, restore=0.0, strain_std=0.0))
    assert len(asked) == 1 and str(asked[0]).startswith("training.noise_std=")
    noise = float(str(asked[0]).split("=")[1])
    after = advice_on(tmp_path / "after", collapses(), noise_std=noise, restore=0.0, strain_std=0.0)
    assert suggest(after) == [] and after.noise_share == pytest.approx(0.85, abs=0.02)


def test_cold_starts_are_missed_and_the_family_suggested_can_be_drawn(tmp_path: Path) -> None:
    scenes = [make_scene(velocity=(0.1 * k, 0.0, 0.0)) for k in range(4)]
    slowing = [moved(s, lambda t, s=s: np.array(s.bodies[0].velocity) * min(t, 0.15), 21) for s in scenes]
    found = [s for s in suggest(advice_on(tmp_path, slowing)) if "block_release" in (s.change or "")]
    assert len(found) == 1 and "none of 3 trajectories" in found[0].message
    GlobalHydra.instance().clear()
    with initialize_config_dir(str(CONF), version_base=None):
        cfg = compose("train", ["data=cube106", str(found[0].change)])
    spec: Any = OmegaConf.to_container(cfg.data, resolve=True)
    blocks = [planned.scene for planned in draw_plan(DatasetSpec.from_dict(spec)) if "block" in planned.scene.name]
    assert len(blocks) == 4
    assert all(body.position[2] == 0 and body.velocity == (0, 0, 0) for scene in blocks for body in scene.bodies)


def test_few_windows_of_a_cold_start(tmp_path: Path) -> None:
    scene = make_scene(position=(0.0, 0.0, 0.0))
    tall = make_scene(position=(0.0, 0.0, 0.0), size=(0.3, 0.3, 0.6))
    long = [moved(s, lambda t: np.array([0.3 * min(t, 0.2) ** 2, 0.0, 0.0]), 401) for s in (scene, tall, scene)]
    settings = {"moving_repeats": 2, "num_steps": 2000}
    assert changes(advice_on(tmp_path / "few", long, start_repeats=1, **settings)) == ["training.start_repeats=2"]
    assert changes(advice_on(tmp_path / "more", long, start_repeats=2, **settings)) == []


def test_a_squared_loss_and_impacts(tmp_path: Path) -> None:
    kick = np.zeros((216, 1))
    kick[100] = 1.0

    def knocked(slide: Any) -> Any:
        return lambda t: slide(t) + kick * 0.002 * (round(t / 0.01) % 2) * np.array([0.0, 0.0, 1.0])

    scene = make_scene(position=(0.0, 0.0, 0.0))
    hit = [moved(scene, knocked(lambda t: np.array([0.3 * min(t, 0.15) ** 2, 0.0, 0.0])), 21)] * 3
    wanted = "training.optimisation.huber_delta=0.3"
    assert wanted in changes(advice_on(tmp_path / "squared", hit, huber_delta=None))
    assert wanted not in changes(advice_on(tmp_path / "huber", hit, huber_delta=0.3))
    assert wanted not in changes(advice_on(tmp_path / "calm", collapses(), huber_delta=None))


def test_a_set_that_rests_too_long_or_never(tmp_path: Path) -> None:
    scene = make_scene(position=(0.0, 0.0, 0.0), size=(0.3, 0.3, 0.3))
    tall = make_scene(position=(0.0, 0.0, 0.0), size=(0.3, 0.3, 0.6))
    for name, until, sentence in (("long", 0.05, "shorten"), ("short", 1.0, "lengthen")):
        made = [moved(s, lambda t, u=until: np.array([0.6 * min(t, u), 0.0, 0.0]), 21) for s in (scene, tall, scene)]
        found = suggest(advice_on(tmp_path / name, made))
        assert [sentence in suggestion.message for suggestion in found].count(True) == 1


def test_one_aspect_ratio_and_no_validation(tmp_path: Path) -> None:
    found = suggest(advice_on(tmp_path, collapses()[::3], {"valid": 0}))
    assert ["aspect ratio" in found[0].message, "no validation" in found[1].message, len(found)] == [True, True, 2]


@pytest.mark.parametrize(
    ("data_errors", "sentence"),
    [
        ({"scale": 80.0}, "positions are 80 times what they were in metres"),
        ({"scale": 0.01}, "positions are 0.01 times what they were in metres"),
        ({"dt_factor": 2.0}, "dt = 0.02 s does not fit the motion, 0.01 s would"),
    ],
)
def test_wrong_units_are_named_and_nothing_else_is_advised(
    tmp_path: Path, data_errors: dict[str, float], sentence: str
) -> None:
    flights = [make_flight(make_scene(velocity=(0.4 * k, 0.0, 0.5)), 20) for k in range(3)]
    wrong = suggest(advice_on(tmp_path / "wrong", flights, data_errors))
    assert sentence in wrong[0].message and all(suggestion.change is None for suggestion in wrong)
    right = suggest(advice_on(tmp_path / "right", flights))
    assert not any("free fall" in suggestion.message for suggestion in right) and changes_something(right)


def changes_something(suggestions: list[Suggestion]) -> bool:
    return any(suggestion.change is not None for suggestion in suggestions)


def test_other_data_errors_are_named(sound: Advice) -> None:
    survey = sound.survey
    for part, values, sentence in (
        ("data_errors", {"not_finite": ("a.h5", "b.h5")}, "2 files hold numbers that are not finite (a.h5, b.h5)"),
        ("data_errors", {"outside": 0.01, "extent": 7.5}, "1 % of the particles lie outside their box"),
        ("data_errors", {"other_dt": ("a.h5",)}, "1 files have another dt"),
        ("motion", {"step": (0.0, 0.1, 0.2, 0.6)}, "the fastest particle moves at 60 m/s"),
        ("motion", {"velocity_std": 10 * survey.motion.velocity_std}, "its statistics are not those of these files"),
        ("motion", {"velocity_std": 0.0}, "nothing in the data moves"),
        ("starts", {"num_obstacles": 2}, "2 trajectories have obstacles"),
    ):
        spoilt = replace(sound, survey=replace(survey, **{part: replace(getattr(survey, part), **values)}))
        assert [sentence in suggestion.message for suggestion in suggest(spoilt)] == [True], sentence


def test_volume_that_is_lost_and_particles_that_are_too_fast(sound: Advice) -> None:
    survey = sound.survey
    lost = replace(sound, survey=replace(survey, density=replace(survey.density, end_over_start=2.0)))
    assert ["data.mpm" in suggestion.message for suggestion in suggest(lost)] == [True]
    fast = replace(sound, survey=replace(survey, motion=replace(survey.motion, step=(0.0, 0.1, 0.22, 0.3))))
    assert changes(fast) == ["data.frame_interval=0.0025"]  # half a radius of 0.11 m a step


def test_kept_points_that_are_short_of_their_runs(sound: Advice) -> None:
    """Told with their scatter; what may be chance, or is little, asks for nothing."""
    assert not any("kept points" in row[0] for row in rows(sound))
    for kept, suggested in (
        (Kept(num_seen=88, front=-0.08, front_scatter=0.16, map=0.05), True),
        (Kept(num_seen=4, front=-0.08, front_scatter=0.01, map=0.05), False),
        (Kept(num_seen=9, front=-0.08, front_scatter=0.16, map=0.05), False),
        (Kept(num_seen=88, front=-0.08, front_scatter=0.16, map=0.05, stratified=True), False),
        (Kept(num_seen=88, front=-0.02, front_scatter=0.01, map=0.05), False),
    ):
        advice = replace(sound, survey=replace(sound.survey, kept=kept))
        assert changes(advice) == (["+data.sampling=stratified"] if suggested else [])
        [row] = [row for row in rows(advice) if "kept points" in row[0]]
        assert row[1] == f"{100 * kept.front:+.3g} %" and f"over {kept.num_seen} trajectories" in row[2]


def test_the_command_reports_and_trains_nothing(
    data_root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cfg = make_config(data_root, tmp_path)
    path = advise(cfg, tmp_path)  # generates where nothing is
    content = json.loads(path.read_text())
    printed = capsys.readouterr().out
    assert path == tmp_path / "advice.json" and [entry.name for entry in tmp_path.iterdir()] == ["advice.json"]
    assert content["survey"]["sizes"]["num_trajectories"] == 2 and content["notes"] == []
    assert content["survey"]["density"]["measured"] == pytest.approx(0.0625, rel=0.1)
    assert content["dataset"] == str(data_root)
    for suggestion in content["suggestions"]:
        assert suggestion["message"][1:] in printed and (suggestion["change"] or "") in printed
    assert "block_release" in printed and "neighbours within it" in printed


def test_a_folder_that_was_not_generated_here(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_set(tmp_path / "foreign", collapses())
    content = json.loads(advise(make_config(tmp_path / "foreign", tmp_path), tmp_path).read_text())
    assert len(content["notes"]) == 1 and "training would refuse it" in content["notes"][0]
    assert content["survey"]["starts"]["num_cold"] == 3 and content["survey"]["motion"]["gravity"] is None
    assert "training would refuse it" in capsys.readouterr().out


def test_bad_settings_are_refused_before_anything_is_generated(tmp_path: Path) -> None:
    for change, sentence in (("training.noise_std=-1", "noise_std"), ("model.output=magic", "output must be one of")):
        with pytest.raises(InputError, match=sentence):
            advise(make_config(tmp_path / "data", tmp_path, change), tmp_path)
    assert not (tmp_path / "data").exists()


def test_large_data_are_asked_for_and_not_generated(tmp_path: Path) -> None:
    cfg = make_config(tmp_path / "data", tmp_path, "data.frame_interval=1e-6")
    cfg.data.root = str(tmp_path / "a b=c")
    with pytest.raises(InputError, match=r"to generate them, \d.* GB, type python generate\.py") as refused:
        advise(cfg, tmp_path)
    typed = shlex.split(str(refused.value).split("generate.py ")[1].split(", which")[0])
    assert typed[1] == f'data.root="{tmp_path}/a b=c"' and list(tmp_path.iterdir()) == []
    size = float(re.search(r"them, (\S+) GB", str(refused.value))[1])  # type: ignore[index]
    assert size == pytest.approx(missing_bytes(OmegaConf.to_container(cfg.data, resolve=True)) / 1e9, rel=0.1)


def test_lines_of_a_suggestion() -> None:
    lines = suggestion_lines([Suggestion("too few.", "+data.families.b={kind:x}"), Suggestion("wrong.")])
    assert lines[1:] == [
        " 1. Too few.",
        "    '+data.families.b={kind:x}'",
        " 2. Wrong.",
        "Other data need another folder: data.root=…",
    ]


def test_a_set_on_a_map_is_to_be_converted_again(tmp_path: Path) -> None:
    """At 600 km float32 leaves 6 cm of a lattice of 5 cm; that is said, whatever else the ruins look like."""
    far = []
    for each in collapses():
        box = each.scene.replace(bodies=(replace(each.scene.bodies[0], position=(600_000.0, 0.0, 0.0)),),
                                 lower=(600_000.0, 0.0, 0.0), upper=(600_001.0, 1.0, 1.0))  # fmt: skip
        far.append(replace(each, position=(each.position + np.float32([6e5, 0, 0])).astype(np.float32), scene=box))
    first = suggest(advice_on(tmp_path, far))[0]
    assert "0.062 m apart" in first.message and "convert their source again" in first.message
