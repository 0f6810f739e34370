"""Files made to harm: they run nothing, claim nothing, and are told in one sentence."""

from __future__ import annotations

import io
import os
import pickle
import struct
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from gns_pl.convert.formats import open_set
from gns_pl.convert.formats.pickled import read_pickle
from gns_pl.errors import InputError
from tests.convert.formats import fixtures
from tests.convert.formats.fixtures import falling
from tests.convert.formats.test_readers import everything


class Calls:
    """Pickles as a call of anything."""

    def __init__(self, function: Any, *arguments: Any) -> None:
        self.call = (function, arguments)

    def __reduce__(self) -> Any:
        return self.call


def test_pickled_arrays_are_refused_with_the_reason(tmp_path: Path) -> None:
    fixtures.write_geoelements(tmp_path, {"train": [falling()]})
    with pytest.raises(InputError, match=r"train\.npz: holds pickled Python objects.*run whatever code.*trust=true"):
        open_set(tmp_path)


HOSTILE: dict[str, Any] = {
    "a command": Calls(os.system, "touch hacked"),
    "an evaluation": Calls(eval, "open('hacked', 'w')"),
    "a file": Calls(open, "hacked", "w"),
    "a memory map": Calls(np.memmap, "hacked", "f4", "w+", 0, (4,)),
    "a load": Calls(np.load, "hacked.npy"),
    "a getter": Calls(getattr, "x", "upper"),
}


@pytest.mark.parametrize("what", HOSTILE)
@pytest.mark.parametrize("protocol", [0, 2, 4, 5])
def test_a_hostile_file_runs_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, what: str, protocol: int) -> None:
    monkeypatch.chdir(tmp_path)
    row = fixtures.objects(falling(), HOSTILE[what])
    fixtures.write_zip(tmp_path / "train.npz", {"a": fixtures.pickled_npy(row, row.shape, protocol)})
    with pytest.raises(InputError, match="which is not NumPy's way to rebuild an array; it was not run"):
        everything(open_set(tmp_path / "train.npz", trust=True))
    assert [path.name for path in tmp_path.iterdir()] == ["train.npz"]


TYPE_STATE = b"(K\x03U\x01<NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb"


