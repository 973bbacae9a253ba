"""A column by id is one declaration: all that mpsim does with the numbers of discs follows, whatever their name."""

import numpy as np
import pytest
from support.goldens import SCENES
from support.internals import column_by_id, memory_order, set_column_by_id
from support.scenes import gas, simulate

import mpsim
from mpsim.core import columns as declared
from mpsim.core.columns import Column
from mpsim.engine import columns
from mpsim.features import FEATURES
from mpsim.features.feature import Feature
from mpsim.kernels.events.features import hooks
from mpsim.output.frames import differs, frame_of
from mpsim.scene import continuing


def declare(column, monkeypatch):
    """The lines of a new column: its declaration, and that all scenes have it."""
    monkeypatch.setattr(declared, "COLUMNS", (*declared.COLUMNS, column))
    monkeypatch.setattr(columns, "_OWN", (*columns._OWN, (column, lambda scene: True)))


@pytest.mark.parametrize("kept", [True, False])
def test_a_column_outlives_a_larger_block_and_a_checkpoint_if_it_is_kept(kept, monkeypatch, tmp_path):
    """One that is not kept, the control, begins with zeros in each."""
    declare(Column("colour", "colour", kept=kept), monkeypatch)
    with SCENES["bare"].start(method="naive") as sim:
        count, zeros = sim.count, [0.0] * (sim.count + 1)
        assert column_by_id(sim, "colour") == zeros[:count]
        spins = [float(disc + 1) for disc in range(count)]
        set_column_by_id(sim, "colour", spins)
        sim.add((0.5, 6.5), (0.0, 0.0))  # the block is full: there will be another one
        expected = [*spins, 0.0] if kept else zeros
        assert column_by_id(sim, "colour") == expected
        path = sim.save(tmp_path / "run")
    with mpsim.Simulation.resume(path) as sim:
        assert column_by_id(sim, "colour") == expected


def test_a_column_of_pairs_has_a_row_for_each_disc_in_a_snapshot(monkeypatch):
    declare(Column("force", "force", (2,)), monkeypatch)
    with SCENES["bare"].start(method="naive") as sim:
        count = sim.count
        set_column_by_id(sim, "force", [[1.0] * count, [2.0] * count])
        found = sim._solver.snapshot()["force"]
        shapes = sim._solver.snapshot_shapes(sim.scene, sim.settings, count)
    assert (found.dtype, found.shape) == shapes["force"]
    assert found.shape == (count, 2)
    assert (found == [1.0, 2.0]).all()


def test_a_scene_has_the_columns_that_it_needs_and_no_other():
    assert columns.columns_of(SCENES["bare"].scene()) == []
    needed = {column.name for column in columns.columns_of(SCENES["everything rough"].scene())}
    assert needed == {"mass", "acceleration", "image", "exits", "spin"} == {column.name for column in declared.COLUMNS}


# --- a column that nobody but its declaration knows

CHARGE = Column("charge", "electric charge", given=True, remedy="Give the scene a charge.")

PASSES = Column("passes", "how often it has passed a gate, and with whom last", (2,), integer=True)

SECRET = Column("charge", "electric charge", in_state=False)
"""The control: what states, and so digests and trajectories, are not to have."""


def values_of(column, count):
    """Others for each disc, which single precision holds."""
    numbers = np.arange(1, 1 + count * 2).reshape(count, 2) / (1 if column.integer else 8)
    return numbers if column.components else numbers[:, 0]


def charged_run(column, folder, **how):
    """A run with such values, during which discs enter a full block: its last state and frame, and its files."""
    files = [mpsim.Trajectory.write(folder / f"run.{ending}", 5) for ending in ("xyz", "gsd")]
    with simulate(gas(60, 0.3), dt=0.05, **how) as sim, files[0] as text, files[1] as binary:
        if column is not None:
            set_column_by_id(sim, column.name, values_of(column, 60).T.tolist())
        sim.run(frames=10, observe=[text, binary])
        given = column is not None and column.given
        sim.add([[1.0, 1.0], [3.0, 1.0]], np.zeros((2, 2)), **({column.name: [7.25, -3.0]} if given else {}))
        sim.save(folder / "run.mpsim")
        sim.run(frames=10, observe=[text, binary])
        assert how["method"] == "naive" or memory_order(sim) != list(range(62)), "discs have been sorted"
        return sim.state, frame_of(sim), (folder / "run.xyz").read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize("column", [CHARGE, PASSES], ids=lambda column: column.name)
