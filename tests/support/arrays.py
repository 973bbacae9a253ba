"""Arrays for calling kernels one by one, without processes and shared memory."""

import numpy as np

from mpsim.kernels import records


def parameters_of(real, width, height, radius=0.5, dt=0.01, columns=1, rows=1):
    """The record `parameters` of a box."""
    values = np.zeros(1, records.parameters_in(real))[0]
    values.dt, values.diameter = dt, 2 * radius
    values.limit[:] = radius, width - radius, radius, height - radius
    values.half_one_plus_e, values.wall_restitution, values.tally_scale = 1, 1, 2.0**20
    values.fast = np.inf
    values.cells_per_x, values.cells_per_y = columns / width, rows / height
    return values


def control_of(count, columns=1, rows=1, workers=1, law=records.ELASTIC):
    """The record `control` of so many discs in a grid."""
    control = np.zeros(1, records.CONTROL)[0]
    control.count, control.columns, control.rows = count, columns, rows
    control.cells = (columns + 1) * (rows + 2)
    control.workers = control.members = workers
    control.law, control.contact = law, records.PUSH
    control.substeps, control.passes, control.race_free = 1, 1, 1
    return control


def team_of(workers) -> np.ndarray:
    """One record per worker."""
    team = np.zeros(workers, records.MEMBER)
    team["bad_slot"] = -1
    return team
