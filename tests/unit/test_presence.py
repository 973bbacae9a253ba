"""Who counts, and where: absorbed discs, periodic borders, a piston that has moved; and what was said before."""

import dataclasses

import numpy as np
import pytest
from support.scenes import gas, simulate

import mpsim
from mpsim.core.errors import InputError
from mpsim.core.state import State
from mpsim.measure import correlation, observables


def box_of(**features):
    """Discs of radius 1/2 in a box of 10 x 8."""
    return mpsim.Scene(**{"width": 10, "height": 8, "radius": 0.5, **features})


def after(scene, until, **settings):
    with simulate(scene, **{"method": "naive", "contact": "impact", "dt": 0.01, **settings}) as sim:
        sim.run(until=until)
        return sim.state


# --- displacements


@pytest.mark.parametrize("method", ["naive", "grid", "event"])
def test_a_free_disc_that_moved_12_in_a_periodic_box_of_10_has_moved_12(method):
    scene = box_of(position=[[2, 4]], velocity=[[3, 0]], boundary="periodic")
    with simulate(scene, method=method, dt=1 / 8) as sim:
        start = sim.state
        sim.run(until=4)
        end = sim.state
    assert observables.mean_squared_displacement(start, end, scene) == pytest.approx(144, rel=1e-12)
    assert observables.mean_squared_displacement(start, end) == pytest.approx(144, rel=1e-12), "no scene is needed"
    bare = [State(state.position, state.velocity) for state in (start, end)]
    assert observables.mean_squared_displacement(*bare, scene) == pytest.approx(4), "the shorter way round, as before"
    assert observables.trajectory_error(end, start, scene).rms == pytest.approx(2), "an error is to the nearest image"


def test_states_of_which_only_one_counts_periods_are_refused():
    scene = box_of(position=[[2, 4]], velocity=[[3, 0]], boundary="periodic")
    end, start = after(scene, 4), State(scene.position, scene.velocity)
    for pair in ((start, end), (end, start)):
        with pytest.raises(InputError, match=r"needs counts of periods \(State.image\) in both states or in neither"):
            observables.mean_squared_displacement(*pair, scene)
    counted = State(scene.position, scene.velocity, image=np.zeros((1, 2), int), box=scene.box)
    assert observables.mean_squared_displacement(counted, end, scene) == pytest.approx(144)


def test_displacements_are_of_discs_that_are_there_all_along():
    scene = box_of(position=[[2, 2], [8, 6]], velocity=[[1, 0], [0.25, 0]], absorbing="right")
    scene = scene.starting_from(State(scene.position[::-1], scene.velocity[::-1] * [[8, 1], [1, 1]]))
    start, end = (State(scene.position, scene.velocity), after(scene, 3))
    assert end.present.tolist() == [False, True]
    assert observables.mean_squared_displacement(start, end) == pytest.approx(9), "not that of the disc that left"
    error = observables.trajectory_error(end, end)
    assert (error.rms, error.disc) == (0, 1), "one that is absent in both has no place"


# --- who is there


@pytest.fixture(scope="module")
def leaking():
    """A gas that has lost some discs through an edge: scene, state, the scene that starts there, and who is left."""
    scene = mpsim.Scene.random(
        count=200, packing=0.3, radius=0.5, seed=4, gravity=(0, -0.25), absorbing="bottom", mass=[1, 2] * 100
    )
    state = after(scene, 4, dt=0.02)
    here = state.present
    assert 40 < here.sum() < 180, here.sum()
    rest = scene.starting_from(state)
    return scene, state, rest, State(state.position[here], state.velocity[here])


def test_observables_count_only_discs_that_are_present(leaking):
    scene, state, rest, left = leaking
    everybody = State(state.position, state.velocity)
    for name in ("kinetic_energy", "potential_energy", "temperature", "momentum", "overlap"):
        function = getattr(observables, name)
        found, expected, before = function(state, scene), function(left, rest), function(everybody, scene)
        if name == "overlap":
            numbers = np.flatnonzero(state.present)
            worst = None if expected.worst is None else tuple(numbers[list(expected.worst)].tolist())
            expected = dataclasses.replace(expected, worst=worst)
            assert before.pairs > 10 * found.pairs, "absorbed discs lie on each other, which was counted"
        if name in ("temperature", "potential_energy"):
            assert abs(before - found) > 0.005 * abs(found), f"{name} was wrong, or this tests nothing"
        assert np.all(found == expected), name
    assert observables.temperature(state, scene, remove_drift=True) == observables.temperature(
        left, rest, remove_drift=True
    )
    assert observables.speed_kurtosis(state) == observables.speed_kurtosis(left)
    assert observables.speed_kurtosis(everybody) > 1.1 * observables.speed_kurtosis(left)
    found, expected = observables.speed_distribution(state), observables.speed_distribution(left)
    assert found.distance == expected.distance
    assert found.density.tolist() == expected.density.tolist()


