"""Kernels of features, by numbers that can be checked by hand: bounces, obstacles, borders, piston, edges, giants."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.arrays import BARE, control_of, discs_of, parameters_of
from support.internals import machine_code, wall_impulses
from support.scenes import simulate

import mpsim
from mpsim.engine import feature_arrays
from mpsim.features.capsules import distance
from mpsim.kernels import layout
from mpsim.kernels.features import acceleration, obstacles
from mpsim.kernels.features.absorption import absorb
from mpsim.kernels.features.acceleration import fall
from mpsim.kernels.features.images import wrap_places
from mpsim.kernels.features.obstacles import meet_capsules
from mpsim.kernels.features.piston import place_wall
from mpsim.kernels.frame import motion
from mpsim.kernels.frame.motion import tally_walls
from mpsim.kernels.frame.sorting import sort

bounce_back, along_axis, meet_capsule = map(
    machine_code, (acceleration.bounce_back, motion.along_axis, obstacles.meet_capsule)
)

FLOOR = (0.0, 0.0, 10.0, 0.0, 0.0)
PEG = (0.0, 0.0, 0.0, 0.0, 0.5)


def parameters(restitution=1.0, dt=1.0):
    values = parameters_of(np.float64, 10, 10, dt=dt)
    values[layout.WALL_RESTITUTION] = restitution
    return values


@pytest.mark.parametrize(("restitution", "expected"), [(1.0, (3.5 / 9, 3.0)), (0.5, (1.5 / 9, 1.0)), (0.0, (0, 0))])
def test_a_bounce_goes_back_to_the_wall_and_on(restitution, expected):
    """Speed 5 at depth 1/2 under a pull of 9: 4 at the wall (25 = 16 + 9), 1/9 ago, and slowed by 1 since."""
    found = bounce_back(0.5, 5.0, 9.0, parameters(restitution))
    assert found == pytest.approx(expected, rel=1e-15)


def test_a_bounce_without_a_pull_is_as_far_inside_as_it_would_be_outside():
    assert bounce_back(0.25, 2.0, 0.0, parameters()) == (0.25, 2.0)
    assert bounce_back(0.25, 2.0, 0.0, parameters(0.5)) == (0.125, 1.0)


def test_a_disc_at_rest_on_a_wall_stays_there():
    """Pulled by 2 for a time 1/4 from rest at the wall: speed 1/2 at depth 1/16, nothing at the wall."""
    assert bounce_back(1 / 16, 0.5, 2.0, parameters(dt=0.25)) == (0, 0)
    assert bounce_back(0.0, 0.0, 0.0, parameters()) == (0, 0)


@given(st.floats(1e-6, 1), st.floats(1e-3, 100), st.floats(-50, 50))
def test_a_bounce_keeps_the_energy_unless_the_disc_comes_to_rest(depth, speed, pull):
    if speed * speed < 2 * pull * depth:
        return  # it would never have been at the wall
    way, inward = bounce_back(depth, speed, pull, parameters(dt=1e9))
    before, after = speed**2 / 2 - pull * depth, inward**2 / 2 + pull * way
    assert after <= before + 1e-9 * (1 + before)
    if way > 0:
        assert after == pytest.approx(before, rel=1e-9, abs=1e-9)


def after_capsule(place, velocity, capsule=FLOOR, impact=True, pull=(0.0, 0.0), restitution=1.0):
    """Place and velocity of a disc of radius 1/2 after its contact with a capsule, if any."""
    discs = discs_of(np.float64, [place[0]], [place[1]], [velocity[0]], [velocity[1]])
    met = meet_capsule(discs, 0, 0, np.array([capsule]), 0.5, *pull, parameters(restitution), impact)
    return met, (discs.x[0], discs.y[0]), (discs.vx[0], discs.vy[0])


@pytest.mark.parametrize(
    ("place", "velocity", "capsule", "restitution", "then", "now"),
    [
        ((5, 0.3), (1, -2), FLOOR, 1.0, (5, 0.7), (1, 2)),
        ((5, 0.3), (1, -2), FLOOR, 0.5, (5, 0.6), (1, 1)),
        ((5, -0.3), (1, 2), FLOOR, 1.0, (5, -0.7), (1, -2)),
        ((5, 0.6), (1, -2), (0, 0, 10, 0, 0.25), 1.0, (5, 0.9), (1, 2)),
        ((0.8, 0), (-2, 0), PEG, 1.0, (1.2, 0), (2, 0)),
        ((10.4, 0), (-1, 0), FLOOR, 1.0, (10.6, 0), (1, 0)),
        ((0.48, 0.64), (-3, -4), PEG, 1.0, (0.72, 0.96), (3, 4)),
    ],
    ids=["side", "lossy side", "side from below", "thick side", "peg", "end", "peg aslant"],
)
def test_an_impact_on_an_obstacle_happens_where_they_touched(place, velocity, capsule, restitution, then, now):
    met, found, speed = after_capsule(place, velocity, capsule, restitution=restitution)
    assert met
    assert found == pytest.approx(then, abs=1e-15)
    assert speed == pytest.approx(now, abs=1e-15)


def test_a_glancing_impact_on_a_peg_turns_the_velocity_about_the_normal_at_touch():
    """It came along y = 0.6 and touched at (-0.8, 0.6), 0.1 ago at speed 2: the normal is (-0.8, 0.6)."""
    _, place, velocity = after_capsule((-0.6, 0.6), (2, 0), PEG)
    along = 2 * -0.8
    expected = np.array([2.0, 0.0]) - 2 * along * np.array([-0.8, 0.6])
    assert velocity == pytest.approx(expected, rel=1e-14)
    assert place == pytest.approx(np.array([-0.8, 0.6]) + 0.1 * expected, rel=1e-14)


@pytest.mark.parametrize("impact", [True, False])
def test_a_disc_that_does_not_approach_is_only_put_out_of_an_obstacle(impact):
    assert after_capsule((5, 0.25), (1, 2), impact=impact) == (True, (5, 0.5), (1, 2))
    assert after_capsule((5, 0.5), (1, -2), impact=impact) == (False, (5, 0.5), (1, -2)), "touching is not overlapping"


def test_a_push_puts_a_disc_at_the_surface_and_turns_it_round_there():
    assert after_capsule((5, 0.25), (1, -2), impact=False) == (True, (5, 0.5), (1, 2))


@pytest.mark.parametrize(
    ("place", "capsule", "then"),
    [((5, 0), FLOOR, (5, 0.5)), ((0, 5), (0, 0, 0, 10, 0), (-0.5, 5)), ((0, 0), PEG, (0, 1))],
    ids=["level", "upright", "peg"],
)
def test_a_disc_with_its_centre_on_an_obstacle_is_put_across_it(place, capsule, then):
    assert after_capsule(place, (0, 0), capsule) == (True, then, (0, 0))


@pytest.mark.parametrize("capsule", [FLOOR, (5.0, -0.5, 5.0, -0.5, 0.5)], ids=["floor", "peg"])
def test_a_disc_at_rest_on_an_obstacle_stays_there(capsule):
    """A step of 1/4 under gravity 2 has led it from (5, 1/2) at rest to depth 1/16 and speed 1/2."""
    met, place, velocity = after_capsule((5, 0.5 - 1 / 16), (0, -0.5), capsule, pull=(0, -2.0))
    assert met
    assert place == pytest.approx((5, 0.5), abs=1e-15)
    assert velocity == pytest.approx((0, 0), abs=1e-15)


@pytest.mark.parametrize(
    ("v", "restitution", "expected"), [(1.0, 1.0, -3.0), (1.0, 0.5, -2.0), (0.0, 1.0, -2.0), (-2.0, 1.0, -2.0)]
)
def test_a_piston_gives_a_disc_twice_its_speed(v, restitution, expected):
    """The right wall, at 9.5 for centres at the end of the step, moves at -1; a disc ends at 9.75 and bounces off."""
    values = parameters(restitution, dt=0.5)
    piston = np.array([layout.X_HIGH, 10.0, -1.0, 2.0, -1.0])
    values[layout.WALL_BOUNCE] = restitution
    p, after = along_axis(9.75 - v / 2, v, layout.X_LOW, 0.0, None, piston, values)
    assert after == expected
    assert p == 9.5 - 0.25 * restitution


def test_a_piston_stands_where_its_time_says_until_it_stops():
    values, control = parameters(dt=0.25), control_of(0)
    piston = np.array([layout.X_HIGH, 9.5, -1.0, 8.9, 0.0])
    found = []
    for step in range(4):
        control[layout.STEPS] = step
        place_wall(piston, values, control)
        found.append((values[layout.X_HIGH], piston[layout.PISTON_NOW]))
    assert found == [(9.25, -1), (9.0, -1), (8.9, 0), (8.9, 0)]


@pytest.mark.parametrize("real", [np.float32, np.float64])
def test_places_come_back_into_a_periodic_box(real):
    length = np.array([7.3], real)
    below = np.nextafter(length[0], real(0))
    places = np.array([0.0, 2.5, -1e-20, 7.3, below, -1.0, 8.0, 3 * 7.3, 1e6 * 7.3, -1e30, 1e30], real)
    found, image = places.copy(), np.zeros((2, len(places)), np.int64)
    wrap_places(found, image, 0, length)
    assert ((found >= 0) & (found < length[0])).all(), found
    assert found[:5].tolist() == [0, 2.5, 0, 0, below]
    assert found[5:7] == pytest.approx([6.3, 0.7], rel=1e-6)
    assert image[0, :7].tolist() == [0, 0, 0, 1, 0, -1, 1], "no period for what rounding alone has put at 0"
    unwrapped = found[:9] + image[0, :9] * float(length[0])
    assert unwrapped == pytest.approx(places[:9].astype(float), abs=1e-6, rel=1e-6)
    assert not image[1].any(), "the other axis has its own counts"
    assert not image[0, 9:].any(), "of a place without a digit in the box no period is counted"
    again, before = found.copy(), image.copy()
    wrap_places(again, image, 0, length)
    assert again.tolist() == found.tolist(), "doing it twice must change nothing"
    assert (image == before).all()
    lost = np.array([np.nan, np.inf, -np.inf], real)
    wrap_places(lost, image[:, :3], 1, length)
    assert np.isnan(lost).all(), "what is not finite must stay so, to be found"
    assert not image[1].any()


@given(st.floats(-1e300, 1e300), st.floats(1e-3, 1e6))
def test_any_place_comes_back_into_any_periodic_box_for_good(place, length):
    places, wrap, image = np.array([place]), np.array([length]), np.zeros((2, 1), np.int64)
    wrap_places(places, image, 0, wrap)
    first, counted = places[0], int(image[0, 0])
    wrap_places(places, image, 0, wrap)
    assert 0 <= first < length
    assert (places[0], image[0, 0]) == (first, counted)
    if abs(place) < 1e15 * length:
        assert abs(first + counted * length - place) <= 1e-15 * (abs(place) + length), "unwrapped, it goes on"


def exits_after(edges, velocity, gravity=None, contact=layout.PUSH):
    """What is noted of a disc of radius 1/2, 1/4 from the left and the bottom wall, in a step of 1/4."""
    discs = discs_of(np.float64, [0.75], [0.75], [velocity[0]], [velocity[1]])
    control, exits = control_of(1), np.zeros((3, 1))
    control[layout.ABSORBING], control[layout.CONTACT] = edges, contact
    features = BARE._replace(exits=exits, gravity=None if gravity is None else np.array(gravity, float))
    absorb(discs, 0, 1, exits, features, parameters(dt=0.25), control)
    return exits[:, 0].tolist()


def test_an_edge_swallows_what_the_step_would_bring_beyond_it():
    left, bottom = 1, 4
    assert exits_after(left, (-1.5, 0)) == [1, 0.75, 0.75]
    assert exits_after(left, (-1.0, 0)) == [0, 0, 0], "to touch the edge is not to leave"
    assert exits_after(bottom, (-1.5, 0)) == [0, 0, 0]
    assert exits_after(left | bottom, (0, -1.5)) == [1, 0.75, 0.75]


@pytest.mark.parametrize(("contact", "least"), [(layout.PUSH, 4), (layout.IMPACT, 8)])
def test_an_edge_swallows_what_gravity_brings_to_it(contact, least):
    """1/4 in a time 1/4 from rest: v += g dt, y += v dt needs g = 4, a parabola 8."""
    bottom = 4
    assert exits_after(bottom, (0, 0), (0, -least), contact)[0] == 0
    assert exits_after(bottom, (0, 0), (0, -least * 1.001), contact)[0] == 1


@pytest.mark.parametrize("contact", ["push", "impact"])
def test_the_floor_carries_a_disc_at_rest(contact):
    heap = mpsim.Scene(
        width=4, height=4, position=[[2, 0.5]], velocity=[[0, 0]], radius=0.5, gravity=(0, -1), wall_restitution=0.5
    )
    with simulate(heap, method="naive", dt=1 / 64, contact=contact) as sim:
        assert wall_impulses(sim, 640) == pytest.approx([0, 0, 10, 0], rel=2e-3)


@pytest.mark.parametrize("gone", [0, 1])
def test_an_edge_takes_no_impulse_from_a_disc_that_it_has_swallowed(gone):
    """A disc of mass 1 that would bounce off the floor at speed 2 in this step, falling or not."""
    values, tally = parameters(dt=0.25), np.zeros((1, layout.TALLIES), np.int64)
    features = BARE._replace(exits=np.array([[gone], [5], [0.75]], float), gravity=np.array([0.0, 0.0]))
    discs = discs_of(np.float64, [5.0], [0.75], [0.0], [-2.0])
    tally_walls(discs, 0, 1, features, values, tally, 0)
    fall(discs, 0, 1, features, values, tally, 0)
    assert tally[0, layout.BOTTOM] / values[layout.TALLY_SCALE] == (0 if gone else 8)


def test_giants_are_few_and_more_than_twice_as_large_as_all_others():
    small = np.full(100, 1.0)
    assert feature_arrays.giant_radius(small) is None
    assert feature_arrays.giant_radius(np.append(small, 2.0)) is None, "twice as large is not enough"
    assert feature_arrays.giant_radius(np.append(small, 2.5)) == 1.0
    assert feature_arrays.giant_radius(np.append(small, [1.5, 1.9, 40.0])) == 1.9, "the grid keeps all but the giants"
    assert feature_arrays.giant_radius(np.append(small, np.full(8, 9.0))) == 1.0
    assert feature_arrays.giant_radius(np.append(small, np.full(9, 9.0))) is None, "nine are too many for giants"
    assert feature_arrays.giant_radius(np.append(np.full(15, 1.0), 9.0)) is None, "too few discs for a grid"
    assert feature_arrays.giant_radius(np.array([])) is None


@pytest.mark.parametrize("boundary", ["walls", "periodic", ("periodic", "walls")])
def test_the_grid_of_obstacles_lists_all_that_a_disc_can_touch(boundary):
    rng = np.random.default_rng(3)
    pegs = [mpsim.FixedDisc(rng.uniform(0, 20, 2), rng.uniform(0.1, 2)) for _ in range(20)]
    walls = [mpsim.Polyline(rng.uniform(0, 20, (3, 2)), rng.uniform(0, 1)) for _ in range(10)]
    scene = mpsim.Scene(
        width=20, height=20, position=[[5, 5]], velocity=[[0, 0]], radius=0.5, obstacles=pegs + walls, boundary=boundary
    )
    arrays = feature_arrays.obstacle_arrays(scene)
    places = rng.uniform(0, 20, (4000, 2))
    touches = distance(places[:, None], arrays["capsule"]) < 0.5
    columns, rows = arrays["grid"]
    column, row = (np.minimum((places * arrays["per_length"]).astype(int), [columns - 1, rows - 1])).T
    listed = 0
    for place, cell in enumerate(column * rows + row):
        near = arrays["index"][arrays["near"][cell] : arrays["near"][cell + 1]]
        assert set(np.flatnonzero(touches[place])) <= set(near.tolist()), f"at {places[place]}"
        assert sorted(near) == list(near), "in the order of the scene"
        listed += len(near)
    assert listed < 4 * touches.sum() + len(places), "the grid lists far more than what is near"
    steps = [(-20, 0, 20) if word == "periodic" else (0,) for word in scene.boundary]
    wraps = [np.array(step) for step in itertools.product(*steps)]
    images = np.min([distance((places + s)[:, None], scene.capsules).min(axis=1) for s in wraps], axis=0)
    assert np.array_equal(images < 0.5, touches.any(axis=1)), "what lies beyond a border must be felt"


def test_radii_go_along_when_discs_are_sorted():
    assert "radius" in layout.Discs._fields
    discs = discs_of(np.float64, [3.0, 1.0], [1.0, 1.0], radius=[0.3, 0.1])
    back = discs_of(np.float64, [0.0, 0.0], [0.0, 0.0], radius=[0.0, 0.0])
    control, team = control_of(2, 4, 4), np.zeros((1, layout.TEAM), np.int64)
    control[layout.CELLS] = 30
    team[0, layout.LAST_COLUMN], team[0, layout.HIGH] = 4, 2
    start, outbox, sent = np.zeros(31, np.int32), np.zeros(18, np.int32), np.zeros((1, 1), np.int64)
    discs.cell[:2] = 20, 8
    start[21], start[9] = 1, 1
    team[0, layout.KEPT] = 2
    assert sort(discs, back, start, outbox, team, sent, 0, control) == (0, 2)
    assert back.radius[:2].tolist() == [0.1, 0.3]
    assert back.id[:2].tolist() == [1, 0]


def test_an_obstacle_never_puts_a_disc_beyond_a_periodic_border():
    """A disc deep in a thick peg at x = 1 is put 5.5 from its centre: 4.5 beyond the border."""
    peg = mpsim.FixedDisc((1, 10), 5.0)
    scene = mpsim.Scene(
        width=20, height=20, position=[[0.5, 10]], velocity=[[0, 0]], radius=0.5, boundary="periodic", obstacles=peg
    )
    obstacles = layout.Obstacles(**feature_arrays.obstacle_arrays(scene))
    wrap = np.array([20.0])
    features = BARE._replace(wrap_x=wrap, wrap_y=wrap, image=np.zeros((2, 1), np.int64), obstacles=obstacles)
    discs = discs_of(np.float64, [0.5], [10.0])
    meet_capsules(discs, 0, 1, features, parameters_of(np.float64, 20, 20), control_of(1))
    assert (discs.x[0], discs.y[0]) == (15.5, 10)
    assert features.image.tolist() == [[-1], [0]]
