"""Friction, by numbers that can be checked by hand."""

import math
import re
from pathlib import Path

import numpy as np
import pytest
from support.internals import machine_code

import mpsim
from mpsim.kernels.features import friction, hooks

tangential_change = machine_code(friction.tangential_change)


@pytest.mark.parametrize(
    ("slip", "expected"), [(0.5, 0.25), (-0.5, -0.25), (1.0, 0.5), (8.0, 0.5), (-8.0, -0.5), (0.0, 0.0)]
)
def test_the_tangential_change_is_that_of_a_contact_that_sticks_up_to_the_limit_of_coulomb(slip, expected):
    """Sticking changes half of the slip, and friction 1/4 allows a quarter of what the contact pressed."""
    assert tangential_change(np.array([0.25, 0.5]), slip, 2.0) == expected


def test_discs_that_cannot_slide_stick_at_any_slip():
    assert tangential_change(np.array([math.inf, 0.5]), 1e6, 1e-6) == 5e5


def test_a_scene_without_friction_has_nothing_of_it_in_the_kernels():
    bare = hooks.features_of({})
    assert bare.friction is bare.wall_friction is bare.spin is None
    assert hooks.special_borders(bare) is None, "the vector code of motion"
    rough = bare._replace(wall_friction=np.zeros(2))
    assert hooks.special_borders(rough), "walls that are met one by one"


def test_no_other_file_names_friction_or_spins():
    """One feature stands for all: what acts only at hooks is named in its own file and in those of the hooks."""
    package = Path(mpsim.__file__).parent / "kernels"
    files = [*(package / "frame").glob("*.py"), *(package / "features").glob("*.py")]
    named = {path.name for path in files if re.search(r"features\.(\w*friction|spin)\b", path.read_text())}
    assert named == {"friction.py", "hooks.py", "contact_hooks.py"}
