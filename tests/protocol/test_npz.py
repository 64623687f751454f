"""Arrays from elsewhere: what numpy writes comes back; bombs, lies and pickles are refused before they take memory."""

from __future__ import annotations

import io
import pickle
import struct
import tracemalloc
import zipfile

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shared.errors import InvalidInputError
from shared.npz import read_npz

LIMIT = 2**20


def npz(**arrays: np.ndarray) -> bytes:
    out = io.BytesIO()
    np.savez(out, **arrays)
    return out.getvalue()


def archive(content: bytes, name: str = "a.npy") -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr(name, content)
    return out.getvalue()


def npy_of(shape: str, data: bytes, descr: str = "<f8") -> bytes:
    header = f"{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}".ljust(117).encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + data


def test_what_numpy_writes_comes_back() -> None:
    arrays = {
        "a": np.arange(6.0).reshape(2, 3), "f": np.asfortranarray(np.arange(6).reshape(2, 3)), "b": np.array(True),
        "s": np.array(["one", "three"]), "e": np.zeros((0, 22, 3), "<f4"),
    }  # fmt: skip
    found = read_npz(npz(**arrays), LIMIT)
    assert found.keys() == arrays.keys()
    for name, array in arrays.items():
        assert found[name].dtype == array.dtype
        np.testing.assert_array_equal(found[name], array)
    found["a"][0, 0] = 7.0


def test_a_bomb_is_refused_before_it_is_unpacked() -> None:
    bomb = archive(npy_of("(8388608,)", bytes(64 * LIMIT)))
    assert len(bomb) < LIMIT // 8
    tracemalloc.start()
    with pytest.raises(InvalidInputError, match="bytes"):
        read_npz(bomb, LIMIT)
    assert tracemalloc.get_traced_memory()[1] < LIMIT
    tracemalloc.stop()


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (npy_of("(1000000000000,)", b"12345678"), "its shape says"),
        (npy_of("(1,)", pickle.dumps([print]), "|O"), "objects"),
        (npy_of("(-1,)", b""), "no arrays"),
        (npy_of("('", b""), "no arrays"),
        (npy_of("(" * 200, b""), "no arrays"),
        (b"\x93NUMPY\x07\x00", "no arrays"),
        (b"", "no arrays"),
    ],
)
def test_lies_and_pickles_are_refused(content: bytes, words: str) -> None:
    with pytest.raises(InvalidInputError, match=words):
        read_npz(archive(content), LIMIT)


@settings(max_examples=200, deadline=None)
@given(st.data())
def test_damaged_bytes_are_arrays_or_an_error_of_ours(data: st.DataObject) -> None:
    damaged = bytearray(npz(a=np.arange(8.0), b=np.arange(3)))
    for place, value in data.draw(
        st.lists(st.tuples(st.integers(0, len(damaged) - 1), st.integers(0, 255)), max_size=4)
    ):
        damaged[place] = value
    cut = data.draw(st.integers(0, len(damaged)))
    for given_bytes in (bytes(damaged), bytes(damaged[:cut])):
        try:
            found = read_npz(given_bytes, LIMIT)
        except InvalidInputError:
            continue
        assert all(isinstance(array, np.ndarray) for array in found.values())
