"""Discs too fast for their steps, too coarse for their numbers, or pressed into each other: told, refused, sub-stepped.

Each warning says what happens, and a run shows that it does; the same scene just below the bound is quiet.
"""

import re
import warnings
from itertools import pairwise

import numpy as np
import pytest
from support.scenes import gas, pair, simulate

import mpsim
from mpsim import (
    Circle,
    Emitter,
    FastWarning,
    FixedDisc,
    InputError,
    Piston,
    Polyline,
    Scene,
    Settings,
    Simulation,
    TooFastError,
    Translation,
)
from mpsim.errors import ResolutionWarning

pytestmark = pytest.mark.plain

NOBODY = {"position": np.zeros((0, 2)), "velocity": np.zeros((0, 2))}
WALL = {"width": 20, "height": 10, "radius": 0.5}


def one(place=(5, 5), velocity=(0, 0), **features):
    return Scene(**{**WALL, "position": [place], "velocity": [velocity], **features})


def row(**features):
    """Ten resting discs that divide the box."""
    return Scene(**WALL, position=[[10.0, 0.5 + i] for i in range(10)], velocity=np.zeros((10, 2)), **features)


def told(scene, text, **settings):
    """Require one warning of a scene at its start."""
    with pytest.warns(FastWarning, match=text):
        Simulation(scene, Settings(**settings)).close()


def quiet(scene, **settings):
    """Start a simulation, where warnings are errors."""
    Simulation(scene, Settings(method="grid", **settings)).close()


def refused(scene, frames, **settings):
    """Why a run is refused, and the frame that is done by then; None and all of them where it is not."""
    with Simulation(scene, Settings(**{"method": "grid", "on_fast": "error", **settings})) as sim:
        try:
            sim.run(frames=frames)
        except TooFastError as error:
            return str(error), sim.frame
    return None, frames


# --- at the start


def test_a_disc_that_moves_more_than_its_radius_is_told_with_number_disc_and_remedy():
    text = (
        r"in frame 0 disc 0 moves 1.2 times its radius 0.5 in one step \(speed 6, step 0.1\); beyond one radius, "
        r"discs may pass through each other without a collision. Use dt=0.042, substeps=3 or "
        r"on_fast='substep'; method='event' has no such limit."
    )
    told(pair(6.0), text, dt=0.1)
    quiet(pair(6.0), dt=0.042)
    quiet(pair(6.0), dt=0.1, substeps=3)
    quiet(pair(4.999), dt=0.1)  # just below the bound
    with Simulation(pair(6.0), Settings(dt=0.1, method="event")) as sim:
        sim.run(frames=1)


STARTS = [
    (one((0.6, 4), (1, 0), width=1.2), "1.5 times its free path 0.2 between the walls along x .* bounces", 0.3, 0.15),
    (gas(64, 0.75), r"a disc collides about [\d.]+ times in one step .* above 1 many", 0.05, 0.01),
]


@pytest.mark.parametrize(("scene", "text", "long", "short"), STARTS, ids=lambda value: str(value)[:20])
def test_what_is_fast_is_told_at_the_start_and_refused_by_error(scene, text, long, short):
    told(scene, text, dt=long, method="grid")
    with pytest.raises(TooFastError, match=text):
        Simulation(scene, Settings(dt=long, on_fast="error", method="grid"))
    quiet(scene, dt=short)


def test_what_is_no_danger_is_not_told():
    quiet(one((0.6, 4), (0, 1), width=1.2), dt=0.3)
    for scene in (gas(30, 0.4), gas(30, 0.4, gravity=(0, -1.0))):
        assert refused(scene, 60, on_fast="warn", dt=0.02) == (None, 60)


# --- on the way


