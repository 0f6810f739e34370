"""What a shell hands over becomes what Hydra's grammar reads as it was meant, for every name of a file."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import OmegaConf

from gns_pl.commands.arguments import LISTS, NAMES, parts_of, prepared
from gns_pl.scene.changes import decoded
from gns_pl.text import override
from tests.commands.test_train import ROOT
from tests.test_text import NAMES as NASTY

CONF = ROOT / "conf"
KEYS = [key.replace("*", "csv") for key in (*LISTS, *NAMES)]
FILES = [name for name in NASTY if name and "/" not in name and name not in ("null",)]
"""Names that a folder of this test can hold."""


def read(argument: str) -> tuple[str, object]:
    """Return key and value as Hydra and OmegaConf read a prepared argument."""
    parsed = OverridesParser.create().parse_override(argument)
    assert not parsed.is_sweep_override(), argument
    config = OmegaConf.create({"x": "interpolated", "value": parsed.value()})
    return parsed.key_or_group, OmegaConf.to_container(config, resolve=True)["value"]


def jobs(arguments: list[str]) -> list[list[tuple[str, object]]]:
    """Return what every job of a sweep reads."""
    overrides = [each for each in arguments if not each.startswith(("-", "hydra.job."))]
    [batch] = BasicSweeper.split_arguments(OverridesParser.create().parse_overrides(overrides), None)
    return [[read(each) for each in job] for job in batch]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("key", KEYS)
def test_a_file_that_is_there_is_meant_whatever_its_name(folder: Path, key: str) -> None:
    for name in FILES if key in ("ckpt", "out") else FILES[1::8]:  # keys of a kind are treated alike
        (folder / name).touch()
        assert [read(each) for each in prepared([f"{key}={name}"], CONF / "simulate.yaml")] == [(key, name)]
        assert jobs(prepared(["-m", f"{key}={name}"], CONF / "simulate.yaml")) == [[(key, name)]]
        if key in LISTS:
            listed = prepared([f"{key}=[{name},other.x,{name}]"], CONF / "simulate.yaml")
            assert [read(each) for each in listed] == [(key, [name, "other.x", name])]
        (folder / name).unlink()


PLAIN = [name for name in FILES if "${" not in name and name[0] not in "~[" and "\\" not in name]


@pytest.mark.parametrize("key", [key for key in KEYS if key not in LISTS])
def test_a_new_name_is_taken_as_it_stands(folder: Path, key: str) -> None:
    for name in [*(PLAIN if key == "out" else PLAIN[1::8]), "[a,b]", "a,b=(c)"]:
        assert [read(each) for each in prepared([f"{key}={name}"], CONF / "convert.yaml")] == [(key, name)]


def test_what_is_printed_is_read_whether_it_is_there_or_not(folder: Path) -> None:
    for name in FILES:
        for there in (False, True):
            if there:
                (folder / name).touch()
            for sweep in ((), ("-m",)):
                (word,) = shlex.split(override("out", name))
                [argument] = [a for a in prepared([*sweep, word], CONF / "convert.yaml") if a not in ("-m",)]
                assert read(argument) == ("out", name)


def test_commas_part_the_jobs_of_a_sweep_but_not_a_name_that_is_there(folder: Path) -> None:
    (folder / "a,b.ckpt").touch()
    (folder / "c d.ckpt").touch()
    ckpt = prepared(["-m", "ckpt=a,b.ckpt,c d.ckpt,e=f.ckpt"], CONF / "simulate.yaml")
    assert [job[0][1] for job in jobs(ckpt)] == ["a,b.ckpt", "c d.ckpt", "e=f.ckpt"]
    lists = prepared(["-m", "ckpt=[a,b.ckpt,c d.ckpt],x"], CONF / "evaluate.yaml")
    assert [job[0][1] for job in jobs(lists)] == [["a,b.ckpt", "c d.ckpt"], "x"]
    assert jobs(prepared(["-m", "ckpt=choice(a,b)"], CONF / "simulate.yaml")) == [[("ckpt", "a")], [("ckpt", "b")]]
    assert parts_of("[a,b],'c,d',e(1,2)") == ["[a,b]", "'c,d'", "e(1,2)"]


def test_home_interpolations_and_null_keep_their_meaning(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(folder / "my home"))
    typed = ["out=~/x (1)", "cache=${x}/a b", "resume=null", "ckpt=null", "~logger.wandb", "name=", "-m", "seed=1"]
    config = CONF / "convert.yaml"
    done = prepared(typed, config)
    assert read(done[0]) == ("out", str(folder / "my home" / "x (1)"))
    assert read(done[1]) == ("cache", "interpolated/a b")
    assert done[2:] == typed[2:]
    (folder / "~").mkdir()
    (folder / "~/x").touch()
    assert read(prepared(["out=~/x"], config)[0]) == ("out", "~/x")  # a folder called ~


@pytest.mark.parametrize("name", ["plain", "a=b, [ä] (1)", '"quoted"', "~"])
def test_a_folder_of_data(folder: Path, name: str) -> None:
    (folder / name).mkdir()
    (folder / name / "manifest.json").touch()
    chosen, root = prepared([f"data={name}"], CONF / "train.yaml")
    assert chosen == "data=imported" and read(root) == ("data.root", name)
    chosen, root = prepared([f"data={folder / name}/"], CONF / "train.yaml")
    assert read(root) == ("data.root", str(folder / name))
    (word,) = shlex.split(override("data", name))
    assert read(prepared([word], CONF / "train.yaml")[1]) == ("data.root", name)


def test_groups_are_taken_with_and_without_a_plus() -> None:
    typed = ["experiment=quickstart", "+data=columns", "++model=small", "+sweep=noise", "hydra/launcher=basic"]
    done = ["+experiment=quickstart", "data=columns", "model=small", "+sweep=noise", "hydra/launcher=basic"]
    assert prepared(typed, CONF / "train.yaml") == done
    assert prepared(["+evaluation=stress"], CONF / "evaluate.yaml") == ["evaluation=stress"]


COMMANDS = {
    "train": ["resume", "data.root", "hydra.run.dir", "hydra.sweep.dir", "name", "description"],
    "evaluate": ["ckpt", "out", "cache", "evaluation.scenes"],
    "simulate": ["ckpt", "scene", "out", "choice.records"],
    "generate": ["data.root"],
    "benchmark": ["ckpt", "out", "cache", "records", "publish"],
    "convert": ["source", "target", "deck", "name", "weights.metadata", "weights.data", "weights.description"],
}


@pytest.mark.parametrize("command", COMMANDS)
def test_every_path_of_a_command_arrives_in_its_config(folder: Path, command: str) -> None:
    name = "a=b, [é] {x} 'q' \"r\" #1: ${z"
    (folder / name).touch()
    arguments = prepared([f"{key}={name}" for key in COMMANDS[command]], CONF / f"{command}.yaml")
    with initialize_config_dir(str(CONF), version_base=None):
        data = ["data=quickstart"] if command == "generate" else []
        cfg = compose(command, [*data, *arguments], return_hydra_config=True)
    assert {key: OmegaConf.select(cfg, key) for key in COMMANDS[command]} == dict.fromkeys(COMMANDS[command], name)


def test_no_path_of_a_config_is_forgotten() -> None:
    """Keys that are null, or text with a slash, and whose comment speaks of a file or a folder, are listed."""
    words = ("file", "folder", "checkpoint", "relative to where", "is kept here", "beside")
    forgotten = []
    for path in CONF.rglob("*.yaml"):
        package = "" if path.parent == CONF else f"{path.parent.name}."
        owner = ""
        for line in path.read_text(encoding="utf-8").splitlines():
            key, _, rest = line.partition(":")
            value, _, comment = rest.partition("#")
            if not line.startswith((" ", "#", "-")):
                owner = "" if value.strip() else f"{key}."
            full = package + (owner if line.startswith(" ") else "") + key.strip()
            is_path = value.strip() == "null" or "/" in value
            if line and line[0] != "#" and is_path and any(word in comment for word in words):
                forgotten.append(full.removeprefix("hydra."))
    unlisted = sorted(key for key in forgotten if key not in (*LISTS, *NAMES))
    assert unlisted == ["evaluation.split", "tolerance"]  # whose comments speak of files all the same


def test_what_an_ensemble_varies_is_any_key_of_a_scene_but_its_own_stay() -> None:
    typed = ["ensemble.walls.z-.friction=[0.2,0.4]", "ensemble.members=4"]
    done = prepared(typed, CONF / "simulate.yaml")
    assert done == ["++ensemble.vary.walls$2e$z-$2e$friction=[0.2,0.4]", "ensemble.members=4"]
    assert decoded({done[0].partition("=")[0].rpartition(".")[2]: 0}) == {"walls.z-.friction": 0}
