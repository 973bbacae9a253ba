"""Arrays for calling kernels one by one, without processes and shared memory."""

import numpy as np

from mpsim.kernels import layout, records
from mpsim.kernels.frame.incremental_sort import BUCKET
from mpsim.kernels.frame.sharing import FEW


def discs_of(real, x, y, vx=None, vy=None, ids=None, radius=None) -> layout.Discs:
    """A buffer that holds the given discs, padded with values that would do harm if they were used."""
    count = len(x)
    zeros = np.zeros(count)
    values = [x, y, zeros if vx is None else vx, zeros if vy is None else vy]
    padding = np.full(layout.PADDING, np.nan)
    fields = [np.concatenate([np.asarray(value, float), padding]).astype(real) for value in values]
    numbers = np.concatenate([np.arange(count) if ids is None else ids, np.full(layout.PADDING, -1)])
    cells = np.full(count + layout.PADDING, -1, np.int32)
    radii = None if radius is None else np.concatenate([radius, padding]).astype(real)
    return layout.Discs(*fields, numbers.astype(np.int32), cells, radii)


def parameters_of(real, width, height, radius=0.5, dt=0.01, columns=1, rows=1):
    """The record `parameters` of a box."""
    values = np.zeros(1, records.parameters_in(real))[0]
    values.dt, values.diameter = dt, 2 * radius
    values.limit[:] = radius, width - radius, radius, height - radius
    values.half_one_plus_e, values.wall_restitution, values.tally_scale = 1, 1, 2.0**20
    values.fast = np.inf
    values.cells_per_x, values.cells_per_y = columns / width, rows / height
    return values


def control_of(count, columns=1, rows=1, workers=1, law=layout.ELASTIC):
    """The record `control` of so many discs in a grid."""
    control = np.zeros(1, records.CONTROL)[0]
    control.count, control.columns, control.rows = count, columns, rows
    control.cells = (columns + 1) * (rows + 2)
    control.workers = control.members = workers
    control.law, control.contact = law, layout.PUSH
    control.substeps, control.passes, control.race_free = 1, 1, 1
    return control


def changes_of(count, cells, workers=1) -> layout.Changes:
    """The lists of discs that change cells, filled with what would do harm if it were used."""
    length = {"first_arrival": cells // BUCKET + workers + 1, "outbox": count + layout.PADDING}
    sizes = (length.get(name, count // FEW + 1) for name in layout.Changes._fields)
    return layout.Changes(*(np.full(size, 10**9, np.int32) for size in sizes))


def team_of(workers) -> np.ndarray:
    """One record per worker."""
    team = np.zeros(workers, records.MEMBER)
    team["bad_slot"] = -1
    return team
