"""Scenes that do something: a piston, an open edge, a hopper, a heap, pegs. Each against a law, with a control."""

import math

import numpy as np
import pytest
from support.internals import wall_impulses
from support.scenes import gas, simulate

from mpsim import FixedDisc, Piston, Polyline, Scene
from mpsim.measure import independent_average

pytestmark = pytest.mark.slow

G = 1.0


def compressed(speed, seed, contact="impact", count=200, radius=0.1, dt=0.02):
    """After a right wall has halved a box of 40 x 20: energy over that at the start, and what impulse times speed of
    the right and of the left wall would make of it."""
    base = Scene.random(count=count, width=40, height=20, radius=radius, seed=seed)
    features = dict(width=40, height=20, radius=radius, piston=Piston("right", -speed, 20.0))
    scene = Scene(position=base.position, velocity=base.velocity, **features)
    before = (scene.velocity**2).sum() / 2
    with simulate(scene, method="naive", dt=dt, contact=contact) as sim:
        left, right, _, _ = wall_impulses(sim, round(20 / speed / dt))
        return (sim.state.velocity**2).sum() / 2 / before, speed * right / before, speed * left / before


def test_a_piston_does_the_work_that_the_gas_gains_and_slowly_keeps_temperature_times_area(figures):
    """T A is constant in two dimensions (gamma = 2) for an ideal gas; d ln T = -Z d ln A for discs, A for centres."""
    radius, count = 0.1, 200
    rows = [compressed(0.02, seed, radius=radius, count=count) for seed in range(3)]
    gained = independent_average([row[0] for row in rows])
    worst = max(abs(work - (energy - 1)) for energy, work, _ in rows)
    assert worst < 1e-8, f"work and energy differ by {worst} of the energy"
    area = [(width - 2 * radius) * (20 - 2 * radius) for width in (40, 20)]
    covered = 2 * count * math.pi * radius**2  # Z = 1 / (1 - 2 eta) at this order: the area that is left to move in
    expected = (area[0] - covered) / (area[1] - covered)
    assert abs(gained.value / expected - 1) < 3 * gained.error / expected + 0.01
    fast, work, other = compressed(2.0, 0, radius=radius, count=count)
    assert fast > 1.5 * expected, f"a piston as fast as the discs must heat by more; got {fast}"
    assert abs(work - (fast - 1)) < 1e-8, "but its work is still what the gas gains"
    assert abs(other - (fast - 1)) > 0.1, "what the wall at rest takes up is another quantity"
    quantity = "box halved by a piston at 0.02: T/T0"
    figures.note("P1", "impact", quantity, f"{expected:.3f}", gained, f"piston at 2: {fast:.2f}")
    figures.note(
        "P1",
        "impact",
        "work of the piston less energy gained, part",
        0,
        f"{worst:.0e}",
        f"other wall: {other - fast + 1:.1f}",
    )


def test_an_open_edge_lets_out_what_reaches_it_and_no_other(figures):
    """Points that never meet: who leaves is known in advance, and how many is n sqrt(kT/2 pi m) per length and time."""
    count, width, height, radius, until = 20_000, 100.0, 20.0, 1e-6, 10.0
    rng = np.random.default_rng(7)
    position = np.column_stack([rng.uniform(1, width - 1, count), rng.uniform(1, height - 1, count)])
    velocity = rng.normal(size=(count, 2))
    scene = Scene(
        width=width, height=height, position=position, velocity=velocity, radius=radius, absorbing="right"
    )  # fmt: skip
    with simulate(scene, method="grid", dt=0.01, contact="impact") as sim:
        sim.run(until=until)
        gone, rest = sim.absorbed, sim.state
    way = position[:, 0] + velocity[:, 0] * until
    way = np.where(way < radius, 2 * radius - way, way)
    leaves = way > width - radius
    sure = np.abs(way - width) > 1e-3
    assert np.array_equal(gone[sure], leaves[sure])
    assert not rest.velocity[gone].any()
    assert (rest.position[gone, 0] > width - 0.06).all(), "they rest where they left"
    expected = count / (width - 2) * (until / math.sqrt(2 * math.pi) - 1 / 2)  # the last length unit was empty
    sigma = math.sqrt(expected)
    assert abs(gone.sum() - expected) < 4 * sigma
    with simulate(Scene(width=width, height=height, position=position, velocity=velocity, radius=radius),
                  method="grid", dt=0.01) as sim:  # fmt: skip
        sim.run(frames=10)
        assert not sim.absorbed.any()
    figures.note("P2", "impact", "discs through an open edge", f"{expected:.0f}({sigma:.0f})", gone.sum(), "closed: 0")