def test_an_empty_box_has_no_energy_and_no_temperature():
    scene = box_of(position=[[2, 2], [5, 3]], velocity=[[0, -9], [0, -9]], gravity=(0, -1), absorbing="bottom")
    state = after(scene, 2)
    assert not state.present.any()
    assert observables.potential_energy(state, scene) == 0
    assert observables.potential_energy(State(state.position, state.velocity), scene) > 0.5, "as it was"
    assert observables.overlap(state, scene) == observables.Overlap(0, 0.0, 0.0, None)
    with pytest.raises(InputError, match="temperature needs at least 1 disc; got 0"):
        observables.temperature(state, scene)


def test_a_run_gathers_the_temperature_of_discs_that_are_present():
    """Half of the discs leave at once: the temperature is that of the others, which fly on for ever."""
    scene = box_of(position=[[2, 2], [5, 6]], velocity=[[0, -50], [3, 0]], absorbing="bottom")
    with simulate(scene, method="naive", contact="impact") as sim:
        sim.run(until=0.5)
        report = sim.run(frames=200, measures=["temperature", "speed_kurtosis", "kinetic_energy"])
    assert report.measures["temperature"].value == pytest.approx(4.5, rel=1e-12), "and not half of it"
    assert report.measures["speed_kurtosis"].value == pytest.approx(1, rel=1e-12), "and not 2"
    assert report.measures["kinetic_energy"].value == pytest.approx(4.5, rel=1e-12)


def test_a_run_goes_on_when_all_have_left_and_says_that_the_mean_is_not_defined():
    scene = box_of(position=[[2, 2]], velocity=[[0, -5]], absorbing="bottom")
    with simulate(scene, method="naive") as sim:
        report = sim.run(until=2, measures=["temperature"])
        assert np.isnan(report.measures["temperature"].value)
        assert sim.time == 2


# --- a scene that starts from a state


def test_a_scene_that_starts_from_a_state_leaves_out_who_has_left(leaking):
    scene, state, rest, left = leaking
    assert rest.count == state.present.sum() < scene.count
    assert rest.position.tolist() == left.position.tolist()
    assert rest.masses.tolist() == scene.masses[state.present].tolist()
    with simulate(rest, method="naive") as sim:
        assert sim.state.present.all()


def test_radii_masses_and_accelerations_follow_the_discs_that_stay(tmp_path):
    scene = box_of(
        position=[[2, 2], [5, 2], [8, 2]],
        velocity=np.zeros((3, 2)),
        radius=[0.5, 0.25, 0.25],
        mass=[3, 1, 1],
        acceleration=[[1, 0], [2, 0], [3, 0]],
        absorbing="top",
    )
    state = State(scene.position, scene.velocity, present=np.array([True, False, True]))
    rest = scene.starting_from(state)
    assert (rest.radius.tolist(), rest.mass.tolist()) == ([0.5, 0.25], [3, 1])
    assert rest.acceleration.tolist() == [[1, 0], [3, 0]]
    assert scene.count == 3, "the scene itself is as it was"
    for kept in ([False, True, True], [True, True, True], [False, False, False]):
        rest = scene.starting_from(State(scene.position, scene.velocity, present=np.array(kept)))
        rest.save(tmp_path / "rest.toml") if rest.count else None
        assert not rest.count or mpsim.Scene.load(tmp_path / "rest.toml").digest() == rest.digest()
    for array in (rest.position, rest.velocity, rest.acceleration):
        assert not array.flags.writeable


