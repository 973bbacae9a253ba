"""A wall of the box that moves at constant speed until it stops."""

from mpsim.kernels.compiling import compiled, inlined
from mpsim.kernels.layout import (
    DT,
    PISTON_NOW,
    PISTON_SPEED,
    PISTON_START,
    PISTON_STOP,
    PISTON_WALL,
    STEPS,
)


@inlined
def advance_piston(piston, parameters, control):
    """Put the wall where it will be at the end of the next step, which the motion of that step will meet.

    Called by one worker between the motion and the contacts of a step, when nobody else looks at the walls. Its place
    follows from the number of steps done, not from its last place: no rounding adds up, and a resumed run agrees.
    """
    if piston is not None:
        way = piston[PISTON_SPEED] * parameters[DT]
        place = piston[PISTON_START] + way * (control[STEPS] + 1)
        arrived = place < piston[PISTON_STOP] if piston[PISTON_SPEED] < 0 else place > piston[PISTON_STOP]
        parameters[int(piston[PISTON_WALL])] = piston[PISTON_STOP] if arrived else place
        piston[PISTON_NOW] = piston[PISTON_SPEED] * 0 if arrived else piston[PISTON_SPEED]


@compiled
def place_wall(piston, parameters, control):
    """`advance_piston` for callers in Python."""
    advance_piston(piston, parameters, control)


def place_piston(arrays):
    """Put the wall where the next step will meet it, after the parameters were written anew."""
    place_wall(arrays["piston"], arrays["parameters"], arrays["control"])
