"""The shared block: its layout, and who removes it."""

import itertools

import numpy as np
import pytest
from support.scenes import gas, simulate

from mpsim.engine.workers.arrays import ArraySpec, block_arrays, grid_for
from mpsim.engine.workers.shared import SharedBlock


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
        assert all(not any(array.tobytes()) for array in block.arrays.values()), "a new block is filled with zeros"
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
