"""A scene goes on from a state of its own in any precision, and from no state that is really outside."""

import numpy as np
import pytest

import mpsim
from mpsim import State

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
