"""What `import gns_pl` offers, and what it costs."""

import subprocess
import sys

import gns_pl
from gns_pl.scene import Scene
from tests.conftest import make_start


def test_every_public_name_is_there() -> None:
    for name, module in gns_pl.PUBLIC.items():
        assert getattr(gns_pl, name).__name__ == (module.partition(":")[2] or name) and name in dir(gns_pl)
    assert not hasattr(gns_pl, "load_everything")


def test_importing_it_imports_nothing_heavy() -> None:
    code = "import sys, gns_pl; print(*({'torch', 'numpy', 'numba', 'h5py', 'lightning'} & set(sys.modules)))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == ""


def test_a_trajectory_prints_itself_in_two_lines(drop: Scene) -> None:
    start = make_start(drop)
    text = repr(start)
    assert text.count("\n") == 1 and f"1 frames of {start.num_particles} particles in 3 dimensions" in text
    assert "'cube_drop'" in text and f"position [1, {start.num_particles}, 3] m, mass 48.6 kg" in text
