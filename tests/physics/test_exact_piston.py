"""The exact solver with a wall that moves: closed forms of one disc, and the stepped solver as its step shrinks."""

import math
import re

import numpy as np
import pytest
from support.scenes import simulate
from support.selection import long_but
from support.tiles import on_tiles

import mpsim
from mpsim import Piston
from mpsim.core.state import State
from mpsim.measure import observables

pytestmark = pytest.mark.slow


def exactly(scene, dt=1.0, **settings):
    return mpsim.Simulation(scene, mpsim.Settings(method="event", dt=dt, **settings))


def one(position, velocity, piston, width=11.0, height=3.0, **features):
    return mpsim.Scene(width=width, height=height, position=[position], velocity=[velocity], radius=0.5,
                       piston=piston, **features)  # fmt: skip


# --- closed forms


@pytest.mark.parametrize("wall", ["left", "right", "bottom", "top"])
def test_a_disc_between_a_wall_and_a_piston_keeps_its_adiabatic_invariant(wall, figures):
    """At each impact L (v - V) is the same: L_n = L_0 (v_0 - V) / (v_n - V), v_n = v_0 + 2 n V."""
    start, v, speed, bounces = 10.0, 3.0, 0.25, 9
    sign, across = (1 if wall in ("left", "bottom") else -1), wall in ("bottom", "top")
    stop = 11.0 - 1.5 if sign > 0 else 1.5
    place, velocity = [6.0, 1.5], [-3.0 * sign, 0.4]  # on its way to the piston
    size = {"width": 11.0, "height": 3.0}
    if across:
        place, velocity, size = place[::-1], velocity[::-1], {"width": 3.0, "height": 11.0}
    gap = 5.5 if sign > 0 else 4.5
    until = gap / (v + speed)  # when it first meets it, at L_0
    first = start - speed * until
    lengths = [first * (v + speed) / (v + (2 * n + 1) * speed) for n in range(bounces + 1)]
    until += (first - lengths[-1]) / speed
    with exactly(one(place, velocity, Piston(wall, sign * speed, stop), **size), dt=until + 1e-9) as sim:
        sim.run(frames=1)
        found = sim.state
    after = v + 2 * (bounces + 1) * speed
    axis = int(across)
    assert found.velocity[0, axis] == pytest.approx(sign * after, rel=1e-13)
    assert abs(found.velocity[0, 1 - axis]) == 0.4
    edge = ("left", "right", "bottom", "top").index(wall)
    centre = found.box[edge] + sign * 0.5
    assert abs(found.position[0, axis] - centre) < 1e-7
    # And a disc of half that time has had fewer impacts: the control.
    assert abs(sign * after - sign * v) > 1
    figures.note("piston", "exact", f"speed after {bounces + 1} impacts, {wall}", after, after, "v - 2 V: 10 % less")


@pytest.mark.long
def test_a_ball_on_a_floor_that_rises_bounces_as_on_one_at_rest_and_then_as_on_it(figures):
    gravity, rise, height, stop = 1.0, 0.2, 1.0, 1.0
    relative = math.sqrt(rise**2 + 2 * gravity * height)
    period = 2 * relative / gravity
    scene = one((2.0, 0.5 + height), (0.0, 0.0), Piston("bottom", rise, stop), width=4.0, height=20.0,
                gravity=(0, -gravity))  # fmt: skip
    first = (relative - rise) / gravity
    with exactly(scene, dt=first + period / 2) as sim:  # the top of a bounce, as the floor sees it
        sim.run(frames=1)
        assert sim.state.velocity[0, 1] == pytest.approx(rise, abs=1e-13)
        top = rise * (first + period / 2) + 0.5 + relative**2 / 2
        error = abs(sim.state.position[0, 1] - top)
        assert error < 1e-13
    # The floor stops at 5, in the second bounce; what the ball then has it keeps.
    with exactly(scene, dt=20.0) as sim:
        sim.run(frames=1)
        found = sim.state
    assert first + period < 5 < first + 2 * period
    energy = 0.5 * (relative + rise) ** 2 + gravity * rise * (first + period)
    assert 0.5 * found.velocity[0, 1] ** 2 + gravity * (found.position[0, 1] - 0.5) == pytest.approx(energy, rel=1e-13)
    figures.note("rising floor", "exact", "height of a bounce", f"{top:.6f}", f"{top + error:.6f}", "at rest: -1.0")


def test_a_piston_sweeps_up_discs_at_rest_at_twice_its_speed_and_not_after_its_stop():
    position = [[3.0, 1.0], [6.0, 3.0], [9.5, 5.0]]
    scene = mpsim.Scene(width=12, height=6, position=position, velocity=np.zeros((3, 2)), radius=0.5,
                        piston=Piston("left", 1.0, 6.0))  # fmt: skip
    with exactly(scene, dt=5.8) as sim:
        sim.run(frames=1)
        assert sim.state.velocity.tolist() == [[2.0, 0.0], [2.0, 0.0], [0.0, 0.0]]
        assert sim.state.position[:2, 0] == pytest.approx([3.0 + 2 * 3.3, 6.0 + 2 * 0.3], abs=1e-12)
        assert sim.state.box == (5.8, 12.0, 0.0, 6.0)
    with exactly(scene, dt=30.0) as sim:
        sim.run(frames=1)
        assert sim.state.box == (6.0, 12.0, 0.0, 6.0)
        assert (sim.state.velocity**2).sum() == 8.0
        assert sim.state.position[:, 0].min() >= 6.5