def array_pickle(shape: tuple[Any, ...], kind: bytes, content: bytes, state: bytes = TYPE_STATE) -> bytes:
    """An array's pickle by hand, whose shape, type and bytes need not fit."""
    lengths = b"".join(b"\x8a\x08" + struct.pack("<q", length) for length in shape)
    rebuilt = b"\x80\x02cnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\x00\x85C\x01b\x87R"
    dtype = b"cnumpy\ndtype\nX" + struct.pack("<I", len(kind)) + kind + b"K\x00K\x01\x87R" + state
    values = b"B" + struct.pack("<I", len(content)) + content
    return rebuilt + b"(K\x01(" + lengths + b"t" + dtype + b"\x89" + values + b"tb."


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (array_pickle((10**12, 3), b"f4", bytes(12)), "bytes do not fit its shape"),
        (array_pickle((-1,), b"f4", bytes(12)), "shape is not a tuple of whole numbers"),
        (array_pickle((1,), b"O8", bytes(8)), "items do not fit its shape"),
        (array_pickle((1,), b"V8", bytes(8)), "only plain numbers"),
        (array_pickle((1,), b"f4", bytes(4), TYPE_STATE.replace(b"<N", b"<(t")), "structured"),
        (b"\x80\x04r\xff\xff\xff\xff.", "truncated or damaged"),  # a memo slot of number 2³² − 1
        (b"\x80\x04\x8e" + struct.pack("<Q", 2**62) + b"x.", "truncated or damaged"),  # 4 EiB of bytes
        (b"\x80\x02\x82\x01.", "registered extension"),
        (b"\x80\x02U\x01xQ.", "truncated or damaged"),  # a persistent object
        (b"", "truncated or damaged"),
    ],
)  # fmt: skip
def test_pickles_that_lie(content: bytes, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        read_pickle(io.BytesIO(content))


def test_the_pickle_by_hand_is_one() -> None:
    """Else the lies above would be found for another reason."""
    honest = array_pickle((1, 3), b"f4", np.arange(3, dtype="<f4").tobytes())
    np.testing.assert_array_equal(pickle.loads(honest, encoding="latin1"), [[0, 1, 2]])
    np.testing.assert_array_equal(read_pickle(io.BytesIO(honest)).values, [[0, 1, 2]])


def test_lists_in_lists_without_end(tmp_path: Path) -> None:
    nested: Any = []
    for _ in range(60):
        nested = [nested, nested]  # 2⁶⁰ items when followed
    row = fixtures.objects(falling(), nested)
    fixtures.write_zip(tmp_path / "train.npz", {"a": fixtures.pickled_npy(row, row.shape)})
    with pytest.raises(InputError, match="nests arrays too deeply"):
        everything(open_set(tmp_path / "train.npz", trust=True))


def test_headers_that_claim_a_million_million_particles(tmp_path: Path) -> None:
    few = falling()
    claims = (6, 10**12, 3)
    (tmp_path / "a.npy").write_bytes(fixtures.npy_bytes(few, shape=claims))
    fixtures.write_zip(tmp_path / "b.npz", {"position": fixtures.npy_bytes(few, shape=claims)})
    with h5py.File(tmp_path / "c.h5", "w") as file:
        file.create_dataset("00000/position", claims, dtype="f4", chunks=(1, 1000, 3))
        file["00000/particle_type"] = 0
    with h5py.File(tmp_path / "d.h5", "w") as file:
        file.create_dataset("00000/position", claims, dtype="f4", chunks=(1, 10**6, 3), compression="gzip")
        file["00000/particle_type"] = 0
    (tmp_path / "e.tfrecord").write_bytes(struct.pack("<Q", 10**12) + fixtures.record(b"")[8:12])
    (tmp_path / "f.vtp").write_bytes(fixtures.vtp(few[0]).replace(b'"64"', b'"1000000000000"'))
    for path in sorted(tmp_path.iterdir()):
        with pytest.raises(InputError, match=r"claims|numbers for 1000000000000 points|wrong sum") as caught:
            everything(open_set(path))
        assert path.name in str(caught.value) and "\n" not in str(caught.value)


def test_a_record_that_claims_more_than_the_file_has(tmp_path: Path) -> None:
    length = struct.pack("<Q", 10**12)
    head = length + struct.pack("<I", _mask(fixtures.slow_crc32c(length)))
    (tmp_path / "train.tfrecord").write_bytes(head + bytes(100))
    with pytest.raises(InputError, match="is cut off: record 0 claims 1,000,000,000,000 bytes"):
        open_set(tmp_path)


def _mask(value: int) -> int:
    return ((value >> 15 | value << 17) + 0xA282EAD8) % 2**32


def test_a_changed_byte_of_a_record_is_found(tmp_path: Path) -> None:
    fixtures.write_tfrecord(tmp_path / "train.tfrecord", [falling(2)], np.full(64, 6))
    content = bytearray((tmp_path / "train.tfrecord").read_bytes())
    content[500] ^= 1
    (tmp_path / "train.tfrecord").write_bytes(content)
    with pytest.raises(InputError, match="wrong checksum"):
        everything(open_set(tmp_path))


def test_links_out_of_an_hdf5_file_are_not_followed(tmp_path: Path) -> None:
    secret = tmp_path / "secret"
    secret.write_bytes(bytes(1000))
    with h5py.File(tmp_path / "train.h5", "w") as file:
        group = file.create_group("00000")
        group.create_dataset("position", (2, 10, 3), "f4", external=[(str(secret), 0, 240)])
        group["particle_type"] = 0
    with pytest.raises(InputError, match="stored in another file, which is not followed"):
        everything(open_set(tmp_path / "train.h5"))
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["position"] = np.zeros((2, 10, 3), dtype="f4")
    with h5py.File(tmp_path / "valid.h5", "w") as file:
        file["00000/particle_type"] = 0
        file["00000/position"] = h5py.ExternalLink("other.h5", "/position")
    with pytest.raises(InputError, match="link into another place"):
        everything(open_set(tmp_path / "valid.h5"))


def test_entities_and_paths_in_xml_are_refused(tmp_path: Path) -> None:
    bomb = b'<?xml version="1.0"?><!DOCTYPE x [<!ENTITY a "aaaa">]><VTKFile>&a;</VTKFile>'
    (tmp_path / "run_0.vtp").write_bytes(bomb)
    with pytest.raises(InputError, match="defines entities"):
        everything(open_set(tmp_path))
    (tmp_path / "run.pvd").write_text(
        '<VTKFile><Collection><DataSet timestep="0" file="../a.vtp"/></Collection></VTKFile>'
    )
    with pytest.raises(InputError, match="not a file beside or below it"):
        open_set(tmp_path)


def test_a_zip_that_claims_to_unpack_to_everything(tmp_path: Path) -> None:
    fixtures.write_zip(tmp_path / "a.npz", {"position": fixtures.npy_bytes(falling())})
    content = bytearray((tmp_path / "a.npz").read_bytes())
    central = content.rindex(b"PK\x01\x02")
    content[central + 24 : central + 28] = struct.pack("<I", 2**32 - 2)  # its uncompressed size
    (tmp_path / "a.npz").write_bytes(content)
    with pytest.raises(InputError, match=r"claims 4,294,967,294 bytes"):
        everything(open_set(tmp_path / "a.npz"))
