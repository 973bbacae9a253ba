"""A column by id is one declaration: block, discs that enter, snapshots and checkpoints follow."""

import pytest
from support.goldens import SCENES
from support.internals import column_by_id, set_column_by_id

import mpsim
from mpsim.core.columns import Column
from mpsim.engine import columns


def declare(column, monkeypatch):
    """The one line of a new column that all scenes have."""
    monkeypatch.setattr(columns, "_OWN", (*columns._OWN, (column, lambda scene: True)))
    monkeypatch.setattr(columns, "COLUMNS", (*columns.COLUMNS, column))


@pytest.mark.parametrize("kept", [True, False])
def test_a_column_outlives_a_larger_block_and_a_checkpoint_if_it_is_kept(kept, monkeypatch, tmp_path):
    """One that is not kept, the control, begins with zeros in each."""
    declare(Column("colour", kept=kept), monkeypatch)
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


@pytest.mark.parametrize("discs_first", [True, False])
def test_a_column_of_pairs_lies_in_a_snapshot_as_it_is_declared(discs_first, monkeypatch):
    declare(Column("force", (2,), discs_first=discs_first), monkeypatch)
    with SCENES["bare"].start(method="naive") as sim:
        count = sim.count
        set_column_by_id(sim, "force", [[1.0] * count, [2.0] * count])
        found = sim._solver.snapshot()["force"]
        shapes = sim._solver.snapshot_shapes(sim.scene, sim.settings, count)
    assert (found.dtype, found.shape) == shapes["force"]
    assert found.shape == ((count, 2) if discs_first else (2, count))
    assert (found[0] == [1.0, 2.0]).all() if discs_first else (found[0] == 1.0).all()


def test_a_scene_has_the_columns_that_it_needs_and_no_other():
    assert columns.columns_of(SCENES["bare"].scene()) == []
    needed = {column.name for column in columns.columns_of(SCENES["everything rough"].scene())}
    assert needed == {"mass", "acceleration", "image", "exits", "spin"} == {column.name for column in columns.COLUMNS}
