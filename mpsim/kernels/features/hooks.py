"""The features of the stepped solvers, which of them a scene has, and at which points of a step they act.

A new feature is a file, its fields in `Features`, and a line at each point where it acts: here, in `collisions.py`
(contacts), or in `motion.py` (what one feature alone does). A function that acts there takes its own field first, so
that it compiles to nothing if that is None. What all steps need (accelerations, masses, radii, boundaries, walls) is
read from the files of those features where it is needed.
"""

from collections import namedtuple
from collections.abc import Mapping
from typing import Any

from mpsim.kernels.compiling import any_present, inlined
from mpsim.kernels.features import bodies, capsules, edges, properties
from mpsim.kernels.features.collisions import log_of, work_of

Features: Any = namedtuple(
    "Features",
    "giants gravity acceleration mass exits wrap_x wrap_y image moving_wall capsules bodies "
    "friction wall_friction spin thermostat thermal_walls log work",
)
"""What only some scenes need. None: the scene lacks it, and the compiler drops whatever is tested against it.

A field is the array of that name, or one of RECORDS. friction, wall_friction: shape (2,), of two discs, and of a disc
with walls and capsules, elements as in `friction.py`; spin: shape (capacity,), by id, counter-clockwise [1/time]. log,
work: `Log` and `Work` of the worker whose call it is.
"""

RECORDS = {"moving_wall": bodies.MovingWalls, "capsules": capsules.Capsules, "bodies": bodies.Bodies}
"""Fields of several arrays: field f of a record r is the array "r.f"."""


def features_of(arrays: Mapping[str, Any], worker: int = 0) -> Any:
    """The `Features` of a scene, from its arrays by name.

    worker: whose log of collisions and sums of work to use, if there are any.
    """
    found = {name: arrays.get(name) for name in Features._fields}
    for name, record in RECORDS.items():
        values = [arrays.get(f"{name}.{field}") for field in record._fields]
        found[name] = None if values[0] is None else record(*values)
    return Features(**found | {"log": log_of(arrays, worker), "work": work_of(arrays, worker)})


# --- the points of a step, in their order -------------------------------------------------------------------------


@inlined
def special_borders(features):
    """None if all four borders are smooth walls at rest, elastic or not: those that the vector code handles."""
    walls = any_present(any_present(features.moving_wall, features.wall_friction), features.thermal_walls)
    return any_present(any_present(features.wrap_x, features.wrap_y), walls)


@inlined
def after_move(discs, low, high, features, parameters, control, mine):
    """When all discs of the slice are known to be finite: contacts of single discs, in any order of discs."""
    capsules.after_move(features.capsules, discs, low, high, features, parameters, control)
    bodies.resolve_bodies(features.bodies, discs, low, high, features, parameters, control, mine)
    bodies.look_beside_walls(features.moving_wall, discs, low, high, features, parameters, control, mine)
    bodies.note_pressed(any_present(features.bodies, features.moving_wall), control, mine)


@inlined
def after_binning(discs, low, high, features, control):
    """When the discs of the slice have cells, which can still be changed: a later line overrides an earlier one."""
    properties.after_binning(features.giants, discs, low, high, control)
    edges.after_binning(features.exits, discs, low, high, control)


@inlined
def prepare_next_step(features, parameters, control):
    """Before the next step: by one worker between motion and contacts, when no worker reads the walls."""
    if any_present(features.bodies, features.moving_wall) is not None:
        control.deep = min(control.deep, 0)
    bodies.move_walls(features.moving_wall, parameters, control)
    bodies.move_bodies(features.bodies, control)


def prepare_first_step(arrays: Mapping[str, Any]) -> None:
    """`prepare_next_step` for the arrays of a block, after its parameters were rewritten."""
    prepare_next_step(features_of(arrays), arrays["parameters"], arrays["control"])
