"""The journal of a simulation: its start and all later changes, written, read and run again."""

from __future__ import annotations

import dataclasses
import json
import math
import os
import tomllib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from mpsim.core import checks, files
from mpsim.engine.changes import ADD, KICK, PARAMETERS, REMOVE, SET, WALLS, Change
from mpsim.engine.solvers.base import MOST_FRAMES_OF_A_RUN
from mpsim.engine.solvers.methods import settings_to_go_on
from mpsim.errors import InputError, OutputError, reason_of
from mpsim.features.feature import demand_kind, pairs, plain, restored
from mpsim.features.obstacles import OBSTACLES
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings

if TYPE_CHECKING:
    from mpsim.engine.simulation import Simulation

# --- The journal of a simulation: its start and all later changes, in files from which it can be run again
#
# In memory and in checkpoints a change is `changes.Change`. A session file is TOML beside a scene file:
#
#     session.toml            settings, and a table for each change
#     session.scene.toml      the scene at the start, with long arrays in files beside it

KINDS = (SET, KICK, REMOVE, ADD, PARAMETERS, *WALLS)

JOURNAL = "journal"
"""Name of the array of a checkpoint that holds what has been changed; only where something has."""

FORMAT = 1  # version of session files. One of a newer version is refused, by number
MOST_BYTES = 2**28  # bytes of a session file at most

KEYS = ("format", "frame", "digest", "scene", "settings", "change")


