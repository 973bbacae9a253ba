"""Compression without compiled kernels."""

import pytest

from mpsim.scene import compression


@pytest.fixture
def plain(monkeypatch):
    """The kernels of a compression as plain Python, of which a test can change a part."""
    for name in ("run_events",):
        function = getattr(compression.solver, name)
        monkeypatch.setattr(compression.solver, name, getattr(function, "py_func", function))
    return monkeypatch
