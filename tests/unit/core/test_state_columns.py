"""Every column of the state is in the digest, in files of states and in checkpoints, or left out for a reason."""

import dataclasses
import inspect
import typing
import warnings
from typing import Any

import numpy as np
import pytest
from support.goldens import SCENES

import mpsim
from mpsim.core import columns
from mpsim.core.state import NOT_DIGESTED, in_frame
from mpsim.engine import checkpoint
from mpsim.output.frames import Frame

pytestmark = pytest.mark.slow

COLUMNS = tuple(field.name for field in dataclasses.fields(mpsim.State))

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
        for kind in (mpsim.errors.EmitterWarning, mpsim.FastWarning, mpsim.OverlapWarning):
            warnings.simplefilter("ignore", kind)
        yield


def same(one: Any, other: Any) -> bool:
    return repr(one) == repr(other) if not isinstance(one, np.ndarray) else np.array_equal(one, other)


# --- the digest and the file of a state


def test_each_column_has_values_here():
    assert set(COLUMNS) == VALUES.keys() == OTHERS.keys()


@pytest.mark.parametrize("name", COLUMNS)
def test_each_column_is_in_the_digest_or_is_left_out_for_a_reason(name):
    before, after = mpsim.State(**VALUES).digest(), mpsim.State(**VALUES | {name: OTHERS[name]}).digest()
    assert (before == after) == (name in NOT_DIGESTED), f"{name}: {before}, {after}"


def test_only_the_box_is_left_out_of_the_digest():
    assert list(NOT_DIGESTED) == ["box"]


def dedented(words):
    """Lines without what stands before them: Python 3.13 takes the indentation of a docstring away, others do not."""
    return "\n".join(line.strip() for line in words.splitlines())


def said_and_declared():
    """Columns as they are said again, by hand, for type checkers and readers, and as they are declared."""
    hints, states = typing.get_type_hints(mpsim.State), {column.name: column for column in columns.in_state()}
    given, words = {column.name for column in columns.given()}, dedented(str(mpsim.State.__doc__))
    of_add, of_scene = (inspect.signature(each).parameters.keys() for each in (mpsim.Simulation.add, mpsim.Scene))
    return {
        "fields of State": (hints.keys() - {"position", "velocity", "present", "box"}, states.keys()),
        "fields of whole numbers": (
            {name for name in states if "int64" in str(hints.get(name))},
            {name for name, column in states.items() if column.integer},
        ),
        "arguments of State": ({"image"} | columns.StateColumns.__annotations__.keys(), states.keys()),
        "words of State": ({name for name in states if f"\n{name}: shape (N," in words}, states.keys()),
        "attributes of Frame": ({name for name in states if hasattr(Frame, name)}, states.keys()),
        "arguments of add": ((of_add & given) | columns.GivenColumns.__annotations__.keys(), given),
        "arguments of Scene": (of_scene & given, given),
    }


def disagreeing():
    return {what for what, (said, expected) in said_and_declared().items() if said != set(expected)}


def test_what_is_said_of_columns_for_type_checkers_agrees_with_their_declarations():
    assert disagreeing() == set()
    hints, given = (typing.get_type_hints(each) for each in (mpsim.State, columns.StateColumns))
    assert given == {name: hints[name] for name in given}


def test_a_column_that_is_forgotten_is_noticed(monkeypatch):
    """The control: one of which State, Frame, Scene and `add` know nothing, and one that only they know."""
    charge = columns.Column("charge", "charge", given=True)
    without_spin = [column for column in columns.COLUMNS if column.name != "spin"]
    monkeypatch.setattr(columns, "COLUMNS", (*columns.COLUMNS, charge))
    assert disagreeing() == said_and_declared().keys() - {"fields of whole numbers"}
    monkeypatch.setattr(columns, "COLUMNS", tuple(without_spin))
    assert disagreeing() == {"fields of State", "arguments of State", "arguments of add"}


def test_a_state_takes_no_column_that_is_not_declared():
    with pytest.raises(mpsim.InputError, match=r"an argument of State must be one of .*; got 'charge'"):
        mpsim.State(VALUES["position"], VALUES["velocity"], charge=np.ones(2))


def test_a_frame_of_a_trajectory_has_the_columns_of_the_discs_that_are_present():
    found = {name: values.tolist() for name, values in in_frame(mpsim.State(**VALUES)).items()}
    assert found == {"velocity": [[0.5, -1.0]], "image": [[1, 0]], "spin": [1.5]}
    assert in_frame(mpsim.State(VALUES["position"], VALUES["velocity"])).keys() == {"velocity"}


