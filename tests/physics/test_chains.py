"""Discs on chains of segments: a chain is one surface, whose joints are felt only where it bends.

A stepped disc sinks into its floor by a fraction of a frame, where the ends of the segments that it slides over would
stop it if each were an obstacle of its own.
"""

import math

import numpy as np
import pytest
from support.scenes import simulate

import mpsim

pytestmark = pytest.mark.plain

LENGTH, SPEED = 40.0, 5.0
STEPPED = [("naive", "push"), ("naive", "impact"), ("grid", "impact")]


def along(angle, pieces, side=1, middle=(20.0, 15.0)):
    """A straight chain through the middle of the box, and unit vectors along it and towards the disc's side."""
    t = np.array([math.cos(angle), math.sin(angle)])
    points = np.array(middle) + np.linspace(-LENGTH / 3, LENGTH / 3, pieces + 1)[:, None] * t
    return mpsim.Polyline(points), t, side * np.array([-t[1], t[0]])


def slide(chain, t, n, *, radius=0.25, pull=10.0, lift=0.0, boundary="walls", until=4.0, more=None, **settings):
    """A disc beside the middle of the box, its speed along a chain, pulled towards it: its state after some time."""
    start = np.array([20.0, 15.0]) + (radius + lift) * n - LENGTH / 4 * t
    with simulate(
        mpsim.Scene(
            width=LENGTH, height=30, position=[start], velocity=[SPEED * t], radius=radius, gravity=tuple(-pull * n),
            obstacles=chain, boundary=boundary, **(more or {}),
        ),
        **{"dt": 0.02, **settings},
    ) as sim:  # fmt: skip
        sim.run(until=until)
        return sim.state


@pytest.mark.parametrize(
    ("pieces", "wall_restitution", "method", "contact"),
    [(1, 0.5, *STEPPED[0]), (40, 0.0, *STEPPED[1]), (40, 1.0, *STEPPED[0]), (400, 0.5, *STEPPED[1])],
)
def test_a_smooth_disc_keeps_its_speed_along_a_straight_chain(pieces, wall_restitution, method, contact):
    """From either side, level or not, thrown onto it or laid, under both laws, also if larger than segments."""
    for angle, side, lift, radius, law in (
        (0.0, 1, 0, 0.25, "elastic"),
        (0.3, -1, 0.01, 0.25, "reflect"),
        (2.5, 1, 0.3, 1.5, "elastic"),
        (0.7, 1, 0.1, 0.25, "reflect"),
    ):
        chain, t, n = along(angle, pieces, side)
        state = slide(
            chain, t, n, lift=lift, radius=radius, method=method, contact=contact, law=law,
            more={"wall_restitution": wall_restitution},
        )  # fmt: skip
        place, speed = (state.position[0] - (20, 15)), state.velocity[0] @ t
        assert abs(speed / SPEED - 1) < 1e-9, f"{speed} along it, {SPEED} before"
        assert place @ n > 0.9 * radius, "it has left the chain's side"
        assert place @ t == pytest.approx(4 * SPEED - LENGTH / 4, rel=1e-9)


@pytest.mark.parametrize(("method", "contact"), STEPPED[::2])
def test_a_level_chain_moves_discs_as_one_segment_does_rough_ones_too(method, contact):
    rough = {"wall_friction": 0.3, "tangential_restitution": 0.5, "spin": 2.0, "wall_restitution": 0.5}
    for more in ({"wall_restitution": 0.5}, rough):
        one, chain = (
            slide(*along(0.0, pieces), lift=0.2, method=method, contact=contact, more=more) for pieces in (1, 97)
        )
        assert chain.position == pytest.approx(one.position, rel=1e-11)
        assert chain.velocity == pytest.approx(one.velocity, rel=1e-11, abs=1e-11)
    assert abs(chain.velocity[0, 0] / SPEED - 1) > 0.01, "friction has done nothing, which tests little"