@pytest.mark.parametrize(("on_fast", "passes"), [("warn", True), ("substep", False)])
def test_an_added_disc_that_would_pass_through_others_does_unless_frames_are_divided(on_fast, passes):
    with simulate(row(), on_fast=on_fast, contact="impact", method="grid", dt=0.01) as sim:
        with pytest.warns(FastWarning, match="disc 10") if passes else warnings.catch_warnings():
            sim.add((1, 5), (400, 0))
        assert sim.substeps == (1 if passes else 16)
        sim.run(frames=4)
        assert (sim.state.position[10, 0] > 11) == passes


def test_sub_steps_keep_every_frame_below_the_bound():
    scene, seen = gas(30, 0.3, restitution=0.5, wall_restitution=0.5), []
    with Simulation(scene, Settings(dt=0.4, method="grid", on_fast="substep")) as sim:
        for _ in range(48):
            sim.run(frames=1)
            assert np.hypot(*sim.state.velocity.T).max() * 0.4 / sim.substeps <= 0.5
            seen.append(sim.substeps)
    assert seen[0] > seen[-1] >= 1, "it takes fewer steps as the gas cools"
    assert all(a == b for frame, (a, b) in enumerate(pairwise(seen), 1) if frame % 16)


def test_the_smallest_disc_counts_for_what_gravity_adds():
    """In 16 frames it adds 64, and the smallest moves half its radius at most: 64 * 0.1 / 0.05 / 0.5 steps, and one for
    the speed of now."""
    discs = {"position": [[4, 80], [2, 80]], "velocity": [[1, 0], [0, 0]], "radius": [0.5, 0.05]}
    with simulate(Scene(width=9, height=90, **discs, gravity=(0, -40)), dt=0.1, on_fast="substep") as sim:
        sim.run(frames=1)
        assert sim.substeps == 257


@pytest.mark.parametrize(
    ("scene", "text"),
    [
        (pair(1e12), r"at most 10000 sub-steps, and would need 4e\+12\. Use a smaller dt"),
        (one(velocity=(1, 0), gravity=(0, -1e15)), r"a speed of 1\.6e\+16 within 16 frames of frame 0, with which it"),
        (pair(1.0, apart=0.1, side=1.2), "No number of sub-steps is enough"),
    ],
)
def test_what_would_need_absurdly_many_sub_steps_is_refused(scene, text):
    with pytest.raises(TooFastError, match=text):
        simulate(scene, dt=1.0, on_fast="substep")


def test_the_frame_in_which_a_disc_is_fast_is_the_one_that_is_told():
    """A disc between two walls that come nearer: each bounce adds twice the speed of the piston."""
    closing = one((3.6, 4), (2, 0), width=5, piston=Piston("right", -0.5, 1.5))
    how = {"dt": 0.05, "precision": "float32"}
    text, frame = refused(closing, 200, **how)
    told = int(re.search(r"in frame (\d+) disc 0 moves 1\.", text)[1])
    assert told in (frame - 1, frame)
    with simulate(closing, method="grid", contact="impact", **how) as sim:
        with pytest.warns(FastWarning, match=f"in frame {told} disc 0 moves 1.") as caught:
            sim.run(frames=frame + 1)
        assert len(caught) == 1
    with simulate(closing, method="event", dt=0.05) as sim:
        sim.run(frames=told)
        assert np.hypot(*sim.state.velocity[0]) * 0.05 > 0.5, "as is so"


@pytest.mark.parametrize(
    ("method", "contact", "radius"), [("naive", "impact", [0.5, 0.5]), ("grid", "push", [0.5, 0.4])]
)
def test_a_light_disc_that_a_heavy_one_meets_is_told_in_the_next_frame(method, contact, radius):
    discs = {"position": [[3, 5], [5, 5]], "velocity": np.zeros((2, 2)), "radius": radius, "mass": [1e4, 1]}
    with simulate(Scene(width=20, height=10, **discs), method=method, contact=contact) as sim:
        sim.set(0, velocity=(40, 0))
        with pytest.warns(FastWarning, match=r"in frame \d+ disc 1 moves (1\.6|2) times its radius") as caught:
            sim.run(frames=10)
        assert (sim.frame, len(caught), caught[0].filename) == (10, 1, __file__)


