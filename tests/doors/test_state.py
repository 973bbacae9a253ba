"""States: copies in the order of the scene, their digest and files; and that checkpoints forget nothing of a run."""

import copy
import dataclasses
import inspect
import pickle

import numpy as np
import pytest
from support.scenes import ZOO, gas, simulate, zoo

import mpsim
from mpsim import InputError, Scene, Settings, State

pytestmark = pytest.mark.plain

ZEROS = np.zeros((2, 2))
VALUES = {
    "position": np.array([[1.0, 2.0], [3.0, 1.5]]),
    "velocity": np.array([[0.5, -1.0], [0.0, 0.25]]),
    "present": np.array([True, False]),
    "image": np.array([[1, 0], [0, -2]]),
    "spin": np.array([1.5, 0.0]),
    "box": (0.0, 4.0, 0.0, 3.0),
}
OTHERS = {
    "position": np.array([[1.0, 2.0], [3.0, np.nextafter(1.5, 2)]]),
    "velocity": np.array([[0.5, -1.0], [-0.0, 0.25]]),
    "present": np.array([False, True]),
    "image": np.array([[1, 0], [0, -1]]),
    "spin": np.array([np.nextafter(1.5, 2), 0.0]),
    "box": (0.0, 4.0, 0.0, np.nextafter(3.0, 4)),
}
"""Another value of each column that differs by as little as can be."""


def same(one, other):
    return np.array_equal(one, other) if isinstance(one, np.ndarray) else repr(one) == repr(other)


def test_each_column_but_the_box_is_in_the_digest_and_all_are_in_the_file(tmp_path):
    state = State(**VALUES)
    assert {field.name for field in dataclasses.fields(State)} == VALUES.keys()
    unlike = {name for name, value in OTHERS.items() if State(**VALUES | {name: value}).digest() != state.digest()}
    assert unlike == VALUES.keys() - {"box"}
    path = state.save(tmp_path / "a.npz")
    assert set(np.load(path).files) == VALUES.keys()
    again = State(**np.load(path))
    assert again.digest() == state.digest()
    assert all(same(getattr(again, name), getattr(state, name)) for name in VALUES)
    assert again.unwrapped.tolist() == [[5, 2], [3, -4.5]]
    np.savez(tmp_path / "old.npz", position=ZEROS, velocity=ZEROS + 1)
    old = State(**np.load(tmp_path / "old.npz"))
    assert (old.present.all(), old.image, old.box, old.unwrapped.tolist()) == (True, None, None, ZEROS.tolist())


def test_a_digest_is_of_values_shape_and_precision_and_not_of_the_layout_in_memory():
    bare = State(ZEROS, ZEROS)
    assert bare.digest() == "9bdceee64eefb27967ee6f81ab287f46", "of a state with walls, as in the versions before"
    assert bare.digest() == State(ZEROS, ZEROS, present=np.ones(2, bool), box=(0, 1, 0, 1)).digest()
    ones, one = ZEROS + 1, np.zeros((1, 2))
    states = [State(ZEROS, ones), State(ones, ZEROS), State(-ZEROS, ones), State(one, one + 1), bare]
    states += [State(ZEROS.astype(np.float32), ones.astype(np.float32))]
    states += [
        State(ZEROS, ZEROS, image=image, box=(0, 1, 0, 1)) for image in (np.zeros((2, 2), int), np.eye(2, dtype=int))
    ]
    assert len({state.digest() for state in states}) == len(states)
    values = np.arange(20.0).reshape(10, 2)
    layouts = values, np.asfortranarray(values), values.astype(">f8"), values.tolist()
    assert len({State(each, values).digest() for each in layouts}) == 1


