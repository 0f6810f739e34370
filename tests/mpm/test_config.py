from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numba
import pytest

from gns_pl.errors import InputError
from gns_pl.machine import available_cores, code_folder
from gns_pl.mpm import COURANT_LIMIT, MPMConfig, simulate
from gns_pl.mpm.compiled import SUBFOLDER, compiled
from gns_pl.mpm.settings import num_threads_alone
from gns_pl.scene import Body
from tests.mpm.conftest import make_box, make_mpm


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"cell_size": 0.0}, "cell_size"),
        ({"cell_size": "wide"}, "cell_size"),
        ({"courant": float("nan")}, "courant"),
        ({"courant": 0.61}, "allow_large_courant"),
        ({"points_per_direction": 0}, "points_per_direction"),
        ({"points_per_direction": 2.5}, "whole"),
        ({"transfer": "musl"}, "pic, flip, apic, affine_flip"),
        ({"damping_rate": -1.0}, "damping_rate"),
        ({"bulk_viscosity": -1.0}, "bulk_viscosity"),
        ({"jitter": 1.0}, "jitter"),
    ],
)
def test_refuses_in_one_sentence(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said) as refused:
        make_mpm(**changes)
    assert str(refused.value).count("\n") == 0


def test_a_large_courant_number_is_taken_when_asked_for_by_name() -> None:
    assert make_mpm(courant=COURANT_LIMIT).courant == COURANT_LIMIT
    assert make_mpm(courant=1.5, allow_large_courant=True).courant == 1.5


def test_spacing() -> None:
    assert make_mpm().spacing == pytest.approx(1 / 48)


def test_refuses_cells_larger_than_the_box_and_frames_without_length() -> None:
    scene = make_box((1.0, 1.0), Body((0.1, 0.1), (0.2, 0.2), (0.0, 0.0)), duration=0.1)
    with pytest.raises(InputError, match="cell of 2 m"):
        simulate(scene, make_mpm(cell_size=2.0), frame_interval=0.01)
    with pytest.raises(InputError, match="frame_interval"):
        simulate(scene, make_mpm(), frame_interval=0.0)


def test_importing_the_room_does_not_import_numba() -> None:
    code = "import sys, gns_pl.mpm; sys.exit('numba' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def _twice(x: float) -> float:
    return 2 * x


def test_the_cache_is_named_by_the_sources_and_numba_is_left_as_it_was() -> None:
    before = numba.config.CACHE_DIR
    function = compiled(_twice)
    assert before == numba.config.CACHE_DIR
    assert function(2.0) == 4.0
    folder = code_folder(Path(__file__).parent / "__pycache__")
    assert folder is not None and SUBFOLDER.startswith("mpm-")
    assert any((folder / SUBFOLDER).rglob("*_twice*.nbi"))


def test_a_large_run_has_the_threads_that_the_environment_allows(monkeypatch: pytest.MonkeyPatch) -> None:
    mpm = vars(make_mpm(cell_size=1 / 60, points_per_direction=2))
    most = min(available_cores(), int(numba.config.NUMBA_NUM_THREADS))
    box = make_box((1.0, 1.0), Body((0.0, 0.0), (1.0, 0.5), (0.0, 0.0)), duration=0.1)
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    assert num_threads_alone(box, mpm) == most
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    assert num_threads_alone(box, mpm) == 1
    assert num_threads_alone(box, {**mpm, "cell_size": 1 / 12}) == 1


def test_presets_are_the_numbers_of_the_configuration() -> None:
    paper, fast = (MPMConfig.preset(name, cell_size=0.1) for name in ("paper", "fast"))
    assert (paper.cell_size, paper.points_per_direction, paper.courant, paper.precision) == (0.1, 4, 0.3, "float64")
    assert (fast.points_per_direction, fast.courant, fast.precision) == (2, 0.5, "float32")
    assert MPMConfig.preset("fast", cell_size=0.1, courant=0.2).courant == 0.2
    with pytest.raises(InputError, match="unknown key"):
        MPMConfig.preset("fast", cell_size=0.1, courants=0.2)