def outflow(gap, gravity, restitution, every, times):
    """Numbers of grains of radius 0.2 that leave a hopper in each of so many spans of time."""
    rng, count, width = np.random.default_rng(0), 800, 20.0
    lattice = np.stack([0.6 + 0.5 * (np.arange(count) % 38), 22 + 0.5 * (np.arange(count) // 38)], axis=1)
    funnel = [
        Polyline([(0, 18.0), ((width - gap) / 2, 10)], 0.4),
        Polyline([(width, 18.0), ((width + gap) / 2, 10)], 0.4),
    ]
    scene = Scene(
        width=width, height=40, radius=0.2, position=lattice + rng.uniform(-0.03, 0.03, (count, 2)),
        velocity=rng.normal(size=(count, 2)) * (0.1 if gravity else 1.0), gravity=(0, -gravity), obstacles=funnel,
        absorbing="bottom", restitution=restitution, wall_restitution=restitution,
    )  # fmt: skip
    with simulate(scene, method="grid", dt=0.005, contact="impact") as sim:
        counts = [0]
        for _ in range(times):
            sim.run(until=sim.time + every)
            counts.append(int(sim.absorbed.sum()))
        assert np.isfinite(sim.state.position).all()
    return np.diff(counts)


def test_a_hopper_empties_at_a_steady_rate_whatever_stands_above(figures):
    """From the time that it flows until a quarter is left; a gas leaves in proportion to what is there."""
    flow = outflow(2.2, G, 0.6, 5.0, 8)[1:7]
    first, last = flow[:3].mean(), flow[3:].mean()
    assert abs(last / first - 1) < 0.2, f"grains in each span: {flow}"
    assert (flow > 50).all(), "it must flow"
    assert flow.sum() > 400, "half of the grains must have run out meanwhile"
    wide, narrow = outflow(3.0, G, 0.6, 5.0, 3)[1:].mean(), outflow(1.6, G, 0.6, 5.0, 3)[1:].mean()
    assert wide > 1.8 * narrow, "a wider gap lets out more"
    gas_flow = outflow(6.0, 0.0, 1.0, 100.0, 6)
    assert gas_flow[-1] < 0.5 * gas_flow[0], f"a gas leaves ever slower: {gas_flow}"
    found, control = f"{last / first:.2f}", f"gas: {gas_flow[-1] / gas_flow[0]:.2f}"
    figures.note("P3", "impact", "hopper: outflow, later over earlier", 1, found, control)


def heap(dt, restitution, until=200.0):
    """Kinetic energy per disc, and how far discs moved over the last quarter, of 60 discs on a bent line and a peg."""
    rng, index = np.random.default_rng(0), np.arange(60)
    position = np.stack([1 + 1.1 * (index % 10) + 0.04 * (index // 10 % 2), 3 + 1.1 * (index // 10)], axis=1)
    scene = Scene(
        width=12, height=16, position=position + rng.uniform(-0.04, 0.04, (60, 2)), velocity=np.zeros((60, 2)),
        radius=0.5, gravity=(0, -G), restitution=restitution, wall_restitution=restitution,
        obstacles=[Polyline([(0, 2.0), (6, 1), (12, 2.0)]), FixedDisc((6, 3), 0.3)],
    )  # fmt: skip
    with simulate(scene, method="naive", dt=dt, contact="impact", passes=4) as sim:
        sim.run(until=until * 3 / 4)
        before = sim.state.position
        energies = []
        for _ in range(20):
            sim.run(until=sim.time + until / 80)
            energies.append((sim.state.velocity**2).sum() / 2 / 60)
        after = sim.state.position
    below = after[:, 1] < 1 + np.abs(after[:, 0] - 6) / 6
    return np.mean(energies), np.abs(after - before).max(), below.sum()


def test_an_inelastic_heap_comes_to_rest_and_stays(figures):
    """What is left is the fall of a frame in each layer, some (6 g dt)^2 / 2 per disc: of second order, no heat."""
    for dt in (0.01, 0.005):
        energy, moved, sunk = heap(dt, 0.5)
        assert energy < (8 * G * dt) ** 2, f"{energy} per disc is left at dt={dt}"
        assert moved < 0.5, f"a disc has moved by {moved} in the last quarter"
        assert sunk == 0, f"{sunk} discs have sunk through the line"
    hot, _, _ = heap(0.005, 1.0)
    assert hot > 0.1, "an elastic one must stay hot"
    figures.note(
        "P4", "impact", "heap, e = 0.5, dt = 0.005: energy per disc", "< 0.0016", f"{energy:.1e}", f"e = 1: {hot:.2f}"
    )


def board(rows, restitution, tilt=0.0, runs=4):
    """Where discs leave a board of pegs, from where they entered, in distances of the pegs: 40 lanes per run."""
    pegs = [FixedDisc((x, 3 + 0.8 * r), 0.1) for r in range(rows) for x in np.arange(0.5 * (r % 2), 400.01, 1.0)]
    ends = []
    for seed in range(runs):
        entry = np.arange(40) * 10 + 5 + 0.5 * ((rows - 1) % 2)
        place = entry + np.random.default_rng(seed).uniform(-0.1, 0.1, 40)
        height = 3 + 0.8 * (rows - 1) + 0.5
        scene = Scene(
            width=400, height=height + 2, position=np.column_stack([place, np.full(40, height)]),
            velocity=np.zeros((40, 2)), radius=0.35, gravity=(tilt, -G), wall_restitution=restitution, obstacles=pegs,
            absorbing="bottom",
        )  # fmt: skip
        with simulate(scene, method="grid", dt=0.01, contact="impact") as sim:
            sim.run(until=10.0 * rows)
            assert sim.absorbed.mean() > 0.95, "discs hang on the pegs"
            ends.append((sim.state.position[:, 0] - entry)[sim.absorbed])
    return np.concatenate(ends)


def from_binomial(ends, rows):
    """Largest difference of the cumulative filling of the bins from the binomial law's, B(rows, 1/2) (Kolmogorov)."""
    steps = np.arange(rows + 1) - rows / 2
    filling = [((ends >= step - 0.5) & (ends < step + 0.5)).mean() for step in steps]
    law = [math.comb(rows, right) / 2**rows for right in range(rows + 1)]
    return np.abs(np.cumsum(filling) - np.cumsum(law)).max()


def check_board(rows, runs, figures):
    """Left and right alike, and as wide as the binomial law says of independent steps, sqrt(rows) / 2, within 20 %."""
    ends, expected = board(rows, 0.24, runs=runs), math.sqrt(rows) / 2
    assert abs(ends.mean()) < 4 * ends.std() / math.sqrt(len(ends)), f"the board is not fair: {ends.mean()}"
    assert abs(ends.std() / expected - 1) < 0.2, f"width {ends.std()}, binomial {expected}"
    skew = ((ends - ends.mean()) ** 3).mean() / ends.std() ** 3
    assert abs(skew) < 4 * math.sqrt(6 / len(ends)), f"the profile is not symmetric: {skew}"
    tilted = board(rows, 0.24, tilt=0.4, runs=1)
    assert tilted.mean() > 4 * tilted.std() / math.sqrt(len(tilted)), "a tilted board must not be fair"
    dull = board(rows, 0.0, runs=1)
    assert dull.std() < 0.5 * expected, "without any bounce discs follow one path"
    control = f"e = 0: {dull.std():.2f}; tilted: mean {tilted.mean():.1f}"
    figures.note(
        "P5", "impact", f"{rows} rows of pegs: width of the profile", f"{expected:.2f}", f"{ends.std():.2f}", control
    )
    critical = 1.63 / math.sqrt(len(ends))  # which independent steps exceed once in a hundred boards
    profile, *controls = (from_binomial(each, rows) for each in (ends, tilted, dull))
    assert profile < critical, f"bins differ from the binomial law by {profile}"
    assert min(controls) > critical
    figures.note(
        "P5", "impact", f"{rows} rows of pegs: bins against the binomial law", f"< {critical:.3f}", f"{profile:.3f}",
        "tilted, e = 0: " + ", ".join(f"{each:.2f}" for each in controls),
    )  # fmt: skip


def test_discs_spread_over_pegs_as_far_as_by_independent_steps(figures):
    check_board(16, 4, figures)


@pytest.mark.long
def test_discs_spread_over_more_pegs(figures):
    check_board(32, 12, figures)


def passed_a_thin_wall(h, packing=0.6, until=50.0):
    """How many of some 190 discs of a hot crowd get to the empty side of a wall without thickness in its middle."""
    base = gas(400, packing, seed=3)
    middle = base.width / 2
    left = base.position[:, 0] < middle - 0.5
    wall = Polyline([(middle, 0), (middle, base.height)])
    features = dict(width=base.width, height=base.height, radius=0.5, obstacles=wall)
    scene = Scene(position=base.position[left], velocity=base.velocity[left], **features)
    with simulate(scene, method="grid", dt=h, contact="impact") as sim:
        sim.run(until=until)
        return (sim.state.position[:, 0] > middle).sum(), left.sum()


def test_a_crowd_does_not_press_discs_through_a_thin_wall_unless_the_step_is_long(figures):
    """Walls are met right after the move; what neighbours do to a disc comes later in the step."""
    (none, of), (some, _) = passed_a_thin_wall(0.05), passed_a_thin_wall(0.2)
    assert none == 0, f"{none} of {of} discs got through the wall"
    assert some > 5, "a control that must let some through"
    figures.note("P7", "impact", "crowd beside a thin wall: got through, h = 0.05", 0, none, f"h = 0.2: {some} of {of}")


def left_of_porous_wall(seed, pull):
    """Mean part of 60 discs left of a wall with gaps in the middle of their box, pulled to the right."""
    base = gas(60, 0.2, seed=seed)
    middle = base.width / 2
    wall = [FixedDisc((middle, y), 0.2) for y in np.arange(0.5, base.height, 2.5)]
    features = dict(width=base.width, height=base.height, radius=0.5, obstacles=wall, gravity=(pull, 0))
    scene = Scene(position=base.position, velocity=base.velocity, **features)
    with simulate(scene, method="naive", dt=0.02, contact="impact") as sim:
        sim.run(until=50)
        counts = []
        for _ in range(300):
            sim.run(frames=100)
            counts.append((sim.state.position[:, 0] < middle).mean())
        energy = (sim.state.velocity**2).sum() / (scene.velocity**2).sum() - 1
    assert pull or abs(energy) < 1e-9, f"obstacles have changed the energy by {energy}"
    return np.mean(counts)


@pytest.mark.long
def test_a_gas_on_both_sides_of_a_porous_wall_has_equal_densities(figures):
    """Obstacles leave the measure uniform: each half holds half of the discs in the mean, and all of the energy."""
    found = independent_average([left_of_porous_wall(seed, 0.0) for seed in range(24)])
    assert abs(found.value - 0.5) < 4 * found.error
    assert found.error < 0.003
    control = independent_average([left_of_porous_wall(seed, 0.1) for seed in range(3)])
    assert control.value < 0.48, "pulled, the gas must be denser on the right"
    figures.note("P6", "impact", "discs left of a porous wall, part", 0.5, found, f"pulled: {control}")
