"""What Python takes from the configuration is what a command composes from the same files."""

from __future__ import annotations

from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from gns_pl.presets import FOLDER, preset
from gns_pl.rollout.policy import Policy


def composed(command: str, *overrides: str) -> dict[str, object]:
    with initialize_config_dir(str(Path(FOLDER).resolve()), version_base=None):
        return OmegaConf.to_container(compose(command, overrides=list(overrides)), resolve=True)  # type: ignore[return-value]


def test_presets_are_what_a_command_composes() -> None:
    simulate = composed("simulate")
    assert preset("choice/default") == simulate["choice"] and preset("rollout/stable") == simulate["stabilise"]
    assert Policy().stabilise == simulate["stabilise"]


@pytest.mark.parametrize("name", ["cube106", "quickstart", "collapse_plane"])
def test_a_data_sets_numbers_are_those_that_generate_it(name: str) -> None:
    data = composed("generate", f"data={name}")["data"]
    assert preset(f"data/{name}")["mpm"] == data["mpm"]  # type: ignore[index]


def test_a_caller_may_change_what_it_got() -> None:
    preset("rollout/stable")["sleep"] = 9.0
    assert preset("rollout/stable")["sleep"] != 9.0