@pytest.mark.parametrize(
    ("wall", "radius", "precision"),
    [
        *[(wall, 0.5, "float64") for wall in ("left", "right", "bottom", "top")],
        ("right", [0.5, 0.25], "float32"),
        ("bottom", [0.5, 0.25], "float32"),
    ],
)
def test_a_piston_goes_on_from_where_it_was(wall, radius, precision):
    """Two runs of a time 2, one after the other, leave it where one of 4 does; discs that it has pushed are inside."""
    axis, upper = divmod(("left", "right", "bottom", "top").index(wall), 2)
    size, speed = (10, 8)[axis], -1.0 if upper else 1.0
    piston = mpsim.Piston(wall, speed, stop=3 if upper else size - 3)
    scene = box_of(position=[[5, 4], [3, 5]], velocity=[[3, 2], [-2, 1]], radius=radius, piston=piston)
    middle = after(scene, 2, precision=precision)
    edges = [0, 10, 0, 8]
    edges[2 * axis + upper] += 2 * speed
    assert middle.box == pytest.approx(edges, rel=1e-6)
    there = scene.starting_from(middle)
    assert there.piston.start == middle.box[2 * axis + upper]
    for until in (1, 2, 9):
        assert after(there, until, precision=precision).box == pytest.approx(after(scene, 2 + until).box, rel=1e-6)
    moved = after(there, 0.01, precision=precision).position - middle.position
    assert np.abs(moved).max() < 0.1, "no disc may jump"
    arrived = scene.starting_from(after(scene, 9, precision=precision))
    assert arrived.piston.start == arrived.piston.stop
    assert after(arrived, 1).box[2 * axis + upper] == piston.stop
    energy = [
        observables.kinetic_energy(state, scene)
        for state in (State(arrived.position, arrived.velocity), after(arrived, 3))
    ]
    assert energy[1] == pytest.approx(energy[0], rel=1e-12), "a piston that has arrived does no work"


def test_a_start_of_a_piston_is_checked_and_kept(tmp_path):
    assert mpsim.Piston("right", -1, 3, start=5).start == 5
    for wall, speed, stop, start in (("right", -1, 3, 2), ("left", 1, 3, 4)):
        with pytest.raises(InputError, match=r"start of a Piston must lie at or (above|below) its stop, 3, .* got"):
            mpsim.Piston(wall, speed, stop, start=start)
    with pytest.raises(InputError, match="start of a Piston must be a finite number >= 0"):
        mpsim.Piston("left", 1, 3, start=-1)
    with pytest.raises(InputError, match=r"start of the piston must lie in the box, in \[0, 10\]; got 11"):
        box_of(position=[[2, 2]], velocity=[[0, 0]], piston=mpsim.Piston("right", -1, 3, start=11))
    with pytest.raises(InputError, match=r"position\[0\] must lie in \[0.5, 5.5\] x \[0.5, 7.5\]"):
        box_of(position=[[7, 2]], velocity=[[0, 0]], piston=mpsim.Piston("right", -1, 3, start=6))
    assert repr(mpsim.Piston("right", -1, 3)) == "Piston(wall='right', speed=-1.0, stop=3.0)", "digests are as before"
    scene = box_of(position=[[2, 2]], velocity=[[0, 0]], piston=mpsim.Piston("right", -1, 3, start=6))
    without = box_of(position=[[2, 2]], velocity=[[0, 0]], piston=mpsim.Piston("right", -1, 3))
    assert scene.digest() != without.digest()
    scene.save(tmp_path / "a.toml")
    assert mpsim.Scene.load(tmp_path / "a.toml").digest() == scene.digest()
    with simulate(scene, method="naive") as sim:
        sim.run(frames=5)
        path = sim.save(tmp_path / "run")
        box = sim.state.box
    with mpsim.Simulation.resume(path) as again:
        assert again.state.box == box
        assert again.scene.digest() == scene.digest()


# --- pair correlation


def test_pair_correlation_behind_a_piston_that_has_arrived_is_that_of_the_smaller_box():
    """Half the box is closed off: the density was taken to be half of what it is, so g came out near 2."""
    half = gas(600, 0.3, seed=2)
    side = half.width
    scene = mpsim.Scene(
        width=2 * side,
        height=side,
        position=half.position,
        velocity=half.velocity,
        radius=0.5,
        piston=mpsim.Piston("right", -1.0, side, start=side),
    )
    with simulate(scene, method="naive", contact="impact") as sim:
        states = [sim.state for _ in range(8) if sim.run(until=sim.time + 0.5)]
    found = correlation.pair_correlation(states, scene, bins=40, r_max=5.0)
    plain = correlation.pair_correlation([State(s.position, s.velocity) for s in states], half, bins=40, r_max=5.0)
    assert found.density == plain.density
    assert found.g.tolist() == plain.g.tolist()
    assert found.g[-10:].mean() == pytest.approx(1, abs=0.03)
    wide = mpsim.Scene(width=2 * side, height=side, position=half.position, velocity=half.velocity, radius=0.5)
    before = correlation.pair_correlation([State(s.position, s.velocity) for s in states], wide, bins=40, r_max=5.0)
    assert before.g[-10:].mean() > 1.5, "the control: the whole box, as it was"


