"""Discs copied from one place to another: one by one, in runs, or exchanged."""

from mpsim.kernels.compiling import inlined
from mpsim.kernels.machine import RUN, copy_lanes, nonnegative


@inlined
def copy_disc(source, i, target, slot):
    """Copy disc i to a slot of the other buffer."""
    target.x[slot] = source.x[i]
    target.y[slot] = source.y[i]
    target.vx[slot] = source.vx[i]
    target.vy[slot] = source.vy[i]
    target.id[slot] = source.id[i]
    target.cell[slot] = source.cell[i]
    copy_radius(source.radius, i, target.radius, slot)


@inlined
def copy_radius(source, i, target, slot):
    """Copy the radius too, if each disc has its own."""
    if source is not None:
        target[slot] = source[i]


@inlined
def copy_run(source, low, high, target, slot, end):
    """Copy the discs [low, high) to the slots from `slot` on.

    Copies whole vectors, so slots after the run, but none from `end` on, may be overwritten: write those later.
    """
    first, slot = nonnegative(low), nonnegative(slot)
    while first < high and slot + RUN <= end:
        copy_lanes(source.x, first, target.x, slot)
        copy_lanes(source.y, first, target.y, slot)
        copy_lanes(source.vx, first, target.vx, slot)
        copy_lanes(source.vy, first, target.vy, slot)
        copy_lanes(source.id, first, target.id, slot)
        copy_lanes(source.cell, first, target.cell, slot)
        _copy_radii(source.radius, first, target.radius, slot)
        first += RUN
        slot += RUN
    while first < high:
        copy_disc(source, first, target, slot)
        first += 1
        slot += 1


@inlined
def _copy_radii(source, first, target, slot):
    """Copy the radii too, if each disc has its own."""
    if source is not None:
        copy_lanes(source, first, target, slot)


@inlined
def swap_discs(discs, i, j):
    """Exchange two discs of one cell."""
    discs.x[i], discs.x[j] = discs.x[j], discs.x[i]
    discs.y[i], discs.y[j] = discs.y[j], discs.y[i]
    discs.vx[i], discs.vx[j] = discs.vx[j], discs.vx[i]
    discs.vy[i], discs.vy[j] = discs.vy[j], discs.vy[i]
    discs.id[i], discs.id[j] = discs.id[j], discs.id[i]
    _swap_radii(discs.radius, i, j)


@inlined
def _swap_radii(radius, i, j):
    """Exchange the radii of two discs, if each has its own."""
    if radius is not None:
        radius[i], radius[j] = radius[j], radius[i]
