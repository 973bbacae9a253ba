"""What `event` refuses, as it has no exact answer; how it stops, grows and ties; the guard that ends endless losses."""

import itertools
import math

import numpy as np
import pytest
from support.compare import assert_same_bits
from support.refusals import assert_refused
from support.scenes import digest_after, lattice, simulate, state_after

from mpsim import InputError, Polyline, Scene
from mpsim.errors import GuardWarning, StalledError

pytestmark = pytest.mark.plain

PAIR = {"width": 9, "height": 9, "position": [[2, 2], [6, 6]], "radius": 0.5}
OVERLAPPING = [[1, 1], [1.9, 1], [5, 5], [5.5, 5]]


@pytest.mark.parametrize(
    ("scene", "settings", "parts"),
    [
        (lattice(3, 3), {"precision": "float32"}, ["precision='float32'", "Leave it out"]),
        (lattice(3, 3), {"unguarded": True}, ["unguarded=True", "Leave it out"]),
        (Scene(**PAIR, velocity=np.zeros((2, 2)), acceleration=np.ones((2, 2))), {}, ["acceleration per disc"]),
        (
            Scene(width=8, height=8, position=OVERLAPPING, velocity=np.zeros((4, 2)), radius=0.5),
            {}, ["do not overlap", "discs 2 and 3 overlap by 0.5", "Move them apart"],
        ),
    ],
    ids=["float32", "unguarded", "acceleration", "overlap"],
)  # fmt: skip
def test_a_scene_that_has_no_exact_solution_is_refused_by_name(scene, settings, parts):
    assert_refused(["method='event'", "method='grid'", *parts], simulate, scene, method="event", **settings)
    with simulate(scene, method="grid", **settings) as sim:  # the control
        sim.run(frames=1)


@pytest.mark.parametrize(("gap", "legal"), [(0.0, True), (-1e-13, True), (-1e-9, False)])
def test_touching_discs_are_no_overlap(gap, legal):
    """A depth of rounding is taken, a depth that any measuring would find is not."""
    scene = Scene(width=9, height=9, position=[[2, 2], [3 + gap, 2]], velocity=[[1, 0], [0, 0]], radius=0.5)
    if not legal:
        with pytest.raises(InputError, match="discs 0 and 1 overlap by 1e-09"):
            simulate(scene, method="event")
        return
    with simulate(scene, method="event", dt=0.1) as sim:
        assert sim.run(frames=1).collisions == 1


def kinetic(velocity):
    return (np.asarray(velocity) ** 2).sum()


def test_a_touching_packing_runs_and_keeps_its_energy():
    """A triangular one, of which rounding has put the discs into each other, and a jammed corner of sixteen."""
    rng = np.random.default_rng(16)
    rows = [[1.0 + i + 0.5 * (j % 2), 1.0 + j * math.sqrt(0.75)] for j in range(5) for i in range(5)]
    corner = [[0.5 + i, 0.5 + j] for j in range(4) for i in range(4)]
    for place, size, until in ((np.array(rows) * (1 - 1e-13), 9.0, 2.0), (corner, 4.0 + 1e-9, 1e-9)):
        velocity = rng.normal(size=(len(place), 2))
        scene = Scene(width=size, height=size, position=place, velocity=velocity, radius=0.5)
        with simulate(scene, method="event", dt=until) as sim:
            assert sim.run(frames=1).collisions > 30
            state = sim.state
        assert kinetic(state.velocity) == pytest.approx(kinetic(velocity), rel=1e-11)
        r = state.position[:, None] - state.position[None]
        assert (np.hypot(r[..., 0], r[..., 1]) + 9.0 * np.eye(len(place))).min() > 1.0 - 1e-10


