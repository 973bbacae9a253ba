"""`scripts/run_bench.py` on a machine that does other work: times, but no verdict."""

import io

import numpy as np
import pytest
from rich.console import Console
from support.scripts import fixture_of

script = fixture_of("run_bench")


@pytest.mark.parametrize(
    ("load", "slowed", "busy"),
    [(0.2, [1.02, 1.1], False), (1.6, [1.0, 1.0], True), (0.2, [1.0, 1.7], True)],
)
def test_a_busy_machine_gets_no_ratio(script, load, slowed, busy):
    assert script.is_busy({"load_before": load, "usable_cores": 2, "slowed": slowed}) == busy
    timing = script.benchmark.Timing("grid", 1, 100, np.full(9, 2e-4), {}, "")
    console = Console(width=120, record=True, file=io.StringIO())
    console.print(script.comparison_table("Fixed", {"grid": timing}, {"grid": 0.14}, busy))
    text = console.export_text()
    assert "200" in text, "the time itself"
    assert ("0.7" in text) != busy, "the report's time over it, which other work may have made"
