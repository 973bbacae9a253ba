"""Errors as they travel from one process to another."""

import pickle

import pytest

import mpsim
from mpsim.errors import SceneFileError

ERRORS = [
    mpsim.InputError("dt must be positive"),
    SceneFileError("a.toml", ["width must be positive", "radius must be positive"]),
    mpsim.DivergedError(3, 7, (1.0, float("inf")), (0.0, 2.0)),
    mpsim.WorkerDiedError(1, 4711, -9, "signal 9 (SIGKILL)", 12, "move"),
]


@pytest.mark.parametrize("error", ERRORS, ids=lambda error: type(error).__name__)
def test_an_error_arrives_as_it_was_sent(error):
    arrived = pickle.loads(pickle.dumps(error))
    assert type(arrived) is type(error)
    assert (str(arrived), arrived.args, vars(arrived)) == (str(error), error.args, vars(error))
    assert arrived.args, "the control: there is something to compare"
