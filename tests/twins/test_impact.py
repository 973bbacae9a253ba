"""Contact `impact`, several passes, and restitution: the same bits as the slow twin, on any number of workers."""

import pytest
from support.compare import assert_same_bits
from support.scenes import crowd, digest_after, gas, state_after
from support.twins import Twin

CASES = [
    {"contact": "impact", "passes": 1},
    {"contact": "impact", "passes": 2},
    {"contact": "push", "passes": 3},
    {"contact": "impact", "law": "reflect"},
]


@pytest.mark.slow
@pytest.mark.parametrize("method", ["naive", "grid"])
@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("case", CASES, ids=str)
@pytest.mark.parametrize("losses", [{}, {"restitution": 0.75, "wall_restitution": 0.5}], ids=["elastic", "lossy"])
def test_impact_is_its_twin(method, precision, case, losses):
    settings = {"method": method, "precision": precision, "dt": 0.05, **case}
    for scene in (gas(60, 0.5, seed=3, **losses), crowd(40, 0.6, seed=4, **losses)):
        twin = Twin(scene, **settings)
        twin.run(12)
        assert twin.contacts > 10, "too few contacts to show anything"
        assert_same_bits(state_after(scene, 12, **settings), twin.state, f"{settings} {losses}")


@pytest.mark.slow
@pytest.mark.parametrize("workers", [2, 3])
@pytest.mark.parametrize("passes", [1, 2])
def test_workers_do_not_change_impacts(workers, passes):
    scene, settings = gas(2000, 0.6, seed=5), {"contact": "impact", "passes": passes, "dt": 0.03}
    expected = digest_after(scene, 60, method="grid", **settings)
    assert digest_after(scene, 60, method="parallel", workers=workers, **settings) == expected


@pytest.mark.slow
def test_impact_and_push_differ():
    scene = gas(60, 0.5, seed=3)
    digests = {digest_after(scene, 12, method="grid", dt=0.05, contact=contact) for contact in ("impact", "push")}
    assert len(digests) == 2
