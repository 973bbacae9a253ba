"""Discs of different radii, and giants: discs so large that the grid, whose cells fit the others, omits them."""

from mpsim.kernels.compiling import inlined

FIELDS = {"giants": "giants"}
"""giants: shape (1,): discs of a larger radius are not in the grid [length]. Radii are a column of `layout.Discs`."""


@inlined
def touching_distance(radius, i, j, parameters):
    """Distance at which the discs in slots i and j touch."""
    if radius is None:
        return parameters.diameter
    return radius[i] + radius[j]


@inlined
def after_binning(giants, discs, low, high, control):
    """Bin the giants of a slice in a cell of their own, beyond the grid."""
    if giants is not None:
        cell = (control.columns + 1) * (control.rows + 2)
        for i in range(low, high):
            if discs.radius[i] > giants[0]:
                discs.cell[i] = cell
