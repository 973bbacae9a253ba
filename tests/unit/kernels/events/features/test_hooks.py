"""The features of the exact solver: what a scene has of them, and that nothing else in it names one."""

from pathlib import Path

import numpy as np
import pytest

import mpsim
from mpsim.engine.solvers import event_snapshot
from mpsim.kernels.events.features import hooks

GIVEN = {"contact_time": 1e-9}
OWNERS = {name: feature for feature in hooks.FEATURES for name in feature.FIELDS}


def scene(**features):
    return mpsim.Scene(width=9, height=9, position=[[2, 2], [6, 6]], velocity=np.ones((2, 2)), **features)


def present(found):
    return {name for name, value in zip(found._fields, found, strict=True) if value is not None}


def test_a_bare_scene_has_no_feature():
    assert present(hooks.features_of(scene(radius=0.5), GIVEN)) == {"contact_time"}
    assert present(hooks.BARE) == set()


@pytest.mark.parametrize(
    ("features", "fields"),
    [
        ({"gravity": (0, -1)}, {"gravity": (0.0, -1.0)}),
        ({"restitution": 0.9}, {"restitution": 0.9}),
        ({"wall_restitution": 0.8}, {"wall_restitution": 0.8}),
        ({"friction": 0.3, "tangential_restitution": 0.5}, {"friction": (0.3, 0.5)}),
        ({"wall_friction": 0.2}, {"wall_friction": (0.2, 0.0)}),
    ],
    ids="-".join,
)
def test_a_number_of_a_scene_is_that_of_its_feature(features, fields):
    found = hooks.features_of(scene(radius=0.5, **features), GIVEN)
    assert present(found) == {"contact_time", *fields}
    assert all(getattr(found, name) == value for name, value in fields.items())


@pytest.mark.parametrize(
    ("features", "columns"),
    [
        ({"radius": 0.5}, set()),
        ({"radius": [0.5, 0.4]}, {"radius"}),
        ({"radius": 0.5, "mass": [1, 2]}, {"mass"}),
        ({"radius": 0.5, "friction": 0.3}, {"spin"}),
        ({"radius": 0.5, "boundary": "periodic"}, {"image"}),
    ],
)
def test_each_array_of_discs_in_the_block_is_a_field_of_a_feature(features, columns):
    shapes = event_snapshot.column_shapes(scene(**features), 2)
    assert shapes.keys() == columns <= OWNERS.keys()
    assert all(OWNERS[name].FIELDS[name] is None for name in columns)


def test_nobody_else_names_friction_or_spins():
    """One feature stands for all: what acts only at hooks is named in its own file and in hooks.py."""
    package = Path(mpsim.__file__).parent
    files = [*(package / "kernels" / "events").rglob("*.py"), *(package / "engine" / "solvers").glob("event*.py")]
    named = {path.name for path in files if any(word in path.read_text() for word in ("friction", "spin"))}
    assert named == {"friction.py", "hooks.py"}
