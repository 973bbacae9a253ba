"""A journal replayed: the same simulation again, on any number of workers."""

import dataclasses
import os
from typing import Any

from mpsim.core import checks
from mpsim.core.errors import InputError
from mpsim.engine.changes import PARAMETERS, Change
from mpsim.engine.frame_count import MOST_FRAMES_OF_A_RUN
from mpsim.engine.journal import Journal, without_workers
from mpsim.engine.simulation import Simulation
from mpsim.engine.solvers.methods import same_bits


def replay(
    source: "Journal | str | os.PathLike[str]",
    *,
    frame: int | None = None,
    workers: int | None = None,
    start_method: str | None = None,
    method: str | None = None,
    comm: object = None,
) -> Simulation:
    """Run again what a journal holds, and return the simulation, which can go on from there.

    Its state has the digest of the journal, and its time [time] is that of the last frame: on one machine, with one version; between machines see docs/determinism.md.

    Args:
        source: `sim.journal`, or a path to which `journal.save` has written it.
        frame: where to stop, with the changes that were made there; None: where the journal ends.
        workers, start_method: as in Settings; they change no bit. Changes of workers in the journal are left out.
        method: "grid", "parallel" or "mpi", for one that was recorded by another of them: they have the same bits.
        comm: as of a new simulation.

    Raises:
        InputError: for no journal, a change in it that is refused, or one that was made inside a frame.

    >>> from mpsim import Scene
    >>> scene = Scene.random(count=50, packing=0.2, radius=0.5, seed=1)
    >>> with Simulation(scene) as sim:
    ...     report = sim.run(frames=10)
    ...     sim.kick(3, impulse=(2, 0))
    ...     report = sim.run(frames=10)
    ...     journal = sim.journal
    >>> with replay(journal, workers=1) as again:
    ...     again.frame, again.digest() == journal.digest
    (20, True)
    """
    journal = source if isinstance(source, Journal) else Journal.load(source)
    last = journal.frame
    if frame is not None:
        last = checks.whole("frame", frame, 0, min(last, MOST_FRAMES_OF_A_RUN), "It is one of those that were done.")
    settings = dataclasses.replace(journal.settings, workers=workers, start_method=start_method)
    if method is not None:
        settings = dataclasses.replace(settings, method=same_bits(journal.settings.method, method))
    sim = Simulation(journal.scene, settings, comm=comm)
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


def _apply(sim: Simulation, number: int, change: Change) -> None:
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
