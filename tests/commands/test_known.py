"""What ships has only keys and kinds of values that its commands have."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from hydra.core.hydra_config import HydraConfig
from omegaconf import open_dict

from gns_pl.commands.known import check_known
from gns_pl.training import sweep  # registers the resolvers of conf/train.yaml
from tests.commands.test_train import ROOT

CONF = ROOT / "conf"


def options(group: str) -> list[str]:
    return sorted(path.stem for path in (CONF / group).glob("*.yaml") if not path.stem.startswith("_"))


OPTUNA = find_spec("hydra_plugins") is not None and find_spec("hydra_plugins.hydra_optuna_sweeper") is not None
SHIPPED = [
    *(("train", f"+experiment={name}") for name in options("experiment")),
    *(("train", f"+sweep={name}") for name in options("sweep") if name != "optuna" or OPTUNA),
    *((command, f"data={name}") for command in ("train", "generate") for name in options("data")),
    *(("train", f"{group}={name}") for group in ("model", "training") for name in options(group)),
    *(("evaluate", f"evaluation={name}") for name in options("evaluation")),
    *((command, "") for command in ("simulate", "benchmark", "convert")),
]


def check(command: str, arguments: list[str], folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Check what a command is given as it does itself, in a folder of its run."""
    assert sweep.SweepReport is not None
    with initialize_config_dir(str(CONF), version_base=None):
        cfg = compose(command, arguments, return_hydra_config=True)
        cfg.hydra.runtime.output_dir = str(folder)
        cfg.hydra.job.num = 0
        monkeypatch.setattr(HydraConfig.instance(), "cfg", None)
        HydraConfig.instance().set_config(cfg)
        with open_dict(cfg):
            del cfg["hydra"]
        check_known(cfg)


@pytest.mark.parametrize(("command", "argument"), SHIPPED)
def test_what_ships_is_known(command: str, argument: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    check(command, [argument] if argument else [], tmp_path, monkeypatch)
