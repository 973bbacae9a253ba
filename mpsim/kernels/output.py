"""Discs as bytes of a picture, and columns as rows of text."""

import numpy as np

from mpsim.kernels.compiling import compiled

# --- Rows of a text table, from the texts of its columns

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


# --- Turns discs in memory order into the bytes of a picture, ordered by disc number, in one pass


@compiled
def paint_places(x, y, number, width, height, wraps_x, wraps_y, steps, out):
    """Places as fractions of the box, rounded to so many steps; a place beyond a wall is put on it.

    x, y: shape (N,) [length]. number: int32, shape (N,), the number of each disc. width, height: of the box [length].
    wraps_x, wraps_y: whether an axis is periodic; a disc may be up to a period beyond its border. steps: at most 65535.
    out: uint16, shape (2 N,): x and y of each disc, in the order of their numbers.
    """
    last = np.float64(steps)
    per_x, per_y = last / width, last / height
    for i in range(number.size):
        here_x, here_y = np.float64(x[i]), np.float64(y[i])
        if wraps_x:
            here_x += width if here_x < 0.0 else (-width if here_x >= width else 0.0)
        if wraps_y:
            here_y += height if here_y < 0.0 else (-height if here_y >= height else 0.0)
        to_x, to_y = here_x * per_x + 0.5, here_y * per_y + 0.5
        to_x = (to_x if to_x < last else last) if to_x > 0.0 else 0.0  # 0 if it is not a number
        to_y = (to_y if to_y < last else last) if to_y > 0.0 else 0.0
        at = np.intp(2) * np.intp(number[i])
        out[at], out[at + 1] = np.uint16(to_x), np.uint16(to_y)


@compiled
def paint_speeds(vx, vy, number, usual, knee, steep, fastest, out):
    """Speeds as bytes, rounded, on a scale of two linear parts: from 0 to `knee`, then with slope `steep` to `fastest`.

    vx, vy: shape (N,) [length/time]. number: as above. usual: the speed of byte knee [length/time]. steep: bytes for
    each further `usual`, at most knee. fastest: the last byte, also for speeds that are greater or not a number.
    out: uint8, shape (N,), in the order of the numbers.
    """
    per, last = 1.0 / usual, np.float64(fastest)
    shift = np.float64(knee) - steep
    for i in range(number.size):
        here_x, here_y = np.float64(vx[i]) * per, np.float64(vy[i]) * per
        speed = np.sqrt(here_x * here_x + here_y * here_y)
        lower, upper = speed * knee, speed * steep + shift
        colour = (lower if lower < upper else upper) + 0.5  # the lower part is the steeper one
        out[number[i]] = np.uint8(colour if colour < last else last)
