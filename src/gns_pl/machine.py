"""What the machine is and what it lacks: processor, memory, home folder, terminal, and a place for compiled code.

What libraries take for granted and containers leave out is made up for here. Nothing here knows what the package does.
"""

from __future__ import annotations

import codecs
import contextlib
import functools
import getpass
import io
import os
import platform
import stat
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast

if TYPE_CHECKING:
    from torch import Tensor

F = TypeVar("F", bound=Callable[..., Any])
NEAREST = "gns_pl.nearest"
"""Name of the codec error handler of standard output and standard error."""


@functools.cache
def machine_name() -> str:
    """Return the processor and the number of its cores that this process may use, as "AMD EPYC 7B13, 2 cores"."""
    name = platform.processor() or platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        name = next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        pass  # not Linux, or a processor without a name
    return f"{name}, {available_cores()} cores"


def available_cores() -> int:
    """Return the number of cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def free_memory() -> int:
    """Return the bytes that can still be used; all of the machine's where the system does not say more."""
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        return next(1024 * int(line.split()[1]) for line in lines if line.startswith("MemAvailable"))
    except (OSError, StopIteration, ValueError):
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


def prepare_process() -> None:
    """Make up for what this process lacks; every command begins with it, and nothing changes where nothing is missing.

    A character that the terminal or the log file cannot show is printed as "?", and no home folder is made up for by
    `provide_home`.
    """
    codecs.register_error(NEAREST, _nearest)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=NEAREST)
    provide_home()


def _nearest(error: UnicodeError) -> tuple[str | bytes, int]:
    """Print a byte of a file name that is no text as that byte, and everything else that cannot be encoded as "?"."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    try:
        return error.object[error.start].encode(error.encoding, "surrogateescape"), error.start + 1
    except UnicodeEncodeError:
        return "?", error.start + 1


def provide_home() -> None:
    """Give libraries a home folder and a user's name where the system has none, as in containers with a foreign uid.

    W&B, torch's compiler and matplotlib look for them and end in a traceback without. A home that is there but cannot
    be written keeps what may be read in it (keys, settings); only what libraries write goes elsewhere.
    """
    try:
        getpass.getuser()
    except (KeyError, OSError):  # no such entry in the password file, nor a variable that names the user
        os.environ["LOGNAME"] = f"uid{os.getuid()}"
    home = _home_folder()
    if home is not None and os.access(home, os.W_OK | os.X_OK):
        return
    folder = private_folder()
    if folder is None:
        return
    if home is None:
        os.environ["HOME"] = str(folder)
        return
    for variable in ("WANDB_DATA_DIR", "WANDB_CACHE_DIR", "TRITON_CACHE_DIR", "MPLCONFIGDIR"):
        os.environ.setdefault(variable, str(folder / variable.partition("_")[0].lower()))


def _home_folder() -> Path | None:
    try:
        home = Path.home()
    except RuntimeError:
        return None
    return home if home.is_absolute() else None


def private_folder() -> Path | None:
    """Return a folder for temporary files that nobody but this user can write into; None if there is no such place."""
    try:
        folder = Path(tempfile.gettempdir()) / f"gns_pl-{os.getuid()}"
        folder.mkdir(mode=0o700, exist_ok=True)
        status = folder.lstat()
    except OSError:
        return None
    # The name can be guessed, and code is loaded from here: what another user has put there is left alone.
    mine = stat.S_ISDIR(status.st_mode) and status.st_uid == os.getuid() and not status.st_mode & 0o022
    return folder if mine and is_writable(folder) else None


def is_writable(folder: Path) -> bool:
    """Tell whether files can be made in a folder, which is made if needed."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        return False
    return True


@functools.cache
def code_folder(preferred: Path) -> Path | None:
    """Return the folder in which compiled code is kept between runs; None where no folder can be written.

    Args:
        preferred: the folder where it lies unless NUMBA_CACHE_DIR names another one.
    """
    import numba

    chosen, home = numba.config.CACHE_DIR, _home_folder()
    folders = [Path(chosen)] if chosen else []
    folders += [preferred, *([home / ".cache" / "gns_pl"] if home else [])]
    return next((folder for folder in folders if is_writable(folder)), private_folder())


def compile_function(function: F, subfolder: str = "", **options: Any) -> F:
    """Compile a function with numba's `njit`; what is compiled is kept for later runs where that is possible.

    Numba's own cache ends an import in a traceback where it finds no folder to write into, and a run where the disk is
    full or a file of the cache is damaged. Here such a function is compiled anew in every process.

    Args:
        function: of a module.
        subfolder: of the folder of compiled code, for functions that numba could not tell apart.
        **options: of `njit`.
    """
    import numba

    folder = code_folder(Path(function.__code__.co_filename).parent / "__pycache__")
    before = numba.config.CACHE_DIR
    # Read when the decorator runs, so it can be put back at once.
    numba.config.CACHE_DIR = str(folder / subfolder) if folder is not None else ""
    try:
        compiled: Any = numba.njit(cache=folder is not None, **options)(function)
    finally:
        numba.config.CACHE_DIR = before
    compiled._cache._guard_against_spurious_io_errors = _compile_anew
    return cast(F, compiled)


def compiles(*tensors: Tensor, backward: bool = False) -> bool:
    """Return whether compiled loops take tensors: float32, on the CPU, none of which wants a derivative.

    Neither torch's compiler nor an exported program sees into a loop.

    Args:
        *tensors: that go in.
        backward: there are loops for derivatives, too.
    """
    import torch

    if torch.compiler.is_exporting() or torch.compiler.is_compiling():
        return False
    known = all(tensor.device.type == "cpu" and tensor.dtype == torch.float32 for tensor in tensors)
    return known and (backward or not any(tensor.requires_grad for tensor in tensors))


@contextlib.contextmanager
def _compile_anew() -> Iterator[None]:
    """Let reading and writing compiled code fail: unpickling what is damaged raises whatever it comes upon."""
    with contextlib.suppress(Exception):
        yield
