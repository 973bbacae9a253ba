"""The discs of a scene at its start: ranges of them, and what looks at all without having them all."""

import copy
import functools
import pickle

import numpy as np
import pytest
from support.scenes import gas

import mpsim
from mpsim import Scene, Settings
from mpsim.engine.feature_arrays import typical_momentum
from mpsim.engine.precision_check import check_precision, rms_speed
from mpsim.engine.solvers.speeds import speeds_at_start, speeds_of
from mpsim.engine.step_limits import StepLimits
from mpsim.scene.lattice import Lattice

COUNT = 200_000


@pytest.fixture
def never_whole(monkeypatch):
    """A lattice raises as soon as all of its discs would be made."""

    for name in ("positions", "velocities"):
        made = getattr(Lattice, name)
        monkeypatch.setattr(Lattice, name, functools.partialmethod(made_in_parts, made))


def made_in_parts(lattice, made, first, last):
    """What `made` makes of some discs of a lattice."""
    if last - first == lattice.count:
        raise AssertionError("all discs are made at once")
    return made(lattice, first, last)


def looks(scene):
    """What is looked at when a simulation is made, and when a scene is shown or sent."""
    settings = Settings(dt=0.01)
    return {
        "precision": lambda: check_precision(scene, settings),
        "steps": lambda: list(StepLimits(scene, settings, has_steps=True).at_start()),
        "sub-steps": lambda: list(StepLimits(scene, Settings(dt=0.01, on_fast="substep"), has_steps=True).at_start()),
        "digest": scene.digest,
        "pickle": lambda: pickle.loads(pickle.dumps(scene)).count,
        "repr": lambda: repr(scene),
        "copy": lambda: copy.copy(scene).count,
        "overlaps": scene.overlaps_at_start,
        "momentum": lambda: typical_momentum(scene, 0.01),
        "a part": lambda: scene.rows(COUNT // 2, COUNT),
    }


@pytest.mark.parametrize("look", looks(Scene.lattice(count=3, packing=0.1, radius=0.5)))
@pytest.mark.usefixtures("never_whole")
def test_a_lattice_is_looked_at_without_being_made(look):
    looks(Scene.lattice(count=COUNT, packing=0.5, radius=0.5))[look]()


@pytest.mark.parametrize("name", ["position", "velocity"])
@pytest.mark.usefixtures("never_whole")
def test_a_look_at_all_discs_at_once_would_be_noticed(name):
    """Negative control."""
    with pytest.raises(AssertionError, match="all discs are made at once"):
        getattr(Scene.lattice(count=COUNT, packing=0.5, radius=0.5), name)


def test_sums_over_pieces_are_those_over_all():
    scene = Scene.lattice(count=COUNT, packing=0.5, radius=0.5, temperature=2.0)
    assert len(list(scene.pieces())) > 1
    found, whole = speeds_at_start(scene), speeds_of(scene.velocity, scene.radii, scene)
    assert (found.disc, found.speed, found.limit) == (whole.disc, whole.speed, whole.limit)
    assert found.mean_speed == pytest.approx(whole.mean_speed, rel=1e-12)
    assert found.collision_rate == pytest.approx(whole.collision_rate, rel=1e-12)
    assert rms_speed(scene) == pytest.approx(2.0, rel=1e-12)
    assert typical_momentum(scene, 0.01) == pytest.approx(2.0**0.5, rel=1e-12)


def test_a_velocity_that_does_not_fit_is_named_by_its_number_in_the_scene():
    scene = Scene.lattice(count=COUNT, packing=0.5, radius=0.5, temperature=1e36)
    worst = np.argwhere(np.abs(scene.velocity) > np.sqrt(np.finfo("float32").max) / 4)[0].tolist()
    assert worst[0] > list(scene.pieces())[1][0], "in a later piece"
    with pytest.raises(mpsim.InputError, match=rf"velocity\[{worst[0]}, {worst[1]}\] is"):
        check_precision(scene, Settings(precision="float32"))


def test_rows_of_given_arrays_are_views():
    scene = gas(20, 0.2)
    position, velocity = scene.rows(5, 15)
    assert np.shares_memory(position, scene.position)
    assert np.shares_memory(velocity, scene.velocity)
    assert position.tolist() == scene.position[5:15].tolist()
    assert velocity.tolist() == scene.velocity[5:15].tolist()
    assert list(scene.pieces()) == [(0, 20)]


@pytest.mark.parametrize("ends", [(-1, 3), (3, 2), (0, 21), (21, 21), (0.5, 1), (True, 2)])
def test_rows_that_a_scene_does_not_have_are_refused(ends):
    with pytest.raises(mpsim.InputError, match=r"(first|last) must be a whole number from \d+ to 20; got"):
        gas(20, 0.2).rows(*ends)


def test_a_copy_may_start_anew():
    scene = gas(20, 0.2)
    other = copy.copy(scene)
    other.start_anew(scene.position[::-1], scene.velocity)
    assert other.position.tolist() == scene.position[::-1].tolist()
    assert other.velocity is scene.velocity
    assert scene.digest() == gas(20, 0.2).digest() != other.digest()
