"""Emission in time: the same discs at the same times for every step and method, each having flown since its own."""

import contextlib
import signal
import warnings

import numpy as np
import pytest
from support.checkpoints import rewrite
from support.compare import assert_same_bits
from support.scenes import simulate
from support.selection import long_but

import mpsim
from mpsim.engine import emission
from mpsim.engine.entry_flight import end_of_flight
from mpsim.engine.solvers import events

ROOM = {"width": 60.0, "height": 60.0, "position": np.zeros((0, 2)), "velocity": np.zeros((0, 2)), "radius": 0.25}

JETS = (
    mpsim.Emitter((10, 30), (4, 1), interval=0.25),
    mpsim.Emitter((12, 10), (5, 3), interval=0.375, limit=5),
)
"""Two jets that neither meet each other nor reach a wall before time 4."""


def scene_of(*emitters, **features):
    return mpsim.Scene(**{**ROOM, **features}, emitters=emitters)


def numbers(scene, dt, times, **settings):
    """Numbers of discs at some times."""
    with simulate(scene, dt=dt, **settings) as sim:
        found = []
        for time in times:
            sim.run(until=time)
            found.append(sim.count)
        return found


STEPS = [("naive", 0.125), ("naive", 0.025), ("naive", 0.75), ("event", 0.025), ("event", 0.75)]


@pytest.mark.parametrize(("method", "dt"), STEPS)
def test_as_many_discs_at_the_same_time_for_every_step_and_method(method, dt):
    scene = scene_of(*JETS, gravity=(0.3, -0.5))
    assert numbers(scene, dt, (0.75, 1.5, 2.25, 3), method=method) == [5, 10, 14, 17]


def test_emitters_that_count_frames_make_another_scene_for_each_step():
    scene = scene_of(mpsim.Emitter((10, 30), (4, 1), every=2), gravity=(0.3, -0.5))
    found = [numbers(scene, dt, (3,), method="naive") for dt in (0.125, 0.25)]
    assert found == [[11], [5]], "the control: every=2 is an interval of 0.25 or of 0.5"


@pytest.mark.parametrize(("method", "dt"), STEPS)
def test_a_disc_enters_with_its_part_of_the_frame_done(method, dt):
    """Under `impact` a lone disc falls exactly, so all places are those of closed form, p + v t + g t^2/2."""
    scene, g = scene_of(*JETS, gravity=(0.3, -0.5)), np.array([0.3, -0.5])
    with simulate(scene, method=method, dt=dt, contact="impact") as sim:
        sim.run(until=3)
        state = sim.state
    flights = [(3 - k * jet.interval, index) for index, jet in enumerate(JETS) for k in range(1, (jet.limit or 12) + 1)]
    wanted = [
        np.append(np.array(JETS[i].position) + t * np.array(JETS[i].velocity) + t * t / 2 * g, JETS[i].velocity + t * g)
        for t, i in sorted(flights, key=lambda flight: (-flight[0], flight[1]))
    ]
    np.testing.assert_allclose(np.hstack([state.position, state.velocity]), wanted, rtol=0, atol=1e-12)
    late = [place[:2] - dt * place[2:] for place in wanted]  # as if each had waited for the next frame
    assert np.abs(state.position - late).max() > dt, "the control"


BUSY = mpsim.Scene(
    width=12,
    height=9,
    position=[[6, 6], [3, 2], [9, 4]],
    velocity=[[1, -0.5], [-0.25, 0.75], [0.5, 0.5]],
    radius=0.4,
    gravity=(0, -0.5),
    restitution=0.95,
    emitters=[
        mpsim.Emitter((1, 4), (3, 1), interval=0.3, radius=0.3, mass=2),
        mpsim.Emitter((11, 5), (-1, 0.5), interval=0.45, limit=6),
    ],
)
"""Everybody meets, and the second emitter's discs, which need 0.72 to leave their place, have to wait."""


def ran(scene, until, pieces=1, **settings):
    with warnings.catch_warnings(), simulate(scene, contact="impact", **settings) as sim:
        warnings.simplefilter("ignore", mpsim.errors.EmitterWarning)
        collisions = sum(sim.run(until=until * k / pieces).collisions for k in range(1, pieces + 1))
        return sim.state, collisions


@pytest.mark.long
def test_the_exact_solver_has_the_same_bits_for_every_frame():
    """At 6, which is a whole number of all these frames, and in float64 the same number."""
    expected, collisions = ran(BUSY, 6.0, method="event", dt=1.0)
    assert collisions > 30
    assert len(expected.position) == 3 + 17 + 6, "of 19 that could have entered in time"
    for dt in (0.01, 0.125, 0.3, 2.0, 6.0):
        state, found = ran(BUSY, 6.0, method="event", dt=dt)
        assert_same_bits(state, expected, f"dt = {dt}")
        assert found == collisions, f"{found} collisions with dt = {dt}; {collisions} with dt = 1"
    other = ran(BUSY, 5.99, method="event", dt=0.01)[0]
    assert not np.array_equal(other.position, expected.position), "the control"


