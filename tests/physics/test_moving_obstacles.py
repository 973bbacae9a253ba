"""Obstacles that move: contacts by closed forms, orders of convergence, belts, drums and other containers."""

import math

import numpy as np
import pytest
from support.scenes import state_after
from support.selection import slow_but

import mpsim
from mpsim import Circle, FixedDisc, Oscillation, Path, Polyline, Rotation, Translation

pytestmark = pytest.mark.plain


def one_disc(obstacle, position, velocity, time, dt=1 / 64, contact="impact", **features):
    """The state of one disc of radius 0.5 beside one obstacle, at a time."""
    features = {"width": 12, "height": 6, "radius": 0.5, "obstacles": obstacle} | features
    scene = mpsim.Scene(position=[position], velocity=[velocity], **features)
    how = {"method": "event"} if contact == "event" else {"method": "grid", "contact": contact, "on_fast": "error"}
    with mpsim.Simulation(scene, mpsim.Settings(dt=dt, **how)) as sim:
        sim.run(frames=round(time / dt))
        return sim.state


@pytest.mark.parametrize("contact", ["impact", "push", "event"])
@pytest.mark.parametrize("restitution", [1.0, 0.75, 0.0])
def test_a_wall_reflects_in_its_own_frame(contact, restitution):
    wall = Polyline([(9, 0), (9, 6)], motion=Translation((-1.0, 0.0), stop=6))
    state = one_disc(wall, (4, 3), (1.0, 0.25), 4.0, contact=contact, wall_restitution=restitution)
    assert state.velocity[0] == pytest.approx([-1 - restitution * 2, 0.25], abs=1e-12)
    if contact != "push":  # they meet where 4.5 + t = 9 - t
        assert state.position[0, 0] == pytest.approx(6.25 - (1 + 2 * restitution) * (4 - 2.25), abs=1e-12)
    assert one_disc(wall, (4, 3), (-1.0, 0.25), 4.0).velocity[0, 0] == 1, "the left wall of the box, not this one"


def test_a_wall_pushes_what_rests_and_a_piston_is_the_same():
    wall = Polyline([(0, 0), (0, 6)], motion=Translation((0.5, 0.0), stop=4))
    state = one_disc(wall, (3, 3), (0.0, 0.0), 6.0)
    assert state.velocity[0, 0] == pytest.approx(1.0, abs=1e-12)
    scene = {"width": 12, "height": 6, "position": [[3, 3], [6, 2]], "velocity": [[-0.5, 0.3], [-1, 0]], "radius": 0.5}
    ends = []
    for how in ({"obstacles": wall}, {"piston": mpsim.Piston("left", 0.5, 4)}):
        state = state_after(mpsim.Scene(**scene, **how), 640, method="grid", contact="impact", dt=1 / 64)
        ends.append(np.concatenate([state.position, state.velocity]))
    assert np.abs(ends[0] - ends[1]).max() < 1e-9


def first_touch(gap, end, steps=1_000):
    """The first time at which a gap closes, by bisection after a search in small steps."""
    times = np.linspace(0, end, steps)
    first = int(np.argmax(np.array([gap(t) for t in times]) < 0))
    low, high = times[first - 1], times[first]
    for _ in range(80):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if gap(middle) < 0 else (middle, high)
    return low


def after_oscillating_wall(time):
    """Place and velocity of the disc of the next test by another way."""
    touch = first_touch(lambda t: 8 + 0.5 * math.sin(2 * math.pi * t / 1.7 + 0.4) - (4.5 + t), 5)
    speed = 0.5 * 2 * math.pi / 1.7 * math.cos(2 * math.pi * touch / 1.7 + 0.4)
    return 4 + touch + (2 * speed - 1) * (time - touch), 2 * speed - 1


