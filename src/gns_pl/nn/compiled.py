"""The decorator of compiled passes: numba's `njit`, its cache named by a hash over all sources of the room.

Numba's own cache sees the file of the function called only, not those of the functions that it calls.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from gns_pl.machine import compile_function


def _subfolder() -> str:
    digest = hashlib.sha256()
    for source in ("backward.py", "compiled.py", "lanes.py", "passes.py", "tiles_backward.py"):
        digest.update((Path(__file__).parent / source).read_bytes())
    return f"nn-{digest.hexdigest()[:12]}"


SUBFOLDER = _subfolder()
FASTMATH = {"contract", "reassoc", "arcp", "nsz"}


def compiled(function: Callable[..., Any]) -> Any:
    """Compile a module-level function: cached, without the GIL, NaN kept, put into its callers whole."""
    return compile_function(function, SUBFOLDER, nogil=True, fastmath=FASTMATH, error_model="numpy", forceinline=True)
