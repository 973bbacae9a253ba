"""Every column of the state is in the digest, in files of states and in checkpoints, or left out for a reason."""

import dataclasses
import inspect
import warnings
from typing import Any

import numpy as np
import pytest
from support.goldens import SCENES

import mpsim
from mpsim.core.state import in_frame
from mpsim.engine import checkpoint

COLUMNS = {field.name: field for field in dataclasses.fields(mpsim.State)}

VALUES: dict[str, Any] = {
    "position": np.array([[1.0, 2.0], [3.0, 1.5]]),
    "velocity": np.array([[0.5, -1.0], [0.0, 0.25]]),
    "image": np.array([[1, 0], [0, -2]]),
    "present": np.array([True, False]),
    "spin": np.array([1.5, 0.0]),
    "box": (0.0, 4.0, 0.0, 3.0),
}
"""A value of each, other than what is there when nobody gives one."""


OTHERS: dict[str, Any] = {
    "position": np.array([[1.0, 2.0], [3.0, np.nextafter(1.5, 2)]]),
    "velocity": np.array([[0.5, -1.0], [-0.0, 0.25]]),
    "image": np.array([[1, 0], [0, -1]]),
    "present": np.array([False, True]),
    "spin": np.array([np.nextafter(1.5, 2), 0.0]),
    "box": (0.0, 4.0, 0.0, np.nextafter(3.0, 4)),
}
"""Another value of each that differs by as little as can be."""


@pytest.fixture(autouse=True)
def without_warnings_of_the_start():
    with warnings.catch_warnings():
        for kind in (mpsim.EmitterWarning, mpsim.FastWarning, mpsim.OverlapWarning):
            warnings.simplefilter("ignore", kind)
        yield


def same(one: Any, other: Any) -> bool:
    return repr(one) == repr(other) if not isinstance(one, np.ndarray) else np.array_equal(one, other)


# --- the digest and the file of a state


def test_each_column_has_values_here():
    assert COLUMNS.keys() == VALUES.keys() == OTHERS.keys()


@pytest.mark.parametrize("name", COLUMNS)
def test_each_column_is_in_the_digest_or_is_left_out_for_a_reason(name):
    before, after = mpsim.State(**VALUES).digest(), mpsim.State(**VALUES | {name: OTHERS[name]}).digest()
    assert (before == after) == ("reason" in COLUMNS[name].metadata), f"{name}: {before}, {after}"


def test_only_the_box_is_left_out_of_the_digest():
    assert [name for name in COLUMNS if "reason" in COLUMNS[name].metadata] == ["box"]


def test_a_new_column_that_does_not_say_whether_it_is_in_the_digest_has_none():
    """The control: a column that somebody forgets."""
    wider = dataclasses.make_dataclass("Wider", [("colour", Any, None)], bases=(mpsim.State,), init=False, frozen=True)
    with pytest.raises(KeyError, match="digested"):
        wider(VALUES["position"], VALUES["velocity"]).digest()


def test_a_column_that_says_so_is_in_the_digest():
    column = dataclasses.field(default=1.0, metadata={"digested": lambda value: True})
    wider = dataclasses.make_dataclass(
        "Wider", [("colour", Any, column)], bases=(mpsim.State,), init=False, frozen=True
    )
    state, digests = wider(VALUES["position"], VALUES["velocity"]), set()
    for colour in (np.zeros(2), np.ones(2)):
        object.__setattr__(state, "colour", colour)
        digests.add(state.digest())
    assert len(digests | {mpsim.State(VALUES["position"], VALUES["velocity"]).digest()}) == 3


def test_a_frame_of_a_trajectory_has_the_columns_that_say_so_of_the_discs_that_are_present():
    column = dataclasses.field(default=1.0, metadata={"digested": lambda value: True, "in_frames": True})
    wider = dataclasses.make_dataclass(
        "Wider", [("colour", Any, column)], bases=(mpsim.State,), init=False, frozen=True
    )
    state = wider(**VALUES)
    object.__setattr__(state, "colour", np.array([3.0, 4.0]))
    found = {name: values.tolist() for name, values in in_frame(state).items()}
    assert found == {"velocity": [[0.5, -1.0]], "image": [[1, 0]], "spin": [1.5], "colour": [3.0]}
    assert in_frame(mpsim.State(VALUES["position"], VALUES["velocity"])).keys() == {"velocity"}


def test_the_file_of_a_state_has_every_column(tmp_path):
    state = mpsim.State(**VALUES)
    path = state.save(tmp_path / "a.npz")
    assert set(np.load(path).files) == COLUMNS.keys()
    again = mpsim.State.load(path)
    for name in COLUMNS:
        assert same(getattr(again, name), getattr(state, name)), name


# --- checkpoints


def saved(tmp_path, name="everything rough", **how):
    """The state in the middle of a run, and the path of its checkpoint."""
    with SCENES[name].start(**how) as sim:
        sim.run(frames=12)
        return sim.state, sim.save(tmp_path / "run")


