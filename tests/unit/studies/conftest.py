"""Costs that take no time, and executors."""

import pytest
from support.executors import dask_pool, process_pool

from mpsim.studies import cost


@pytest.fixture
def quick(monkeypatch):
    """Costs that take no time, where a test is about errors."""
    made = {"median": 2.0, "low": 1.0, "high": 3.0, "memory": 100.0, "method": "grid", "workers": 1}
    monkeypatch.setattr(cost, "measure", lambda *_: dict(made))


@pytest.fixture
def processes():
    with process_pool(2) as executor:
        yield executor


@pytest.fixture
def dask():
    with dask_pool() as executor:
        yield executor
