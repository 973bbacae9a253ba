"""A frame pass by pass on the page: what is told of each, and that the last one is where the frame ends."""

import pytest
from support.scenes import gas

import mpsim
from mpsim.viewer.passes import PassView

SCENE = gas(300, 0.4)


def test_all_passes_of_a_frame_then_those_of_the_next():
    view = PassView()
    assert view.told() == {"name": None}
    with mpsim.Simulation(SCENE, mpsim.Settings(method="grid", dt=0.05, contact="push")) as sim:
        sim.run(frames=7)
        before = sim.digest()
        names, contacts = [], 0
        while not view.is_last:
            names.append(view.next(sim).name)
            contacts += view.told()["contacts"]
            assert sim.digest() == before
        told = view.told()
        assert (names, told["number"], told["of"]) == (["even", "odd"], 2, 2)
        assert told["columns"] == 24
        assert told["brackets"][:2] == [1, 3]
        assert set(told["owners"]) == {0}
        with pytest.raises(mpsim.InputError, match="must end where the frame does"):
            view.demand_end(before)
        assert sim.run(frames=1).collisions == contacts
        view.demand_end(sim.digest())
        assert view.next(sim).name == "even"
        view.close()
        assert not view.is_open
