"""Scenes and simulations refuse assignments, which a run would not see, and copies that share a block."""

import copy
import pickle

import pytest
from support.scenes import gas, simulate

import mpsim


@pytest.mark.parametrize("name", ["gravity", "width", "radius", "position", "thermostat", "duration", "gravty"])
@pytest.mark.parametrize("again", [lambda scene: scene, copy.deepcopy, lambda scene: pickle.loads(pickle.dumps(scene))])
def test_a_scene_refuses_assignments_and_so_do_its_copies(name, again):
    scene = again(gas(20, 0.2))
    before = scene.digest()
    with pytest.raises(mpsim.InputError, match=rf"^{name} of a Scene cannot be assigned; got 3\. Make another Scene; "):
        setattr(scene, name, 3)
    assert scene.digest() == before
    assert not hasattr(scene, "gravty")


@pytest.mark.parametrize("name", ["dt", "workers", "gravity", "scene", "frame", "state", "comm"])
def test_a_simulation_refuses_assignments(name):
    with simulate(gas(20, 0.2)) as sim:
        with pytest.raises(
            mpsim.InputError, match=rf"^{name} of a Simulation cannot be assigned; got 3\. Use sim\.cha"
        ):
            setattr(sim, name, 3)
        assert not hasattr(sim, "dt")


class Named(mpsim.Scene):
    """A scene of a user, with an attribute of its own."""

    def __init__(self, **arguments):
        super().__init__(**arguments)
        self.label = "first"


def test_a_class_that_inherits_may_have_attributes_of_its_own():
    scene = Named.random(count=9, packing=0.1, radius=0.5)
    scene.label = "second"
    assert scene.label == "second"
    del scene.label
    with pytest.raises(mpsim.InputError, match=r"width of a Named cannot be assigned; got 3\. Make another Scene; "):
        scene.width = 3
    with pytest.raises(mpsim.InputError, match=r"gravity of a Named cannot be deleted\. Make another Scene; "):
        del scene.gravity


@pytest.mark.parametrize("copied", [pickle.dumps, copy.copy, copy.deepcopy])
def test_a_simulation_is_not_copied_and_says_what_can_be(copied):
    with simulate(gas(20, 0.2)) as sim, pytest.raises(mpsim.InputError, match=r"cannot be pickled .* Pass sim\.state"):
        copied(sim)