def test_what_the_walls_took_up_is_counted_over_a_stop_inside_a_frame():
    """Of a gas so thin that its pressure is that of the walls alone, in one frame and in sixty-four."""
    scene = scene_of(mpsim.Emitter((1, 30), (-7, 2), interval=0.5, limit=6), width=8)
    found = []
    for dt in (4.0, 0.0625):
        with simulate(scene, method="event", dt=dt) as sim:
            found.append(sim.run(until=4, measures=["pressure"]).measures["pressure"].value)
    assert found[0] == pytest.approx(found[1], rel=1e-12)
    assert found[0] > 0


@pytest.mark.long
def test_stepped_methods_agree_with_the_exact_solver(monkeypatch):
    """Frames that no interval is a multiple of. `impact` resolves one collision of a disc in a frame exactly."""
    until = 2.8
    exactly, collisions = ran(BUSY, until, method="event", dt=0.7)
    assert collisions >= 3

    def largest_error(dt):
        state, _ = ran(BUSY, until, method="naive", dt=dt)
        return np.abs(state.position - exactly.position).max()

    assert max(map(largest_error, (0.07, 0.007))) < 1e-9
    monkeypatch.setattr(
        emission, "end_of_flight", lambda scene, emitter, *_: end_of_flight(scene, emitter, 0.4, 0.0, 0.0)
    )
    assert largest_error(0.07) > 0.05, "the control: discs that enter where the frame ends, without a flight"


# --- waiting


@pytest.mark.parametrize(("method", "dt"), [*STEPS, ("naive", 0.3), ("event", 3.0)])
def test_a_disc_that_waits_tries_again_at_times_that_do_not_depend_on_the_step(method, dt):
    """The first enters at 0.25 and covers the place for 0.5 / 0.9; the next multiple of 0.25 / 8 is 0.8125."""
    scene = scene_of(mpsim.Emitter((10, 30), (0.9, 0), interval=0.25))
    with simulate(scene, method=method, dt=dt) as sim:
        with pytest.warns(mpsim.errors.EmitterWarning) as caught:
            sim.run(until=3)
        x = sim.state.position[:, 0]
    entered = 0.25 + 0.5625 * np.arange(5)
    np.testing.assert_allclose(x, 10 + 0.9 * (3 - entered), rtol=0, atol=1e-12)
    assert [str(warning.message) for warning in caught] == [
        "emitters[0] found its place (10.0, 30.0) occupied at time 0.5: its disc waits until the place is free. "
        "Give a larger `interval`, or a velocity that leads away."
    ]
    assert caught[0].filename == __file__


@pytest.mark.slow
@pytest.mark.parametrize("precision", long_but(["float64", "float32"], "float64"))
@pytest.mark.parametrize("pieces", [1, 20])
def test_workers_and_pieces_change_no_bit_while_discs_wait(pieces, precision):
    expected = ran(BUSY, 6.0, method="grid", dt=0.02, precision=precision)[0]
    found = ran(BUSY, 6.0, pieces, method="parallel", workers=2, dt=0.02, precision=precision)[0]
    assert_same_bits(found, expected, f"two workers, {pieces} pieces, {precision}")


@pytest.mark.parametrize("every", [False, True])
def test_how_the_exact_solver_is_cut_into_calls_changes_no_bit(monkeypatch, every):
    """A place is looked at when it is time for it, not whenever a call of the kernel ends."""
    timing = {"every": 1} if every else {"interval": 0.2}
    jam = mpsim.Emitter((5, 4), (0.4, 0.3), **timing)
    scene = mpsim.Scene.random(count=20, width=10, height=8, radius=0.3, seed=2, emitters=jam)
    expected = ran(scene, 6.0, method="event", dt=1.0)[0]
    for name in ("FEWEST_EVENTS", "SECONDS_AT_ONCE"):
        monkeypatch.setattr(events, name, 0.0 if name == "SECONDS_AT_ONCE" else 3)
    assert_same_bits(ran(scene, 6.0, 6, method="event", dt=1.0)[0], expected, f"{timing}, three events at once")


@pytest.mark.slow
@pytest.mark.parametrize(("method", "dt"), [("grid", 0.02), ("event", 0.1)])
def test_a_checkpoint_in_the_middle_of_waiting_changes_no_bit(tmp_path, method, dt):
    expected = ran(BUSY, 6.0, method=method, dt=dt)[0]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with simulate(BUSY, contact="impact", method=method, dt=dt) as sim:
            sim.run(until=2.6)
            assert any(due % 8 for due in sim._coordinator.emission.progress["due"]), "a disc waits"
            path = sim.save(tmp_path / "run")
        with mpsim.Simulation.resume(path) as sim:
            sim.run(until=6)
            assert_same_bits(sim.state, expected, "resumed")
            assert sim.scene.emitters == BUSY.emitters


