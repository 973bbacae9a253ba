"""The exact solver with absorbing edges and emitters: times and places of leaving in closed form."""

import math

import numpy as np
import pytest
from support.compare import assert_same_bits
from support.scenes import simulate

import mpsim
from mpsim import Emitter, FixedDisc, Piston, Polyline

pytestmark = pytest.mark.slow

EDGES = ("left", "right", "bottom", "top")


def exactly(scene, dt=1.0, **settings):
    return mpsim.Simulation(scene, mpsim.Settings(method="event", dt=dt, **settings))


@pytest.mark.parametrize("edge", EDGES)
def test_a_disc_leaves_at_the_instant_at_which_it_touches(edge, figures):
    """Bisected by frames: it is there a rounding before, and away a rounding after."""
    sign, axis = (1 if edge in ("right", "top") else -1), int(edge in ("bottom", "top"))
    velocity, gravity = [0.3, 0.3], [0.1, 0.1]
    velocity[axis], gravity[axis] = 1.5 * sign, 0.4 * sign
    scene = mpsim.Scene(width=8, height=8, position=[[4, 4]], velocity=[velocity], radius=0.5, gravity=gravity,
                        absorbing=edge)  # fmt: skip
    touch = (-1.5 + math.sqrt(1.5**2 + 2 * 0.4 * 3.5)) / 0.4
    for late in (-1e-12, 1e-12):
        with exactly(scene, dt=touch + late) as sim:
            sim.run(frames=1)
            assert sim.absorbed.tolist() == [late > 0]
            assert sim.state.present.tolist() == [late < 0]
            assert sim.state.position[0, axis] == pytest.approx(4 + 3.5 * sign, abs=1e-11)
            assert sim.state.position[0, 1 - axis] == pytest.approx(4 + 0.3 * touch + 0.05 * touch**2, abs=1e-11)
            assert (sim.state.velocity[0] == 0).all() == (late > 0)
    # It rests there, whatever gravity does.
    with exactly(scene, dt=50.0) as sim:
        sim.run(frames=2)
        place = sim.state.position[0].tolist()
        assert place[axis] == 4 + 3.5 * sign
        assert place[1 - axis] == pytest.approx(4 + 0.3 * touch + 0.05 * touch**2, abs=1e-12)
    figures.note(
        "absorbing", "exact", f"time of leaving, {edge}", f"{touch:.6f}", "within 1e-12", "1e-12 before: there"
    )


def test_what_has_left_meets_no_disc():
    """The first leaves at 1; the second would have met it at its place later, and leaves at 3."""
    scene = mpsim.Scene(width=8, height=3, position=[[6.5, 1.5], [4.5, 1.5]], velocity=[[1, 0], [1, 0]], radius=0.5,
                        absorbing="right")  # fmt: skip
    with exactly(scene, dt=2.0) as sim:
        assert sim.run(frames=1).collisions == 0
        assert sim.absorbed.tolist() == [True, False]
        assert sim.run(frames=1).collisions == 0
        assert sim.absorbed.all()
        assert sim.state.position[:, 0].tolist() == [7.5, 7.5]
    # Negative control: at a wall the first comes back and meets the second.
    walled = mpsim.Scene(width=8, height=3, position=scene.position, velocity=scene.velocity, radius=0.5)
    with exactly(walled, dt=4.0) as sim:
        assert sim.run(frames=1).collisions == 1


def test_a_predicted_impact_with_a_disc_that_leaves_before_does_not_happen():
    """Head-on beyond the edge: without it they would meet at x = 7.5, after the first has touched the edge."""
    scene = mpsim.Scene(width=8, height=8, position=[[6.6, 4.0], [7.5, 6.0]], velocity=[[1.0, 0.0], [0.0, -1.1]],
                        radius=0.5, absorbing="right")  # fmt: skip
    with exactly(scene, dt=4.0) as sim:
        assert sim.run(frames=1).collisions == 0
        assert sim.absorbed.tolist() == [True, False]
        assert sim.state.velocity[1].tolist() == [0.0, -1.1]
    walled = mpsim.Scene(width=8, height=8, position=scene.position, velocity=scene.velocity, radius=0.5)
    with exactly(walled, dt=4.0) as sim:
        assert sim.run(frames=1).collisions > 0


