"""A corrector leaves alone what rests, and comes back from its file."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from gns_pl.errors import InputError
from gns_pl.models.corrector import Corrector, CorrectorConfig, CorrectorFile, load_corrector, save_corrector
from gns_pl.models.shipped import find_corrector
from tests.conftest import make_static

CONFIG = CorrectorConfig(
    dim=3,
    interval=0.02,
    spacing=0.1,
    mpm={"cell_size": 0.2},
    connectivity_radius=0.2,
    latent_size=8,
    num_mlp_layers=1,
    num_message_passing_steps=1,
    velocity_threshold=0.1,
)


def make(seed: int = 0) -> Corrector:
    torch.manual_seed(seed)
    return Corrector(CONFIG).eval()


def test_what_rests_is_left_alone() -> None:
    static, position = make_static(50), torch.rand(50, 3)
    moved = position.clone()
    moved[:10] += 0.01
    velocity = make()(position, position, moved, static)
    assert (velocity[:10].norm(dim=1) > 0).all()
    assert torch.equal(velocity[10:], torch.zeros(40, 3))


def test_a_file_brings_it_back(tmp_path: Path) -> None:
    corrector, static = make(), make_static(50)
    corrector.velocity_scale.fill_(0.3)
    places = [torch.rand(50, 3) for _ in range(3)]
    save_corrector(tmp_path / "a.corrector", CorrectorFile(corrector, {"name": "x"}, {"steps": 3}))
    back = load_corrector(tmp_path / "a.corrector")
    assert torch.equal(back.corrector(*places, static), corrector(*places, static))
    assert back.corrector.config == CONFIG and back.data == {"name": "x"} and back.provenance == {"steps": 3}


def test_a_file_of_before_is_read_by_the_names_of_then(tmp_path: Path) -> None:
    """`velocity_threshold` was `slow` before, as in the one that comes with the package."""
    save_corrector(tmp_path / "a.corrector", CorrectorFile(make(), {}, {}))
    content = torch.load(tmp_path / "a.corrector", weights_only=True)
    content["gns_pl_corrector"]["config"]["slow"] = content["gns_pl_corrector"]["config"].pop("velocity_threshold")
    torch.save(content, tmp_path / "b.corrector")
    assert load_corrector(tmp_path / "b.corrector").corrector.config == CONFIG
    shipped = find_corrector("corrected_plane")
    assert torch.load(shipped, weights_only=True)["gns_pl_corrector"]["config"]["slow"] == 0.2
    assert load_corrector(shipped).corrector.config.velocity_threshold == 0.2


def test_what_is_no_corrector_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no such corrector"):
        load_corrector(tmp_path / "a.corrector")
    (tmp_path / "a.corrector").write_bytes(b"abc")
    with pytest.raises(InputError, match="is not a corrector"):
        load_corrector(tmp_path / "a.corrector")
    torch.save({"other": 1}, tmp_path / "a.corrector")
    with pytest.raises(InputError, match="is not a corrector"):
        load_corrector(tmp_path / "a.corrector")
    with pytest.raises(InputError, match=r"model\.interval must be positive"):
        CorrectorConfig(**{**vars(CONFIG), "interval": 0})


def test_a_radius_below_the_spacing_is_refused() -> None:
    with pytest.raises(InputError, match=r"0\.05 m reaches no neighbour at a spacing of 0\.1 m; take .*radius=0\.21$"):
        CorrectorConfig(**{**vars(CONFIG), "connectivity_radius": 0.05})
