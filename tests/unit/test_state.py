"""State: copies in the order of the scene's discs; the grid; the layout of the shared block."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.scenes import gas, simulate

import mpsim
from mpsim.engine.workers.arrays import ArraySpec, block_arrays, grid_for
from mpsim.engine.workers.shared import SharedBlock


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
        state.position[:] = 0
        state.velocity[:] = np.nan
        assert sim.digest() == before
    assert state.position.shape == (50, 2), "a state outlives its simulation"


def test_a_digest_depends_on_dtype_shape_and_field():
    zeros, ones = np.zeros((2, 2)), np.ones((2, 2))
    states = [
        mpsim.State(zeros, ones),
        mpsim.State(ones, zeros),
        mpsim.State(zeros.astype(np.float32), ones.astype(np.float32)),
        mpsim.State(np.zeros((4, 2)), np.ones((0, 2))),
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


@given(
    st.integers(0, 3000),
    st.floats(1, 1e4),
    st.floats(1, 1e4),
    st.floats(1e-3, 1),
    st.sampled_from(["float32", "float64"]),
)
def test_cells_are_never_narrower_than_a_diameter_and_never_many_more_than_discs(
    count, width, height, diameter, precision
):
    grid = grid_for(count, width, height, diameter, precision)
    assert grid.columns >= 1
    assert grid.rows >= 1
    for cells, length in ((grid.columns, width), (grid.rows, height)):
        # The index int(x * cells / length) of two discs two cells apart is wrong by rounding at most this much:
        rounding = 4 * float(np.finfo(precision).eps) * length
        assert cells == 1 or length / cells >= diameter + rounding
    if min(grid.columns, grid.rows) > 1:
        assert grid.columns * grid.rows <= 2 * max(count, 1)
    assert grid.table_size == (grid.columns + 1) * (grid.rows + 2) + 1


def test_cells_are_about_a_diameter_wide_in_a_dense_scene():
    grid = grid_for(10_000, 100, 100, 1.0, "float64")
    assert (grid.columns, grid.rows) == (99, 99)
    assert grid_for(100, 1000, 1000, 1.0, "float64").columns == int(1000 / math.sqrt(1000 * 1000 / 200))


def test_a_larger_scene_never_has_a_smaller_grid():
    """So a block made for more discs has room for the table of fewer."""
    sizes = [grid_for(count, 30, 50, 0.5, "float64").table_size for count in range(5000)]
    assert sizes == sorted(sizes)


def made(specs):
    block = SharedBlock(specs)
    block.create()
    return block


def test_arrays_of_the_block_do_not_overlap_and_are_aligned():
    specs = block_arrays(
        100,
        grid_for(100, 10, 10, 1.0, "float32"),
        3,
        "float32",
        {"gravity": ArraySpec(np.dtype(np.float32), (2,))},
        False,
    )
    block = made(specs)
    try:
        places = sorted(
            (array.__array_interface__["data"][0], array.nbytes, name) for name, array in block.arrays.items()
        )
        for (start, size, name), (following, _, other) in itertools.pairwise(places):
            assert start + size <= following, f"{name} runs into {other}"
        for start, _, name in places:
            assert start % 64 == 0, f"{name} does not begin on a cache line"
        assert all(not array.any() for array in block.arrays.values()), "a new block is filled with zeros"
        del places
    finally:
        block.close()


def test_a_block_can_be_attached_by_name_and_only_its_creator_removes_it():
    specs = {"numbers": ArraySpec(np.dtype(np.int64), (3,))}
    block = made(specs)
    other = SharedBlock.attach(block.name, specs)
    block.arrays["numbers"][1] = 42
    assert other.arrays["numbers"].tolist() == [0, 42, 0]
    other.close()
    again = SharedBlock.attach(block.name, specs)
    again.close()
    block.close()
    block.close()
    with pytest.raises(FileNotFoundError):
        SharedBlock.attach(block.name, specs)


@pytest.mark.parametrize("gravity", [None, (0, -1)])
def test_a_feature_that_a_scene_lacks_costs_no_array(gravity):
    with simulate(gas(10, 0.2, gravity=gravity), method="grid") as sim:
        names = set(sim._solver._block.arrays)
    assert ("gravity" in names) == (gravity is not None)
    assert "acceleration" not in names


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
    with pytest.raises(mpsim.InputError, match=r"must have one shape, \(N, 2\), and one floating dtype; .*\(2, 2\)"):
        mpsim.State.load(tmp_path / "other.npz")
    np.savez(tmp_path / "code.npz", position=np.array([print], object), velocity=np.zeros((1, 2)))
    with pytest.raises(mpsim.InputError, match="no plain array"):
        mpsim.State.load(tmp_path / "code.npz")
    with pytest.raises(mpsim.OutputError, match=r"must be in a folder that can be written to; got .* Choose another"):
        mpsim.State(np.zeros((1, 2)), np.zeros((1, 2))).save(tmp_path / "none" / "a.npz")
