"""Rows of a text table, from the texts of its columns."""

import numpy as np

from mpsim.kernels.compiling import compiled

COMMA, SPACE, NEWLINE = ord(","), ord(" "), ord("\n")


@compiled
def join_rows(text, at, steps, rows, out):
    """Join the entries of all columns into rows, separated by spaces. Returns the length of the text written.

    text: uint8, the texts of the columns, a comma after each entry. at: int64, shape (C,), where the first entry of
    each column begins; advanced here. steps: bool, shape (C,): False for a column that has one entry for all rows.
    out: uint8, with room for all rows.
    """
    end = 0
    for _ in range(rows):
        for column in range(at.size):
            begin = np.uintp(at[column])
            length = np.uintp(0)
            while text[begin + length] != COMMA:
                out[np.uintp(end) + length] = text[begin + length]
                length += np.uintp(1)
            end += np.int64(length) + 1
            out[end - 1] = SPACE
            if steps[column]:
                at[column] = begin + length + np.uintp(1)
        out[end - 1] = NEWLINE
    return end