def test_a_disc_that_is_on_the_wall_when_it_stops_stays_inside():
    """Slow discs in contact at the moment of the stop, at many places: none is lost behind it."""
    for part in np.linspace(0.0, 1.0, 41):
        scene = one((2.5 + part, 1.5), (0.0, 0.0), Piston("left", 0.5, 3.0 - part * 1e-16))
        with exactly(scene, dt=40.0) as sim:
            sim.run(frames=1)
            assert 3.5 - 1e-12 <= sim.state.position[0, 0] <= 10.5


# --- no room


WEDGE = mpsim.Polyline([[5, 1], [3, 3], [5, 5]], thickness=0.4)
ACROSS = mpsim.Polyline([[2, 0], [2, 6]], thickness=0.4)


def pressed(stop, position=(6.0, 3.0), velocity=(0.1, 0.03), **features):
    """A piston that comes from the right at a speed of 0.5, until it is at `stop`."""
    return one(position, velocity, Piston("right", -0.5, stop), width=12.0, height=6.0, **features)


@pytest.mark.parametrize("losses", long_but([1.0, 0.5, 0.0], 1.0))
@pytest.mark.parametrize(
    ("features", "at"),
    [({"obstacles": ACROSS}, 3.2), ({"obstacles": WEDGE, "velocity": (0.0, 0.0)}, 4.49), ({"stop": 1.0}, 1.0)],
    ids=["before an obstacle", "in a wedge", "before a wall"],
)
@pytest.mark.filterwarnings("ignore::mpsim.errors.GuardWarning")
def test_a_disc_that_is_crushed_is_an_error_that_names_it_and_what_to_do(features, at, losses):
    """As before: it met both without end, some 10 s later a collapse at one instant, or never."""
    scene = pressed(**{"stop": 2.0, "wall_restitution": losses, **features})
    if losses == 0 and "stop" in features:  # it is pushed along without a bounce, and fits just in
        with exactly(scene, dt=0.5) as sim:
            sim.run(frames=60)
            assert sim.state.position[0, 0] == pytest.approx(0.5, abs=1e-12)
        return
    with exactly(scene, dt=0.5) as sim, pytest.raises(mpsim.errors.StalledError) as caught:
        sim.run(frames=60)
    found = re.match(
        r"disc 0 is crushed in frame \d+: the piston, now at (.*) and on its way to [12], leaves it no room before an "
        r"obstacle, a wall or other discs, and has driven it to a speed of 5[.\d]*e\+03, more than 10000 times any at "
        r"the start\. Let the piston stop earlier, or make room for the discs before it\.$",
        str(caught.value),
    )
    assert found, caught.value
    assert float(found[1]) == pytest.approx(at, abs=0.01)


def test_where_it_stops_a_hundredth_earlier_a_disc_lives_on():
    """Negative control: in a gap that shrinks to a thousandth it becomes a thousand times as fast, and stays so."""
    with exactly(pressed(3.21, (6.0, 3.0), (-1.0, 0.0), obstacles=ACROSS), dt=0.5) as sim:
        sim.run(frames=60)
        assert 100 < abs(sim.state.velocity[0, 0]) < 2000
        assert 2.7 <= sim.state.position[0, 0] <= 2.71 + 1e-12


def test_a_fast_disc_that_is_added_is_not_taken_for_one_that_is_crushed(tmp_path):
    """A hundred thousand times as fast as all at the start, also after the run was saved."""
    with exactly(pressed(5.0), dt=0.001) as sim:
        sim.run(frames=1)
        sim.add((8.0, 1.0), (5e4, 0.0))
        assert sim.run(frames=1).frames == 1
        sim.save(tmp_path / "fast")
    with mpsim.Simulation.resume(tmp_path / "fast") as sim:
        assert sim.run(frames=1).frames == 1
        assert np.abs(sim.state.velocity).max() >= 5e4


@pytest.mark.long
@pytest.mark.parametrize("workers", [1, 2])
def test_discs_are_crushed_alike_on_tiles(workers):
    """The same disc, place and speed on tiles and as a whole."""
    place = np.stack(np.meshgrid(np.arange(30) * 1.2 + 2.2, np.arange(40) * 1.2 + 0.8), -1).reshape(-1, 2)
    velocity = np.random.default_rng(1).normal(size=place.shape)
    place, velocity = np.append(place, [[58.5, 24.5]], axis=0), np.append(velocity, [[0.0, 0.0]], axis=0)
    scene = mpsim.Scene(width=60, height=49, radius=0.5, position=place, velocity=velocity,
                        obstacles=mpsim.Polyline([[57, 20], [57, 29]], thickness=0.2),
                        piston=Piston("right", -1.0, 50.0))  # fmt: skip
    texts = []
    for tiling, number in (((1, 1), 1), ((2, 1), workers)):
        with on_tiles(scene, tiling, number, dt=0.25) as sim, pytest.raises(mpsim.errors.StalledError) as caught:
            sim.run(frames=200)
        texts.append(str(caught.value))
    assert texts[0] == texts[1]
    assert re.match("disc 1200 is crushed in frame 7: the piston, now at 58.1 ", texts[0])


