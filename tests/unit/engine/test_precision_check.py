"""Numbers too coarse for a scene are warned of or refused."""

import re

import pytest
from support.scenes import pair, quiet

import mpsim


def test_a_box_too_large_for_the_precision_is_told_and_then_refused():
    far = pair(side=8000.0)
    with pytest.warns(mpsim.errors.ResolutionWarning, match=r"in float32 coordinates are 0.000954 apart .* 0.0019 of"):
        mpsim.Simulation(far, mpsim.Settings(dt=0.1, precision="float32")).close()
    quiet(far, dt=0.1)
    quiet(pair(side=800.0), dt=0.1, precision="float32")
    text = r"radius must be at least 0.954 in a box of 1e\+06 x 1e\+06 in float32, .* got 0.5. Use precision='float64'"
    with pytest.raises(mpsim.InputError, match=text):
        mpsim.Simulation(pair(side=1e6), mpsim.Settings(precision="float32"))


def test_steps_that_rounding_swallows_are_told():
    slow = pair(1e-5, side=100.0)
    with pytest.warns(
        mpsim.errors.ResolutionWarning, match="most discs do not move at all. Use larger steps, or precision="
    ):
        sim = mpsim.Simulation(slow, mpsim.Settings(dt=0.1, precision="float32", method="grid"))
    with sim:
        start = sim.state.position
        sim.run(frames=100)
        assert (sim.state.position == start).all(), "what was said is so"
    quiet(slow, dt=0.1)


def test_gravity_that_rounding_swallows_is_told():
    weak = pair(1.0, gravity=(0, -1e-15))
    with pytest.warns(
        mpsim.errors.ResolutionWarning,
        match=r"gravity changes a velocity by 1e-17 in a step, which is lost to rounding",
    ):
        mpsim.Simulation(weak, mpsim.Settings(dt=0.01, method="grid")).close()


def test_what_event_cannot_resolve_is_refused_or_told():
    with pytest.raises(mpsim.InputError, match="velocity must be at least 1e-100 for method='event', or all zero"):
        mpsim.Simulation(pair(1e-200), mpsim.Settings(dt=1.0, method="event"))
    with pytest.raises(mpsim.InputError, match=r"dt must be at most 1e\+100 for method='event'; got 1e\+110"):
        mpsim.Simulation(pair(), mpsim.Settings(dt=1e110, method="event"))
    with pytest.raises(mpsim.InputError, match=r"would take the fastest disc 5e\+18 times through the box"):
        mpsim.Simulation(pair(), mpsim.Settings(dt=1e20, method="event"))
    with pytest.warns(mpsim.errors.ResolutionWarning, match="the square of the radius is lost"):
        mpsim.Simulation(pair(radius=1e-9), mpsim.Settings(dt=0.1, method="event")).close()


@pytest.mark.parametrize(("mass", "rule"), [(1e-300, "at least"), (1e200, "at most")])
def test_masses_that_the_precision_would_lose_are_refused(mass, rule):
    with pytest.raises(mpsim.InputError, match=re.escape(f"mass must be {rule}")):
        mpsim.Simulation(pair(mass=[mass, 1.0]), mpsim.Settings(dt=0.1))