ON_THE_WAY = {
    "pushed by a piston": (one(piston=Piston("left", 30, 9)), {"dt": 0.01}),
    "from an emitter": (row(emitters=Emitter((1, 5), (400, 0), every=2)), {"dt": 0.01}),
    "in a heat bath": (one(thermostat=mpsim.Thermostat(400.0, 5.0)), {"dt": 0.1}),
    "by a fall": (one(gravity=(0, -2)), {"dt": 0.2}),
}


@pytest.mark.parametrize("name", ON_THE_WAY)
def test_what_becomes_fast_is_told_in_its_frame(name):
    scene, settings = ON_THE_WAY[name]
    text, frame = refused(scene, 60, **settings)
    assert re.search(r"in frame \d+ disc \d+ moves [\d.]+ times its radius", text)
    assert 0 < frame < 60


def test_a_piston_that_heats_a_gas_is_told_before_collisions_are_missed():
    box = {"width": 10, "height": 5, "temperature": 1.0, "seed": 0, "count": 16, "radius": 0.5}
    text, frame = refused(Scene.random(**box, piston=Piston("right", -2, 4.2)), 250, dt=0.02)
    assert "a disc collides about 1." in text
    assert 100 < frame < 150
    assert refused(Scene.random(**box, piston=Piston("right", -2, 8)), 150, dt=0.02) == (None, 150), "it stops early"


@pytest.mark.parametrize(
    ("settings", "features", "loses"),
    [
        ({"contact": "push", "dt": 0.02}, {}, True),
        ({"contact": "push", "dt": 0.002}, {}, True),
        ({"contact": "impact", "dt": 0.02}, {}, False),
        ({"contact": "push", "dt": 0.0005}, {}, False),
        ({"contact": "push", "dt": 0.02, "substeps": 40}, {}, False),
        ({"contact": "push", "dt": 0.02}, {"wall_restitution": 0.5}, False),
        ({"contact": "push", "dt": 0.02}, {"boundary": "periodic"}, False),
    ],
)
def test_contact_push_under_gravity_is_told_where_it_takes_energy(settings, features, loses):
    """From a disc that bounces without losses otherwise."""
    ball = Scene(width=10, height=10, position=[[5, 8.5]], velocity=[[0, 0]], radius=0.5, gravity=(0, -10), **features)
    if loses:
        text = r"contact='push' takes 0\.\d+ of its energy or more .* under gravity .* Use contact='impact'"
        told(ball, text, method="naive", **settings)
    else:
        Simulation(ball, Settings(method="naive", **settings)).close()  # warnings are errors


# --- pressed into each other

PRESSED = "discs are pressed into each other: at time"


def closing(restitution):
    """30 discs and a peg, to which a piston leaves packing 0.8: no bound excludes it, and no motion leads to it."""
    features = {"obstacles": FixedDisc((2, 3), 1.9), "piston": Piston("right", -0.5, 6.8)}
    lossy = {"restitution": restitution, "wall_restitution": restitution}
    return Scene.random(count=30, width=20, height=6, radius=0.5, seed=2, temperature=0.1, **features, **lossy)


def nearly(restitution, tmp_path, **settings):
    """A checkpoint shortly before they are pressed."""
    with simulate(closing(restitution), method="naive", dt=0.1, **{"on_fast": "error", **settings}) as sim:
        sim.run(until=8)
        return sim.save(tmp_path / "run")


@pytest.mark.parametrize("contact", ["impact", "push"])
def test_a_piston_that_presses_lossy_discs_is_refused_while_they_overlap_little(contact, tmp_path):
    """Nor does the place depend on how the run is cut."""
    path, ends = nearly(0.2, tmp_path, contact=contact), []
    for pieces in (1, 5):
        with Simulation.resume(path) as sim:
            for piece in range(pieces - 1):
                sim.run(until=8 + piece / 8)
            with pytest.raises(TooFastError, match=PRESSED) as caught:
                sim.run(until=20)
            assert "smaller steps and on_fast='substep' do not help" in str(caught.value)
            assert "on_fast='warn' runs it anyway" in str(caught.value)
            assert mpsim.measure.overlap(sim.state, sim.scene).largest < 0.3
            ends.append((sim.time, sim.digest()))
    assert ends[0] == ends[1]
    assert ends[0][0] < 10