def until_crushed(sim, frames):
    """The error that ends a run."""
    with pytest.raises(mpsim.errors.StalledError, match="is crushed") as caught:
        sim.run(frames=frames)
    return str(caught.value)


def test_a_disc_that_is_fast_already_when_a_run_is_saved_is_crushed_at_the_same_event(tmp_path):
    """What counts as crushed follows from the start, not from the discs that are there when a run is resumed."""
    scene, dt = pressed(2.0, obstacles=ACROSS), 1 / 64
    with exactly(scene, dt=dt) as sim:
        expected = until_crushed(sim, 2000)
    last = int(re.findall(r"frame (\d+)", expected)[0])
    with exactly(scene, dt=dt) as sim:
        sim.run(frames=last)
        assert np.abs(sim.state.velocity).max() > 10 * np.abs(scene.velocity).max()
        sim.save(tmp_path / "run")
    with mpsim.Simulation.resume(tmp_path / "run") as sim:
        assert until_crushed(sim, 2000) == expected


# --- many discs


def crowd(gravity=None, **features):
    return mpsim.Scene.random(count=40, width=14, height=10, radius=0.4, seed=3, gravity=gravity,
                              **{"piston": Piston("right", -0.5, 11.0), **features})  # fmt: skip


@pytest.mark.parametrize("gravity", [None, pytest.param((0.3, -1.0), marks=pytest.mark.long)])
def test_no_disc_is_ever_behind_the_piston_and_it_works_on_the_gas(gravity):
    scene = crowd(gravity)
    with exactly(scene, dt=0.5) as sim:
        before = (sim.state.velocity**2).sum()
        for _ in range(20):
            sim.run(frames=1)
            state = sim.state
            assert (state.position[:, 0] <= state.box[1] - 0.4).all()
            assert state.box[1] == max(14 - 0.5 * sim.time, 11.0)
            assert observables.overlap(state, scene).largest < 1e-12
        assert gravity or (sim.state.velocity**2).sum() > 1.2 * before
        later = scene.starting_from(sim.state)
    with exactly(later) as sim:
        assert sim.state.box[1] == 11.0


def test_a_run_goes_back_when_the_piston_does():
    """Reversed velocities, and a wall that leaves: not to be had, so the piston first stops."""
    scene = crowd(piston=Piston("right", -0.5, 13.5))
    with exactly(scene) as sim:
        sim.run(until=2.0)
        rest = scene.starting_from(sim.state)
    with exactly(rest) as there:
        assert there.run(until=1.0).collisions > 10
        state = there.state
    with exactly(rest.starting_from(State(state.position, -state.velocity, box=state.box))) as back:
        back.run(until=1.0)
        assert observables.trajectory_error(back.state, State(rest.position, rest.velocity), rest).largest < 1e-9


@pytest.mark.parametrize("contact", ["impact", "push"])
def test_the_stepped_solver_comes_to_it_as_its_step_shrinks(contact, figures):
    scene, until = crowd((0.3, -1.0)), 1.0
    with exactly(scene, dt=until) as sim:
        sim.run(frames=1)
        exact = sim.state
    errors = []
    for steps in (200, 800, 3200):
        with simulate(scene, method="grid", contact=contact, dt=until / steps) as sim:
            sim.run(frames=steps)
            errors.append(observables.trajectory_error(sim.state, exact, scene).rms)
    if contact == "impact":  # which is exact for one contact a step
        assert max(errors) < 1e-10
    else:
        assert errors[0] / errors[2] > 8, f"16 times shorter steps: errors {errors}"
    # Negative control: a piston that is faster by a tenth.
    with exactly(crowd((0.3, -1.0), piston=Piston("right", -0.55, 11.0)), dt=until) as sim:
        sim.run(frames=1)
        assert observables.trajectory_error(sim.state, exact, scene).rms > 5 * errors[2]
    figures.note(
        "piston", "exact", f"rms error of {contact}, dt / 16", "1/16", f"{errors[2] / errors[0]:.3f}", "V + 10 %"
    )


def test_a_piston_stops_at_the_same_time_however_long_the_laps_and_frames_are():
    ends = []
    for dt in (0.01, 0.37, 8.0):
        with exactly(crowd(), dt=dt) as sim:
            sim.run(until=8.0)
            ends.append(sim.digest() if sim.time == 8.0 else "")
    assert ends[0] == ends[2] != ""