@pytest.mark.parametrize(
    "how", [{"method": "naive"}, {"method": "parallel", "workers": 2}], ids=lambda how: how["method"]
)
def test_a_new_column_goes_wherever_discs_go(column, how, monkeypatch, tmp_path):
    """Through sorted discs, a larger block, checkpoints, states, their files and digests, and trajectories."""
    declare(column, monkeypatch)
    state, frame, _ = charged_run(column, tmp_path, **how)
    entered = [7.25, -3.0] if column.given else np.zeros((2, 2))
    expected = np.concatenate([values_of(column, 60), entered])
    found = getattr(state, column.name)
    assert found.tolist() == expected.tolist()
    assert found.dtype == (np.int64 if column.integer else np.float64)
    with mpsim.Simulation.resume(tmp_path / "run.mpsim", workers=how.get("workers")) as sim:
        assert getattr(sim.state, column.name).tolist() == expected.tolist()
        sim.run(frames=10)
        assert sim.digest() == state.digest()
    assert mpsim.State.load(state.save(tmp_path / "state.npz")).digest() == state.digest()
    for ending in ("xyz", "gsd"):
        last = mpsim.Trajectory(tmp_path / f"run.{ending}")[-1]
        assert last.known[column.name].dtype == found.dtype
        assert last.state.digest() == state.digest()
        assert differs(last, frame) is None
        last.known[column.name][-1] += 1
        assert differs(last, frame) == f"its {column.name} of the discs differs"
        assert last.state.digest() != state.digest()


def test_a_column_that_states_do_not_have_is_in_none_of_these(monkeypatch, tmp_path):
    """The control: digest and files are those of a run without the column."""
    runs = []
    for column in (CHARGE, SECRET, None):
        folder = tmp_path / str(len(runs))
        folder.mkdir()
        with monkeypatch.context() as patch:
            if column is not None:
                declare(column, patch)
            state, frame, text = charged_run(column, folder, method="naive")
        assert ("charge" in frame.known) == hasattr(state, "charge") == (column is CHARGE)
        runs.append((state.digest(), text))
    for with_charge, secret, without in zip(*runs, strict=True):
        assert with_charge != secret == without
    assert b":charge:R:1 " in runs[0][1]


def test_files_with_a_column_that_is_not_declared_any_more_are_read_without_it(monkeypatch, tmp_path):
    with monkeypatch.context() as patch:
        declare(CHARGE, patch)
        state, _, _ = charged_run(CHARGE, tmp_path, method="naive")
        path = state.save(tmp_path / "state.npz")
    plain = mpsim.State(state.position, state.velocity).digest()
    assert mpsim.State.load(path).digest() == plain != state.digest()
    for ending in ("xyz", "gsd"):
        assert mpsim.Trajectory(tmp_path / f"run.{ending}")[-1].state.digest() == plain


@pytest.mark.parametrize(
    ("given", "error", "match"),
    [
        ({"charge": np.nan}, mpsim.InputError, "charge must be finite"),
        ({"charge": [1.0, 2.0]}, mpsim.InputError, r"charge must have shape \(\) or \(1,\), one per row of position"),
        ({"charge": 1e30}, mpsim.InputError, "charge must be at most .* in float32"),
        (
            {"passes": [1, 2]},
            mpsim.InputError,
            r"Simulation.add must be one of .*'charge'; got 'passes'",
        ),
        (
            {"spin": 1.0},
            mpsim.InputError,
            "spin can be given for added discs only in a scene of rough discs; here they",
        ),
    ],
)
def test_what_is_given_of_a_new_column_is_checked(given, error, match, monkeypatch):
    declare(CHARGE, monkeypatch)
    declare(PASSES, monkeypatch)
    with simulate(gas(9, 0.1), method="naive", precision="float32") as sim:
        with pytest.raises(error, match=match):
            sim.add([1.0, 1.0], [0.0, 0.0], **given)
        assert sim.count == 9


