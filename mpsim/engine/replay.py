"""Runs the simulation of a journal again, on any number of workers."""

import dataclasses
import os
from collections.abc import Callable
from typing import Any, Protocol, TypeVar

from mpsim.core import checks
from mpsim.engine.changes import PARAMETERS, Change
from mpsim.engine.frame_count import MOST_FRAMES_OF_A_RUN
from mpsim.engine.journal import Journal, without_workers
from mpsim.engine.solvers.methods import same_bits
from mpsim.errors import InputError


class Replayable(Protocol):
    """What a simulation is asked for; the methods of changes are called by name."""

    @property
    def frame(self) -> int:
        """Frames done."""
        ...

    @property
    def time(self) -> float:
        """Time reached [time]."""
        ...

    def run(self, frames: int) -> Any:
        """Run so many frames."""
        ...

    def close(self) -> None:
        """Stop."""
        ...


Sim = TypeVar("Sim", bound=Replayable)


def replayed(
    make: Callable[..., Sim], source: Journal | str | os.PathLike[str], frame: int | None, **chosen: Any
) -> Sim:
    """What `Simulation.replay` returns.

    Args:
        make: a simulation, called with scene, settings, comm and start_method.
        source, frame: as of `Simulation.replay`.
        chosen: its workers, method, comm and start_method.
    """
    journal = source if isinstance(source, Journal) else Journal.load(source)
    last = journal.frame
    if frame is not None:
        last = checks.whole("frame", frame, 0, min(last, MOST_FRAMES_OF_A_RUN), "It is one of those that were done.")
    workers, method = chosen.pop("workers"), chosen.pop("method")
    settings = dataclasses.replace(journal.settings, workers=workers)
    if method is not None:
        settings = dataclasses.replace(settings, method=same_bits(journal.settings.method, method))
    sim = make(journal.scene, settings, **chosen)
    try:
        for number, change in enumerate(journal.changes):
            if change.frame <= last:
                sim.run(frames=change.frame - sim.frame)
                _apply(sim, number, change)
        sim.run(frames=last - sim.frame)
    except BaseException:
        sim.close()
        raise
    return sim


def _apply(sim: Replayable, number: int, change: Change) -> None:
    """Make a change of a journal again."""
    if sim.time != change.time:
        raise InputError(
            f"change {number} of a journal must have been made at the end of frame {change.frame}, at time "
            f"{sim.time!r}; got {change.time!r}: an interrupt had left that run inside a frame. Replay up to a frame "
            "before, by frame=..."
        )
    values: dict[str, Any] = dict(change.values)
    if change.what == PARAMETERS:
        values = without_workers(values)
        if not values:
            return
    try:
        getattr(sim, change.what)(**values)
    except (InputError, TypeError) as error:
        raise InputError(f"change {number} of a journal, {change.what!r} at frame {change.frame}: {error}") from error
