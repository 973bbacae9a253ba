"""The even and the odd pass over the columns of a worker.

An odd column c only requires that columns c - 1 and c + 1 have had the even pass; it need not wait for all others. So a
worker takes a few of its columns at a time through the end of the sort and both passes, while their discs are in the
cache. Only the columns next to those of a neighbour remain: an even last one, and the odd ones beside a column that a
neighbour's even pass changes. They have their passes after barriers (`stepping.py`).
"""

from mpsim.kernels.compiling import linked
from mpsim.kernels.frame.contacts import resolve_columns
from mpsim.kernels.frame.incremental_sort import first_cursor, merge_up_to
from mpsim.kernels.frame.phases import add_time, set_phase
from mpsim.kernels.layout import EVEN, ODD, SORT

AT_ONCE = 4096
"""Discs of the columns that are taken through sort and passes together: some 200 kB of both buffers in float32."""


@linked
def resolve_inside(
    front, back, start, changes, slot, end, merging, features, parameters, control, team, tally, times, worker, moment
):
    """The part of both passes within own columns, and before it the merge, if the sort has left one to do.

    slot, end: the slice of the worker in `back`. Returns the columns where the passes continue, and the time.
    """
    mine = team[worker]
    first, last = mine.first_column, mine.last_column
    even = first + first % 2
    odd = even + 1
    cursor = first_cursor(team, worker, control, slot)
    width = max(2, AT_ONCE * (last - first) // max(end - slot, 1))
    rest = features, parameters, control, mine, tally, times
    # At least once, for a last worker without columns, which has the discs outside the grid.
    for column in range(first + width, max(last, first + 1) + width, width):
        stop = min(column, last)
        if merging:
            set_phase(mine, SORT)
            cursor = merge_up_to(stop, cursor, front, back, start, changes, team, worker, control, end)
            moment = add_time(times, mine, SORT, moment)
        if control.race_free == 1:
            moment = resolve_columns(EVEN, even, stop - 1, 2, back, start, *rest, moment)
            even += 2 * max(0, (stop - even) // 2)  # the first that is left
            moment = resolve_columns(ODD, odd, even - 1, 2, back, start, *rest, moment)
            odd += 2 * max(0, (even - odd) // 2)
    return even, odd, moment
