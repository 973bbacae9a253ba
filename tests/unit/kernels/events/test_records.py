"""The records of the exact solver: named fields, and the plain numbers that snapshots hold."""

import numpy as np
import pytest

from mpsim.kernels.events import records

KINDS = {name: value for name, value in vars(records).items() if isinstance(value, np.dtype)}


@pytest.mark.parametrize("name", KINDS)
def test_a_field_is_not_hidden_by_an_attribute_of_numpy(name):
    assert not [field for field in KINDS[name].names if hasattr(np.void, field)]
    assert hasattr(np.void, "base"), "a name that would be"


@pytest.mark.parametrize("name", KINDS)
def test_numbers_are_a_view_of_records(name):
    kind = KINDS[name]
    several, one = np.zeros(3, kind), np.zeros((), kind)[()]
    for found, where in ((several, (2, ...)), (one, ...)):
        plain = records.numbers(found)
        plain[where] = np.arange(plain.shape[-1])
        again = records.of_numbers(kind, plain)
        assert again.tobytes() == found.tobytes() == plain.tobytes()
        assert plain.any()
        assert plain.base is not None
    field = kind.names[0]
    one[field] = 7
    assert records.of_numbers(kind, records.numbers(one))[field] == pytest.approx(7)


def test_a_disc_is_one_cache_line():
    assert records.DISC.itemsize == 64
    assert records.EVENT.itemsize == 32


def test_other_arrays_are_numbers_already():
    array = np.arange(3)
    assert records.numbers(array) is array