@pytest.mark.parametrize(("name", "method"), [("everything rough", "grid"), ("rough exact", "event")])
def test_a_checkpoint_has_every_column_of_the_state(name, method, tmp_path):
    state, path = saved(tmp_path, name, method=method)
    start = mpsim.State(SCENES[name].scene().position, SCENES[name].scene().velocity)
    with mpsim.Simulation.resume(path) as sim:
        for column in COLUMNS:
            assert same(getattr(sim.state, column), getattr(state, column)), column
            moved = not same(getattr(state, column), getattr(start, column))
            assert moved or (column == "present" and method == "event"), f"{column} is as it was at the start"


@pytest.mark.parametrize(
    ("array", "column"), [("exits", "present"), ("image", "image"), ("velocity", "velocity"), ("spin", "spin")]
)
def test_a_checkpoint_that_forgets_a_column_is_noticed(array, column, tmp_path, monkeypatch):
    """The control."""
    state, path = saved(tmp_path, method="grid")
    read = checkpoint.read

    def read_and_forget(path, check):
        found = read(path, check)
        return dataclasses.replace(found, arrays=found.arrays | {array: np.zeros_like(found.arrays[array])})

    monkeypatch.setattr(checkpoint, "read", read_and_forget)
    with mpsim.Simulation.resume(path) as sim:
        assert not same(getattr(sim.state, column), getattr(state, column))


IN_A_SNAPSHOT = {
    "a.x": "position", "a.y": "position", "a.vx": "velocity", "a.vy": "velocity", "a.radius": "radii", "mass": "masses",
    "acceleration": "acceleration", "exits": "exits", "image": "image", "spin": "spin", "control": "progress",
    "disc": "disc", "event": "event", "cell_head": "cell_head", "cell_next": "cell_next", "order": "order",
    "clock": "clock", "counter": "counter", "tally": "tally", "winding": "winding", "radius": "radii",
}  # fmt: skip
"""Arrays of the block that frames change, or that hold discs that were added, and what has them in a checkpoint."""


MADE_ANEW = {
    "the other buffer": {"b.x", "b.y", "b.vx", "b.vy", "b.id", "b.cell", "b.radius"},
    "the order in memory, which changes no bit": {"a.id", "a.cell", "start", "outbox", "sent", "team"},
    "times that are measured": {"times"},
    "from scene and settings": {"parameters", "gravity", "giants", "wrap_x", "piston", "friction", "wall_friction",
                                "capsules.capsule",
                                "capsules.near", "capsules.index", "capsules.grid", "capsules.per_length"},
    "the calendar, from the next events of the discs": {"entry", "step_head", "heap"},
}  # fmt: skip
"""Arrays of the block that a checkpoint leaves out, by the reason."""


def test_each_array_of_the_block_is_in_a_checkpoint_or_made_anew():
    names, kept = set(), set()
    for name, method in (("everything rough", "grid"), ("rough exact", "event")):
        with SCENES[name].start(method=method) as sim:
            names |= set(sim._solver.array_names)
            kept |= sim._solver.snapshot().keys()
    anew = set().union(*MADE_ANEW.values())
    assert not anew & IN_A_SNAPSHOT.keys()
    assert names == anew | IN_A_SNAPSHOT.keys()
    assert kept == set(IN_A_SNAPSHOT.values()) | {"seen"}, "seen: what of the tally was handed out, beside the block"


def test_a_checkpoint_has_every_argument_of_the_scene(tmp_path):
    everything, plain = SCENES["everything rough"].scene(), SCENES["bare"].scene()
    values = {name: getattr(everything, name) for name in inspect.signature(mpsim.Scene).parameters}
    scene = mpsim.Scene(**values | {"duration": 3.5})
    with mpsim.Simulation(scene, mpsim.Settings(method="grid")) as sim:
        path = sim.save(tmp_path / "run")
    with mpsim.Simulation.resume(path) as sim:
        assert sim.scene.digest() == scene.digest()
        for name in values:
            assert same(getattr(sim.scene, name), getattr(scene, name)), name
            common = name in ("width", "height", "position", "velocity")
            assert common or not same(getattr(scene, name), getattr(plain, name)), f"{name} is as in the bare scene"


def test_a_checkpoint_has_every_setting_that_changes_a_bit(tmp_path):
    settings = mpsim.Settings(
        dt=0.02, method="grid", law="reflect", contact="push", passes=2, substeps=3, precision="float32",
        unguarded=True, on_worker_death="restart", on_fast="substep",
    )  # fmt: skip
    with mpsim.Simulation(SCENES["bare"].scene(), settings) as sim:
        path = sim.save(tmp_path / "run")
    with mpsim.Simulation.resume(path) as sim:
        assert sim.settings == settings
    same_by_default = {
        each.name for each in dataclasses.fields(settings) if getattr(settings, each.name) == each.default
    }
    assert same_by_default == {"workers", "start_method"}, "which are chosen anew"
