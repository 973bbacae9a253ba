"""Edges that absorb, and emitters: times and places of leaving in closed form, by the exact and the stepped solvers."""

import math

import numpy as np
import pytest
from support.compare import assert_same_bits
from support.scenes import simulate

import mpsim
from mpsim import Emitter, FixedDisc, Polyline, Scene

pytestmark = pytest.mark.plain

EDGES = ("left", "right", "bottom", "top")


def exactly(scene, dt=1.0):
    return simulate(scene, method="event", dt=dt)


def closed(scene):
    """The same discs between walls: the control."""
    return Scene(width=scene.width, height=scene.height, position=scene.position, velocity=scene.velocity,
                 radius=scene.radius)  # fmt: skip


@pytest.mark.parametrize("edge", EDGES)
def test_a_disc_leaves_at_the_instant_at_which_it_touches(edge, figures):
    """It is there a rounding before, and away a rounding after; then it rests there, whatever gravity does."""
    sign, axis = (1 if edge in ("right", "top") else -1), int(edge in ("bottom", "top"))
    velocity, gravity = [0.3, 0.3], [0.1, 0.1]
    velocity[axis], gravity[axis] = 1.5 * sign, 0.4 * sign
    scene = Scene(width=8, height=8, position=[[4, 4]], velocity=[velocity], radius=0.5, gravity=gravity,
                  absorbing=edge)  # fmt: skip
    touch = (-1.5 + math.sqrt(1.5**2 + 2 * 0.4 * 3.5)) / 0.4
    for late in (-1e-12, 1e-12, 50.0):
        with exactly(scene, dt=touch + late) as sim:
            sim.run(frames=1)
            assert sim.absorbed.tolist() == [late > 0]
            assert sim.state.present.tolist() == [late < 0]
            assert sim.state.position[0, axis] == pytest.approx(4 + 3.5 * sign, abs=1e-11)
            assert sim.state.position[0, 1 - axis] == pytest.approx(4 + 0.3 * touch + 0.05 * touch**2, abs=1e-11)
            assert (sim.state.velocity[0] == 0).all() == (late > 0)
    with simulate(scene, method="grid", contact="impact", dt=touch / 20) as sim:
        assert sim.run(frames=19).frames == 19
        assert not sim.absorbed.any()
        sim.run(frames=2)
        assert sim.absorbed.all()
        assert sim.state.position[0, axis] == pytest.approx(4 + 3.5 * sign, abs=0.3)
    figures.note(
        "absorbing", "event", f"time of leaving, {edge}", f"{touch:.6f}", "within 1e-12", "1e-12 before: there"
    )


@pytest.mark.parametrize("settings", [{"method": "event", "dt": 2.0}, {"method": "grid", "dt": 0.05}], ids=str)
def test_what_has_left_meets_no_disc(settings):
    """The first leaves at 1; the second would have met it at its place later, and leaves at 3."""
    scene = Scene(width=8, height=3, position=[[6.5, 1.5], [4.5, 1.5]], velocity=[[1, 0], [1, 0]], radius=0.5,
                  absorbing="right")  # fmt: skip
    with simulate(scene, **settings) as sim:
        assert sim.run(until=2.0).collisions == 0
        assert sim.absorbed.tolist() == [True, False]
        assert sim.run(until=4.0).collisions == 0
        assert sim.absorbed.all()
        assert sim.state.position[:, 0] == pytest.approx([7.5, 7.5], abs=0.06)
    with simulate(closed(scene), **settings) as sim:
        assert sim.run(until=4.0).collisions == 1, "the control: at a wall the first comes back and meets the second"


def test_a_predicted_impact_with_a_disc_that_leaves_before_does_not_happen():
    """Without the edge they would meet at x = 7.5, after the first has touched it."""
    scene = Scene(width=8, height=8, position=[[6.6, 4.0], [7.5, 6.0]], velocity=[[1.0, 0.0], [0.0, -1.1]],
                  radius=0.5, absorbing="right")  # fmt: skip
    with exactly(scene, dt=4.0) as sim:
        assert sim.run(frames=1).collisions == 0
        assert sim.absorbed.tolist() == [True, False]
        assert sim.state.velocity[1].tolist() == [0.0, -1.1]
    with exactly(closed(scene), dt=4.0) as sim:
        assert sim.run(frames=1).collisions > 0, "the control"


