"""The features of the stepped solvers, which of them a scene has, and at which points of a step they act.

A new feature is a file with its FIELDS, an entry in FEATURES, and a line at each point where it acts, here or in
`contact_hooks.py`. A function that acts there takes its own field first, so that it compiles to nothing if that is
None. Callers pass `features` and know no single feature. What all steps need (accelerations, masses, radii,
boundaries) is read from the files of those features where it is needed.
"""

from collections import namedtuple
from collections.abc import Mapping
from typing import Any

from mpsim.kernels.compiling import any_present, inlined
from mpsim.kernels.features import baths, bodies, capsules, collisions, edges, friction, piston, properties, work
from mpsim.kernels.features.collisions import log_of
from mpsim.kernels.features.work import work_of

FEATURES = (properties, edges, piston, capsules, bodies, friction, baths, collisions, work)
"""Their FIELDS are those of `Features`: of each the name of its array, or the class of a record of several,
or None: of the log of collisions, and of sums of work, each worker has its own."""

Features: Any = namedtuple("Features", [name for feature in FEATURES for name in feature.FIELDS])
"""What only some scenes need. None: the scene lacks it, and the compiler drops whatever is tested against it."""

BARE = Features(*[None] * len(Features._fields))
"""Of a scene without features."""


def features_of(arrays: Mapping[str, Any], worker: int = 0) -> Any:
    """The `Features` of a scene, from its arrays by name; field f of a record r is the array "r.f".

    worker: whose log of collisions and sums of work to use, if there are any.
    """
    found: dict[str, Any] = {"log": log_of(arrays, worker), "work": work_of(arrays, worker)}
    for feature in FEATURES:
        for name, source in feature.FIELDS.items():
            if isinstance(source, str):
                found[name] = arrays.get(source)
            elif source is not None and f"{name}.{source._fields[0]}" in arrays:
                found[name] = source(*(arrays.get(f"{name}.{field}") for field in source._fields))
    return BARE._replace(**found)


# --- what a feature may answer ------------------------------------------------------------------------------------


@inlined
def wall_motion(edge, features, parameters):
    """Speed and acceleration of the wall at an edge (LEFT, ...) [length/time], [length/time^2]."""
    return piston.wall_motion(features.moving_wall, edge, parameters)


@inlined
def wall_place(edge, features, parameters):
    """Position of the limit of an edge while contacts are resolved [length]."""
    return piston.wall_place(features.moving_wall, edge, parameters)


@inlined
def is_absent(disc, features):
    """Whether a disc has left, by its id."""
    return edges.is_absent(features.exits, disc)


@inlined
def lets_out(edge, features, control):
    """Whether an edge (LEFT, ...) absorbs discs."""
    return edges.lets_out(features.exits, control, edge)


@inlined
def special_borders(features):
    """None if all four borders are smooth walls at rest, elastic or not: those that the vector code handles."""
    walls = any_present(any_present(features.moving_wall, features.wall_friction), features.thermal_walls)
    return any_present(any_present(features.wrap_x, features.wrap_y), walls)


# --- the points of a step, in their order -------------------------------------------------------------------------


@inlined
def begin_step(discs, low, high, features, control):
    """At the start of a step, before anything else reads the discs of a slice: features that change velocities."""
    baths.begin_step(features.thermostat, discs, low, high, features, control)


@inlined
def before_move(discs, low, high, features, parameters, control):
    """Before the discs of a slice are moved."""
    edges.before_move(features.exits, discs, low, high, features, parameters, control)


@inlined
def after_flight(discs, low, high, features):
    """After their flight and its bounces off walls, before they are checked to be finite."""
    edges.after_flight(features.exits, discs, low, high, features.spin)


@inlined
def after_move(discs, low, high, features, parameters, control, mine):
    """When all discs of the slice are known to be finite: contacts of single discs, in any order of discs."""
    capsules.after_move(features.capsules, discs, low, high, features, parameters, control)
    bodies.after_move(features.bodies, discs, low, high, features, parameters, control, mine)


@inlined
def after_binning(discs, low, high, features, control):
    """When the discs of the slice have cells, which can still be changed: a later line overrides an earlier one."""
    properties.after_binning(features.giants, discs, low, high, control)
    edges.after_binning(features.exits, discs, low, high, control)


@inlined
def pack(features, disc, message, k):
    """When a disc moves to another rank: what features store by its number, into entry k of a message."""
    edges.pack(features.image, disc, message, k)
    friction.pack(features.spin, disc, message, k)


@inlined
def unpack(message, k, features, disc):
    """When a disc has come from another rank."""
    edges.unpack(message, k, features.image, disc)
    friction.unpack(message, k, features.spin, disc)


@inlined
def prepare_next_step(features, parameters, control):
    """Before the next step: by one worker between motion and contacts, when no worker reads the walls."""
    piston.prepare_next_step(features.moving_wall, parameters, control)
    bodies.prepare_next_step(features.bodies, control)


def prepare_first_step(arrays: Mapping[str, Any]) -> None:
    """`prepare_next_step` for the arrays of a block, after its parameters were rewritten."""
    prepare_next_step(features_of(arrays), arrays["parameters"], arrays["control"])
