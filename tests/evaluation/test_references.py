"""What a rollout is judged against: other cells tell what the reference leaves open; a split is found where it lies."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gns_pl.errors import InputError
from gns_pl.evaluation import references
from gns_pl.evaluation.checks import with_data
from gns_pl.evaluation.references import reference_of, resolution_spread, stored_references
from gns_pl.generation import generate_dataset
from gns_pl.metrics.summary import Measured
from gns_pl.models.checkpoint import Checkpoint
from tests.conftest import MPM as mpm_settings
from tests.conftest import make_simulator
from tests.evaluation.made_up import SPACING, column, spreading
from tests.evaluation.test_scenes import DATA

MPM = {**mpm_settings, "cell_size": 0.1, "points_per_direction": 2}


def test_other_cells_give_their_largest_change(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def made_up(scene, *, mpm, frame_interval, seed, cache_directory):
        asked.append(mpm["cell_size"])
        share = {0.1: 1.0, 0.15: 0.8, 0.05: 1.1}[round(mpm["cell_size"], 3)]
        return spreading(scene, 20, share=share, dt=frame_interval)

    monkeypatch.setattr(references, "reference_trajectory", made_up)
    checkpoint = Checkpoint(make_simulator(dt=0.02), {**DATA, "mpm": MPM}, {})
    found = reference_of(column(), checkpoint, cache=tmp_path, seed=0, cells=[1.5, 0.5])
    assert asked == pytest.approx([0.1, 0.15, 0.05]) and found.cells == (1.5, 0.5)
    # Lengths of 1 + share: 1.8, 2 and 2.1 times the first.
    assert found.spread["runout_max"] == pytest.approx(0.2 * 0.375 / 0.4, rel=1e-3)
    assert found.spread["mean_height"] == pytest.approx(0.1 * (1 / 1.8 - 1 / 2), rel=0.01)
    assert found.spread["sinkhorn"] * SPACING == pytest.approx(0.2 * 0.4 / 3**0.5, rel=0.1)
    assert "mse_1" not in found.spread
    assert reference_of(column(), checkpoint, cache=tmp_path, seed=0).spread == {}
    with pytest.raises(InputError, match=r"evaluation\.spread: sizes of cells"):
        reference_of(column(), checkpoint, cache=tmp_path, seed=0, cells=[-1])


def test_the_same_run_has_no_spread() -> None:
    values = resolution_spread(Measured(spreading()), [spreading()], SPACING)
    assert max(values.values()) < 1e-6 and resolution_spread(Measured(spreading()), [], SPACING) == {}


def test_a_split_of_the_data_set(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = {
        **DATA,
        "name": "tiny",
        "root": str(tmp_path / "tiny"),
        "seed": 0,
        "frame_interval": 0.01,
        "mpm": MPM,
        "families": {
            "cube_drop": {
                "count": 3, "valid": 1, "test": 1, "duration": 0.05, "domain": [1, 1, 1], "side": [0.3, 0.3],
                "speed": 0.1, "max_drop": 0.1,
            }
        },
    }  # fmt: skip
    checkpoint = Checkpoint(make_simulator(dt=0.02), data, {})
    with pytest.raises(
        InputError,
        match=r"holds no data; say where they are with data.root=FOLDER, or make them: python generate.py data=tiny",
    ):
        stored_references(checkpoint, "test")
    generate_dataset(data, num_workers=1, progress=False)
    [(name, reference)] = stored_references(checkpoint, "test").items()
    assert name.startswith("trajectory_") and reference.spread == {}
    assert reference.trajectory.dt == pytest.approx(0.02) and reference.trajectory.num_frames == 3
    assert np.isfinite(reference.trajectory.position).all()
    with pytest.raises(InputError, match="must be one of train, valid, test, not 'exam'"):
        stored_references(checkpoint, "exam")
    with pytest.raises(InputError, match=r"does not say where its data are; say so with data\.root=FOLDER"):
        stored_references(replace(checkpoint, data=DATA), "test")
    moved = tmp_path / "elsewhere" / "a copy"
    moved.parent.mkdir()
    (tmp_path / "tiny").rename(moved)
    with pytest.raises(InputError, match=r"tiny holds no data; say where they are with data\.root=FOLDER"):
        stored_references(checkpoint, "test")
    [again] = stored_references(with_data(checkpoint, str(moved)), "test", placements=2, seed=1).values()
    np.testing.assert_array_equal(again.trajectory.position, reference.trajectory.position)
    assert again.complete and len(again.starts) == 2
    with pytest.raises(InputError, match=r"nowhere holds no data"):
        with_data(checkpoint, "nowhere")
    capsys.readouterr()
    with_data(replace(checkpoint, provenance={"manifest_sha256": "0"}), str(moved))
    assert "not the data that this checkpoint was trained on" in capsys.readouterr().out


def test_the_stored_points_of_finer_runs_are_said_to_be_that(tmp_path: Path) -> None:
    """A set of every second point lies in a folder of its own, which is found from the set's folder and by itself."""
    data = {
        **DATA, "name": "tiny", "root": str(tmp_path / "tiny"), "seed": 0, "frame_interval": 0.01, "store_every": [2],
        "mpm": MPM, "families": {"cube_drop": {
            "count": 2, "valid": 0, "test": 1, "duration": 0.02, "domain": [1, 1, 1], "side": [0.3, 0.3], "speed": 0.1,
            "max_drop": 0.1,
        }},
    }  # fmt: skip
    generate_dataset(data, num_workers=1, progress=False)
    checkpoint = Checkpoint(make_simulator(dt=0.01, spacing=0.1), data, {})
    for root in ("tiny", "tiny/every_2"):
        [reference] = stored_references(with_data(checkpoint, str(tmp_path / root)), "test").values()
        assert not reference.complete and reference.whole.trajectory is reference.trajectory
        assert reference.trajectory.num_particles == 3**3


def test_a_scene_that_sinks_by_its_own_weight_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(references, "reference_trajectory", lambda scene, **_: spreading(scene, 3))
    checkpoint = Checkpoint(make_simulator(dt=0.02), {**DATA, "mpm": MPM}, {})
    reference_of(column(), checkpoint, cache=tmp_path, seed=0)
    assert "compresses" not in capsys.readouterr().out
    moon = column().replace(gravity=(0, 0, -9810.0))
    reference_of(moon, checkpoint, cache=tmp_path, seed=0)
    assert "weight alone compresses 'sand', 0.2 m high, by 66 % of its height" in capsys.readouterr().out
