"""Emitters: which discs enter, when and where, whatever the step and the method; what is said while one waits."""

import contextlib
import signal
import warnings

import numpy as np
import pytest
from support.compare import assert_same_bits
from support.internals import solver_of
from support.scenes import simulate, state_after

import mpsim
from mpsim import Emitter, FixedDisc, InputError, Piston, Polyline
from mpsim.errors import EmitterWarning

pytestmark = [pytest.mark.plain, pytest.mark.filterwarnings("ignore::mpsim.FastWarning")]  # steps are long, by hand

NOBODY = {"position": np.zeros((0, 2)), "velocity": np.zeros((0, 2))}
BOX = {"width": 10, "height": 4, "radius": 0.25, **NOBODY}
ROOM = {"width": 60.0, "height": 60.0, "radius": 0.25, **NOBODY}
LEFT = (1.0, 2.0)


def scene_of(*emitters, **features):
    return mpsim.Scene(**{**ROOM, **features}, emitters=emitters)


# --- by frames


def entered(frames, *emitters, **scene):
    """Numbers of discs after each frame of 0.1."""
    with simulate(mpsim.Scene(**{**BOX, **scene}, emitters=emitters), method="naive", dt=0.1) as sim:
        return [sim.run(frames=1).frames and sim.count for _ in range(frames)]


def test_a_disc_enters_before_every_so_manieth_frame_until_the_limit():
    assert entered(10, Emitter(LEFT, (10, 0), every=3, limit=2)) == [0, 0, 0, 1, 1, 1, 2, 2, 2, 2]
    assert entered(5, Emitter(LEFT, (10, 0), every=2), Emitter((1, 1), (10, 0), every=3)) == [0, 0, 1, 2, 3]


def test_discs_beyond_a_periodic_border_occupy_a_place_and_those_that_have_left_none():
    blocked = {"position": [[9.9, 2]], "velocity": [[0, 0]], "boundary": ("periodic", "walls")}
    with pytest.warns(EmitterWarning):
        assert entered(4, Emitter((0.2, 2), (1, 0), every=1), **blocked) == [1] * 4
    left = {"position": [[9.5, 2]], "velocity": [[5, 0]], "absorbing": "right"}
    back = Emitter((9.5, 2), (-5, 0), every=2, limit=1)
    with simulate(mpsim.Scene(**{**BOX, **left}, emitters=back), method="naive", dt=0.1) as sim:
        sim.run(frames=4)  # where warnings are errors
        assert sim.absorbed.tolist() == [True, False]
        assert sim.state.position[1, 0] == pytest.approx(8.5)


@pytest.mark.parametrize("boundary", ["walls", "periodic"])
def test_of_many_that_enter_together_those_do_whose_place_is_free(boundary):
    """The twin compares each with all that are there."""
    places = np.random.default_rng(8).uniform(1, 29, (100, 2))
    box = {"width": 30, "height": 30, "radius": 1, "boundary": boundary, **NOBODY}
    spouts = [Emitter(place, (0, 0), every=1, limit=1) for place in places]
    taken = []
    for place in places:
        apart = np.abs(np.reshape(taken, (-1, 2)) - place)
        if boundary == "periodic":
            apart = np.minimum(apart, 30 - apart)
        if not (np.hypot(*apart.T) < 2).any():
            taken.append(place)
    with simulate(mpsim.Scene(**box, emitters=spouts), method="naive") as sim, warnings.catch_warnings():
        warnings.simplefilter("ignore", EmitterWarning)
        sim.run(frames=2)
        assert 40 < sim.count < 95
        assert np.array_equal(sim.state.position, taken)


# --- in time

JETS = (Emitter((10, 30), (4, 1), interval=0.25), Emitter((12, 10), (5, 3), interval=0.375, limit=5))
"""Two jets that neither meet each other nor reach a wall before time 4."""

STEPS = [("naive", 0.125), ("grid", 0.75), ("event", 0.025), ("event", 0.75)]