def test_checkpoints_of_versions_without_intervals_are_read(tmp_path):
    """Their emitters have no such field, and one that waits was due at a frame of the past."""
    slow = mpsim.Emitter((10, 30), (1, 0), every=2)
    with simulate(scene_of(slow), method="naive", dt=0.1) as sim:
        with pytest.warns(mpsim.errors.EmitterWarning):
            sim.run(frames=6)
        path = sim.save(tmp_path / "run")
        sim.run(frames=20)
        expected = sim.state

    def as_it_was(header, arrays):
        (emitter,) = header["scene"]["emitters"]
        del emitter[1]["interval"]
        assert header["run"]["emission"] == {"emitted": [1], "due": [6]}
        header["run"]["emission"]["due"] = [4]

    rewrite(path, as_it_was)
    with mpsim.Simulation.resume(path) as sim:
        with pytest.warns(mpsim.errors.EmitterWarning):
            sim.run(frames=20)
        assert_same_bits(sim.state, expected, "resumed from an old checkpoint")


@pytest.mark.parametrize("method", ["naive", "event"])
def test_an_interrupt_while_a_disc_enters_lets_it_enter_once(method):
    scene = scene_of(JETS[0])
    with simulate(scene, method=method, dt=0.5) as sim:
        add = sim._solver.add

        def interrupted(*discs):
            add(*discs)
            signal.raise_signal(signal.SIGINT)

        sim._solver.add = interrupted
        for _ in range(100):
            with contextlib.suppress(KeyboardInterrupt):
                sim.run(until=3)
                break
        else:
            pytest.fail("the run does not come to its end")
        found = sim.state
    with simulate(scene, method=method, dt=0.5) as sim:
        sim.run(until=3)
        assert_same_bits(found, sim.state, "interrupted whenever a disc enters")


# --- flights that meet something


@pytest.mark.slow
@pytest.mark.parametrize(
    ("features", "place"),
    [
        ({"width": 12}, 12 - 0.25),
        ({"obstacles": mpsim.Polyline([(13, 20), (13, 40)], 0.2)}, 13 - 0.1 - 0.25),
        ({"obstacles": mpsim.FixedDisc((14, 30), 0.5)}, 14 - 0.5 - 0.25),
        ({"width": 16, "piston": mpsim.Piston("right", -2, 5)}, 16 - 2 * 1.0 - 0.25),
        ({"width": 12, "absorbing": "right"}, 12 - 0.25),
        ({"width": 12, "boundary": ("periodic", "walls")}, (10 + 8 * 0.9) % 12),
        pytest.param(
            {"width": 12, "boundary": ("periodic", "walls"), "obstacles": mpsim.FixedDisc((2, 30), 0.5)},
            2 - 0.5 - 0.25,
            marks=pytest.mark.long,
        ),
    ],
)
def test_a_flight_ends_where_it_meets_something_and_the_next_frame_begins_there(features, place):
    """Due at 0.1, in a frame that ends at 1, the disc would fly 7.2 far, through whatever there is."""
    scene = scene_of(mpsim.Emitter((10, 30), (8, 0), interval=0.1, limit=1), **features)
    with simulate(scene, method="naive", dt=1.0) as sim:
        sim.run(frames=1)
        state = sim.state
        assert state.position[0] == pytest.approx([place, 30], rel=1e-12)
        assert state.velocity[0].tolist() == [8, 0]
        if "absorbing" in features:
            sim.run(frames=1)
            assert sim.absorbed.all()


# --- what is refused


@pytest.mark.parametrize(
    ("timing", "text"),
    [
        ({}, "must have either interval, the time between two discs, or every, .*got neither. Give one of them."),
        ({"interval": 0.5, "every": 3}, "either interval, .*got both, 0.5 and 3. Give one of them."),
        ({"interval": 0}, r"interval of an Emitter must be a finite number > 0 \[time\]; got 0"),
        ({"interval": -0.5}, r"interval of an Emitter must be a finite number > 0 \[time\]; got -0.5"),
        ({"interval": float("nan")}, r"interval of an Emitter must be a finite number > 0 \[time\]; got nan"),
        ({"interval": float("inf")}, r"interval of an Emitter must be a finite number > 0 \[time\]; got inf"),
        ({"interval": "often"}, r"interval of an Emitter must be a number > 0 \[time\]; got 'often'"),
        ({"every": 0.5}, "every of an Emitter must be a whole number from 1"),
    ],
)
def test_an_emitter_without_a_right_time_is_refused(timing, text):
    with pytest.raises(mpsim.InputError, match=text):
        mpsim.Emitter((1, 2), (1, 0), **timing)


@pytest.mark.parametrize("method", ["naive", "event"])
def test_an_interval_in_which_a_frame_has_more_discs_than_a_scene_is_refused(method):
    scene = scene_of(mpsim.Emitter((1, 2), (1, 0), interval=1e-12))
    with pytest.raises(mpsim.InputError, match=r"interval of emitters\[0\] must be at least dt / 1e\+08, 1e-10 here"):
        mpsim.Simulation(scene, mpsim.Settings(dt=0.01, method=method))


def test_the_emitters_of_a_digest_are_those_of_before():
    """As text: with a key that the emitter does not have, digests of older scenes would be others."""
    emitter = mpsim.Emitter((1, 2), (1, 0), every=np.int64(3))
    assert (
        repr(emitter)
        == "Emitter(position=(1.0, 2.0), velocity=(1.0, 0.0), every=3, limit=None, radius=None, mass=None)"
    )
