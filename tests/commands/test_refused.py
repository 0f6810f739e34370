"""What no command takes is refused in one sentence with status 2, before anything is made."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import yaml
from hydra import compose, initialize_config_dir
from hydra.errors import MissingConfigException
from omegaconf import OmegaConf

from gns_pl.commands.telling import error_message
from gns_pl.io import write_manifest
from gns_pl.text import did_you_mean, nearest
from tests.commands.test_train import ROOT
from tests.commands.typed import typed
from tests.data.sets import make_flight, make_scene, write_set

COMMANDS = ("train", "evaluate", "simulate", "generate", "benchmark", "convert", "fit")
SCENE = str(ROOT / "scenes/two_blocks.yaml")
RUN = ("ckpt=collapse", "scene=column_collapse")
TINY = ("data=quickstart", "data.root=/dev/null/none")  # were a training begun, it would end at once
NEEDED = {"generate": ("data=quickstart",)}


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def refused(capsys: pytest.CaptureFixture[str], command: str, *arguments: str) -> str:
    """Return the one sentence of a command that ends with status 2."""
    ended = typed(capsys, command, *arguments)
    assert ended.status == 2 and ended.err.startswith(f"{command}.py: ") and ended.err.count("\n") == 1, ended
    return ended.err


@pytest.mark.parametrize("command", COMMANDS)
def test_a_key_that_no_file_has(capsys: pytest.CaptureFixture[str], folder: Path, command: str) -> None:
    for key in ("+unknown=1", "++foo.bar=2", "unknown=1"):
        sentence = refused(capsys, command, *NEEDED.get(command, ()), key)
        assert f"there is no key {key.strip('+').split('=')[0].split('.')[0]}" in sentence
    assert not [path for path in folder.iterdir() if path.name != "runs"]
    assert not [path for path in folder.rglob("*") if path.is_file() and ".hydra" not in path.parts]


MISSPELT = [
    ("train", ("training.bach_size=3",), "there is no key training.bach_size (did you mean training.batch_size?)"),
    ("train", ("+training.bach_size=3",), "there is no key training.bach_size (did you mean training.batch_size?)"),
    ("train", ("bach_size=3",), "(did you mean training.batch_size?)"),
    ("train", ("training={bach_size:3}",), "(did you mean training.batch_size?)"),
    (
        "generate",
        ("data=column_runs", "data.families.valid_1.2.count=1"),
        "the name valid_1.2 has a dot in it, a step down for a command line; give it as a mapping, as "
        "'data.families={valid_1.2:{…}}'",
    ),
    ("train", ("~logger.wnadb",), "there is no key logger.wnadb (did you mean logger.wandb?)"),
    (
        "train",
        ("data=cub106",),
        "there is no such option, and no folder of a data set (did you mean cube106?)",
    ),
    ("train", ("+experiment=quikstart",), "experiment=quikstart: there is no such option (did you mean quickstart?)"),
    (
        "train",
        ("model=papr",),
        "(did you mean paper?); options are corrector, corrector_retuned, geoelements, paper, small.",
    ),
    ("evaluate", ("ckpt=collapse", "evaluation.duraton=3"), "(did you mean evaluation.duration?)"),
    (
        "evaluate",
        ("evaluation=strss",),
        "(did you mean stress?); options are columns, general, stress, sweep, terrain, validation.",
    ),
    ("evaluate", ("ckpt=colum-fast",), "colum-fast: there is no such checkpoint (did you mean column-fast?); those"),
    ("evaluate", ("ckpt=x", "evaluation.columns.mine=1"), "added by a + before it: +evaluation.columns.mine=…"),
    ("simulate", (*RUN, "acceleration.skim=1"), "(did you mean acceleration.skin?)"),
    ("simulate", (*RUN, "aspect_ratio=1"), "there is no key aspect_ratio (did you mean scene.aspect_ratio?)"),
    ("simulate", (*RUN, "scene.aspekt_ratio=1"), "has no such key (did you mean aspect_ratio?); there are length"),
    (
        "simulate",
        ("ckpt=colapse", "scene=column_collapse"),
        "colapse: there is no such checkpoint (did you mean collapse",
    ),
    (
        "simulate",
        ("ckpt=collapse", "scene=colum_collapse"),
        "(did you mean column_collapse?); the catalogue has ",
    ),
    ("simulate", ("ckpt=collapse", f"scene={SCENE[:-6]}.yaml"), f"(did you mean {SCENE}?)"),
    (
        "simulate",
        ("ckpt=collapse", f"scene={SCENE}", "scene.duraton=1"),
        "key duraton (did you mean duration?)",
    ),
    (
        "simulate",
        ("ckpt=collapse", f"scene={SCENE}", "scene.bodies.2.size=1"),
        "2 is no entry of the scene; there are",
    ),
    ("simulate", ("ckpt=collapse", f"scene={SCENE}", "scene.bodis.0.size=1"), "has no such key (did you mean bodies?)"),
    ("generate", (), "which data? data=NAME; there are collapse, "),
    ("generate", ("data=quickstart", "num_worker=2"), "(did you mean num_workers?)"),
    ("benchmark", ("ckpt=[colapse]",), "colapse: there is no such checkpoint (did you mean collapse"),
    ("train", ("experiment=corrected_plane", "modl.latent_size=3"), "(did you mean model.latent_size?)"),
    ("convert", ("source=x", "target=y", "+weights.edge_updates=1"), "(did you mean weights.edge_update?)"),
]


@pytest.mark.parametrize(("command", "arguments", "sentence"), MISSPELT)
def test_what_was_meant_is_told(
    capsys: pytest.CaptureFixture[str], command: str, arguments: tuple[str, ...], sentence: str
) -> None:
    assert sentence in refused(capsys, command, *arguments)


WRONG = [
    ("simulate", (*RUN, "scene.aspect_ratio=-1"), "aspect_ratio must be a finite number above 0, not -1."),
    ("simulate", (*RUN, "scene.aspect_ratio=null"), "aspect_ratio must be a number, not None."),
    ("simulate", ("ckpt=[a,b]", "scene=column_collapse"), "ckpt=a,b: a run takes one checkpoint; -m ckpt=A,B makes"),
    ("simulate", (*RUN, "seed=abc"), "seed must be a number, not 'abc'."),
    ("simulate", (*RUN, "monitor=3"), "monitor must be true or false, not 3."),
    (
        "simulate",
        (*RUN, "acceleration=3"),
        "must be a mapping of names to values, as {a:1} or null, not 3.",
    ),
    ("simulate", (*RUN, "duration=abc"), "duration must be a number or null, not 'abc'."),
    ("simulate", (*RUN, "out=null"), "out must be text, not null."),
    ("simulate", (*RUN, "choice.learned=collapse"), "choice.learned must be a list, as [a,b], not 'collapse'."),
    ("simulate", (*RUN, "choice.cells=[a]"), "choice.cells must be a list of numbers, not ['a']."),
    ("simulate", (*RUN, "~acceleration.skin"), "acceleration.skin: it cannot be left out."),
    ("simulate", (*RUN, "out=${nowhere}/x"), "nowhere"),
    ("simulate", ("ckpt", "=", "collapse"), "'ckpt' is not KEY=VALUE; write it without spaces around the ="),
    (
        "simulate",
        (*RUN, "seed=a b=c"),
        "the value cannot be read; if it is meant as text, type 'seed=\"a b=c\"'",
    ),
    ("train", ("seed=null",), "seed must be a number, not null."),
    ("train", ("+seed=1",), "seed exists already: leave out the +."),
    ("train", ("trainer.max_steps=a", *TINY), "lightning.pytorch.trainer.trainer.Trainer: "),
    ("train", ("+trainer.max_step=1", *TINY), "Trainer.__init__() got an unexpected keyword argument 'max_step'"),
    ("convert", ("source=x", "target=y", "lower=3"), "lower must be a list, as [a,b] or null, not 3."),
    ("convert", ("source=x", "target=y", "valid=a"), "valid must be a number, not 'a'."),
    ("evaluate", ("ckpt=collapse", "evaluation.domain=3"), "evaluation.domain must be a list, as [a,b], not 3."),
    ("generate", ("data=quickstart", "device=null"), "device must be text, not null."),
]


@pytest.mark.parametrize(("command", "arguments", "sentence"), WRONG)
def test_a_value_of_another_kind(
    capsys: pytest.CaptureFixture[str], command: str, arguments: tuple[str, ...], sentence: str
) -> None:
    assert sentence in refused(capsys, command, *arguments)


def test_what_may_be_new_is_taken(capsys: pytest.CaptureFixture[str]) -> None:
    """Keys that are added rightly reach those who read them."""
    new = "+evaluation.columns.mine={length:0.1}"
    assert "columns.mine must be {length, height}" in refused(capsys, "evaluate", "ckpt=collapse", new)
    assert "kind 'x'" in refused(capsys, "generate", "data=quickstart", "+data.families.mine={kind:x}")
    wall = refused(capsys, "simulate", *RUN, "scene.side_walls={condition:slipp}")
    assert "condition must be one of stick, slip, friction" in wall


def test_a_folder_that_cannot_be_generated(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    manifest = write_set(folder / "a=b", [make_flight(make_scene(), frames=4)] * 2)
    write_manifest(
        folder / "a=b", replace(manifest, spec={"name": "n", "gravity": 9.81, "imported": {"format": "npz"}})
    )
    assert "a=b: its data are imported" in refused(capsys, "generate", "data=a=b")
    assert "of its own finer runs, and these data are imported" in refused(
        capsys, "train", "experiment=corrected_plane", "data=a=b"
    )


def test_unwritable_folders_are_told(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    (folder / "file").touch()
    for command, key in (("train", "hydra.run.dir"), ("simulate", "out")):
        arguments = RUN if command == "simulate" else ("data=quickstart",)
        assert "file" in refused(capsys, command, *arguments, f"{key}=file/x")


def test_yaml_errors_name_file_and_line(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    (folder / "mine.yaml").write_text("name: a\nbodies: [1, 2\nlower: 3\n")
    assert "mine.yaml: is not YAML or JSON (line 3: " in refused(capsys, "simulate", "ckpt=collapse", "scene=mine.yaml")
    (folder / "own/experiment").mkdir(parents=True)
    (folder / "own/experiment/mine.yaml").write_text("# @package _global_\nname: a\nseed: [1\n")
    sentence = refused(capsys, "train", "--config-dir", "own", "experiment=mine")
    assert "own/experiment/mine.yaml, line 4: is not YAML (" in sentence
    (folder / "own/experiment/mine.yaml").write_text("# @package _global_\ntraining: {bach_size: 3}\n")
    assert "did you mean training.batch_size?" in refused(capsys, "train", "--config-dir", "own", "experiment=mine")


@pytest.mark.parametrize("command", COMMANDS)
def test_help_has_a_purpose_two_examples_and_its_own_groups(capsys: pytest.CaptureFixture[str], command: str) -> None:
    ended = typed(capsys, command, "--help")
    lines = ended.out.splitlines()
    assert ended.status == 0 and lines[0].endswith(".") and not ended.err
    assert [line.split()[:2] for line in lines[2:4]] == [["python", f"{command}.py"]] * 2
    groups = (
        {line.strip().partition("=")[0] for line in lines[lines.index("Groups:") + 1 : lines.index("", 8)]}
        if ("Groups:" in lines)
        else set()
    )
    defaults = yaml.safe_load((ROOT / f"conf/{command}.yaml").read_text())["defaults"]
    own = {key for each in defaults if isinstance(each, dict) for key in each if not key.startswith("override")}
    assert groups == own | ({"experiment", "sweep"} if command == "train" else set())


@pytest.mark.parametrize("command", COMMANDS)
def test_the_examples_of_the_help_can_be_composed(command: str) -> None:
    from gns_pl.commands.arguments import prepared

    config = ROOT / "conf" / f"{command}.yaml"
    for line in yaml.safe_load(config.read_text())["hydra"]["help"]["footer"].splitlines():
        arguments = [each for each in line.split()[2:] if "," not in each or "[" in each]
        arguments = [each for each in prepared(arguments, config) if not each.startswith(("-", "hydra."))]
        arguments = ["data=quickstart" if each == "data=datasets/mine" else each for each in arguments]
        with initialize_config_dir(str(config.parent), version_base=None):
            assert OmegaConf.is_config(compose(config.stem, arguments))


def test_nearest_first() -> None:
    assert nearest("cub106", ["cube106_fine", "cube106", "columns"]) == ["cube106", "cube106_fine"][:1]
    assert nearest("xyz", ["abc"]) == [] and did_you_mean("xyz", ["abc"]) == ""
    assert did_you_mean("Seed", ["seed", "need"]) == " (did you mean seed?)"
    assert nearest("num_step", ["training.optimisation.num_steps", "num_train"], dotted=True)[0].endswith("num_steps")


@pytest.mark.parametrize(("plugin", "extra"), [("sweeper/optuna", "optuna"), ("launcher/joblib", "joblib")])
def test_a_plugin_that_is_missing_is_named(plugin: str, extra: str) -> None:
    """Hydra's error as it is where the plugin is not installed, which it may be here."""
    error = MissingConfigException(f"Could not find 'hydra/{plugin}'", f"hydra/{plugin}")
    told = error_message(error, ["+experiment=quickstart"], ROOT / "conf/train.yaml")
    assert told == f"hydra/{plugin} is not installed: pip install 'gns_pl[{extra}]'."