def test_it_is_told_once_or_ends_the_run_as_often_as_the_warning_is_an_error(tmp_path):
    with Simulation.resume(nearly(0.2, tmp_path, on_fast="warn")) as sim:
        for _ in range(2):
            with pytest.raises(FastWarning, match=PRESSED):
                sim.run(until=18)
        with pytest.warns(FastWarning, match=PRESSED) as found:
            sim.run(until=18)
        assert (len(found), found[0].filename, sim.time) == (1, __file__, pytest.approx(18))


def test_a_disc_pressed_between_piston_and_obstacle_is_found():
    """Slow enough never to be fast: a lossy disc to which a wall leaves no place."""
    scene = Scene(
        width=20, height=6, position=[[5, 2], [8, 4]], velocity=[[0.1, 0], [0.2, 0.1]], radius=0.5,
        obstacles=Polyline([(6.2, 0), (6.2, 6)], 0.1), piston=Piston("right", -0.5, 6.9),
        restitution=0, wall_restitution=0,
    )  # fmt: skip
    text, _ = refused(scene, 600, method="naive", dt=0.05)
    assert PRESSED in text
    assert re.search(r"disc 1 is 0\.\d+ .*deep in obstacles\[0\]", text)


def between(other, stop, x=9.0, **features):
    """A disc of diameter 1 before a paddle that comes from the left and stops at a distance from another surface."""
    paddle = Polyline([(x - 1, 2), (x - 1, 8)], motion=Translation((0.5, 0), stop=stop))
    box = {"width": 20, "height": 10, "position": [[x, 5]], "velocity": [[0, 0]], "radius": 0.5}
    return Scene(**box, obstacles=[each for each in (paddle, other) if each], **features)


PINCHES = {
    "at rest": (Polyline([(11, 2), (11, 8)]), 9.0, "obstacles[1]"),
    "coming": (Polyline([(11.5, 2), (11.5, 8)], motion=Translation((-0.5, 0), stop=0.5)), 9.0, "obstacles[1]"),
    "container": (Circle((6, 5), 5, inside=True), 9.0, "obstacles[1]"),
    "wall": (None, 19.0, "the right wall"),
}


@pytest.mark.parametrize("restitution", [0.0, 1.0])
@pytest.mark.parametrize("contact", ["impact", "push"])
@pytest.mark.parametrize("name", PINCHES)
def test_a_disc_is_named_with_both_surfaces_before_they_press_it_through_one(name, contact, restitution):
    """To which they leave less than a diameter. The control: with more, it lives on where it is."""
    other, x, told = PINCHES[name]
    settings, room = {"method": "naive", "dt": 0.02, "contact": contact}, 3 - (other is None)
    with simulate(between(other, room, x, wall_restitution=restitution), on_fast="error", **settings) as sim:
        words = r"disc 0 is pinched between .* in frame \d+: one more step"
        words += "|what moves may press discs through an obst" * (restitution == 1)  # too fast before that
        with pytest.raises(TooFastError, match=words) as caught:
            sim.run(frames=500)
        named = set(re.findall(r"obstacles\[\d\]|the right wall", str(caught.value)))
        assert {"obstacles[0]", told} <= named or (restitution == 1 and not named)
        assert x - 1 + 0.5 * sim.time < sim.state.position[0, 0] < x - 1 + room
        assert room - 0.5 * sim.time < 1.5, "only where it is narrow"
    with simulate(between(other, room - 1.5, x, wall_restitution=restitution), on_fast="error", **settings) as sim:
        sim.run(frames=500)
        assert x - 1 + room - 1.5 < sim.state.position[0, 0] < x - 1 + room


