"""The decorator of this room's kernels: numba's `njit`, its cache named by a hash over all sources of the room."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from gns_pl.machine import compile_function


def _subfolder() -> str:
    digest = hashlib.sha256()
    for source in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(source.name.encode() + source.read_bytes())
    return f"shallow-{digest.hexdigest()[:12]}"


SUBFOLDER = _subfolder()


def compiled(function: Callable[..., Any]) -> Any:
    """Compile a module-level function: cached, without the GIL, in strict IEEE arithmetic.

    Numba's own cache sees the file of the function called only, not those of the functions that it calls.
    """
    return compile_function(function, SUBFOLDER, nogil=True)
