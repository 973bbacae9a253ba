"""Giants: the few discs far larger than all others. They are not in the grid, whose cells fit the others.

Worker 0 alone, after the odd columns, tests each giant against the discs in all cells under it. Otherwise one disc of
20 radii among 10,000 would make each cell 400 times as large, with hundreds of neighbours for each disc.
"""

from mpsim.kernels.compiling import inlined, linked
from mpsim.kernels.features.boundary import period_of
from mpsim.kernels.frame.contacts import resolve_far
from mpsim.kernels.machine import nonnegative


@inlined
def cells_under(centre, reach, per_length, cells):
    """First and one past the last cell along an axis that discs of the grid may touch from `centre`."""
    first = int(max((centre - reach) * per_length, -1.0))
    last = int(max((centre + reach) * per_length, -1.0))
    return max(first, 0), min(last, cells - 1) + 1


@linked
def resolve_giants(discs, start, features, parameters, control, tally, frame):
    """Contacts of each giant with the discs of the grid under it, then with the giants after it. Returns how many."""
    columns, rows = control.columns, control.rows
    stride = rows + 2
    zero = discs.x.dtype.type(0)
    width, height = period_of(features.wrap_x, zero), period_of(features.wrap_y, zero)
    first_x, first_y = -1 if width > 0 else 0, -1 if height > 0 else 0  # images: -1, 0 and 1 periods away, or 0 alone
    giants_end = start[(columns + 1) * stride + 1]
    contacts = 0
    for slot in range(start[(columns + 1) * stride], giants_end):
        i = nonnegative(slot)
        for shift_x in range(first_x, 1 - first_x):
            for shift_y in range(first_y, 1 - first_y):
                sx, sy = discs.x.dtype.type(shift_x * width), discs.x.dtype.type(shift_y * height)
                reach = discs.radius[i] + features.giants[0]
                left, right = cells_under(discs.x[i] - sx, reach, parameters.cells_per_x, columns)
                low, high = cells_under(discs.y[i] - sy, reach, parameters.cells_per_y, rows)
                for column in range(left, right):
                    if low < high:
                        cell = column * stride + 1
                        contacts += resolve_far(
                            discs,
                            i,
                            start[cell + low],
                            start[cell + high],
                            sx,
                            sy,
                            features,
                            parameters,
                            control,
                            tally,
                            frame,
                        )
                contacts += resolve_far(
                    discs, i, i + 1, giants_end, sx, sy, features, parameters, control, tally, frame
                )
    return contacts