@pytest.mark.parametrize("method", ["naive", "grid", "event"])
def test_a_state_is_a_read_only_copy_in_the_order_and_precision_of_the_scene(method):
    scene, given = gas(30, 0.5, seed=1), np.zeros((2, 2))
    precision = "float64" if method == "event" else "float32"
    with simulate(scene, method=method, precision=precision) as sim:
        state, before = sim.state, sim.digest()
        assert state.position.tolist() == scene.position.astype(precision).tolist()
        assert state.velocity.tolist() == scene.velocity.astype(precision).tolist()
        assert state.position.dtype == precision
        assert (sim.frame, sim.time, sim.count, sim.scene is scene) == (0, 0, 30, True)
        for each in (State(given, given, spin=np.zeros(2)), state, sim.state_between(0, 10), sim.local_state()[1]):
            for array in vars(each).values():
                if isinstance(array, np.ndarray):
                    with pytest.raises(ValueError, match="read-only"):
                        array[0] = 1
        assert sim.digest() == before
    assert state.position.shape == (30, 2), "a state outlives its simulation"
    given[0] = 1.0  # the caller's own array stays as it is


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: State(ZEROS, ZEROS, image=np.zeros((1, 2), int), box=(0, 1, 0, 1)), r"of shape \(2, 2\)"),
        (lambda: State(ZEROS, ZEROS, image=np.zeros((2, 2), int)), "image of a state needs box"),
        (lambda: State(ZEROS, ZEROS, charge=np.ones(2)), "an argument of State must be one of .*; got 'charge'"),
        (lambda: State([["1", "2"]], [[0, 0]]), r"of a state must be numbers of shape \(N, 2\); got .* \(text\)"),
        (lambda: State(ZEROS, ZEROS).save("a.txt"), r"must end in \.npz; got 'a\.txt'\. Use 'state\.npz'\."),
    ],
)  # fmt: skip
def test_what_is_no_state_is_refused_by_name(make, words):
    with pytest.raises(InputError, match=words):
        make()


def test_a_state_that_cannot_be_written_is_an_error_and_one_is_shown_in_a_line(tmp_path):
    with pytest.raises(mpsim.errors.OutputError, match=r"must be in a folder that can be written to; got .* Choose"):
        State(ZEROS, ZEROS).save(tmp_path / "none" / "a.npz")
    shown = State(ZEROS, ZEROS, present=np.array([True, False]), box=(0.0, 4.0, 0.0, 3.0))
    assert repr(shown) == "<State: 2 discs, 1 absorbed, in 4 x 3, float64>"


# --- simulations and checkpoints


@pytest.mark.parametrize("name", ["dt", "gravity", "state"])
def test_a_simulation_refuses_assignments(name):
    with simulate(gas(5, 0.2), method="naive") as sim:
        with pytest.raises(InputError, match=rf"^{name} of a Simulation cannot be assigned; got 3\. Use sim\.cha"):
            setattr(sim, name, 3)
        assert not hasattr(sim, "dt")
        for copied in (pickle.dumps, copy.copy, copy.deepcopy):
            with pytest.raises(InputError, match=r"cannot be pickled .* Pass sim\.state"):
                copied(sim)


@pytest.mark.filterwarnings("ignore::mpsim.errors.EmitterWarning")
@pytest.mark.filterwarnings("ignore::mpsim.FastWarning")
def test_a_checkpoint_has_every_column_and_every_argument_of_the_scene(tmp_path):
    plain, rough = zoo("", count=12), zoo(ZOO["everything rough"], count=12, thermostat=mpsim.Thermostat(1.0, 5.0))
    values = {name: getattr(rough, name) for name in inspect.signature(Scene).parameters}
    own = {"settings": Settings(passes=2), "picture_interval": 0.5, "measures": "temperature", "duration": 3.5}
    scene = Scene(**values | own)
    with simulate(scene, method="naive", dt=0.02) as sim:
        sim.run(frames=12)
        state, path = sim.state, sim.save(tmp_path / "run")
    with mpsim.Simulation.resume(path) as sim:
        assert sim.scene.digest() == scene.digest()
        for name in values:
            assert same(getattr(sim.scene, name), getattr(scene, name)), name
            common = name in ("width", "height", "position", "velocity", "thermal_walls")
            assert common or not same(getattr(scene, name), getattr(plain, name)), f"{name} is as in the bare scene"
        for name in VALUES:
            assert same(getattr(sim.state, name), getattr(state, name)), name
            start = State(scene.position, scene.velocity)
            assert not same(getattr(state, name), getattr(start, name)), f"{name} is as it was at the start"


def test_a_checkpoint_has_every_setting_that_changes_a_bit(tmp_path):
    settings = Settings(
        dt=0.02, method="naive", law="reflect", contact="push", passes=2, substeps=3, precision="float32",
        on_fast="substep", contact_time=0.125,
    )  # fmt: skip
    with mpsim.Simulation(gas(5, 0.1), settings) as sim:
        path = sim.save(tmp_path / "run")
    with mpsim.Simulation.resume(path) as sim:
        assert sim.settings == settings
    alike = {each.name for each in dataclasses.fields(settings) if getattr(settings, each.name) == each.default}
    assert alike == {"workers"}, "which is chosen anew"
