"""A reference is run once and found again, unless anything that matters has changed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gns_pl.errors import InputError
from gns_pl.generation import reference_trajectory
from gns_pl.mpm import settings as solver
from gns_pl.scene import Scene
from gns_pl.trajectory import Trajectory
from tests.generation.fake import MPM, fake_solver


@pytest.fixture
def runs(monkeypatch: pytest.MonkeyPatch) -> list[Scene]:
    """The scenes that were really run, compiling apart."""
    made: list[Scene] = []

    def counting(scene: Scene, *arguments: Any, **rest: Any) -> Trajectory:
        made.append(scene)
        return fake_solver(scene, *arguments, **rest)

    monkeypatch.setattr(solver, "run_solver", counting)
    monkeypatch.setattr(solver, "compile_solver", lambda *_, **__: None)
    return made


def get(scene: Scene, cache: Path, **changes: Any) -> Trajectory:
    values = {"mpm": MPM, "frame_interval": 0.01, "seed": 0, "cache_directory": cache, "progress": False}
    return reference_trajectory(scene, **(values | changes))


def test_is_run_once(drop: Scene, tmp_path: Path, runs: list[Scene]) -> None:
    first, second = get(drop, tmp_path / "new" / "cache"), get(drop, tmp_path / "new" / "cache")
    assert runs == [drop]
    np.testing.assert_array_equal(first.position, second.position)
    assert first.provenance == second.provenance
    assert first.provenance["wall_seconds"] >= 0  # type: ignore[operator]
    assert first.provenance["solver_version"] == solver.solver_version()
    assert len(list((tmp_path / "new" / "cache").iterdir())) == 1


@pytest.mark.parametrize(
    "changes", [{"seed": 1}, {"frame_interval": 0.02}, {"mpm": {**MPM, "courant": 0.2}}, {"scene": "longer"}, {}]
)
def test_whatever_matters_is_run_again(
    drop: Scene, tmp_path: Path, runs: list[Scene], changes: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    get(drop, tmp_path)
    if not changes:
        monkeypatch.setattr(solver, "solver_version", lambda mpm: "another")
    scene = drop.replace(duration=0.3) if changes.pop("scene", None) else drop
    get(scene, tmp_path, **changes)
    assert len(runs) == 2


def test_the_way_settings_are_written_does_not_matter(drop: Scene, tmp_path: Path, runs: list[Scene]) -> None:
    get(drop, tmp_path)
    get(drop, tmp_path, mpm=dict(reversed(MPM.items())))
    get(drop, tmp_path, mpm=solver.solver_config(MPM))
    assert len(runs) == 1


def test_a_damaged_reference_is_named(drop: Scene, tmp_path: Path, runs: list[Scene]) -> None:
    get(drop, tmp_path)
    (path,) = tmp_path.iterdir()
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(InputError, match=f"{path.name}: is truncated or damaged"):
        get(drop, tmp_path)


def test_a_failed_run_leaves_nothing(drop: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def failing(*_: Any, **__: Any) -> Trajectory:
        raise RuntimeError("no longer finite")

    monkeypatch.setattr(solver, "run_solver", failing)
    with pytest.raises(RuntimeError, match="no longer finite"):
        get(drop, tmp_path)
    assert not list(tmp_path.glob("*.h5"))


def test_settings_are_checked_first(drop: Scene, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="mpm: unknown key x"):
        get(drop, tmp_path / "cache", mpm={**MPM, "x": 1})
    assert not (tmp_path / "cache").exists()


def test_with_the_real_solver(drop: Scene, tmp_path: Path) -> None:
    scene = drop.replace(duration=0.02)
    reference = get(scene, tmp_path)
    assert reference.num_frames == 3
    assert reference.scene == scene
    assert reference.provenance["solver"] == "gns_pl.mpm"
    assert 0 < reference.provenance["wall_seconds"] < 2  # type: ignore[operator]  # compilation is not in it
