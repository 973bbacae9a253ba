"""Edges that absorb, and emitters: times and places of leaving in closed form, by the exact and the stepped solvers."""

import math

import pytest
from support.scenes import simulate

from mpsim import Scene

pytestmark = pytest.mark.plain

EDGES = ("left", "right", "bottom", "top")


def exactly(scene, dt=1.0):
    return simulate(scene, method="event", dt=dt)


def closed(scene):
    """The same discs between walls: the control."""
    return Scene(width=scene.width, height=scene.height, position=scene.position, velocity=scene.velocity,
                 radius=scene.radius)  # fmt: skip


@pytest.mark.parametrize("edge", EDGES)
def test_a_disc_leaves_at_the_instant_at_which_it_touches(edge):
    """It is there a rounding before, and away a rounding after; then it rests there, whatever gravity does."""
    sign, axis = (1 if edge in ("right", "top") else -1), int(edge in ("bottom", "top"))
    velocity, gravity = [0.3, 0.3], [0.1, 0.1]
    velocity[axis], gravity[axis] = 1.5 * sign, 0.4 * sign
    scene = Scene(width=8, height=8, position=[[4, 4]], velocity=[velocity], radius=0.5, gravity=gravity,
                  absorbing=edge)  # fmt: skip
    touch = (-1.5 + math.sqrt(1.5**2 + 2 * 0.4 * 3.5)) / 0.4
    for late in (-1e-12, 1e-12, 50.0):
        with exactly(scene, dt=touch + late) as sim:
            sim.run(frames=1)
            assert sim.absorbed.tolist() == [late > 0]
            assert sim.state.present.tolist() == [late < 0]
            assert sim.state.position[0, axis] == pytest.approx(4 + 3.5 * sign, abs=1e-11)
            assert sim.state.position[0, 1 - axis] == pytest.approx(4 + 0.3 * touch + 0.05 * touch**2, abs=1e-11)
            assert (sim.state.velocity[0] == 0).all() == (late > 0)
    with simulate(scene, method="grid", contact="impact", dt=touch / 20) as sim:
        assert sim.run(frames=19).frames == 19
        assert not sim.absorbed.any()
        sim.run(frames=2)
        assert sim.absorbed.all()
        assert sim.state.position[0, axis] == pytest.approx(4 + 3.5 * sign, abs=0.3)


@pytest.mark.parametrize("settings", [{"method": "event", "dt": 2.0}, {"method": "grid", "dt": 0.05}], ids=str)
def test_what_has_left_meets_no_disc(settings):
    """The first leaves at 1; the second would have met it at its place later, and leaves at 3."""
    scene = Scene(width=8, height=3, position=[[6.5, 1.5], [4.5, 1.5]], velocity=[[1, 0], [1, 0]], radius=0.5,
                  absorbing="right")  # fmt: skip
    with simulate(scene, **settings) as sim:
        assert sim.run(until=2.0).collisions == 0
        assert sim.absorbed.tolist() == [True, False]
        assert sim.run(until=4.0).collisions == 0
        assert sim.absorbed.all()
        assert sim.state.position[:, 0] == pytest.approx([7.5, 7.5], abs=0.06)
    with simulate(closed(scene), **settings) as sim:
        assert sim.run(until=4.0).collisions == 1, "the control: at a wall the first comes back and meets the second"


def test_a_disc_added_later_finds_those_that_have_left_away():
    """Also where another lies on them now."""
    scene = Scene(width=8, height=3, position=[[6.5, 1.5], [2.0, 1.5]], velocity=[[1, 0], [0, 0]], radius=0.5,
                  absorbing="right", gravity=(0.0, 0.0))  # fmt: skip
    with exactly(scene, dt=2.0) as sim:
        sim.run(frames=1)
        sim.add([7.4, 1.5], [-1.0, 0.0])
        assert sim.absorbed.tolist() == [True, False, False]
        assert sim.run(frames=3).collisions == 1
        assert sim.state.velocity[:, 0].tolist() == [0.0, 1.0, 0.0], "the second is back from the wall"
