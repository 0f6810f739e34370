"""What a container lacks is made up for: a home, a user's name, characters, a place for compiled code."""

from __future__ import annotations

import getpass
import importlib.util
import io
import os
import pwd
import sys
import tempfile
from pathlib import Path
from types import ModuleType

import pytest

from gns_pl.machine import code_folder, prepare_process, private_folder, provide_home

NAMES = ("HOME", "LOGNAME", "USER", "LNAME", "USERNAME")
WRITTEN = ("WANDB_DATA_DIR", "WANDB_CACHE_DIR", "TRITON_CACHE_DIR", "MPLCONFIGDIR")
SOURCE = """
from gns_pl.machine import compile_function

def twice(x):
    return 2 * x

twice = compile_function(twice, "room", nogil=True)
"""


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder for temporary files of a process of its own, whose environment is put back."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    for name in (*NAMES, *WRITTEN):
        monkeypatch.setenv(name, "")  # so that it is put back at the end
        monkeypatch.delenv(name)
    return folder


def unknown_user(uid: int) -> pwd.struct_passwd:
    raise KeyError(f"getpwuid(): uid not found: {uid}")


def test_without_home_and_name_both_are_provided(temporary: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pwd, "getpwuid", unknown_user)
    with pytest.raises(RuntimeError):
        Path.home()
    provide_home()
    assert Path.home() == temporary / f"gns_pl-{os.getuid()}"
    assert Path.home().stat().st_mode & 0o777 == 0o700
    assert getpass.getuser() == f"uid{os.getuid()}"


def test_an_unwritable_home_keeps_what_may_be_read_in_it(temporary: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", "/proc")
    monkeypatch.setattr(os, "access", lambda path, mode: not str(path).startswith("/proc"))
    monkeypatch.setenv("WANDB_DATA_DIR", "mine")
    provide_home()
    assert os.environ["HOME"] == "/proc" and os.environ["WANDB_DATA_DIR"] == "mine"
    assert os.environ["WANDB_CACHE_DIR"].startswith(str(temporary))


def test_a_usual_home_is_left_alone(temporary: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("USER", "somebody")
    before = dict(os.environ)
    provide_home()
    assert dict(os.environ) == before and not list(temporary.iterdir())


def test_a_folder_that_others_can_write_into_is_not_used(temporary: Path) -> None:
    folder = temporary / f"gns_pl-{os.getuid()}"
    folder.mkdir()
    folder.chmod(0o777)
    assert private_folder() is None
    folder.chmod(0o700)
    assert private_folder() == folder
    folder.rmdir()
    (temporary / "elsewhere").mkdir(mode=0o700)
    folder.symlink_to(temporary / "elsewhere")
    assert private_folder() is None


def load_module(folder: Path) -> ModuleType:
    """Import a module with a compiled function, anew."""
    code_folder.cache_clear()
    spec = importlib.util.spec_from_file_location("module_of_test", folder / "module_of_test.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    code_folder.cache_clear()
    return module


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A package into which nothing compiled can be written, for its place is taken; so is that in the home."""
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    monkeypatch.setattr("numba.config.CACHE_DIR", "")
    folder = tmp_path / "package"
    folder.mkdir()
    (folder / "module_of_test.py").write_text(SOURCE, encoding="utf-8")
    (folder / "__pycache__").touch()
    return folder


def test_compiled_code_is_kept_where_there_is_room(
    temporary: Path, package: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", "/proc/none")
    module = load_module(package)
    assert module.twice(2.5) == 5.0
    [index] = temporary.rglob("*.nbi")
    assert index.is_relative_to(temporary / f"gns_pl-{os.getuid()}" / "room")
    again = load_module(package)
    assert again.twice(2.5) == 5.0 and sum(again.twice.stats.cache_hits.values()) == 1

    index.write_bytes(b"\x80")  # broken off, as after a power cut
    damaged = load_module(package)
    assert damaged.twice(2.5) == 5.0 and sum(damaged.twice.stats.cache_hits.values()) == 0

    home = tmp_path / "home"
    home.mkdir()
    monkeypatch.setenv("HOME", str(home))
    assert load_module(package).twice(2.5) == 5.0
    assert list((home / ".cache" / "gns_pl" / "room").rglob("*.nbi"))

    (package / "__pycache__").unlink()
    assert load_module(package).twice(2.5) == 5.0
    assert list((package / "__pycache__" / "room").rglob("*.nbi"))


def test_without_any_room_it_is_compiled_anew(package: Path, temporary: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", "/proc/none")
    monkeypatch.setattr(tempfile, "tempdir", "/proc/none")
    assert load_module(package).twice(2.5) == 5.0
    assert not list(temporary.rglob("*.nbi"))


def test_a_full_disk_costs_the_cache_alone(package: Path, temporary: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", "/proc/none")
    module = load_module(package)

    def full(*args: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("numba.core.caching.IndexDataCacheFile.save", full)
    assert module.twice(2.5) == 5.0


@pytest.mark.parametrize(
    ("encoding", "printed"),
    [
        ("latin-1", b"S\xe4ule ? 3 \xb0 \xff\n"),
        ("ascii", b"S?ule ? 3 ? \xff\n"),
        ("utf-8", "Säule ≈ 3 °".encode() + b" \xff\n"),
    ],
)
def test_what_a_terminal_cannot_show_does_not_end_a_command(
    encoding: str, printed: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The last character is a byte of a file name that is no text in UTF-8."""
    raw = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(raw, encoding=encoding))
    text = "Säule ≈ 3 ° " + os.fsdecode(b"\xff")
    prepare_process()
    print(text, flush=True)
    assert raw.getvalue() == printed