@pytest.mark.parametrize("settings", [{"method": "event", "dt": 20.0}, {"method": "naive", "dt": 0.25}], ids=str)
def test_discs_that_meet_nobody_leave_after_the_time_to_the_nearest_edge(settings, figures):
    """Points in a box that is open all round: who leaves is known in advance."""
    rng, radius, until = np.random.default_rng(4), 1e-6, 20.0
    position, angle = rng.uniform(0.5, 49.5, (40, 2)), rng.uniform(0, 2 * math.pi, 40)
    velocity = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    scene = Scene(width=50, height=50, position=position, velocity=velocity, radius=radius, absorbing=EDGES)
    with simulate(scene, **settings) as sim:
        sim.run(until=until)
        gone, rest = sim.absorbed, sim.state
    ahead = (np.where(velocity > 0, 50 - radius - position, position - radius) / np.abs(velocity)).min(axis=1)
    assert (gone == (ahead <= until))[np.abs(ahead - until) > 0.25].all()
    assert 5 < gone.sum() < 35
    assert not rest.velocity[gone].any()
    assert np.minimum(rest.position, 50 - rest.position)[gone].min(axis=1).max() < 0.3, "they rest where they left"
    with simulate(closed(scene), **settings) as sim:
        sim.run(until=until)
        assert not sim.absorbed.any()
    figures.note("P2", settings["method"], "of 40 discs, away at t = 20", int(gone.sum()), int(gone.sum()), "closed: 0")


def through(**features):
    """A stream of discs through pegs, from emitters above to an absorbing floor."""
    pegs = [FixedDisc((x + (y % 2), y), 0.3) for x in (2, 4, 6, 8) for y in (3, 4)]
    return Scene(width=12, height=10, position=np.zeros((0, 2)), velocity=np.zeros((0, 2)), radius=0.3,
                 gravity=(0, -1.0), restitution=0.8, wall_restitution=0.7, absorbing="bottom",
                 obstacles=[*pegs, Polyline([(0, 8), (3, 7)], 0.1)],
                 emitters=[Emitter((5.1, 9.0), (0.1, 0.0), interval=1.3, limit=4),
                           Emitter((1.5, 9.0), (0.4, 0.0), interval=1.45, limit=4)], **features)  # fmt: skip


def test_all_that_enters_leaves_and_how_frames_are_cut_changes_no_bit(tmp_path):
    scene = through(piston=mpsim.Piston("right", -0.05, 11.0))
    with exactly(scene, dt=0.7) as whole:
        whole.run(frames=40)
        state = whole.state
        assert whole.count == 8
        assert whole.absorbed.all()
        assert state.position[:, 1].tolist() == [0.3] * 8
        assert scene.deepest(state.position, np.full(8, 0.3 - 1e-12)) is None
    with exactly(scene, dt=0.7) as part:
        for frames in (1, 6, 8):
            part.run(frames=frames)
        assert 0 < part.absorbed.sum() < part.count
        part.save(tmp_path / "run")
    with mpsim.Simulation.resume(tmp_path / "run") as rest:
        assert 0 < rest.absorbed.sum() < rest.count
        rest.run(frames=25)
        assert_same_bits(rest.state, state, "resumed")


def test_a_disc_added_later_finds_those_that_have_left_away():
    """Also where another lies on them now."""
    scene = Scene(width=8, height=3, position=[[6.5, 1.5], [2.0, 1.5]], velocity=[[1, 0], [0, 0]], radius=0.5,
                  absorbing="right", gravity=(0.0, 0.0))  # fmt: skip
    with exactly(scene, dt=2.0) as sim:
        sim.run(frames=1)
        sim.add([7.4, 1.5], [-1.0, 0.0])
        assert sim.absorbed.tolist() == [True, False, False]
        assert sim.run(frames=3).collisions == 1
        assert sim.state.velocity[:, 0].tolist() == [0.0, 1.0, 0.0], "the second is back from the wall"


def test_stepped_runs_come_to_the_exact_one_as_their_step_shrinks(figures):
    """Who has left, and where the others are, before chaos has multiplied the steps' errors."""
    until = 1.5
    scene = Scene.random(count=16, width=9, height=6, radius=0.3, gravity=(0.1, -1.0), seed=2,
                         absorbing=("bottom", "left"), obstacles=[FixedDisc((4.5, 2.5), 0.5)])  # fmt: skip
    with exactly(scene, dt=until) as sim:
        sim.run(frames=1)
        exact, gone = sim.state, sim.absorbed
    assert 0 < gone.sum() < len(gone)
    errors = []
    for contact, steps in (("impact", 300), ("push", 50), ("push", 400)):
        with simulate(scene, method="grid", contact=contact, dt=until / steps) as sim:
            sim.run(frames=steps)
            assert sim.absorbed.tolist() == gone.tolist()
            errors.append(float(np.abs(sim.state.position - exact.position)[~gone].max()))
    assert errors[0] < 1e-4
    assert errors[1] / errors[2] > 3, f"8 times shorter steps: errors {errors}"
    figures.note("absorbing", "push", "error of push, dt / 8", "1/8", f"{errors[2] / errors[1]:.3f}", "")


