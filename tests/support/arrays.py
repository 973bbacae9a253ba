"""Arrays for calling kernels one by one, without processes and shared memory."""

import numpy as np

from mpsim.kernels import layout


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


def parameters_of(real, width, height, radius=0.5, dt=0.01, columns=1, rows=1) -> np.ndarray:
    """The parameter array of a box."""
    values = np.zeros(layout.PARAMETERS, real)
    values[[layout.DT, layout.DIAMETER]] = dt, 2 * radius
    values[[layout.X_LOW, layout.X_HIGH, layout.Y_LOW, layout.Y_HIGH]] = radius, width - radius, radius, height - radius
    values[[layout.EXCHANGE, layout.WALL_RESTITUTION, layout.TALLY_SCALE]] = 1, 1, 2.0**20
    values[layout.FAST] = np.inf
    values[[layout.CELLS_PER_X, layout.CELLS_PER_Y]] = columns / width, rows / height
    return values


def control_of(count, columns=1, rows=1, workers=1, law=layout.ELASTIC) -> np.ndarray:
    """The control words of so many discs in a grid."""
    control = np.zeros(layout.CONTROL, np.int64)
    for index, value in (
        (layout.COUNT, count),
        (layout.COLUMNS, columns),
        (layout.ROWS, rows),
        (layout.WORKERS, workers),
        (layout.LAW, law),
        (layout.SUBSTEPS, 1),
        (layout.PASSES, 1),
        (layout.CONTACT, layout.PUSH),
        (layout.GUARDED, 1),
        (layout.CELLS, (columns + 1) * (rows + 2)),
    ):
        control[index] = value
    return control


def team_of(workers) -> np.ndarray:
    """One row of words per worker."""
    team = np.zeros((workers, layout.TEAM), np.int64)
    team[:, layout.BAD_SLOT] = -1
    return team
