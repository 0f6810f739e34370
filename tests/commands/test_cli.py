"""`gns-pl COMMAND`, from the sources and from a built wheel."""

from __future__ import annotations

import os
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path

import pytest

from gns_pl import text
from gns_pl.commands import cli
from gns_pl.io import write_manifest
from tests.commands.test_train import ROOT
from tests.data.sets import make_flight, make_scene, write_set


def ended(monkeypatch: pytest.MonkeyPatch, *typed: str) -> int:
    monkeypatch.setattr(text, "_program", list(text._program))
    monkeypatch.setattr(sys, "argv", ["gns-pl", *typed])
    try:
        cli.main()
    except SystemExit as end:
        return int(end.code or 0)
    return 0


def test_commands_go_by_their_names(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    assert ended(monkeypatch, "--help") == 0 and "train, evaluate, simulate" in capsys.readouterr().out
    assert ended(monkeypatch, "tran") == 2
    assert "there is no command tran (did you mean train?)" in capsys.readouterr().err
    for name in cli.COMMANDS:
        assert ended(monkeypatch, name, "--help") == 0
        shown = capsys.readouterr().out
        assert f"gns-pl {name}" in shown and ".py" not in shown.partition("Settings")[0]
        assert (ROOT / f"{name}.py").read_text().count("\n") <= 7


def test_messages_name_the_command_as_it_was_typed(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    assert text.command("train") == "python train.py"
    assert ended(monkeypatch, "evaluate") == 2
    assert "Name one: gns-pl evaluate ckpt=" in capsys.readouterr().err


@pytest.mark.slow
def test_a_wheel_has_commands_and_configuration(tmp_path: Path) -> None:
    """It trains from an empty folder, on nothing that the repository has."""
    build = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", str(ROOT)]
    subprocess.run([*build, "--wheel-dir", str(tmp_path)], check=True)
    (wheel,) = tmp_path.glob("gns_pl-*.whl")
    installed, work = tmp_path / "installed", tmp_path / "work"
    work.mkdir()
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(installed)
        names = {name for name in archive.namelist() if name.startswith("gns_pl/conf/")}
    assert names == {f"gns_pl/{file.relative_to(ROOT)}" for file in (ROOT / "conf").rglob("*.yaml")}
    manifest = write_set(work / "few", [make_flight(make_scene(), 8)] * 3)
    write_manifest(work / "few", replace(manifest, spec={"name": "few", "imported": {}, "gravity": 9.81}))
    command = [sys.executable, "-m", "gns_pl.commands.cli", "train", "+experiment=quickstart", "data=few"]
    settings = ["training.rollout.num_steps=0", "callbacks.best.monitor=valid/position_error"]  # no fine runs
    settings += ["training.optimisation.num_steps=3", "trainer.val_check_interval=3", "logger=csv", "hydra.run.dir=run"]
    environment = os.environ | {"PYTHONPATH": str(installed)}
    run = subprocess.run(
        [*command, *settings], cwd=work, env=environment, capture_output=True, text=True, check=False, timeout=300
    )
    assert run.returncode == 0, run.stderr
    assert (work / "run/last.ckpt").is_file() and "gns-pl evaluate ckpt=run/last.ckpt" in run.stdout