@pytest.mark.parametrize(
    ("column", "values", "match"),
    [
        (CHARGE, np.zeros(3), r"charge of a state must be real numbers of shape \(2,\), one per disc; got float64 of"),
        (CHARGE, np.zeros(2, int), r"one per disc; got int64 of shape \(2,\). Leave it out where there is none"),
        (PASSES, np.zeros((2, 2)), r"passes of a state must hold whole numbers of shape \(2, 2\), one pair per disc"),
    ],
)
def test_a_state_has_a_new_column_of_each_disc(column, values, match, monkeypatch):
    declare(column, monkeypatch)
    with pytest.raises(mpsim.InputError, match=match):
        mpsim.State(np.zeros((2, 2)), np.zeros((2, 2)), **{column.name: values})


class Charges(Feature):
    """A feature whose discs have the new column; the scene has it as an attribute."""

    argument = "charge"
    columns = (CHARGE,)

    def is_in(self, scene):
        return hasattr(scene, "charge")


def test_a_scene_continues_with_the_new_column_of_a_state(monkeypatch):
    declare(CHARGE, monkeypatch)
    scene, there = gas(9, 0.1), np.arange(9) > 2
    state = mpsim.State(scene.position, scene.velocity, present=there, charge=values_of(CHARGE, 9))
    assert not hasattr(scene.starting_from(state), "charge"), "the control: no feature of the scene has it"
    monkeypatch.setattr(continuing, "FEATURES", (*continuing.FEATURES, Charges()))
    vars(scene)["charge"] = np.zeros(9)
    assert scene.starting_from(state).charge.tolist() == values_of(CHARGE, 9)[3:].tolist()


# --- what is said of the columns that there are


@pytest.mark.parametrize(
    ("act", "text"),
    [
        (
            lambda sim, pair: sim.add([1, 1], [0, 0], spin=2),
            "spin can be given for added discs only in a scene of rough discs; here they are smooth, and got 2. Give "
            "the scene friction, wall_friction or spin.",
        ),
        (
            lambda sim, pair: sim.add([1, 1], [0, 0], [0, 1]),
            "acceleration can be given for added discs only in a scene that has acceleration per disc; this one has "
            "none, and got [0, 1]. Give the scene acceleration=numpy.zeros((N, 2)).",
        ),
        (
            lambda sim, pair: mpsim.State(pair, pair, spin=pair),
            "spin of a state must be real numbers of shape (2,), one per disc; got float64 of shape (2, 2). Leave it "
            "out where discs are smooth.",
        ),
        (
            lambda sim, pair: mpsim.State(pair, pair, image=pair, box=(0, 1, 0, 1)),
            "image of a state must hold whole numbers of shape (2, 2), one pair per disc; got float64 of shape (2, 2). "
            "Leave it out where image flags were not kept.",
        ),
    ],
)
def test_a_refusal_says_of_each_column_what_it_is(act, text):
    with simulate(gas(9, 0.1), method="naive") as sim, pytest.raises(mpsim.InputError) as caught:
        act(sim, np.zeros((2, 2)))
    assert str(caught.value) == text


def test_a_trajectory_without_spins_says_where_it_would_have_them(tmp_path):
    writer = mpsim.Trajectory.write(tmp_path / "a.xyz")
    with simulate(gas(9, 0.1), method="naive") as sim, writer as out:
        sim.run(frames=1, observe=out)
    with pytest.raises(mpsim.errors.TrajectoryError) as caught:
        _ = mpsim.Trajectory(tmp_path / "a.xyz")[0].spin
    where = "the column spin:R:1 (extended XYZ) or log/particles/mpsim/spin (GSD)"
    assert str(caught.value).endswith(f"Have the program that wrote it write {where}, too.")


def test_the_exact_solver_carries_each_column_of_a_feature_or_refuses_the_feature():
    """Its kernels have a layout of their own, so that columns do not come to it by themselves."""
    carried = {column.name for feature in FEATURES if not feature.not_exact for column in feature.columns}
    assert carried <= set(hooks.Features._fields)
    assert {column.name for feature in FEATURES for column in feature.columns} - carried == {"acceleration"}