def test_ties_break_the_same_way_every_time():
    """Rows of discs in step: a whole lattice of impacts at the same instants, in pieces or at once, early or late."""
    place = np.array(list(itertools.product(2.0 * np.arange(4) + 1.5, repeat=2)))
    velocity = np.where((np.indices((4, 4)).sum(0) % 2).reshape(-1, 1) == 0, [1.0, 0.0], [-1.0, 0.0])
    scene = Scene(width=9, height=9, position=place, velocity=velocity, radius=0.5)
    digests = set()
    for dt, pieces in ((16.0, 1), (4.0, 4), (0.5, 32)):
        with simulate(scene, method="event", dt=dt) as sim:
            contacts = sum(sim.run(frames=1).collisions for _ in range(pieces))
            digests.add((contacts, sim.digest()))
    assert len(digests) == 1
    assert contacts > 50


def test_a_refused_disc_changes_nothing():
    """The scene is so dilute that more discs would have other cells."""
    scene = Scene(width=40, height=40, position=[[2, 2], [30, 9.3]], velocity=[[1.3, 0.2], [-2, 1]], radius=0.5)
    many = 8 + 2.0 * np.array(list(itertools.product(range(9), repeat=2)))
    with simulate(scene, method="event", dt=1.7) as sim, simulate(scene, method="event", dt=1.7) as other:
        for each in (sim, other):
            each.run(frames=20)
        many[-1] = sim.state.position[1] + [0.3, 0]
        with pytest.raises(InputError, match="do not overlap; discs 1 and 82"):
            sim.add(many, np.zeros((81, 2)))
        with pytest.raises(InputError, match="discs 0 and 1 overlap"):
            sim.set(0, position=sim.state.position[1] + [0.3, 0])
        assert sim.count == 2
        found = [each.run(frames=60, measures=["pressure"]).measures["pressure"].value for each in (sim, other)]
        assert_same_bits(sim.state, state_after(scene, 80, method="event", dt=1.7), "after a refused growth")
        assert found[0] == pytest.approx(found[1], rel=1e-12)


# --- the guard and its contact time


def ball(height=1.5, pull=1.0, **features):
    box = {"width": 9, "height": 9, "position": [[4, height]], "velocity": [[0, 0]], "radius": 0.5}
    return Scene(**{**box, "gravity": (0, -pull), "wall_restitution": 0.5, **features})


def dropped(until=4.243, **settings):
    """A ball dropped on the floor, until it is at rest: the report and its height."""
    with simulate(ball(), method="event", dt=until, **settings) as sim, pytest.warns(GuardWarning):
        return sim.run(frames=1), sim.state.position[0, 1]


def test_a_disc_at_rest_hovers_in_bounces_of_the_contact_time():
    """It comes to rest after sqrt(2) (1 + 2 e / (1 - e)) = 4.243, and bounces for the rest of the time."""
    usual, height = dropped()
    assert usual.contact_time == pytest.approx(1e-6 * 0.5 / math.sqrt(0.5), rel=1e-12)
    assert usual.guarded > 50
    again, same = dropped(contact_time=usual.contact_time)
    assert (again.guarded, same) == (usual.guarded, height)
    report, height = dropped(contact_time=1e-2, until=4.5)
    assert report.contact_time == 1e-2
    bounces = (4.5 - 3 * math.sqrt(2)) / 1e-2
    assert 0.8 * bounces < report.guarded < 2.2 * bounces + 3  # in each, once or twice
    assert 0.5 <= height <= 0.5 + 1e-2**2 / 8 * (1 + 1e-9)


def test_the_guard_is_told_once_in_a_simulation():
    with simulate(ball(0.5), method="event", dt=0.1, contact_time=0.01) as sim:
        with pytest.warns(GuardWarning, match="This is said once; report.guarded counts"):
            first = sim.run(frames=1)
        assert first.guarded > 1 < sim.run(frames=1).guarded, "and the second time there is no warning"