def after_paddle(time):
    """Place and velocity (x, y) of a disc that a paddle about (8, 3) hits on its side."""
    start, velocity, rate = np.array([4.5, 2.6]), np.array([1.0, 0.3]), 0.7

    def seen(t):  # from the paddle, along it and across it
        c, s = math.cos(rate * t), math.sin(rate * t)
        x, y = start + velocity * t - (8, 3)
        return c * x + s * y, c * y - s * x

    def gap(t):
        along, across = seen(t)
        return math.hypot(max(abs(along) - 2, 0), across) - 0.5

    touch = first_touch(gap, 5)
    along, across = seen(touch)
    beyond = math.copysign(max(abs(along) - 2, 0), along)
    c, s = math.cos(rate * touch), math.sin(rate * touch)
    n = np.array([c * beyond - s * across, s * beyond + c * across]) / math.hypot(beyond, across)
    place = start + velocity * touch
    point = place - 0.5 * n - (8, 3)
    wall = rate * np.array([-point[1], point[0]])
    new = velocity - 2 * ((velocity - wall) @ n) * n
    return place + new * (time - touch), new


def errors(obstacle, position, velocity, expected, contact, steps):
    return [
        max(np.abs(state.position[0] - expected[0]).max(), np.abs(state.velocity[0] - expected[1]).max())
        for dt in steps
        for state in [one_disc(obstacle, position, velocity, 4.0, dt, contact)]
    ]


def oscillation():
    place, speed = after_oscillating_wall(4.0)
    wall = Polyline([(8, 0), (8, 6)], motion=Oscillation((0.5, 0), period=1.7, phase=0.4))
    return wall, (4, 3), (1, 0.25), (np.array([place, 4.0]), np.array([speed, 0.25]))


def rotation():
    paddle = Polyline([(6, 3), (10, 3)], motion=Rotation((8, 3), rate=0.7))
    return paddle, (4.5, 2.6), (1.0, 0.3), after_paddle(4.0)


@pytest.mark.parametrize("case", [oscillation, rotation])
def test_contacts_are_of_second_order_or_better_by_impact_of_first_by_push_and_exact_by_event(case):
    obstacle, position, velocity, expected = case()
    coarse, fine = errors(obstacle, position, velocity, expected, "impact", (1 / 32, 1 / 128))
    assert coarse < 1e-4
    assert fine < max(coarse / 16, 1e-9), "not even of second order"
    assert errors(obstacle, position, velocity, expected, "push", (1 / 128,))[0] > 100 * fine, "the control"
    assert errors(obstacle, position, velocity, expected, "event", (1 / 4,))[0] < 1e-12


def test_a_path_is_followed_and_rests_before_and_after():
    path = Path([0, 1, 3], [(0, 0), (2, 0), (1, 0)], start=0.5)
    table = Polyline([(5, 0), (5, 6)], motion=path)
    places = [path.capsules_at(np.array([[5.0, 0, 5, 6, 0]]), t)[0, 0] for t in (0, 0.5, 1, 1.5, 2.5, 3.5, 9)]
    assert places == pytest.approx([5, 5, 6, 7, 6.5, 6, 6], abs=1e-12)
    assert one_disc(table, (6.5, 3), (0, 0), 2.0).velocity[0, 0] == pytest.approx(4.0, abs=1e-12)  # hit at speed 2
    assert one_disc(table, (11.4, 3), (-1, 0), 6.0).velocity[0, 0] == pytest.approx(1.0, abs=1e-12)  # found at rest