def test_pair_correlation_is_refused_where_density_is_not_uniform():
    plain = gas(200, 0.2)
    parts = {name: getattr(plain, name) for name in ("width", "height", "position", "velocity", "radius")}
    state = State(plain.position, plain.velocity)
    emitter = mpsim.Emitter(position=(plain.width / 2, plain.width / 2), velocity=(1, 0), interval=1.0)
    for features, words in (
        ({"gravity": (0, -1)}, "has gravity"),
        ({"acceleration": np.ones((200, 2))}, "has acceleration"),
        ({"emitters": emitter}, "has emitters"),
        ({"piston": mpsim.Piston("left", 1, plain.width / 2)}, "needs a box at rest; got a piston on its way"),
    ):
        with pytest.raises(InputError, match=words):
            correlation.pair_correlation(state, mpsim.Scene(**parts, **features), 10, 3.0)
    scene = mpsim.Scene(**parts, absorbing="left")
    assert correlation.pair_correlation(state, scene, 10, 3.0).references > 0, "nobody has left yet"
    gone = State(plain.position, plain.velocity, present=np.arange(200) > 0)
    with pytest.raises(InputError, match=r"discs have left through an absorbing edge \(1 absent in 2 states\)"):
        correlation.pair_correlation([state, gone], scene, 10, 3.0)
    still = mpsim.Scene(**parts, gravity=(0, 0))
    assert correlation.pair_correlation(state, still, 10, 3.0).references > 0, "no pull, no gradient"


# --- states


def test_a_state_keeps_all_of_it_in_a_file(tmp_path):
    zeros = np.zeros((3, 2))
    whole = State(
        zeros,
        zeros + 1,
        present=np.array([True, False, True]),
        image=np.array([[0, 1], [-2, 0], [2**40, 0]]),
        box=(0, 4, 1, 3),
    )
    again = State.load(whole.save(tmp_path / "a.npz"))
    assert again.digest() == whole.digest()
    assert again.present.tolist() == [True, False, True]
    assert again.image.tolist() == whole.image.tolist()
    assert again.box == (0.0, 4.0, 1.0, 3.0)
    assert again.unwrapped.tolist() == [[0, 2], [-8, 0], [2**42, 0]]
    np.savez(tmp_path / "old.npz", position=zeros, velocity=zeros + 1)
    old = State.load(tmp_path / "old.npz")
    assert old.present.all()
    assert (old.image, old.box) == (None, None)
    assert old.unwrapped.tolist() == zeros.tolist()


def test_a_digest_depends_on_counts_and_on_who_is_present():
    zeros, box = np.zeros((2, 2)), (0, 1, 0, 1)
    bare = State(zeros, zeros)
    assert bare.digest() == "9bdceee64eefb27967ee6f81ab287f46", "of a state with walls, as in the versions before"
    assert bare.digest() == State(zeros, zeros, present=np.ones(2, bool), box=box).digest()
    states = [
        bare,
        State(zeros, zeros, present=np.array([True, False])),
        State(zeros, zeros, present=np.array([False, True])),
        State(zeros, zeros, image=np.zeros((2, 2), int), box=box),
        State(zeros, zeros, image=np.eye(2, dtype=int), box=box),
    ]
    assert len({state.digest() for state in states}) == len(states)


def test_parts_of_a_state_that_do_not_fit_are_refused():
    zeros = np.zeros((2, 2))
    for parts, words in (
        ({"present": [True]}, r"present of a state must have shape \(2,\)"),
        ({"image": np.zeros((2, 2)), "box": (0, 1, 0, 1)}, "image of a state must hold whole numbers"),
        ({"image": np.zeros((1, 2), int), "box": (0, 1, 0, 1)}, r"of shape \(2, 2\)"),
        ({"image": np.zeros((2, 2), int)}, "image of a state needs box"),
        ({"box": (0, 1, 2)}, "box of a state must have shape"),
    ):
        with pytest.raises(InputError, match=words):
            State(zeros, zeros, **parts)
