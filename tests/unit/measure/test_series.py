"""A number of the state along a run."""

import numpy as np
import pytest
from support.scenes import gas, simulate

import mpsim
from mpsim.measure import Series, kinetic_energy, reference, speed_kurtosis

SETTINGS = {"dt": 0.05, "method": "grid"}


def test_each_frame_is_noted_once_with_its_time():
    found, scene = Series(lambda state, scene: state.position[3, 0], every=3), gas(20, 0.2)
    expected = []
    with simulate(scene, **SETTINGS) as sim:
        for frames in (4, 0, 5, 6):
            sim.run(frames=frames, observe=found)
    with simulate(scene, **SETTINGS) as sim:
        for frame in range(16):
            if frame % 3 == 0:
                expected.append((sim.time, sim.state.position[3, 0]))
            sim.run(frames=1)
    assert np.column_stack([found.time, found.value]).tolist() == np.array(expected).tolist()
    assert repr(found) == "<Series: 6 values>"


def test_where_speeds_have_become_those_of_maxwell_is_found():
    """Discs of one speed: <v^4>/<v^2>^2 is 1 at first, and 2 - 2/(N + 1) between walls from a few collisions on."""
    start, angle = gas(200, 0.2, seed=1), np.random.default_rng(1).uniform(0, 2 * np.pi, 200)
    equal = mpsim.Scene(
        width=start.width,
        height=start.height,
        position=start.position,
        velocity=np.sqrt(2) * np.column_stack([np.cos(angle), np.sin(angle)]),
        radius=0.5,
    )
    found = Series(lambda state, scene: speed_kurtosis(state), every=5)
    with simulate(equal, dt=0.05, method="grid", contact="impact") as sim:
        sim.run(frames=4000, observe=found)
    cut = found.equilibration()
    assert cut.found
    assert 4 < cut.start < 200
    assert cut.measure.error < 0.02
    assert abs(cut.measure.deviation(reference.speed_kurtosis(200))) < 3
    assert found.value[0] == pytest.approx(1.0)
    assert abs(cut.measure.deviation(1.0)) > 30


def test_bad_input_is_refused():
    for make, words in (
        (lambda: Series("temperature"), "function of a Series must be called as function(state, scene); got 'temp"),
        (lambda: Series(kinetic_energy, every=0), "every must be a whole number"),
        (lambda: Series(kinetic_energy).equilibration(), "got 0 samples"),
    ):
        with pytest.raises(mpsim.InputError) as caught:
            make()
        assert words in str(caught.value)
    words = "what function of a Series gives must be a number; got 'hot'"
    with simulate(gas(20, 0.2), **SETTINGS) as sim, pytest.raises(mpsim.InputError, match=words):
        sim.run(frames=1, observe=Series(lambda state, scene: "hot"))
    found = Series(kinetic_energy)
    for _ in range(2):
        with simulate(gas(20, 0.2), **SETTINGS) as sim:
            if not len(found.value):
                sim.run(frames=1, observe=found)
                continue
            with pytest.raises(mpsim.InputError, match="a Series must observe one simulation"):
                sim.run(frames=1, observe=found)