def test_the_file_of_a_state_has_every_column(tmp_path):
    state = mpsim.State(**VALUES)
    path = state.save(tmp_path / "a.npz")
    assert np.load(path).files == list(COLUMNS), "in this order, so that files are the same to the byte"
    again = mpsim.State.load(path)
    for name in COLUMNS:
        assert same(getattr(again, name), getattr(state, name)), name


# --- checkpoints


def saved(tmp_path, name="everything rough", **how):
    """The state in the middle of a run, and the path of its checkpoint."""
    with SCENES[name].start(**how) as sim:
        sim.run(frames=12)
        return sim.state, sim.save(tmp_path / "run")


@pytest.mark.parametrize(
    ("name", "method"), [("everything rough", "grid"), pytest.param("rough exact", "event", marks=pytest.mark.long)]
)
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
    "disc": "disc", "event": "event", "order": "order",
    "clock": "clock", "counter": "counter", "tally": "tally", "radius": "radii",
}  # fmt: skip
"""Arrays of the block that frames change, or that hold discs that were added, and what has them in a checkpoint."""


MADE_ANEW = {
    "lists of cells, from the discs": {"cell_head", "cell_next", "turn"},
    "the other buffer": {"b.x", "b.y", "b.vx", "b.vy", "b.id", "b.cell", "b.radius"},
    "the order in memory, which changes no bit": {"a.id", "a.cell", "start", "outbox", "sent", "team"},
    "what a step notes while it moves, for its sort": {"id", "old_cell", "new_cell", "slot", "first_arrival",
                                                       "next_arrival"},
    "times that are measured": {"times"},
    "from scene and settings": {"parameters", "gravity", "giants", "wrap_x", "piston", "friction", "wall_friction",
                                "capsules.capsule", "capsules.next_end",
                                "capsules.near", "capsules.index", "capsules.grid", "capsules.per_length"},
    "what a prediction notes": {"near", "approach"},
    "the calendar, from the next events of the discs": {"entry", "step_head", "heap"},
}  # fmt: skip
"""Arrays of the block that a checkpoint leaves out, by the reason."""


@pytest.mark.usefixtures("compiled_when_run")
def test_each_array_of_the_block_is_in_a_checkpoint_or_made_anew():
    names, kept = set(), set()
    for name, method in (("everything rough", "grid"), ("rough exact", "event")):
        with SCENES[name].start(method=method) as sim:
            names |= set(sim._solver.array_names)
            kept |= sim._solver.snapshot().keys()
    anew = set().union(*MADE_ANEW.values())
    assert not anew & IN_A_SNAPSHOT.keys()
    assert names == anew | IN_A_SNAPSHOT.keys()
    # "seen" is what of the tally was handed out, and "units" those of it, beside the block; "winding" the name of
    # "image" in exact snapshots.
    assert kept == set(IN_A_SNAPSHOT.values()) | {"seen", "units", "winding"}


def test_a_checkpoint_has_every_argument_of_the_scene(tmp_path):
    everything, plain = SCENES["everything rough"].scene(), SCENES["bare"].scene()
    values = {name: getattr(everything, name) for name in inspect.signature(mpsim.Scene).parameters}
    own = {"settings": mpsim.Settings(passes=2), "picture_interval": 0.5, "measures": "temperature"}
    scene = mpsim.Scene(**values | {"duration": 3.5, **own})
    with mpsim.Simulation(scene, mpsim.Settings(method="grid")) as sim:
        path = sim.save(tmp_path / "run")
    with mpsim.Simulation.resume(path) as sim:
        assert sim.scene.digest() == scene.digest()
        for name in values:
            assert same(getattr(sim.scene, name), getattr(scene, name)), name
            common = name in ("width", "height", "position", "velocity", "thermostat", "thermal_walls")
            assert common or not same(getattr(scene, name), getattr(plain, name)), f"{name} is as in the bare scene"


def test_a_checkpoint_has_every_setting_that_changes_a_bit(tmp_path):
    settings = mpsim.Settings(
        dt=0.02, method="grid", law="reflect", contact="push", passes=2, substeps=3, precision="float32",
        on_fast="substep", contact_time=0.125,
    )  # fmt: skip
    with mpsim.Simulation(SCENES["bare"].scene(), settings) as sim:
        path = sim.save(tmp_path / "run")
    with mpsim.Simulation.resume(path) as sim:
        assert sim.settings == settings
    same_by_default = {
        each.name for each in dataclasses.fields(settings) if getattr(settings, each.name) == each.default
    }
    assert same_by_default == {"workers"}, "which is chosen anew"
