"""Costs that take no time."""

import pytest

from mpsim.studies import cost


@pytest.fixture
def quick(monkeypatch):
    """Costs that take no time, where a test is about errors."""
    made = {"median": 2.0, "low": 1.0, "high": 3.0, "memory": 100.0, "method": "grid", "workers": 1}
    monkeypatch.setattr(cost, "measure", lambda *_: dict(made))
