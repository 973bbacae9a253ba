"""A scene goes on from a state: of any precision, without the discs that have left, with the piston where it was."""

import numpy as np
import pytest
from support.scenes import simulate
from support.states import after, box_of

import mpsim
from mpsim import State
from mpsim.errors import InputError
from mpsim.measure import observables


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


@pytest.mark.slow
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


WAYS = {
    "float32": lambda array: array.astype(np.float32),
    "float32 numbers held as float64": lambda array: array.astype(np.float32).astype(np.float64),
    "float64": lambda array: array,
    "float64 and a rounding": lambda array: np.nextafter(array, np.where(array > array.mean(), np.inf, -np.inf)),
}
"""What a state of a run may hold where a disc touches a wall."""


def boxes():
    """Scenes with a disc in each corner, in boxes small and large, whose walls are no float32 numbers."""
    rng = np.random.default_rng(3)
    for _ in range(40):
        width = float(10 ** rng.uniform(-4, 9))
        height = width * float(10 ** rng.uniform(-2, 2))
        radius = min(width, height) * float(rng.uniform(0.001, 0.4))
        corners = [[x, y] for x in (radius, width - radius) for y in (radius, height - radius)]
        yield mpsim.Scene(width=width, height=height, position=corners, velocity=np.zeros((4, 2)), radius=radius)


@pytest.mark.parametrize("way", WAYS)
def test_discs_at_the_walls_stay_at_the_walls(way):
    moved = 0
    for scene in boxes():
        position = WAYS[way](scene.position)
        there = scene.starting_from(State(position, np.zeros_like(position)))
        low, high = scene.limits(scene.radius)
        assert ((there.position >= low) & (there.position <= high)).all()
        assert np.abs(there.position - position).max() <= 2 * np.finfo(np.float32).eps * max(scene.width, scene.height)
        moved += int((there.position != position).any())
    assert moved or way == "float64", "no rounding led beyond a wall, which tests nothing"


@pytest.mark.parametrize(
    ("way", "dtype"),
    [
        ("float32", np.float32),
        ("float32 numbers held as float64", np.float32),
        ("float64", np.float64),
        ("float64 and a rounding", np.float64),
    ],
)
def test_a_disc_that_is_really_outside_is_refused(way, dtype):
    """The control: 64 roundings of the state's precision beyond the wall."""
    for scene in boxes():
        position = scene.position.copy()
        position[3] += 64 * np.finfo(dtype).eps * max(scene.width, scene.height)
        position = WAYS[way](position)
        with pytest.raises(mpsim.InputError, match=r"position\[3\] must lie in"):
            scene.starting_from(State(position, np.zeros_like(position)))


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("contact", ["impact", "push"])
def test_a_run_that_is_broken_off_anywhere_can_be_gone_on_with(precision, contact):
    scene = mpsim.Scene.random(count=60, width=9.7, height=7.3, radius=0.35, temperature=4, seed=3)
    at_wall = 0
    with mpsim.Simulation(scene, mpsim.Settings(dt=0.02, method="grid", precision=precision, contact=contact)) as sim:
        for _ in range(50):
            sim.run(frames=5)
            for position in (sim.state.position, sim.state.position.astype(np.float64)):
                there = scene.starting_from(State(position, sim.state.velocity))
                at_wall += int((there.position != position).any())
    if precision == "float32" and contact == "push":
        assert at_wall, "no disc came to a wall whose place is rounded, which tests nothing"
