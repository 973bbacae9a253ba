"""The search for contacts against slow obvious twins."""

import numpy as np
import pytest
from support.arrays import control_of, discs_of, parameters_of
from support.internals import machine_code

from mpsim.kernels.features.hooks import BARE
from mpsim.kernels.frame import contacts, laws
from mpsim.kernels.frame.contacts import resolve_all_pairs
from mpsim.kernels.layout import ELASTIC, REFLECT

REALS = [np.float32, np.float64]

push_contact, resolve_range = map(machine_code, (laws.push_contact, contacts.resolve_range))


def contact(discs, i, j, parameters, law):
    push_contact(discs, i, j, None, None, BARE, parameters, law)


def contacts_of_range(discs, i, first, last, parameters, control):
    return resolve_range(discs, i, first, last, None, None, BARE, parameters, control, None, 0)


def twin_of_range(discs, i, first, last, parameters, law):
    """Test one by one, resolve at once."""
    contacts = 0
    for j in range(first, last):
        dx, dy = discs.x[j] - discs.x[i], discs.y[j] - discs.y[i]
        if dx * dx + dy * dy < parameters.diameter * parameters.diameter:
            contact(discs, i, j, parameters, law)
            contacts += 1
    return contacts


def copy(discs):
    return type(discs)(*(None if field is None else field.copy() for field in discs))


@pytest.mark.slow
@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("law", [ELASTIC, REFLECT])
@pytest.mark.parametrize("length", [0, 1, 7, 8, 9, 16, 17, 40])
def test_testing_eight_at_a_time_is_testing_one_by_one(length, law, real):
    """A contact moves disc i, so that discs tested before with no overlap may overlap now, and the reverse."""
    total = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        x, y, vx, vy = rng.normal(size=(4, length + 1)) * 0.8
        discs = discs_of(real, x + 5, y + 5, vx, vy)
        parameters = parameters_of(real, 10, 10)
        expected = copy(discs)
        found = contacts_of_range(discs, 0, 1, length + 1, parameters, control_of(length + 1, law=law))
        assert found == twin_of_range(expected, 0, 1, length + 1, parameters, law), f"seed {seed}"
        for name, field, other in zip(discs._fields, discs, expected, strict=True):
            assert field is None or field.tobytes() == other.tobytes(), f"seed {seed}: {name} differs"
        total += found
    assert total >= 4 * length


@pytest.mark.parametrize("real", REALS)
def test_all_pairs_are_visited_in_index_order(real):
    rng = np.random.default_rng(3)
    x, y, vx, vy = rng.normal(size=(4, 30))
    discs = discs_of(real, x + 5, y + 5, vx, vy)
    parameters, expected = parameters_of(real, 10, 10), copy(discs)
    contacts = resolve_all_pairs(discs, BARE, parameters, control_of(30), None, 0)
    assert contacts == sum(twin_of_range(expected, i, i + 1, 30, parameters, ELASTIC) for i in range(30)) > 80
    assert discs.x.tobytes() == expected.x.tobytes()
    assert discs.vy.tobytes() == expected.vy.tobytes()
