"""The default candidates of a trade."""

import pytest
from support.scenes import gas

from mpsim import tradeoff
from mpsim.studies.default_candidates import default_candidates


def test_the_default_ladder_has_all_contacts_and_leaves_out_all_pairs_for_many_discs():
    few, many = default_candidates(gas(40, 0.3), 1.0), default_candidates(gas(3500, 0.1), 1.0)
    assert {"event", "naive", "grid", "parallel", "auto"} == {each.method for each in few}
    assert "naive" not in {each.method for each in many}
    assert len(set(few)) == len(few)
    assert {each.contact for each in few} == {"push", "impact"}
    assert "reflect" in {each.law for each in few}
    assert {each.precision for each in few} == {"float32", "float64"}


@pytest.mark.long
def test_the_default_ladder_runs():
    found = tradeoff(gas(60, 0.3), replicas=3)
    assert len(found.rows) >= 20
    assert [row.label for row in found.rows if row.failure] == []