@dataclass(frozen=True)
class Journal:
    """All that was done to a simulation from outside, up to a frame. Iterating over it gives the changes, in order.

    Attributes:
        scene, settings: at the start.
        changes: each with `frame` and `time` at which it was made, `what` it was ("set", "kick", "remove", "add",
            "change", "add_wall", "move_wall" or "remove_wall", the method that was called), and its `values`, the
            arguments by name.
        frame: the last one; `replay` ends there.
        digest: of the state then.

    Times are in the unit of the scene [time].

    >>> from mpsim import Simulation
    >>> scene = Scene.random(count=5, packing=0.2, radius=0.5, seed=1)
    >>> with Simulation(scene) as sim:
    ...     sim.kick(2, impulse=(1, 0))
    ...     sim.journal, [change.what for change in sim.journal]
    (<Journal: 1 changes in 0 frames>, ['kick'])
    """

    scene: Scene
    settings: Settings
    changes: tuple[Change, ...]
    frame: int
    digest: str

    def __iter__(self) -> Iterator[Change]:
        return iter(self.changes)

    def __len__(self) -> int:
        return len(self.changes)

    def __repr__(self) -> str:
        return f"<Journal: {len(self.changes)} changes in {self.frame} frames>"

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write a session file, from which `Simulation.replay` makes the same simulation, bit for bit.

        Args:
            path: ends in .toml; an existing file is replaced. The scene goes to a scene file beside it, named after it:
                session.scene.toml for session.toml.

        Raises:
            InputError: if the path does not end in .toml.
            OutputError: if a file cannot be written, or would hold an object of a class derived from one of mpsim.
        """
        target = files.ending_as("run.toml", path, "a session")
        start = target.with_name(f"{target.stem}.scene.toml")
        for each in self.scene._features:
            if each.kinds:
                plain(each.of(self.scene), each.classes)
        head = {"format": FORMAT, "frame": self.frame, "digest": self.digest, "scene": start.name}
        lines = [*pairs(head), "", "[settings]", *pairs(table_of(self.settings)), ""]
        for each in self.changes:
            entry = {"frame": each.frame, "time": each.time, "what": each.what, **_plain_values(each)}
            lines += ["[[change]]", *pairs(entry), ""]
        text = "\n".join(lines).encode()
        if len(text) > MOST_BYTES:
            raise OutputError(
                f"a session file must have at most {MOST_BYTES:,} bytes; {str(target)!r} would have {len(text):,}. "
                "Save a checkpoint instead, which holds the journal too, or begin a new simulation earlier."
            )
        self.scene.save(start)
        rule = "be in a folder that can be written to"
        with files.writable("a session", target, rule), files.atomic_write(target) as file:
            file.write(text)
        return target

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Journal:
        """Read what `save` wrote. Nothing in the files is executed.

        Args:
            path: of the session file, with its scene file beside it.

        Raises:
            InputError: if it is no such file; SceneFileError, one of these, for its scene.
        """
        source = files.ending_as("run.toml", path, "a session")
        try:
            tables = tomllib.loads(files.text(source, MOST_BYTES))
            return cls(*_checked(tables, source))
        except InputError:
            raise
        except (OSError, ValueError, LookupError, TypeError, RecursionError) as error:
            raise InputError(
                f"a session must be a file that Journal.save has written; {str(source)!r}: {reason_of(error):.200}."
            ) from None


def _checked(tables: dict[str, Any], source: Path) -> tuple[Scene, Settings, tuple[Change, ...], int, str]:
    """What a session file holds, as arguments of Journal."""
    if (version := tables.get("format")) != FORMAT:
        raise ValueError(f"its format is {version!r:.30}, and this version of mpsim reads {FORMAT}")
    if unknown := tables.keys() - {*KEYS}:
        raise ValueError(f"it has the key {min(unknown)!r:.60}; its keys are {', '.join(KEYS)}")
    name, frame, digest = tables["scene"], tables["frame"], tables["digest"]
    if not isinstance(name, str) or Path(name).name != name or not isinstance(digest, str):
        raise ValueError(f"its scene must be a file beside it, and its digest a text; got {name!r:.60}, {digest!r:.60}")
    changes = tables.get("change", [])
    if not isinstance(changes, list) or not all(isinstance(each, dict) for each in changes):
        raise ValueError(f"its changes must be tables, each below [[change]]; got {changes!r:.60}")
    entries = [(each.pop("frame"), each.pop("time"), each.pop("what"), each) for each in changes]
    scene, settings = Scene.load(source.with_name(name)), Settings(**tables["settings"])
    return scene, settings, _checked_entries(entries, frame), frame, digest


def _checked_entries(entries: Iterable[Any], frame: Any) -> tuple[Change, ...]:
    """Changes from plain values (frame, time, what, values), in order and none after a frame.

    Their values are checked when they are applied.
    """
    found: list[Change] = []
    for number, (at, time, what, values) in enumerate(entries):
        before = found[-1].frame if found else 0
        if type(at) is not int or type(frame) is not int or not before <= at <= frame:
            raise ValueError(f"frames must be whole numbers that do not fall, up to {frame!r:.30}; got {at!r:.30}")
        is_time = type(time) in (int, float) and 0 <= time < math.inf
        if not is_time or what not in KINDS or not isinstance(values, dict):
            raise ValueError(f"change {number} must have a time and be one of {', '.join(KINDS)}; got {what!r:.60}")
        kinds = OBSTACLES.classes if what in (PARAMETERS, *WALLS) else ()
        given = {name: restored(value, kinds) for name, value in values.items()} if kinds else values
        found.append(Change(at, float(time), what, given))
    return tuple(found)


def table_of(settings: Settings) -> dict[str, Any]:
    """Settings by name, as plain values of which they can be made again."""
    demand_kind(settings, (Settings,))
    return dataclasses.asdict(settings)


def packed(changes: Iterable[Change]) -> NDArray[np.uint8]:
    """Changes as the array of a checkpoint: text, in which numbers lose no bit."""
    entries = [(*each[:3], _plain_values(each)) for each in changes]
    return np.frombuffer(json.dumps(entries).encode(), np.uint8)


def unpacked(array: NDArray[Any], frame: int) -> tuple[Change, ...]:
    """The changes in such an array, none after a frame."""
    if array.dtype != np.uint8 or array.ndim != 1:
        raise ValueError("its journal is not a text")
    entries = json.loads(array.tobytes())
    if not isinstance(entries, list):
        raise ValueError("its journal is not a list")
    return _checked_entries(entries, frame)


def _plain_values(change: Change) -> dict[str, Any]:
    return {name: plain(value, OBSTACLES.classes) for name, value in change.values.items()}


# --- Runs the simulation of a journal again, on any number of workers


Sim = TypeVar("Sim", bound="Simulation")


def replayed(
    make: Callable[..., Sim], source: Journal | str | os.PathLike[str], frame: int | None, **chosen: Any
) -> Sim:
    """What `Simulation.replay` returns: `make` is that class; chosen: workers, method, comm and start_method."""
    journal = source if isinstance(source, Journal) else Journal.load(source)
    last = journal.frame
    if frame is not None:
        last = checks.whole("frame", frame, 0, min(last, MOST_FRAMES_OF_A_RUN), "It is one of those that were done.")
    settings = settings_to_go_on(journal.settings, chosen.pop("method"), chosen.pop("workers"))
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
        values.pop("workers", None)  # which does not affect the bits of the result
        if not values:
            return
    try:
        getattr(sim, change.what)(**values)
    except (InputError, TypeError) as error:
        raise InputError(f"change {number} of a journal, {change.what!r} at frame {change.frame}: {error}") from error