def test_a_gas_escapes_at_the_rate_of_its_effusion(figures):
    """A beam of one speed in all directions: discs that meet nothing else leave after the time to the edge, each."""
    rng = np.random.default_rng(4)
    position = rng.uniform(0.5, 49.5, (200, 2))
    angle = rng.uniform(0, 2 * math.pi, 200)
    velocity = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    leaving = []
    for place, speed in zip(position, velocity, strict=True):
        scene = mpsim.Scene(width=50, height=50, position=[place], velocity=[speed], radius=0.5, absorbing=EDGES)
        with exactly(scene, dt=20.0) as sim:
            sim.run(frames=1)
            leaving.append(sim.absorbed[0])
    ahead = np.where(velocity > 0, 49.5 - position, position - 0.5) / np.abs(velocity)
    assert (np.array(leaving) == (ahead.min(axis=1) <= 20.0)).all()
    assert 0 < np.sum(leaving) < 200
    figures.note("absorbing", "exact", "of 200 discs, away at t = 20", int(np.sum(leaving)), int(np.sum(leaving)), "")


# --- emitters, and everything


def through(**features):
    """A stream of discs through pegs, from an emitter above to an absorbing floor."""
    pegs = [FixedDisc((x + (y % 2), y), 0.3) for x in (2, 4, 6, 8) for y in (3, 4, 5)]
    return mpsim.Scene(width=12, height=10, position=np.zeros((0, 2)), velocity=np.zeros((0, 2)), radius=0.3,
                       gravity=(0, -1.0), restitution=0.8, wall_restitution=0.7, absorbing="bottom",
                       obstacles=[*pegs, Polyline([(0, 8), (3, 7)], 0.1)],
                       emitters=[Emitter((5.1, 9.0), (0.1, 0.0), interval=1.3, limit=12),
                                 Emitter((1.5, 9.0), (0.4, 0.0), interval=1.45, limit=12)],
                       **features)  # fmt: skip


@pytest.mark.long
def test_all_that_enters_leaves_and_how_frames_are_cut_changes_no_bit(tmp_path):
    scene = through(piston=Piston("right", -0.05, 11.0))
    with exactly(scene, dt=0.7) as whole:
        whole.run(frames=60)
        state = whole.state
        assert whole.count == 24
        assert whole.absorbed.all()
        assert state.position[:, 1].tolist() == [0.3] * 24
        assert scene.deepest(state.position, np.full(24, 0.3 - 1e-12)) is None
    with exactly(scene, dt=0.7) as part:
        for frames in (1, 6, 9):
            part.run(frames=frames)
        assert 0 < part.absorbed.sum() < part.count < 24
        part.save(tmp_path / "run")
    with mpsim.Simulation.resume(tmp_path / "run") as rest:
        assert 0 < rest.absorbed.sum() < rest.count
        rest.run(frames=44)
        assert_same_bits(rest.state, state, "resumed")


def test_a_disc_added_later_finds_those_that_have_left_away():
    """A store made anew for a new disc keeps who has left, also where another lies on them now."""
    scene = mpsim.Scene(width=8, height=3, position=[[6.5, 1.5], [2.0, 1.5]], velocity=[[1, 0], [0, 0]], radius=0.5,
                        absorbing="right", gravity=(0.0, 0.0))  # fmt: skip
    with exactly(scene, dt=2.0) as sim:
        sim.run(frames=1)
        sim.add([7.4, 1.5], [-1.0, 0.0])
        assert sim.absorbed.tolist() == [True, False, False]
        assert sim.run(frames=3).collisions == 1
        assert sim.state.velocity[:, 0].tolist() == [0.0, 1.0, 0.0]  # the second is back from the wall


@pytest.mark.long
def test_the_stepped_solver_comes_to_it_as_its_step_shrinks(figures):
    """Who has left, and where the others are, before chaos has multiplied the steps' errors."""
    scene = mpsim.Scene.random(count=30, width=12, height=8, radius=0.3, gravity=(0.1, -1.0), seed=2,
                               absorbing=("bottom", "left"), obstacles=[FixedDisc((6.0, 3.0), 0.5)])  # fmt: skip
    until = 1.5
    with exactly(scene, dt=until) as sim:
        sim.run(frames=1)
        exact, gone = sim.state, sim.absorbed
    assert 0 < gone.sum() < len(gone)
    errors = []
    for contact, steps in (("impact", 500), ("push", 500), ("push", 2000), ("push", 8000)):
        with simulate(scene, method="grid", contact=contact, dt=until / steps) as sim:
            sim.run(frames=steps)
            assert sim.absorbed.tolist() == gone.tolist()
            errors.append(float(np.abs(sim.state.position - exact.position)[~gone].max()))
    assert errors[0] < 1e-10, "contact impact is exact for one contact a step"
    assert errors[1] / errors[3] > 8, f"16 times shorter steps: errors {errors}"
    figures.note("absorbing", "exact", "error of push, dt / 16", "1/16", f"{errors[3] / errors[1]:.3f}", "")
