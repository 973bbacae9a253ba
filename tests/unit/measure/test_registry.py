"""Each observable has one entry, from which follow what runs can measure, and the errors of a trade-off study."""

import numpy as np
import pytest
from support.scenes import gas

import mpsim
from mpsim.core.state import State
from mpsim.features import FEATURES
from mpsim.kernels import records
from mpsim.measure.counted import Run
from mpsim.measure.registry import COUNTED, DRIFTS, ERRORS, LONG, NAMES, OBSERVABLES, SAMPLED, SHORT, Observable
from mpsim.measure.run_averages import RunAverages
from mpsim.output.tables import UNITS


def test_each_has_one_function_or_only_an_error():
    for name, each in OBSERVABLES.items():
        functions = [kind for kind in (each.counted, each.sampled, each.drift) if kind]
        assert len(functions) <= 1, name
        assert functions or each.error, name
        assert each.error or each.unit == "%", f"the unit of {name} is that of its error"


def test_runs_and_trades_know_all_of_them():
    assert {*NAMES, *ERRORS} == OBSERVABLES.keys()
    assert (*COUNTED, *SAMPLED, *DRIFTS) == NAMES
    assert (*LONG, *SHORT) == ERRORS
    assert UNITS.keys() <= set(ERRORS)


def test_the_docs_of_run_name_what_it_can_measure():
    assert all(f'"{name}"' in mpsim.Simulation.run.__doc__ for name in NAMES)
    assert all(name in mpsim.tradeoff.__doc__ for name in ERRORS)


def test_features_invalidate_only_what_there_is():
    named = {name for feature in FEATURES for each in feature.invalidates for name in each.measures}
    assert named <= OBSERVABLES.keys() | {"virial"}


def test_what_does_not_say_that_it_is_constant_is_not_settled_before_it_changes(monkeypatch):
    observed = Observable(sampled=lambda state, scene: 0.25)
    monkeypatch.setitem(OBSERVABLES, "temperature", observed)
    monkeypatch.setitem(SAMPLED, "temperature", observed.sample)
    scene = gas(10, 0.2)
    averages = RunAverages(
        ("temperature", "kinetic_energy"), 50, scene, lambda look: look(State(scene.position, scene.velocity))
    )
    for frame in range(1, 51):
        averages.take(np.zeros(1, records.COUNTS), frame)
    measures = averages.measures(Run(scene, scene.count, 0.01))
    assert (measures["temperature"].value, measures["temperature"].settled) == (0.25, False)
    assert measures["kinetic_energy"].settled
    assert measures["kinetic_energy"].error < 1e-12


@pytest.mark.parametrize(("left", "needs"), [(0, "discs"), (0, "motion"), (1, "motion")])
def test_what_is_undefined_is_not_asked_for(left, needs):
    state = State(np.ones((1, 2)), np.zeros((1, 2)), present=np.array([bool(left)]))
    assert np.isnan(Observable(sampled=lambda state, scene: 1 / 0, needs=needs).sample(state, gas(1, 0.1)))
    assert Observable(sampled=lambda state, scene: 0.0, needs="nothing").sample(state, gas(1, 0.1)) == 0.0


def test_an_observable_that_says_nothing_is_taken_of_moving_discs():
    assert Observable().needs == "motion"
