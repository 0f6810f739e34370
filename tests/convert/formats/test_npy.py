"""NumPy's files as NumPy writes them, and what cuts them short or claims too much."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from gns_pl.convert.formats.npy import MAGIC, map_numbers, members, open_member, read_array_header, read_numbers
from gns_pl.errors import InputError
from tests.convert.formats import fixtures

DTYPES = st.sampled_from(["<f4", "<f8", ">f4", "<i8", "|u1", "|b1"])


def saved(array: np.ndarray, version: tuple[int, int] | None = None) -> bytes:
    stream = io.BytesIO()
    np.lib.format.write_array(stream, array, version=version)
    return stream.getvalue()


def read(content: bytes) -> np.ndarray:
    stream = io.BytesIO(content)
    header = read_array_header(stream)
    return read_numbers(stream, header, len(content) - stream.tell(), "it")


@settings(max_examples=60, deadline=None)
@given(DTYPES.flatmap(lambda dtype: arrays.arrays(dtype, arrays.array_shapes(min_dims=0, min_side=0, max_side=4))))
def test_every_array_comes_back(array: np.ndarray) -> None:
    for version, order in (((1, 0), "C"), ((2, 0), "F"), ((3, 0), "C")):
        again = read(saved(np.asarray(array, order=order), version))
        assert again.dtype == array.dtype
        np.testing.assert_array_equal(again, array)


@pytest.mark.parametrize("order", ["C", "F"])
def test_a_file_stays_on_the_disk(tmp_path: Path, order: str) -> None:
    array = np.arange(24, dtype=np.float32).reshape(2, 3, 4)
    np.save(tmp_path / "a.npy", np.asarray(array, order=order))
    mapped = map_numbers(tmp_path / "a.npy")
    assert isinstance(mapped, np.memmap)
    np.testing.assert_array_equal(mapped, array)


def test_members_of_an_archive_are_read_one_by_one(tmp_path: Path) -> None:
    some = {"position": np.ones((3, 2)), "type": np.arange(5)}
    np.savez_compressed(tmp_path / "a.npz", **some)
    assert members(tmp_path / "a.npz") == {"position": "position.npy", "type": "type.npy"}
    with zipfile.ZipFile(tmp_path / "a.npz") as archive:
        for name, array in some.items():
            with open_member(archive, f"{name}.npy") as (stream, header, left):
                assert header.shape == array.shape and header.num_bytes == left
                np.testing.assert_array_equal(read_numbers(stream, header, left, name), array)


def test_wherever_a_file_is_cut_it_is_said() -> None:
    content = saved(np.arange(6, dtype=np.float64))
    for length in range(len(content)):
        with pytest.raises(InputError):
            read(content[:length])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"PK\x03\x04 and more", "is not an array in NumPy's format"),
        (MAGIC + b"\x07\x00" + bytes(60), "is in version 7 of NumPy's format"),
        (MAGIC + b"\x02\x00\xff\xff\xff\x7f" + bytes(60), "it is damaged or made to harm"),
        (MAGIC + b"\x01\x00\x04\x00{1:2", "has a damaged header"),
        (MAGIC + b"\x01\x00\x0a\x00__import__", "has a damaged header"),
    ],
)
def test_a_damaged_header_is_told(content: bytes, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_array_header(io.BytesIO(content))


def test_more_than_is_stored_is_not_made_room_for(tmp_path: Path) -> None:
    """Ten numbers that call themselves a million million."""
    content = fixtures.npy_bytes(np.zeros(10), shape=(10**12,))
    with pytest.raises(InputError, match="8,000,000,000,000 bytes"):
        read(content)
    (tmp_path / "a.npy").write_bytes(content)
    with pytest.raises(InputError, match="8,000,000,000,000 bytes"):
        map_numbers(tmp_path / "a.npy")


def test_objects_are_never_opened(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.array([{"a": 1}], dtype=object))
    with pytest.raises(InputError, match="pickled Python objects"):
        map_numbers(tmp_path / "a.npy")
    with pytest.raises(InputError, match="it holds Python objects"):
        read((tmp_path / "a.npy").read_bytes())


def test_an_empty_file_of_numbers_is_told(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.zeros((0, 3)))
    with pytest.raises(InputError, match="is empty"):
        map_numbers(tmp_path / "a.npy")
