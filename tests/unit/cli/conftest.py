"""Ctrl-C at a chosen frame of a command."""

import contextlib

import pytest

from mpsim.cli import terminal


@pytest.fixture
def ctrl_c(monkeypatch):
    """Call it with a number of frames: Ctrl-C comes when the next run has done so many."""

    def at(frames: int) -> None:
        @contextlib.contextmanager
        def progress(quiet):
            def show(done, of, what):
                if done >= frames:
                    raise KeyboardInterrupt

            yield show

        monkeypatch.setattr(terminal, "progress", progress)

    yield at
    monkeypatch.undo()
