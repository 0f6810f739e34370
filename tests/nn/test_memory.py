from __future__ import annotations

import subprocess
import sys

import pytest

PROBE = """
import resource
from gns_pl.nn.memory import keep_freed_memory
kept = keep_freed_memory()
faults = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(3):
    block = bytearray(50_000_000); del block
before = faults()
for _ in range(10):
    block = bytearray(50_000_000); del block
print(kept, faults() - before)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="glibc's allocator")
def test_freed_memory_is_used_again() -> None:
    """Ten blocks of 50 MB would be 120,000 pages of 4 KB, or 240 of 2 MB, if each came from the system."""
    kept, faults = subprocess.run(
        [sys.executable, "-c", PROBE], capture_output=True, text=True, check=True
    ).stdout.split()
    assert kept == "True"
    assert int(faults) < 100