@pytest.mark.parametrize(("method", "dt"), STEPS)
def test_a_disc_enters_with_its_part_of_the_frame_done(method, dt):
    """Under `impact` a lone disc falls exactly, so that all places are those of closed form, p + v t + g t^2/2."""
    scene, g, counts = scene_of(*JETS, gravity=(0.3, -0.5)), np.array([0.3, -0.5]), []
    with simulate(scene, method=method, dt=dt, contact="impact") as sim:
        for time in (0.75, 1.5, 2.25, 3):
            sim.run(until=time)
            counts.append(sim.count)
        state = sim.state
    assert counts == [5, 10, 14, 17]
    flights = [(3 - k * jet.interval, index) for index, jet in enumerate(JETS) for k in range(1, (jet.limit or 12) + 1)]
    wanted = [
        np.append(np.array(JETS[i].position) + t * np.array(JETS[i].velocity) + t * t / 2 * g, JETS[i].velocity + t * g)
        for t, i in sorted(flights, key=lambda flight: (-flight[0], flight[1]))
    ]
    np.testing.assert_allclose(np.hstack([state.position, state.velocity]), wanted, rtol=0, atol=1e-12)
    late = [place[:2] - dt * place[2:] for place in wanted]  # as if each had waited for the next frame
    assert np.abs(state.position - late).max() > dt, "the control"


@pytest.mark.filterwarnings("ignore::mpsim.errors.EmitterWarning")
@pytest.mark.parametrize("timing", [{"every": 1}, {"interval": 0.2}])
def test_how_an_exact_run_is_cut_changes_no_bit_where_a_disc_waits(timing, tmp_path):
    """A place is looked at when it is time for it, not whenever a call ends."""
    jam = Emitter((5, 4), (0.4, 0.3), **timing)
    scene = mpsim.Scene.random(count=20, width=10, height=8, radius=0.3, seed=2, emitters=jam)
    expected = state_after(scene, 4, method="event", dt=0.5)
    with simulate(scene, method="event", dt=0.5) as sim:
        for piece in range(1, 3):
            sim.run(until=0.5 * piece)
        path = sim.save(tmp_path / "run")
    with mpsim.Simulation.resume(path) as sim:
        sim.run(until=2.0)
        assert_same_bits(sim.state, expected, f"{timing}, in pieces and resumed")
    if "interval" in timing:
        assert_same_bits(state_after(scene, 1, method="event", dt=2.0), expected, "in one frame")


@pytest.mark.parametrize(("method", "dt"), [("grid", 0.75), ("naive", 0.3), ("event", 0.125), ("event", 3.0)])
def test_a_disc_that_waits_tries_again_at_times_that_do_not_depend_on_the_step(method, dt):
    """The first enters at 0.25 and covers the place for 0.5 / 0.9; the next multiple of 0.25 / 8 is 0.8125."""
    with simulate(scene_of(Emitter((10, 30), (0.9, 0), interval=0.25)), method=method, dt=dt) as sim:
        with pytest.warns(EmitterWarning) as caught:
            sim.run(until=3)
        x = sim.state.position[:, 0]
    np.testing.assert_allclose(x, 10 + 0.9 * (3 - 0.25 - 0.5625 * np.arange(5)), rtol=0, atol=1e-12)
    waits = [warning for warning in caught if warning.category is EmitterWarning]  # beside the speed of the disc
    assert [str(warning.message) for warning in waits] == [
        "emitters[0] found its place (10.0, 30.0) occupied at time 0.5: its disc waits until the place is free. "
        "Give a larger `interval`, or a velocity that leads away."
    ]
    assert waits[0].filename == __file__


@pytest.mark.parametrize("method", ["naive", "event"])
def test_an_interrupt_while_a_disc_enters_lets_it_enter_once(method):
    """The signal comes where no timer of a test would hit: when a disc is in and the emitter does not know it yet."""
    with simulate(scene_of(JETS[0]), method=method, dt=0.5) as sim, simulate(scene_of(JETS[0]), dt=0.5) as other:
        solver = solver_of(sim)
        add = solver.add

        def interrupted(*discs):
            add(*discs)
            signal.raise_signal(signal.SIGINT)

        solver.add = interrupted
        for _ in range(100):
            with contextlib.suppress(KeyboardInterrupt):
                sim.run(until=3)
                break
        other.run(until=3)
        assert sim.time == 3
        assert sim.state.position == pytest.approx(other.state.position, abs=1e-12)