@pytest.mark.parametrize(("thickness", "method", "contact"), [(0.0, *STEPPED[0]), (0.2, *STEPPED[1])])
def test_walls_that_end_on_a_floor_do_not_stick_out_of_it(thickness, method, contact):
    """Below it, or in line with it and joined but for rounding, whichever is given first."""
    for angle, side in ((0.0, 1), (2.5, -1)):
        floor, t, n = along(angle, 1, side)
        places = np.array(floor.points[0]) + np.linspace(0.2, 26.5, 58)[:, None] * t
        below = [mpsim.Polyline([place, place - 4 * n + t], thickness) for place in places]
        cut = np.stack([places[:-1], places[1:] + 1e-15 * np.sign(n)], axis=1)  # which rounds some of them only
        for number, obstacles in enumerate(
            (
                [*below, mpsim.Polyline(floor.points, thickness)],
                [mpsim.Polyline(floor.points, thickness), *below],
                [mpsim.Polyline(each, thickness) for each in [*cut, (floor.points[0], places[0]), places[-2:]]],
            )
        ):
            state = slide(
                obstacles, t, n, lift=thickness / 2, method=method, contact=contact, until=3.0,
                more={"wall_restitution": 0.5},
            )  # fmt: skip
            assert abs(state.velocity[0] @ t / SPEED - 1) < 1e-9, (angle, number)


@pytest.mark.parametrize(("method", "contact"), STEPPED[:2])
def test_there_is_no_joint_where_a_ring_or_a_line_through_a_border_closes(method, contact):
    """Nor where two Polylines meet, in whichever direction each is given."""
    ring = mpsim.Polyline([(20, 15), (39, 15), (39, 25), (1, 25), (1, 15), (20, 15)])
    through = mpsim.Polyline([(0, 15), (13, 15), (LENGTH, 15)])
    parts = [mpsim.Polyline([(0, 15), (13, 15)]), mpsim.Polyline([(LENGTH, 15), (13, 15)])]
    t = np.array([1.0, 0.0])
    for n in (np.array([0.0, 1.0]), np.array([0.0, -1.0])):
        state = slide(ring, t, n, lift=1e-3, method=method, contact=contact, until=3.0)
        assert abs(state.velocity[0, 0] / SPEED - 1) < 1e-9
        for line in (through, parts):
            state = slide(
                line, t, n, lift=1e-3, method=method, contact=contact, until=9.0, boundary=("periodic", "walls")
            )
            assert abs(state.velocity[0, 0] / SPEED - 1) < 1e-9
            assert state.image[0, 0] == 1, "it did not pass the border"


@pytest.mark.parametrize("shift", [0.0, 0.7])
def test_a_corner_that_sticks_out_is_met_like_a_disc_of_no_size(shift):
    """Under `impact`, along the normal at touch; and so is the end of a chain."""
    corner, radius = np.array([10.0, 10.0]), 0.5
    velocity = np.array([-3.0, -2.0])
    for points in ([(2, 10), corner, (10, 2)], [(2, 7), corner]):
        for offset in (-0.3, 0.0, 0.2):
            t = velocity / np.hypot(*velocity)
            across = offset * np.array([-t[1], t[0]])
            touch = corner + across - math.sqrt(radius**2 - offset**2) * t
            normal = (touch - corner) / radius
            start = touch - velocity * (0.5 + 0.02 * shift)
            scene = mpsim.Scene(
                width=20, height=20, position=[start], velocity=[velocity], radius=radius,
                obstacles=[mpsim.Polyline(points)],
            )  # fmt: skip
            with simulate(scene, method="naive", contact="impact", dt=0.02) as sim:
                sim.run(until=1.0)
                after = velocity - 2 * (velocity @ normal) * normal
                assert sim.state.velocity[0] == pytest.approx(after, rel=1e-12)
                place = touch + after * (sim.time - 0.5 - 0.02 * shift)
                assert sim.state.position[0] == pytest.approx(place, rel=1e-12)


@pytest.mark.parametrize(("method", "contact"), STEPPED[::2])
@pytest.mark.parametrize(("bend", "kept"), [(0.2, math.cos(0.2)), (-0.2, 1.0)], ids=["rises", "falls"])
def test_a_bend_that_rises_takes_the_speed_across_it_and_one_that_falls_takes_none(bend, kept, method, contact):
    """Without restitution and gravity. It is the control of the others: a joint of 0.2 radians is felt."""
    line = mpsim.Polyline([(5, 15), (20, 15), (20 + 15 * math.cos(bend), 15 + 15 * math.sin(bend))])
    state = slide(
        line, np.array([1.0, 0.0]), np.array([0.0, 1.0]), pull=0.0, method=method, contact=contact,
        more={"wall_restitution": 0.0},
    )  # fmt: skip
    assert np.hypot(*state.velocity[0]) == pytest.approx(SPEED * kept, rel=1e-12)
    assert math.atan2(state.velocity[0, 1], state.velocity[0, 0]) == pytest.approx(max(bend, 0.0), abs=1e-12)
