"""Rows of a text table."""

import numpy as np
import pytest

from mpsim.kernels.text_rows import join_rows


def joined(columns, rows, steps):
    """The rows, by the kernel, of columns whose entries are given."""
    texts = [b"".join(entry + b"," for entry in column) for column in columns]
    at = np.array([sum(map(len, texts[:index])) for index in range(len(texts))], np.int64)
    out = np.full(200, ord("?"), np.uint8)
    end = join_rows(np.frombuffer(b"".join(texts), np.uint8), at, np.array(steps), rows, out)
    assert bytes(out[end:]) == b"?" * (200 - end), "it wrote beyond its end"
    return bytes(out[:end])


@pytest.mark.parametrize("rows", [1, 2, 3])
def test_entries_are_joined_row_by_row(rows):
    columns = [[b"X"], [b"1.5", b"-0.0", b"1e-7"], [b"", b"7", b"77"]]
    found = joined(columns, rows, [False, True, True])
    assert found == b"".join(b"X %b %b\n" % each for each in list(zip(columns[1], columns[2], strict=True))[:rows])


def test_a_column_that_does_not_step_is_the_same_in_each_row():
    assert joined([[b"a", b"b"]], 2, [False]) == b"a\na\n"
    assert joined([[b"a", b"b"]], 2, [True]) == b"a\nb\n"