@pytest.mark.parametrize("contact", ["impact", "push"])
@pytest.mark.parametrize("other", [Polyline([(11, 2), (11, 8)], 0.1), PINCHES["container"][0]], ids=["line", "circle"])
def test_a_disc_between_a_piston_and_what_is_at_rest_is_named_before_it_is_through(other, contact):
    scene = one((9, 5), obstacles=other, wall_restitution=0.8, piston=Piston("left", 2, 17, start=8))
    why, _ = refused(scene, 300, method="naive", dt=0.02, contact=contact)
    assert re.search(r"disc 0 is pinched between obstacles.0. and the left wall in frame 5", why or "")


def test_a_fast_disc_that_a_contact_has_put_on_a_surface_is_not_pinched():
    """Where it lies is in or out of it by rounding."""
    peg = FixedDisc((13, 5), 2, motion=Translation((-1, 0), stop=4))
    scenes = [one((9, 5 + k / 10), (21.5, 0), obstacles=peg) for k in range(5)]
    assert [refused(scene, 20, dt=0.02, contact="push") for scene in scenes] == [(None, 20)] * 5


def test_a_pinched_disc_is_warned_of_once_and_on_any_workers_in_the_same_frame(tmp_path):
    scene, told = between(PINCHES["at rest"][0], 3, wall_restitution=0.5), []
    for method, workers in (("naive", None), ("grid", None), ("parallel", 2)):
        with simulate(scene, method=method, workers=workers, dt=0.01) as sim:
            with pytest.warns(FastWarning, match="pinched between obstacles") as found:
                sim.run(frames=600)
            told.append(([str(each.message) for each in found], sim.digest()))
    assert told[0] == told[1] == told[2]
    assert len(told[0][0]) == 1


LINE = Polyline([(12, 0), (12, 6)])
PADDLE = Polyline([(8, 1), (8, 5)], motion=Translation((1, 0), stop=3.5))


@pytest.mark.parametrize(("contact", "restitution"), [("impact", 0.0), ("impact", 0.9), ("push", 0.0), ("push", 1.0)])
@pytest.mark.parametrize(
    ("discs", "moving"),
    [
        (2, {"obstacles": [LINE, PADDLE]}),
        (3, {"obstacles": LINE, "piston": Piston("left", 1, 11.2, start=8)}),
        (2, {"obstacles": [PADDLE, Polyline([(12, 1), (12, 5)], motion=Translation((-0.001, 0), stop=0.01))]}),
    ],
)
def test_discs_that_press_each_other_are_named_before_one_is_through(discs, moving, contact, restitution):
    places = [(11.3 - 1.01 * number, 3) for number in range(discs)]
    scene = mpsim.Scene(
        width=20, height=6, position=places, velocity=np.zeros((discs, 2)), radius=0.5, restitution=restitution,
        wall_restitution=restitution, **moving,
    )  # fmt: skip
    with simulate(scene, on_fast="error", method="naive", dt=0.01, contact=contact) as sim:
        with pytest.raises(TooFastError, match=r"pressed into each other|what moves may press discs through an obst"):
            sim.run(frames=600)
        places = sim.state.position[:, 0]
        assert (places < 12).all()
        assert (np.diff(places) < 0).all()


def test_a_crowd_under_a_lid_is_named_before_it_leaks_and_only_if_there_is_no_room():
    for stop in (6.0, 3.0):
        lid = Polyline([(0, 9), (10, 9)], motion=Translation((0, -0.5), stop=stop))
        crowd = mpsim.Scene.random(
            count=60, width=10, height=10, radius=0.4, inside=(0.4, 0.4, 9.6, 8.5), obstacles=lid, restitution=0.5,
            wall_restitution=0.5, gravity=(0, -1), seed=2, temperature=0.1,
        )  # fmt: skip
        with simulate(crowd, on_fast="error", dt=0.01, method="grid") as sim:
            if stop > 3:
                with pytest.raises(TooFastError, match="discs are pressed into each other: at time"):
                    sim.run(frames=1300)
            else:
                sim.run(frames=1300)
            assert (sim.state.position[:, 1] < 9 - min(0.5 * sim.time, stop)).all()