def test_a_disc_on_a_belt_slides_and_then_rolls_at_its_speed():
    """From rest mu g acts until the surfaces no longer slip: with the inertia of a disc at a third of the belt's."""
    belt = Polyline([(0, 1), (12, 1)], surface_velocity=1.5)
    how = {"gravity": (0, -2.0), "wall_friction": 0.25, "wall_restitution": 0.0, "dt": 1 / 256}
    sliding, rolling = (one_disc(belt, (3, 1.5), (0, 0), time, **how) for time in (0.5, 4.0))
    assert sliding.velocity[0, 0] == pytest.approx(0.25 * 2.0 * 0.5, rel=0.02)
    assert rolling.velocity[0, 0] == pytest.approx(0.5, rel=0.02)
    assert rolling.spin[0] * 0.5 == pytest.approx(-(0.5 - 1.5), rel=0.02)
    against = one_disc(Polyline([(12, 1), (0, 1)], surface_velocity=1.5), (9, 1.5), (0, 0), 4.0, **how)
    assert against.velocity[0, 0] == pytest.approx(-0.5, rel=0.02), "from the first point to the last"
    peg, how = FixedDisc((6, 3), 0.5, surface_velocity=2.0), {"wall_friction": 5.0, "tangential_restitution": 0.5}
    steps, exact = (one_disc(peg, (6.2, 4.1), (0, -1), 1.0, contact=by, **how) for by in ("impact", "event"))
    assert exact.velocity[0, 0] < -0.1, "counter-clockwise"
    assert np.abs(steps.velocity - exact.velocity).max() < 1e-9
    assert steps.spin == pytest.approx(exact.spin, abs=1e-9)


@pytest.mark.filterwarnings("ignore::mpsim.errors.GuardWarning")
@pytest.mark.parametrize("contact", slow_but(["impact", "push", "event"], "impact"))
def test_what_is_in_a_drum_stays_in_it_and_turns_with_it(contact):
    angle = np.linspace(0, 2 * math.pi, 25)
    points = np.column_stack([6 + 5 * np.cos(angle), 6 + 5 * np.sin(angle)])
    points[-1] = points[0]
    drum = Polyline(points, thickness=0.25, motion=Rotation((6, 6), rate=0.5))
    places = [(x, y) for x in np.arange(3, 9.1, 1.1) for y in np.arange(3, 9.1, 1.1)]
    scene = mpsim.Scene(
        width=12, height=12, position=places, velocity=np.zeros((len(places), 2)), radius=0.5, gravity=(0, -1),
        restitution=0.5, wall_restitution=0.5, friction=0.5, wall_friction=0.5, obstacles=drum,
    )  # fmt: skip
    how = {"method": "event", "contact_time": 0.02} if contact == "event" else {"method": "grid", "contact": contact}
    with mpsim.Simulation(scene, mpsim.Settings(dt=0.02, **how)) as sim:
        sim.run(frames=400)
        state, now = sim.state, scene.capsules_at(sim.time)
    assert scene._deepest(state.position, np.full(len(places), 0.4), 8.0) is None, "deeper than a fifth of a radius"
    assert np.hypot(*(state.position - 6).T).max() < 5
    tilt = state.position.mean(axis=0) - 6
    assert tilt[1] < -0.4, "nothing has settled"
    assert tilt[0] > 0.3, "the heap is not carried up on the side that rises"
    assert now[:, :2] == pytest.approx(
        np.column_stack([6 + 5 * np.cos(angle[:-1] + 4), 6 + 5 * np.sin(angle[:-1] + 4)]), abs=1e-12
    )


def test_a_floor_that_vibrates_across_a_periodic_box_hits_alike_everywhere():
    floor = Polyline([(0, 1), (8, 1)], motion=Oscillation((0.25, 0.25), period=1.0))
    ends, box = [], {"width": 8, "gravity": (0, -1), "boundary": ("periodic", "walls")}
    for x in (0.1, 2.5, 7.9):
        state = one_disc(floor, (x, 3), (0.5, 0), 8.0, **box)
        ends.append((state.position[0, 1], state.velocity[0, 1]))
    assert np.ptp(ends, axis=0).max() < 1e-9
    assert ends[0][1] ** 2 / 2 + ends[0][0] != pytest.approx(3.0, abs=1e-3), "no energy was exchanged"


def test_the_image_of_a_rotor_beyond_a_border_hits_too():
    rotor = Polyline([(0.2, 3), (2.2, 3)], motion=Rotation((0.2, 3), rate=1.0))  # about a point near the left border
    in_the_middle = Polyline([(6.2, 3), (8.2, 3)], motion=Rotation((6.2, 3), rate=1.0))
    beyond, middle = (
        one_disc(obstacle, (x, 3.2), (0, 0), 200 / 64, boundary=(box, "walls")).velocity[0]
        for box, obstacle, x in (("periodic", rotor, 11.2), ("walls", in_the_middle, 5.2))
    )
    assert np.hypot(*beyond) > 0.5
    assert beyond == pytest.approx(middle, abs=1e-9)


