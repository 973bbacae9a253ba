"""Arrays that are read in chunks are those that they stand for."""

import numpy as np
import pytest

from mpsim.core import chunks
from mpsim.core.chunks import ChunkedArray, chunks_of

ROWS = np.arange(30.0).reshape(10, 3)


def read(first, last):
    return ROWS[first:last]


@pytest.mark.parametrize("length", [1, 3, 10, 100])
def test_chunks_are_the_array_in_the_order_of_c(monkeypatch, length):
    monkeypatch.setattr(chunks, "CHUNK", length)
    array = ChunkedArray(ROWS.dtype, (10, 3), read)
    assert (np.asarray(array) == ROWS).all()
    found = list(chunks_of(array))
    assert b"".join(chunk.tobytes() for chunk in found) == ROWS.tobytes()
    assert max(len(chunk) for chunk in found) <= length


def test_slices_are_rows():
    assert (ChunkedArray(ROWS.dtype, (10, 3), read)[8:99] == ROWS[8:]).all()


def test_without_rows_there_is_no_chunk():
    assert list(chunks_of(ChunkedArray(ROWS.dtype, (0, 3), read))) == []