# --- flows


def outflow(gap, gravity, restitution, every, times):
    """Numbers of grains of radius 0.2 that leave a hopper in each of so many spans of time."""
    rng, count, width = np.random.default_rng(0), 800, 20.0
    lattice = np.stack([0.6 + 0.5 * (np.arange(count) % 38), 22 + 0.5 * (np.arange(count) // 38)], axis=1)
    funnel = [Polyline([(side, 18.0), ((width - way * gap) / 2, 10)], 0.4) for side, way in ((0, 1), (width, -1))]
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


@pytest.mark.slow
def test_a_hopper_empties_at_a_steady_rate_whatever_stands_above(figures):
    """From the time that it flows until a quarter is left; a gas leaves in proportion to what is there."""
    flow = outflow(2.2, 1.0, 0.6, 5.0, 8)[1:7]
    first, last = flow[:3].mean(), flow[3:].mean()
    assert abs(last / first - 1) < 0.2, f"grains in each span: {flow}"
    assert (flow > 50).all(), "it must flow"
    assert flow.sum() > 400, "half of the grains must have run out meanwhile"
    wide, narrow = outflow(3.0, 1.0, 0.6, 5.0, 3)[1:].mean(), outflow(1.6, 1.0, 0.6, 5.0, 3)[1:].mean()
    assert wide > 1.8 * narrow, "a wider gap lets out more"
    gas_flow = outflow(6.0, 0.0, 1.0, 100.0, 4)
    assert gas_flow[-1] < 0.65 * gas_flow[0], f"a gas leaves ever slower: {gas_flow}"
    figures.note("P3", "impact", "hopper: outflow, later over earlier", 1, f"{last / first:.2f}", str(gas_flow))


def board(rows, restitution, tilt=0.0, runs=4):
    """Where discs leave a board of pegs, from where they entered, in distances of the pegs: 40 lanes per run."""
    pegs = [FixedDisc((x, 3 + 0.8 * r), 0.1) for r in range(rows) for x in np.arange(0.5 * (r % 2), 400.01, 1.0)]
    ends = []
    for seed in range(runs):
        entry = np.arange(40) * 10 + 5 + 0.5 * ((rows - 1) % 2)
        height = 3 + 0.8 * (rows - 1) + 0.5
        scene = Scene(
            width=400, height=height + 2, velocity=np.zeros((40, 2)), radius=0.35, gravity=(tilt, -1.0),
            position=np.column_stack([entry + np.random.default_rng(seed).uniform(-0.1, 0.1, 40), np.full(40, height)]),
            wall_restitution=restitution, obstacles=pegs, absorbing="bottom",
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


@pytest.mark.long
@pytest.mark.parametrize(("rows", "runs"), [(16, 4), (32, 12)])
def test_discs_spread_over_pegs_as_far_as_by_independent_steps(rows, runs, figures):
    """Left and right alike, as wide as the binomial law says, sqrt(rows) / 2, within 20 %; bins by Kolmogorov.

    The controls: a tilted board, and one without any bounce, on which discs follow one path.
    """
    ends, expected = board(rows, 0.24, runs=runs), math.sqrt(rows) / 2
    assert abs(ends.mean()) < 4 * ends.std() / math.sqrt(len(ends)), f"the board is not fair: {ends.mean()}"
    assert abs(ends.std() / expected - 1) < 0.2, f"width {ends.std()}, binomial {expected}"
    skew = ((ends - ends.mean()) ** 3).mean() / ends.std() ** 3
    assert abs(skew) < 4 * math.sqrt(6 / len(ends)), f"the profile is not symmetric: {skew}"
    tilted, dull = board(rows, 0.24, tilt=0.4, runs=1), board(rows, 0.0, runs=1)
    assert tilted.mean() > 4 * tilted.std() / math.sqrt(len(tilted))
    assert dull.std() < 0.5 * expected
    critical = 1.63 / math.sqrt(len(ends))  # which independent steps exceed once in a hundred boards
    profile, *controls = (from_binomial(each, rows) for each in (ends, tilted, dull))
    assert profile < critical < min(controls), f"bins differ from the binomial law by {profile}"
    figures.note("P5", "impact", f"{rows} rows of pegs: width", f"{expected:.2f}", f"{ends.std():.2f}", "tilted, e = 0")