# --- containers

DRUM = Circle((6, 6), 5, inside=True)


def in_container(container, frames, position=(7, 6.5), velocity=(0.3, 1.7), **features):
    """The state of one disc of radius 0.5 in a box of 12 x 12, by frames of a 16th."""
    return one_disc(container, position, velocity, frames / 16, 1 / 16, height=12, **features)


def angular_momentum(state):
    (x, y), (vx, vy) = state.position[0] - 6, state.velocity[0]
    return x * vy - y * vx


@pytest.mark.parametrize("contact", ["event", "impact"])
@pytest.mark.parametrize("velocity", [(0.3, 1.7), (-0.8, 1.6)], ids=["across", "along the wall"])
def test_a_circular_billiard_keeps_energy_and_angular_momentum_also_in_steps(contact, velocity):
    """Between two reflections the disc flies on a chord, always of the same length, which every frame may cut."""
    state = in_container(DRUM, 400, velocity=velocity, contact=contact)
    first = 1.0 * velocity[1] - 0.5 * velocity[0]
    assert angular_momentum(state) == pytest.approx(first, rel=1e-12)
    assert np.hypot(*state.velocity[0]) == pytest.approx(np.hypot(*velocity), rel=1e-12)
    turns, start = np.hypot(*velocity) * 400 / 16, np.array([1.0, 0.5])
    unit = np.array(velocity) / np.hypot(*velocity)
    impact, until = abs(first) / np.hypot(*velocity), np.sqrt(4.5**2 - (first / np.hypot(*velocity)) ** 2)
    chords, rest = divmod(turns + until + start @ unit, 2 * until)
    angle = math.atan2(unit[1], unit[0]) + math.copysign(chords * 2 * math.acos(impact / 4.5), first)
    along, across = np.array([math.cos(angle), math.sin(angle)]), np.array([-math.sin(angle), math.cos(angle)])
    place = (rest - until) * along - math.copysign(impact, first) * across
    assert np.abs(state.position[0] - 6 - place).max() < 1e-9


@pytest.mark.slow
def test_a_circular_billiard_keeps_angular_momentum_over_a_hundred_thousand_reflections():
    state = in_container(DRUM, 4_000_000, velocity=(-1.6, 3.2), contact="event")
    chord = 2 * math.sqrt(4.5**2 - 4.0**2 / (1.6**2 + 3.2**2))
    assert math.hypot(1.6, 3.2) * 4_000_000 / 16 / chord > 100_000
    assert angular_momentum(state) == pytest.approx(3.2 + 0.8, rel=1e-12)


@pytest.mark.long
def test_a_gas_in_a_drum_at_rest_keeps_energy_and_angular_momentum_over_a_million_collisions():
    """The control: a drum that shakes."""
    for motion in (None, Oscillation((0.5, 0), period=2.0)):
        ring = Circle((21, 21), 20, inside=True, motion=motion)
        box = {"width": 42, "height": 42, "inside": Circle((21, 21), 19, inside=True)}
        scene = mpsim.Scene.random(count=1000, radius=0.3, seed=1, obstacles=ring, **box)
        with mpsim.Simulation(scene, mpsim.Settings(dt=1.0, method="event")) as sim:
            collisions = 0
            while collisions < (1_000_000 if motion is None else 10_000):
                collisions += sim.run(frames=5).collisions
            state = sim.state
        energy, turning = [], []
        for each in (scene, state):
            energy.append((each.velocity**2).sum())
            turning.append(((each.position - 21) * each.velocity[:, ::-1] @ (1, -1)).sum())
        assert (abs(energy[1] / energy[0] - 1) < 1e-12) == (motion is None), energy
        assert (abs(turning[1] - turning[0]) < 1e-9 * np.sqrt(energy[0])) == (motion is None), turning
        assert np.hypot(*(state.position - 21).T).max() < 20.2


