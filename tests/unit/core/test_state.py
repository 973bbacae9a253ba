"""State: copies in the order of the scene's discs, its digest, its files."""

import numpy as np
import pytest
from support.scenes import gas, simulate

import mpsim
from mpsim.core.state import State
from mpsim.errors import InputError


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


@pytest.mark.parametrize("method", ["naive", "grid", "parallel"])
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_the_first_state_is_the_scene_in_its_order_and_precision(method, precision):
    scene = gas(200, 0.5, seed=1)
    with simulate(scene, method=method, workers=2, precision=precision) as sim:
        assert sim.state.position.tolist() == scene.position.astype(precision).tolist()
        assert sim.state.velocity.tolist() == scene.velocity.astype(precision).tolist()
        assert sim.state.position.dtype == precision
        assert (sim.frame, sim.time, sim.count) == (0, 0, 200)
        assert sim.scene is scene


def test_a_state_is_a_copy():
    with simulate(gas(50, 0.5), method="grid") as sim:
        before = sim.digest()
        state = sim.state
        state.position.base[:] = 0
        state.velocity.base[:] = np.nan
        assert sim.digest() == before
    assert state.position.shape == (50, 2), "a state outlives its simulation"


def test_a_state_is_not_written_to():
    given = np.zeros((2, 2))
    made = mpsim.State(given, given, spin=np.zeros(2), image=np.zeros((2, 2), int), box=(0, 1, 0, 1))
    with simulate(gas(50, 0.5), method="grid") as sim:
        for state in (made, sim.state, sim.state_between(0, 10), sim.local_state()[1]):
            for array in vars(state).values():
                if isinstance(array, np.ndarray):
                    with pytest.raises(ValueError, match="read-only"):
                        array[0] = 1
                    array.copy()[0] = 1
    given[0] = 1.0  # the caller's own array stays as it is


def test_a_digest_depends_on_shape_and_field():
    zeros, ones = np.zeros((2, 2)), np.ones((2, 2))
    states = [
        mpsim.State(zeros, ones),
        mpsim.State(ones, zeros),
        mpsim.State(zeros.astype(np.float32), ones.astype(np.float32)),
        mpsim.State(-zeros, ones),
        mpsim.State(np.zeros((1, 2)), np.ones((1, 2))),
    ]
    assert len({state.digest() for state in states}) == len(states)


def test_a_digest_does_not_depend_on_the_layout_in_memory():
    values = np.arange(20.0).reshape(10, 2)
    digests = {
        mpsim.State(values, values).digest(),
        mpsim.State(np.asfortranarray(values), values).digest(),
        mpsim.State(values.astype(">f8"), values).digest(),
    }
    assert len(digests) == 1


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_a_state_is_saved_and_loaded_to_the_bit(tmp_path, precision):
    with simulate(gas(50, 0.5), method="grid", precision=precision) as sim:
        sim.run(frames=5)
        state = sim.state
    again = mpsim.State.load(state.save(tmp_path / "a.npz"))
    assert again.digest() == state.digest()
    assert again.position.dtype == precision


def test_a_file_that_is_no_state_is_refused(tmp_path):
    with pytest.raises(mpsim.InputError, match=r"must end in \.npz; got 'a\.txt'\. Use 'state\.npz'\."):
        mpsim.State.load("a.txt")
    with pytest.raises(mpsim.InputError, match=r"must be a \.npz with position and velocity; .*No such file"):
        mpsim.State.load(tmp_path / "none.npz")
    (tmp_path / "bad.npz").write_bytes(b"PK nonsense")
    with pytest.raises(mpsim.InputError, match=r"must be a \.npz with position and velocity; "):
        mpsim.State.load(tmp_path / "bad.npz")
    np.savez(tmp_path / "other.npz", position=np.zeros((3, 2)), velocity=np.zeros((2, 2)))
    with pytest.raises(mpsim.InputError, match=r"velocity of a state must have shape \(3, 2\).*got \(2, 2\)\.$"):
        mpsim.State.load(tmp_path / "other.npz")
    np.savez(tmp_path / "code.npz", position=np.array([print], object), velocity=np.zeros((1, 2)))
    with pytest.raises(mpsim.InputError, match="is not a plain array"):
        mpsim.State.load(tmp_path / "code.npz")
    with pytest.raises(
        mpsim.errors.OutputError, match=r"must be in a folder that can be written to; got .* Choose another"
    ):
        mpsim.State(np.zeros((1, 2)), np.zeros((1, 2))).save(tmp_path / "none" / "a.npz")


def test_a_state_prints_as_a_line():
    state = State(np.zeros((2, 2)), np.zeros((2, 2)), present=np.array([True, False]), box=(0.0, 4.0, 0.0, 3.0))
    assert repr(state) == "<State: 2 discs, 1 absorbed, in 4 x 3, float64>"


def test_a_state_may_be_given_as_lists():
    state = mpsim.State([[1.0, 2.0]], [[0, 3]])
    assert state.digest() == mpsim.State(np.array([[1.0, 2.0]]), np.array([[0.0, 3.0]])).digest()


@pytest.mark.parametrize(
    ("position", "velocity", "words"),
    [
        ([1, 2], [1, 2], r"position of a state must have shape \(N, 2\); got shape \(2,\)"),
        (np.ones(2), np.ones(2), r"position of a state must have shape \(N, 2\), one row per disc; got \(2,\)"),
        (np.ones((2, 2)), np.ones((3, 2)), r"velocity of a state must have shape \(2, 2\), .* got \(3, 2\)"),
        ([["1", "2"]], [[0, 0]], r"position of a state must be numbers of shape \(N, 2\); got .* \(text\)"),
    ],
)
def test_a_state_of_another_shape_is_refused_by_name(position, velocity, words):
    with pytest.raises(mpsim.InputError, match=words):
        mpsim.State(position, velocity)


@pytest.mark.parametrize("given", [gas(9, 0.1), "gas", None])
def test_a_scene_starts_from_states_only(given):
    with pytest.raises(mpsim.InputError, match=r"state must be a State; got \w+\. Use sim\.state"):
        gas(9, 0.1).starting_from(given)