def test_a_contact_time_that_throws_discs_at_rest_higher_than_their_radius_is_refused():
    with simulate(ball(0.5, wall_restitution=1.0), method="event", dt=1.0, contact_time=2.0) as sim:
        with pytest.warns(GuardWarning):
            sim.run(frames=1)
        assert sim.state.position[0, 1] == pytest.approx(1.0, abs=0.01), "the control: thrown by its radius"
    message = (
        r"contact_time must be at most 2 in this scene: .* bounce higher than their radius, 0\.5; got 2\.01\. Give"
    )
    with pytest.raises(InputError, match=message):
        simulate(ball(0.5), method="event", contact_time=2.01)
    with (
        simulate(ball(0.5, pull=0.0), method="event", contact_time=2.01) as sim,
        pytest.raises(InputError, match=r"contact_time must be at most 1\.41 in this scene"),
    ):
        sim.change(gravity=(0.0, -2.0))


def test_an_elastic_gas_has_no_contact_time():
    with simulate(lattice(3, 3), method="event", contact_time=0.125) as sim:
        assert sim.run(frames=1).contact_time == 0.0
        assert sim.digest() == digest_after(lattice(3, 3), 1, method="event")


# --- collisions without end


def gap(room, restitution):
    """A disc runs into a gap between a wall and the end of an obstacle which is as wide as itself, and some more."""
    end = Polyline([[1 + room, 12], [7, 10.1]], thickness=0.0)
    box = {"width": 15, "height": 14, "position": [[0.6, 9]], "velocity": [[-0.1, 1]], "radius": 0.5}
    return Scene(**box, obstacles=end, wall_restitution=restitution)


def crystal(room):
    """Four discs that fill their box."""
    place, velocity = list(itertools.product([0.5, 1.5], repeat=2)), [[1, 2], [-2, 1], [0, 1], [1, 0]]
    return Scene(width=2 + room, height=2 + room, position=place, velocity=velocity, radius=0.5)


LONGER = r"contact time of the guard is 4.98e-07\. Give a longer one, such as contact_time=0.01"
ROOM = (
    r"no collision takes energy\. Give the discs more room \(a larger box or a smaller radius\), or use method='grid'"
)


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::mpsim.errors.GuardWarning")
@pytest.mark.parametrize(
    ("jammed", "roomy", "text"),
    [
        (gap(0.0, 0.5), gap(0.01, 0.5), LONGER + r" or the discs more room, or use method='grid'"),
        (gap(0.0, 0.0), gap(0.01, 0.0), LONGER + r", a restitution above 0 or the discs more room, or use method='gri"),
        (crystal(0.0), crystal(0.01), ROOM),
    ],
    ids=["losses", "no restitution", "a crystal without losses"],
)
def test_collisions_without_end_at_one_instant_name_what_ends_them(jammed, roomy, text):
    with simulate(jammed, method="event", dt=0.5) as sim, pytest.raises(StalledError, match=text) as caught:
        sim.run(frames=20)
    assert ("contact time" in str(caught.value)) == text.startswith("contact")
    with simulate(roomy, method="event", dt=0.5) as sim:
        assert sim.run(frames=20).frames == 20


@pytest.mark.filterwarnings("ignore::mpsim.errors.GuardWarning")
@pytest.mark.parametrize("losses", [{"restitution": 0.0}, {"wall_restitution": 0.0}])
def test_what_meets_without_any_restitution_parts_by_a_rounding(losses):
    """Else rounding leaves such discs approaching, and an impact is too small to change that: a stall."""
    slanted = Polyline([[2, 3], [5, 6.3], [7, 5]], thickness=0.3)
    box = {"count": 20, "width": 10, "height": 9, "radius": 0.5, "temperature": 1.0, "seed": 1}
    scene = Scene.random(**box, obstacles=slanted, **losses)
    with simulate(scene, method="event", dt=1.0) as sim:
        assert sim.run(frames=8).collisions > 30
        assert 0.005 < kinetic(sim.state.velocity) / kinetic(scene.velocity) < 0.7