PEG = FixedDisc((2, 30), 0.5)


@pytest.mark.parametrize(
    ("features", "place"),
    [
        ({"width": 12}, 12 - 0.25),
        ({"obstacles": Polyline([(13, 20), (13, 40)], 0.2)}, 13 - 0.1 - 0.25),
        ({"width": 16, "piston": Piston("right", -2, 5)}, 16 - 2 * 1.0 - 0.25),
        ({"width": 12, "absorbing": "right"}, 12 - 0.25),
        ({"width": 12, "boundary": ("periodic", "walls"), "obstacles": PEG}, 2 - 0.5 - 0.25),
    ],
)
def test_a_flight_ends_where_it_meets_something_and_the_next_frame_begins_there(features, place):
    """Due at 0.1, in a frame that ends at 1, the disc would fly 7.2 far, through whatever there is."""
    scene = scene_of(Emitter((10, 30), (8, 0), interval=0.1, limit=1), **features)
    with simulate(scene, method="naive", dt=1.0) as sim:
        sim.run(frames=1)
        assert sim.state.position[0] == pytest.approx([place, 30], rel=1e-12)
        assert sim.state.velocity[0].tolist() == [8, 0]
        if "absorbing" in features:
            sim.run(frames=1)
            assert sim.absorbed.all()


# --- where there is no room


def test_an_emitter_that_the_piston_has_passed_waits_for_good_and_says_so():
    behind = {"piston": Piston("right", -10, 6), "emitters": Emitter((15, 5), (0, 9), every=3)}
    text = r"emitters\[0\] found no room before frame 6, and its disc waits: .* must lie in \[0.5, 13.5\] x"
    with simulate(mpsim.Scene(width=20, height=10, radius=0.5, **NOBODY, **behind), method="naive", dt=0.1) as sim:
        sim.run(frames=5)
        with pytest.warns(EmitterWarning, match=text):
            sim.run(frames=5)
        assert sim.count == 1


# --- what is refused


@pytest.mark.parametrize(
    ("features", "text"),
    [
        ({"radius": [0.5, 0.25]}, r"emitters\[0\] must have a radius, as each disc of the scene; got N"),
        ({"radius": 0.5, "mass": [1, 2]}, r"emitters\[0\] must have a mass, as each disc of the scene"),
        ({"radius": 3.5}, r"the position of emitters\[0\] must lie in \[3.5, 6.5\] x \[3.5, 6.5\]"),
    ],
)
def test_an_emitter_that_does_not_fit_the_scene_is_refused_by_name(features, text):
    with pytest.raises(InputError, match=r"either interval, .*got both, 0\.5 and 3\. Give one"):
        Emitter((1, 2), (1, 0), interval=0.5, every=3)
    discs = {"position": [[4, 4], [6, 6]], "velocity": np.zeros((2, 2)), "emitters": Emitter((1, 1), (0, 0), every=1)}
    with pytest.raises(InputError, match=text):
        mpsim.Scene(width=10, height=10, **{**features, **discs})
    mpsim.Scene(width=10, height=10, radius=0.5, obstacles=FixedDisc((0, 1), 0.5), **discs)  # which it touches


@pytest.mark.parametrize("method", ["naive", "event"])
def test_an_interval_in_which_a_frame_has_more_discs_than_a_scene_is_refused(method):
    scene = scene_of(Emitter((1, 2), (1, 0), interval=1e-12))
    with pytest.raises(InputError, match=r"interval of emitters\[0\] must be at least dt / 1e\+08, 1e-10 here"):
        mpsim.Simulation(scene, mpsim.Settings(dt=0.01, method=method))
