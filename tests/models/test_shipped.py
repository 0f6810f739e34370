"""The checkpoints that come with the package: they load by name, say where they are from, and step sand sensibly."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from gns_pl.evaluation.scenes import build_scenes
from gns_pl.models.checkpoint import load_checkpoint
from gns_pl.models.corrector import load_corrector
from gns_pl.models.shipped import FOLDER, find_checkpoint, find_corrector, pretrained_names
from gns_pl.rollout import rollout
from gns_pl.scene import fill_scene
from gns_pl.trajectory import start_trajectory


def paths_of_a_machine(provenance: object) -> list[str]:
    """Return the absolute paths among texts, as of the folder in which a model was trained."""
    return re.findall(r"'(?:/|[A-Z]:)[\w.-]+/[^']*'", repr(provenance))


@pytest.mark.parametrize("name", pretrained_names())
def test_each_has_a_card_and_its_provenance(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    checkpoint = load_checkpoint(name)
    assert checkpoint.provenance["config"]["name"] == name and checkpoint.provenance["steps"] > 0
    assert (FOLDER / f"{name}.md").read_text(encoding="utf-8").split("---\n", 2)[2].startswith(f"# {name}\n")
    assert find_checkpoint(name).stat().st_size < 1e7
    assert not paths_of_a_machine(checkpoint.provenance)


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.corrector")), ids=lambda path: path.stem)
def test_each_corrector_has_a_card_and_its_provenance(path: Path) -> None:
    file = load_corrector(find_corrector(path.stem))
    assert file.provenance["steps"] > 0 and file.data["families"] and not paths_of_a_machine(file.provenance)
    assert (FOLDER / f"{path.stem}.md").read_text(encoding="utf-8").split("---\n", 2)[2].startswith(f"# {path.stem}\n")
    assert path.stat().st_size < 1e7


def test_a_folder_hides_no_model(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "column-fast").mkdir()  # as out=column-fast leaves one
    assert find_checkpoint("column-fast") == FOLDER / "column-fast.ckpt"
    (tmp_path / "corrected_plane").mkdir()
    assert find_corrector("corrected_plane") == FOLDER / "corrected_plane.corrector"


def test_a_file_goes_before_a_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert find_checkpoint("collapse") == FOLDER / "collapse.ckpt"
    Path("collapse").touch()
    assert find_checkpoint("collapse") == Path("collapse")
    assert find_checkpoint("elsewhere/last.ckpt") == Path("elsewhere/last.ckpt")


def test_a_column_collapses_and_comes_to_rest() -> None:
    """The shipped weights still do with today's features what the card says (a = 1.2)."""
    checkpoint = load_checkpoint("collapse")
    config, data = checkpoint.simulator.config, checkpoint.data
    specification = {"column": {"length": 0.25, "height": 0.3}}
    settings = {"files": None, "only": None, "domain": [1.2, 0.25, 0.5], "duration": 6.0, "interval": config.dt}
    scene = build_scenes(specification, data=data, **settings)["column"]
    grains = fill_scene(scene, config.spacing, jitter=data["mpm"]["jitter"], generator=np.random.default_rng(0))
    found = rollout(checkpoint.simulator, start_trajectory(scene, grains, config.dt, {}), 60).position
    spread = np.quantile(found[-1, :, 0], 0.99) - np.quantile(found[0, :, 0], 0.99)
    assert 0.8 < spread / 0.25 < 2.2  # Lube et al. (2005): 1.2 × 1.2
    assert np.linalg.norm(found[-1] - found[-2], axis=1).mean() / config.dt < 0.03
    assert 0.4 < found[-1, :, 2].mean() / found[0, :, 2].mean() < 0.7
