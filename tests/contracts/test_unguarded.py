"""The negative control: without the odd/even passes the columns are resolved in an order that depends on workers.

That two racing runs differ would be a matter of luck, so these tests look at the order itself: on one worker it is
simply another one (columns 0, 1, 2, ...), which is enough to change the bits of a dense scene.
"""

import pytest
from support.compare import assert_inside_and_finite
from support.scenes import crowd, digest_after, gas, simulate


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_unguarded_columns_are_resolved_in_another_order(precision):
    scene = crowd(500, 0.85, seed=1)
    guarded, unguarded = (
        digest_after(scene, 5, method="grid", precision=precision, unguarded=flag) for flag in (False, True)
    )
    assert guarded != unguarded, "odd/even passes make no difference here: the determinism tests would pass without"


def test_unguarded_columns_change_nothing_where_no_columns_touch():
    """So the switch changes the order of columns, and nothing else."""
    scene = gas(200, 0.01, seed=2)
    guarded, unguarded = (digest_after(scene, 20, method="grid", unguarded=flag) for flag in (False, True))
    assert guarded == unguarded


def test_unguarded_workers_lose_no_disc_and_end_cleanly():
    scene = gas(3000, 0.7, seed=3)
    with simulate(scene, method="parallel", workers=3, unguarded=True) as sim:
        sim.run(frames=50)
        assert_inside_and_finite(sim.state, scene, "unguarded on 3 workers")
