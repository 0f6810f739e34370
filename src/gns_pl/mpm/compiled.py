"""The decorator of every compiled function here: numba's `njit`, with a cache that knows all sources of this room.

numba's own cache looks at the file of the function called, not at those of the functions it calls: after an edit of
`constitutive.py` a cached `advance` of `grid.py` would go on with the old law, silently. So the cache lies in a folder
named by a hash over all sources of the room.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba

FASTMATH = {"contract", "reassoc", "arcp", "nsz"}
"""Everything of fastmath that keeps NaN and infinity meaningful: a failed run must be seen to fail."""


def _cache_folder() -> str:
    """Folder of compiled code: in NUMBA_CACHE_DIR if that is set, else in this package's `__pycache__`."""
    here = Path(__file__).parent
    digest = hashlib.sha256()
    for source in sorted(here.glob("*.py")):
        digest.update(source.name.encode() + source.read_bytes())
    parent = Path(numba.config.CACHE_DIR or here / "__pycache__")
    return str(parent / f"mpm-{digest.hexdigest()[:12]}")


_FOLDER = _cache_folder()


def compiled(function: Callable[..., Any]) -> Any:
    """Compile a module-level function with `njit`: cached, without the GIL, NaN kept.

    If the folder of the cache cannot be written, numba falls back on its own places.
    """
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = _FOLDER  # read when the decorator runs, so it can be put back at once
    try:
        return numba.njit(cache=True, nogil=True, fastmath=FASTMATH)(function)
    finally:
        numba.config.CACHE_DIR = before