@pytest.mark.parametrize(("packing", "dt", "contact"), [(0.6, 0.05, "impact"), (0.7, 0.04, "push")])
def test_gases_with_the_longest_steps_that_pass_are_not_pressed(packing, dt, contact):
    """Their discs do overlap, by nearly a tenth of a radius, but no more than steps explain."""
    scene, deepest = gas(30, packing), 0.0
    with Simulation(scene, Settings(dt=dt, method="grid", contact=contact)) as sim:
        for _ in range(20):
            sim.run(frames=5)
            deepest = max(deepest, mpsim.measure.overlap(sim.state, scene).largest)
    assert deepest > 0.04, "the control"


# --- numbers too coarse


def test_what_the_precision_cannot_resolve_is_told_and_a_box_far_too_large_refused():
    far = pair(side=8000.0)
    with pytest.warns(ResolutionWarning, match=r"in float32 coordinates are 0.000954 apart .* 0.0019 of"):
        Simulation(far, Settings(dt=0.1, precision="float32")).close()
    quiet(far, dt=0.1)
    quiet(pair(side=800.0), dt=0.1, precision="float32")
    slow, swallowed = pair(1e-5, side=100.0), {"dt": 0.1, "precision": "float32", "method": "grid"}
    with pytest.warns(ResolutionWarning, match="most discs do not move at all. Use larger steps, or precision="):
        sim = Simulation(slow, Settings(**swallowed))
    with sim:
        sim.run(frames=5)
        assert sim.state.position.tolist() == slow.position.astype(np.float32).tolist(), "as is so"
    quiet(slow, dt=0.1)
    for scene, settings, text in (
        (pair(1.0, gravity=(0, -1e-15)), {"dt": 0.01, "method": "grid"}, "gravity changes a velocity by 1e-17 in a st"),
        (pair(radius=1e-9), {"dt": 0.1, "method": "event"}, "the square of the radius is lost"),
    ):
        with pytest.warns(ResolutionWarning, match=text):
            Simulation(scene, Settings(**settings)).close()
    text = r"radius must be at least 0.954 in a box of 1e\+06 x 1e\+06 in float32, .* got 0.5. Use precision='float64'"
    with pytest.raises(InputError, match=text):
        Simulation(pair(side=1e6), Settings(precision="float32"))


@pytest.mark.parametrize(
    ("scene", "settings", "text"),
    [
        (pair(1e-200), {"method": "event"}, "velocity must be at least 1e-100 for method='event', or all zero"),
        (pair(), {"dt": 1e20, "method": "event"}, "would take the fastest disc 5e+18 times through the box"),
        (one(velocity=(1e101, 0)), {"dt": 1e-95, "method": "event"}, "velocity[0] must be below 1e100"),
        (pair(mass=[1e-300, 1.0]), {"dt": 0.1}, "mass must be at least"),
        (one(velocity=(1e200, 0)), {"method": "grid"}, "squares fit"),
    ],
)
def test_numbers_that_a_run_could_not_hold_are_refused(scene, settings, text):
    with pytest.raises(InputError, match=re.escape(text)):
        Simulation(scene, Settings(**settings))


def test_the_number_of_cells_does_not_grow_with_the_aspect_of_a_box():
    scene = Scene(width=4e9, height=4.0, position=[[1, 2], [3e9, 2]], velocity=[[1, 0], [-1, 0]], radius=0.5)
    with Simulation(scene, Settings(dt=0.1, method="grid")) as sim:
        assert sim.run(frames=3).block_bytes < 2e6
    for width, height, radius in ((4e9, 4.0, 0.5), (1e6, 1e6, 0.5), (1e100, 1.0, [0.1, 0.2, 0.3])):
        assert Scene.random(count=3, width=width, height=height, radius=radius).count == 3
