"""Whatever ships runs by its name, in three dimensions too where its slice gives the whole."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hydra import compose, initialize_config_dir

from gns_pl.errors import InputError
from gns_pl.io import read_trajectory
from gns_pl.models.shipped import corrector_names, pretrained_names
from gns_pl.scene import Box, Scene, read_scene, write_scene
from gns_pl.solvers.catalogue import load_solver
from gns_pl.solvers.simulate import simulate_config
from tests.solvers.simulated import simulate_learned
from tests.solvers.test_selection import ROUGH, column

CONF = str(Path(__file__).parents[2] / "conf")
STABLE = {"sleep": 0.1, "min_distance": 0.2, "energy_limiter": True}


def run(folder: Path, name: str, scene: Scene, *more: str, key: str = "ckpt") -> Path:
    """As `simulate.py ckpt=NAME scene=FILE`."""
    folder.mkdir(exist_ok=True)
    write_scene(scene, folder / "scene.yaml")
    overrides = [f"{key}={name}", f"scene={folder / 'scene.yaml'}", f"out={folder / 'out'}", *more]
    with initialize_config_dir(CONF, version_base=None):
        (path,) = simulate_config(compose("simulate", overrides=overrides))
    return path


@pytest.mark.parametrize(
    "name",
    [
        "collapse_plane",
        "friction_plane",
        "column-fast-plane",
        "friction-fast-plane",
        *corrector_names(),
        "collapse_plane_then_mpm",
    ],
)
def test_what_is_of_two_dimensions_runs_a_column_between_smooth_walls(name: str, tmp_path: Path) -> None:
    scene = column().replace(duration=0.1)
    made = read_trajectory(run(tmp_path, name, scene))
    assert made.scene == scene and made.position.shape[2] == 3
    assert made.mass.sum() == pytest.approx(1800 * 0.3 * 0.5 * 0.3, rel=1e-5)
    layers = np.unique(made.position[..., 1])
    assert len(layers) > 5 and layers.min() > 0 and layers.max() < 0.5
    assert made.position[-1, :, 0].max() > made.position[0, :, 0].max()


def test_every_name_is_tried_here_or_is_of_three_dimensions() -> None:
    space = {"collapse", "column-fast", "cube106", "general-fast", "ground"}
    assert set(pretrained_names()) - space == {
        "collapse_plane",
        "column-fast-plane",
        "friction-fast-plane",
        "friction_plane",
    }
    assert corrector_names() == ["corrected_plane"]


@pytest.mark.parametrize("name", ["column-fast-plane", "corrected_plane"])
def test_what_is_no_slice_is_refused_with_the_reason(name: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"is not in plane strain: wall y- is not slip"):
        run(tmp_path, name, column(sides=ROUGH))
    obstacle = Box((0.8, 0, 0), (0.1, 0.5, 0.1), ROUGH)
    with pytest.raises(InputError, match=r"has obstacles, which .* does not know; use solver=ground or mpm"):
        run(tmp_path, name, column(obstacles=(obstacle,)))
    assert not list(tmp_path.rglob("*.h5*"))


def test_names_of_models_are_names_of_solvers(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run(tmp_path / "other", "friction_plane", column().replace(duration=0.02), key="solver")
    assert "chosen: friction_plane, as asked for; its error on this scene is unmeasured" in capsys.readouterr().out
    run(tmp_path / "one", "column-fast-plane", column().replace(duration=0.02), key="solver")
    assert "chosen: column-fast-plane, as asked for" in capsys.readouterr().out
    with pytest.raises(InputError, match=r"cell_size= and check= are MPM's"):
        run(tmp_path, "collapse_plane", column(), "check=true")
    with pytest.raises(InputError, match="give scene= and either ckpt= or tolerance="):
        run(tmp_path, "null", column(), "check=true")
    with pytest.raises(InputError, match="cell_size= is that of solver=mpm; tolerance= chooses among"):
        run(tmp_path, "0.05", column(), "cell_size=0.05", key="tolerance")
    with pytest.raises(InputError, match=r"those that come with gns_pl are collapse, .*collapse_plane_then_mpm"):
        run(tmp_path, "corected_plane", column())


def test_a_slice_goes_on_where_it_was_and_is_that_of_the_choice(tmp_path: Path) -> None:
    scene = column().replace(duration=0.16)
    for duration in (0.06, 0.16):
        (path,) = simulate_learned("collapse_plane", [scene], out=tmp_path, duration=duration, stabilise=STABLE)
    parts = read_trajectory(path)
    (path,) = simulate_learned("collapse_plane", [scene], out=tmp_path / "whole", stabilise=STABLE)
    np.testing.assert_array_equal(parts.position, read_trajectory(path).position)
    chosen = read_trajectory(
        run(tmp_path / "choice", "collapse_plane", scene, "choice.frame_interval=0.02", key="solver")
    )
    np.testing.assert_allclose(parts.position, chosen.position, atol=1e-6)
    np.testing.assert_array_equal(parts.mass, chosen.mass)


def test_a_scene_of_another_size_is_run_at_that_of_the_data_or_refused_with_what_to_do() -> None:
    """A learned simulator has one spacing, at which a hillside has more particles than any memory."""
    hillside, ground = read_scene(Path(CONF).parent / "scenes" / "landslide.yaml"), load_solver("ground")
    assert ground.size(hillside)[0] < 10_000
    with pytest.raises(InputError, match=r"1\.2e\+08 particles at the spacing of 0\.0417 m that ground learned, .*mpm"):
        ground.filled(hillside, 0)
