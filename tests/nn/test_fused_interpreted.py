"""The tests of the kernels where there is no GPU: Triton has to know from its first import that it interprets."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch


@pytest.mark.skipif(torch.cuda.is_available(), reason="there they run on the GPU")
def test_the_kernels_in_the_interpreter() -> None:
    pytest.importorskip("triton")
    command = [sys.executable, "-m", "pytest", "-p", "no:xdist", "tests/nn/test_fused.py"]
    environment = os.environ | {"TRITON_INTERPRET": "1"}
    for name in [each for each in environment if each.startswith("PYTEST")]:
        del environment[name]
    done = subprocess.run(
        command, cwd=Path(__file__).parents[2], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout
    assert "10 passed" in done.stdout
