"""Edges that absorb discs. An absorbed disc keeps its number, stays at rest where it left, and meets no disc."""

from mpsim.kernels.compiling import inlined, linked, value_or
from mpsim.kernels.features.acceleration import accelerations_of
from mpsim.kernels.records import BOTTOM, IMPACT, LEFT, RIGHT, TOP

FIELDS = {"exits": "exits"}
"""exits: shape (3, capacity), by id: 1 for discs that an edge has absorbed, and where [length]."""


@inlined
def is_absent(exits, disc):
    """Whether a disc has left, by its id."""
    if exits is None:
        return False
    return exits[0, disc] != 0


@inlined
def lets_out(exits, control, edge):
    """Whether an edge (LEFT, ...) absorbs discs."""
    if exits is None:
        return False
    return control.absorbing[edge] != 0


@linked
def absorb(discs, low, high, exits, features, parameters, control):
    """Absorb the discs of a slice that this step would bring to an absorbing edge."""
    edges, dt = control.absorbing, parameters.dt
    zero, two = discs.x.dtype.type(0), discs.x.dtype.type(2)
    # Under impact a flight follows its parabola, whose mean velocity is v + a dt / 2; under push it is v + a dt.
    late = dt / two if control.contact == IMPACT else zero
    for i in range(low, high):
        disc = discs.id[i]
        margin = value_or(discs.radius, i, zero)
        ax, ay = accelerations_of(discs, i, features)
        x = discs.x[i] + (discs.vx[i] + ax * (dt - late)) * dt
        y = discs.y[i] + (discs.vy[i] + ay * (dt - late)) * dt
        left = edges[LEFT] != 0 and x < parameters.limit[LEFT] + margin
        right = edges[RIGHT] != 0 and x > parameters.limit[RIGHT] - margin
        bottom = edges[BOTTOM] != 0 and y < parameters.limit[BOTTOM] + margin
        top = edges[TOP] != 0 and y > parameters.limit[TOP] - margin
        if (left or right or bottom or top) and exits[0, disc] == 0:
            exits[0, disc], exits[1, disc], exits[2, disc] = 1, discs.x[i], discs.y[i]


@linked
def put_back_absorbed(discs, low, high, exits):
    """Undo what a step has done to the absorbed discs of a slice."""
    zero = discs.x.dtype.type(0)
    for i in range(low, high):
        disc = discs.id[i]
        if exits[0, disc] != 0:
            discs.x[i], discs.y[i] = exits[1, disc], exits[2, disc]
            discs.vx[i], discs.vy[i] = zero, zero


@inlined
def before_move(exits, discs, low, high, features, parameters, control):
    """`absorb`, if there are such edges; absorbed discs stand still while the others move."""
    if exits is not None:
        absorb(discs, low, high, exits, features, parameters, control)


@inlined
def after_flight(exits, discs, low, high):
    """`put_back_absorbed`, if there are such edges."""
    if exits is not None:
        put_back_absorbed(discs, low, high, exits)


@inlined
def after_binning(exits, discs, low, high, control):
    """Bin the absorbed discs of a slice in a cell beyond the grid, where no neighbours are looked for."""
    if exits is not None:
        cell = (control.columns + 1) * (control.rows + 2) + 1
        for i in range(low, high):
            if exits[0, discs.id[i]] != 0:
                discs.cell[i] = cell
