"""Edges that absorb discs: a disc that touches one stays there, at rest, in no cell, and has no further event."""

from typing import Any

from mpsim.kernels.compiling import inlined

EDGES = ("left", "right", "bottom", "top")


def absorbing_of(scene: Any) -> tuple[bool, ...] | None:
    """For each edge (LEFT, ...), whether it absorbs; None for a scene without such edges."""
    return tuple(edge in scene.absorbing for edge in EDGES) if scene.absorbing else None


FIELDS = {"absorbing": absorbing_of, "exits": None}
"""exits: shape (N, 3): 1 for discs that an edge has absorbed, and where [length]."""


@inlined
def is_absent(exits, i):
    """Whether disc i has been absorbed."""
    if exits is None:
        return False
    return exits[i, 0] != 0.0


@inlined
def lets_out(absorbing, side):
    """Whether the wall at `side` absorbs discs."""
    if absorbing is None:
        return False
    return absorbing[side]


@inlined
def leave(exits, disc, i):
    """Disc i, whose stored state is current, is absorbed where it is."""
    if exits is not None:
        exits[i, 0], exits[i, 1], exits[i, 2] = 1.0, disc.position[0], disc.position[1]
        disc.velocity[0], disc.velocity[1] = 0.0, 0.0