def test_a_container_that_turns_about_its_own_centre_is_a_belt():
    rough = {"wall_friction": 0.5, "gravity": (0, -1)}
    for contact in ("impact", "event"):
        turned, running = (
            in_container(drum, 200, contact=contact, **rough)
            for drum in (
                Circle((6, 6), 5, inside=True, motion=Rotation((6, 6), rate=0.4)),
                Circle((6, 6), 5, inside=True, surface_velocity=2.0),
            )
        )
        assert turned.digest() == running.digest()
        assert turned.spin[0] > 0, "driven counter-clockwise, as a wheel inside a ring"
    eased = in_container(Circle((6, 6), 5, inside=True, motion=Rotation((6, 6), 0.4, stop=100)), 200, **rough)
    assert eased.position == pytest.approx(in_container(DRUM, 0, **rough).position, abs=9)
    assert eased.velocity == pytest.approx(turned.velocity, abs=0.05), "the same by way of a body that moves"


@pytest.mark.parametrize("contact", ["impact", "push", "event"])
def test_a_container_that_moves_reflects_in_its_own_frame(contact):
    wall = Circle((5, 3), 3, inside=True, motion=Translation((-1.0, 0.0), stop=4.5))
    state = one_disc(wall, (4, 3), (1.0, 0.0), 3.0, contact=contact)
    assert state.velocity[0] == pytest.approx([-3, 0], abs=1e-9)
    if contact != "push":  # they meet where 4.5 + t = 8 - t
        assert state.position[0] == pytest.approx([5.75 - 3 * (3 - 1.75), 3], abs=1e-9)


def test_grains_come_to_rest_in_a_rough_container_that_turns():
    """A disc in contact step after step may lie outside on a line that does not cross the circle."""
    drum = Circle((4, 4), 3.5, inside=True, motion=Rotation((4, 4), rate=0.4))
    scene = mpsim.Scene.random(
        count=12, width=8, height=8, radius=0.4, temperature=0, gravity=(0, -1), restitution=0.5, wall_restitution=0.5,
        friction=0.5, wall_friction=0.8, obstacles=drum, seed=1,
    )  # fmt: skip
    state = state_after(scene, 200, dt=0.02, method="grid", contact="impact")
    assert np.abs(state.spin).max() < 20
    assert np.hypot(*(state.position - 4).T).max() < 3.1 + 0.01
    assert np.hypot(*state.velocity.T).max() < 2


def test_discs_outside_a_container_or_too_large_for_it_are_refused():
    for container, words in (
        (Circle((3, 6), 3, inside=True), r"position\[0\] must lie inside obstacles\[0\], a Circle; got"),
        (Circle((7, 6.5), 0.5, inside=True), r"radius of obstacles\[0\], a Circle with discs inside, must be above"),
    ):
        with pytest.raises(mpsim.InputError, match=words):
            in_container(container, 1)
    with pytest.raises(mpsim.InputError, match=r"must lie in the periodic box along x, in \[0, 12\]; got \[-1, 13\]"):
        in_container(Circle((6, 6), 7, inside=True), 1, boundary=("periodic", "walls"))
    moving = Circle((6, 6), 5, inside=True, motion=Translation((1, 0), stop=2))
    with pytest.raises(mpsim.InputError, match=r"the motion of obstacles\[0\] must keep it in the box"):
        in_container(moving, 1, boundary=("periodic", "walls"))
    scene = mpsim.Scene(width=12, height=12, position=[(6, 6)], velocity=[(0, 0)], radius=0.5, obstacles=DRUM)
    with mpsim.Simulation(scene) as sim:
        for place in ((1.4, 6), (11.5, 11.5)):
            with pytest.raises(mpsim.InputError, match="must be one radius from every obstacle"):
                sim.add(place, (0, 0))
        sim.add((1.6, 6), (0, 0))
