"""Trajectories: frames of a run in one file, written while it runs, continued, and read back one by one."""

from __future__ import annotations

import contextlib
import copy
import gzip
import logging
import math
import os
import time
import warnings
import zlib
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, overload

import numpy as np
from numpy.typing import ArrayLike

from mpsim.core import checks, files
from mpsim.core.checks import Binding, Closable
from mpsim.core.files import FileLock
from mpsim.engine.simulation import Simulation
from mpsim.engine.solvers.base import ALONE, Ranks
from mpsim.engine.solvers.methods import capabilities_of
from mpsim.engine.solvers.ranks.messages import MpiRanks
from mpsim.errors import InputError, OutputError, TrajectoryError, TrajectoryWarning, level_of_caller, reason_of
from mpsim.features.edges import BoundaryName
from mpsim.output.frames import Frame, Given, differs, frame_of, select
from mpsim.output.gsd import GsdReader, GsdWriter
from mpsim.output.xyz import DumpReader, XyzReader, XyzWriter
from mpsim.scene.scene import Scene
from mpsim.scene.starts import region_in_words

logger: logging.Logger = logging.getLogger("mpsim")

# --- Formats

Reader = XyzReader | DumpReader | GsdReader
Writer = XyzWriter | GsdWriter

WRITERS: dict[str, type[Writer]] = {".xyz": XyzWriter, ".extxyz": XyzWriter, ".gsd": GsdWriter}
"""What writes a file, by its ending."""

READERS: dict[str, type[Reader]] = {
    ".xyz": XyzReader,
    ".extxyz": XyzReader,
    ".lammpstrj": DumpReader,
    ".dump": DumpReader,
}
READERS |= {f"{ending}.gz": reader for ending, reader in READERS.items()} | {".gsd": GsdReader}
"""What reads a file, by its ending; texts may be compressed."""

FORMATS = ("xyz", "gsd")  # usual endings of the formats that are written


def ending_of(path: str | os.PathLike[str]) -> str:
    """The ending of a file, such as .xyz.gz, in lower case."""
    suffixes = [suffix.lower() for suffix in Path(os.fsdecode(path)).suffixes]
    return "".join(suffixes[-2:] if suffixes[-1:] == [".gz"] else suffixes[-1:])


def _path_of(path: str | os.PathLike[str], endings: Iterable[str]) -> Path:
    if isinstance(path, str | os.PathLike) and ending_of(path) in endings:
        return Path(os.fsdecode(path))
    instead = "Use 'run.xyz'."
    if isinstance(path, str | os.PathLike) and os.path.isdir(path):  # False too for what no path can be
        inside = sorted(each for each in Path(os.fsdecode(path)).iterdir() if ending_of(each) in endings)
        instead = f"It is a folder; use {str(inside[0])!r}." if inside else instead
    raise InputError(f"a trajectory's path must end in {', '.join(endings)}; got {path!r}. {instead}")


# --- Checks that a trajectory file belongs to a simulation before it is continued

NEEDED = {"time": "times", "velocity": "velocities", "radius": "radii", "mass": "masses", "ids": "numbers of discs"}
"""What frames must hold to be continued, besides positions, in words: all frames of a file hold the same."""

ROUNDING = 16
"""Multiples of the precision by which computed places may differ: those of a moving wall, and of discs at the start."""


def discrepancy(sim: Simulation, now: Frame, first: Frame, last: Frame) -> str | None:
    """Why frames of a file cannot be those of a simulation, in words that follow the file's name; None if they can.

    Box, boundaries, precision and dt must agree, and so must radii and masses of the discs that both have. The discs
    must be possible ones: added discs have new numbers, and absorbed ones do not return. If both hold the same moment,
    the present or the start, positions and velocities must agree too.

    now: the present frame of the simulation. first, last: frames of the file, the last one up to now.
    """
    wrong = _setting(sim, now, last) or _discs(sim, now, last)
    if wrong is None and last.frame == now.frame:
        # The frame may have been written before discs were added at it; they are in the next one.
        wrong = differs(last, select(now, last.ids))
    if wrong is not None:
        return f"at frame {last.frame} {wrong}"
    if first.frame == 0 and not _begins_as(sim.scene, first):
        return "its frame 0 shows another start of such a scene"
    return None


def _setting(sim: Simulation, now: Frame, last: Frame) -> str | None:
    if last.periodic != now.periodic:
        return f"its periodic axes (x, y) are {last.periodic} and not {now.periodic}"
    if last.position.dtype != now.position.dtype:
        return f"its precision is {last.position.dtype} and not {now.position.dtype}"
    since, began = sim.origin
    if last.frame < since or last.time < sim.scene._piston_from[0]:  # dt or the piston's speed has changed since
        return None
    time = began + (last.frame - since) * sim.settings.dt
    if not math.isclose(last.time, time, rel_tol=1e-9):
        return f"its time is {last.time:g} and not {time:g}, as dt = {sim.settings.dt:g} makes it"
    corners = np.array([*last.origin, *np.add(last.origin, last.box)])
    expected = np.concatenate(sim.scene.walls_at(time))
    if np.abs(corners - expected).max() > _slack(sim.scene, last):
        return f"its box is {region_in_words(corners)} and not {region_in_words(expected)}"
    return None


def _discs(sim: Simulation, now: Frame, last: Frame) -> str | None:
    behind = last.frame <= now.frame
    highest = int(last.ids.max(initial=-1))
    if behind and highest >= sim.count:
        return f"it has a disc {highest}, and the simulation has only {sim.count}"
    known = last.ids < sim.count
    ids = last.ids[known]
    for name, theirs, ours in (("radius", last.radius, sim.radii), ("mass", last.mass, sim.masses)):
        if len(other := np.flatnonzero(theirs[known] != ours[ids])):
            disc = int(ids[other[0]])
            return f"its {name} of disc {disc} is {theirs[known][other[0]]:g} and not {ours[disc]:g}"
    if behind:
        back = now.ids[~np.isin(now.ids, last.ids) & (now.ids < max(highest + 1, sim.scene.count))]
        if len(back):
            return f"it has no disc {back[0]}, and the simulation has had it from before"
    return None


def _begins_as(scene: Scene, first: Frame) -> bool:
    """Whether the discs of the scene are in the first frame where they start, as fast as they start."""
    ids = np.arange(scene.count)
    start = select(first, ids)
    if not checks.equal(start.ids, ids):
        return False
    offset = np.abs(scene._to_nearest_image(start.position - scene.position))
    change, fastest = np.abs(start.velocity - scene.velocity), float(np.abs(scene.velocity).max(initial=0.0))
    rounding = ROUNDING * float(np.finfo(first.position.dtype).eps)
    return bool((offset <= _slack(scene, first)).all() and (change <= rounding * fastest).all())


def _slack(scene: Scene, frame: Frame) -> float:
    """Rounding of a place in the box [length]."""
    return ROUNDING * float(np.finfo(frame.position.dtype).eps) * max(scene.width, scene.height)


# --- Files that are read, and written while a run goes on


class Trajectory(Closable):
    """A trajectory to read: a sequence of frames, each read from the file when it is needed.

    Args:
        path: ends in .xyz, .extxyz, .gsd, .lammpstrj or .dump (text dumps of LAMMPS), or, but for GSD, one of these
            and .gz; written by mpsim or by another program.
        box: for frames that hold no box, as those of plain XYZ: (width, height), or (x_low, x_high, y_low, y_high)
            [length].
        boundary: for frames that do not say which axes are periodic: as of a Scene; None: both are.
        radius: for frames that hold no radii: that of all discs [length].

    Attributes:
        path: of the file.
        given: box, boundary and radius, by name.

    Raises:
        InputError: for another ending; from a frame that holds what was given.
        TrajectoryError: if the file cannot be read; the message says what is missing.

    Warns:
        TrajectoryWarning: if the file ends in the middle of a frame, which is left out; or in the middle of a line, in
            a file of another program: that frame is read.

    >>> import tempfile, mpsim
    >>> scene = mpsim.Scene.random(count=50, packing=0.2, radius=0.5, seed=1)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with mpsim.Simulation(scene) as sim, mpsim.Trajectory.write(f"{folder}/run.xyz", every=10) as out:
    ...         report = sim.run(frames=100, observe=out)
    ...     trajectory = mpsim.Trajectory(f"{folder}/run.xyz")
    ...     len(trajectory), trajectory[-1].frame, trajectory[-1].position.shape
    ...     [frame.frame for frame in trajectory[::4]]
    (11, 100, (50, 2))
    [0, 40, 80]
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        box: ArrayLike | None = None,
        boundary: BoundaryName | Sequence[BoundaryName] | None = None,
        radius: float | None = None,
    ):
        self.path: Path = _path_of(path, READERS)
        self.given: dict[str, Any] = {"box": box, "boundary": boundary, "radius": radius}
        given = Given.of(**self.given)
        if not self.path.is_file():
            what = "is not a file" if self.path.exists() else "does not exist"
            raise TrajectoryError(f"a trajectory must be a file that can be read; {str(self.path)!r} {what}.")
        with self._unreadable():
            self._reader: Reader = READERS[ending_of(self.path)](self.path, given)
        self._range = range(len(self._reader))
        self._whole = True

    def __len__(self) -> int:
        return len(self._range)

    @overload
    def __getitem__(self, index: int) -> Frame: ...

    @overload
    def __getitem__(self, index: slice) -> Trajectory: ...

    def __getitem__(self, index: int | slice) -> Frame | Trajectory:
        if isinstance(index, slice):
            part = copy.copy(self)
            part._range, part._whole = self._range[index], False
            return part
        try:
            number = self._range[index]
        except IndexError:
            raise IndexError(f"the trajectory has {len(self)} frames; got index {index}.") from None
        except TypeError:
            got = checks.brief(index)
            raise TypeError(f"an index of a trajectory must be a whole number or a slice; got {got}.") from None
        with self._unreadable():
            return self._reader.read(number)

    def __iter__(self) -> Iterator[Frame]:
        return map(self.__getitem__, range(len(self)))

    def refresh(self) -> int:
        """Look for frames that another process, or a writer in this one, has written since; returns how many there are.

        A part of a trajectory, such as `trajectory[:10]`, keeps its frames.

        Raises:
            TrajectoryError: if the file cannot be read any more.

        >>> import tempfile, mpsim
        >>> scene = mpsim.Scene.random(count=50, packing=0.2, radius=0.5, seed=1)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     with mpsim.Simulation(scene) as sim, Trajectory.write(f"{folder}/run.xyz", every=10) as out:
        ...         report = sim.run(frames=20, observe=out)
        ...         trajectory = Trajectory(f"{folder}/run.xyz")
        ...         report = sim.run(frames=30, observe=out)
        ...         before, after = len(trajectory), trajectory.refresh()
        >>> before, after
        (3, 6)
        """
        with self._unreadable():
            self._reader.refresh()
        if self._whole:
            self._range = range(len(self._reader))
        return len(self)

    @contextlib.contextmanager
    def _unreadable(self) -> Iterator[None]:
        """Turn errors of the system and of gzip into a TrajectoryError, as of a file that was replaced or removed."""
        try:
            yield
        except (OSError, zlib.error, EOFError) as error:
            reason = str(error) if isinstance(error, gzip.BadGzipFile) else reason_of(error)
            raise TrajectoryError(
                f"a trajectory must be a file that can be read; {str(self.path)!r} cannot ({reason})."
            ) from None

    def close(self) -> None:
        """Close the file. Not needed for text that is not compressed, whose file is open only while a frame is read."""
        self._reader.close()

    def __repr__(self) -> str:
        return f"<Trajectory: {len(self)} frames in {str(self.path)!r}>"

    @staticmethod
    def write(
        path: str | os.PathLike[str], every: int = 1, *, mode: str = "x", comm: object = None
    ) -> TrajectoryWriter:
        """An observer for `Simulation.run(observe=...)` that writes a trajectory of one simulation.

        Args:
            path: ends in .xyz, .extxyz (extended XYZ) or .gsd (needs the package gsd).
            every: write every n-th frame of the simulation, >= 1.
            mode: "x" for a new file only, "w" to replace an existing file, "a" to continue one, as after
                `Simulation.resume`: frames later than the simulation's present one, written after its checkpoint, are
                dropped and written again with the same bits.
            comm: for method="mpi", the communicator of the simulation: all its ranks make this call. The first one
                writes the file.

        Raises:
            InputError: naming the argument, its rule and the value received.
            OutputError: if the file exists (mode "x"), has another writer that is still open, in this process or
                another (if the file system has locks), or cannot be written, or if the package gsd is missing.
        """
        return TrajectoryWriter(path, every, mode=mode, comm=comm)


class TrajectoryWriter(Closable):
    """Writes frames of a run to a file; made by `Trajectory.write`, and used in a `with` block.

    It belongs to the first simulation that it observes: another one is refused by an OutputError, and after `close`
    any is. One that continues a file (mode "a") refuses a simulation that cannot have written it.

    Attributes:
        path: of the file.
        every: frames of the simulation between two frames of the file.
        frames: written so far.
        seconds: time spent on writing [s].
    """

    def __init__(self, path: str | os.PathLike[str], every: int = 1, *, mode: str = "x", comm: object = None):
        self.path: Path = _path_of(path, WRITERS)
        self.every: int = checks.whole("every", every, 1, 10**12, "1 writes every frame.")
        checks.choice("mode", mode, ("x", "w", "a"))
        self.frames: int = 0
        self.seconds: float = 0.0
        self._name = f"the trajectory {str(self.path)!r}"
        advice = "Open one for each by mpsim.Trajectory.write(...); for the same run, resumed, with mode='a'."
        self._owner = Binding(self._name, advice, OutputError)
        self._on_ranks, self._closed = comm is not None, False
        self._last = -1  # number of the frame that was written last
        self._writer: Writer | None = None
        self._ranks: Ranks = ALONE if comm is None else MpiRanks(comm)
        try:
            self._ranks.on_root(lambda: self._open(mode))
        except BaseException:
            self._ranks.close()
            raise

    def _open(self, mode: str) -> None:
        """Open the file, locked against other writers. Only the first rank has `_writer` and `_lock`."""
        path = self.path
        if mode == "x" and path.exists():
            raise OutputError(
                f"{self._name} exists already, and is not overwritten. Choose another name, or use mode='w' to "
                "replace it, mode='a' to continue it."
            )
        if path.exists() and not path.is_file():
            raise OutputError(f"a trajectory must be a file; {str(path)!r} is not. Choose another name.")
        if mode != "x":
            FileLock(path).release()  # before the file is emptied, if nobody writes it
        self._unchecked = mode == "a" and path.exists() and path.stat().st_size > 0
        with self._writing():
            # A trajectory grows frame by frame, under its own name: a kill costs the frame in hand, not all of them.
            if mode == "w":  # never through a link
                files.check_target(path)
                path.unlink(missing_ok=True)
            self._writer = WRITERS[ending_of(path)](path, "x" if mode == "w" else mode)
        try:
            self._lock = FileLock(path)
        except OutputError:  # another writer was faster
            self._writer.close()
            raise

    def observe(self, sim: Simulation, collisions: int) -> None:
        """Write the present frame, unless it is there already."""
        started = time.perf_counter()
        if self._closed:
            rule = "be open to be written to, and was closed, as by the end of its `with` block"
            more = f"use mpsim.Trajectory.write({str(self.path)!r}, mode='a')"
            instead = f"Put all its runs into that block. To write more frames, {more}."
            raise checks.refusal(self._name, rule, f"{sim} to observe", instead, OutputError)
        if capabilities_of(sim.settings).on_ranks != self._on_ranks:
            raise InputError(
                f"{self._name} must be given comm, the communicator of the simulation, with method='mpi' and only "
                f"there; the method is {sim.settings.method!r}. Open it on all ranks, or without comm."
            )
        self._owner.bind_or_check(sim)
        self.frames += sim.once(lambda: self._append(sim, frame_of(sim)))
        self.seconds += time.perf_counter() - started

    def _append(self, sim: Simulation, now: Frame) -> bool:
        """Write the present frame of a simulation, unless the file has it. Returns whether it was written."""
        assert self._writer is not None  # of the first rank, and not closed
        if self._unchecked:
            self._continue(sim, now.whole(), self._writer)
            self._unchecked = False
        if now.frame <= self._last:
            return False
        with self._writing():
            self._writer.write(now)
        self._last = now.frame
        return True

    def _continue(self, sim: Simulation, now: Frame, writer: Writer) -> None:
        """Cut the file back to the frame of the simulation, after a check that it belongs to it."""
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            reader = READERS[ending_of(self.path)](self.path, Given())
        for each in caught:
            logger.warning("mpsim: %s It is cut off.", each.message)
        try:
            kept = len(reader)
            while kept and reader.read(kept - 1).frame > sim.frame:
                kept -= 1
            if kept < len(reader):
                logger.info("mpsim: %d frames of %s are written anew.", len(reader) - kept, self.path)
            ends = [reader.read(index) for index in (0, max(kept - 1, 0))] if len(reader) else []
        finally:
            reader.close()
        if ends:
            self._demand_same_run(sim, now, *ends)
        if kept:
            self._last = ends[1].frame
            if self._last < sim.frame - self.every:
                warnings.warn(
                    f"{self._name} continues at frame {sim.frame}, and its last frame was {self._last}: those between "
                    "are missing.",
                    TrajectoryWarning,
                    stacklevel=level_of_caller(),
                )
        writer.truncate(kept)
        self._lock.renew()

    def _demand_same_run(self, sim: Simulation, now: Frame, first: Frame, last: Frame) -> None:
        """Refuse to continue a file of another run, or one that lacks what mpsim writes now."""
        if missing := [words for each, words in NEEDED.items() if each not in last.known]:
            raise OutputError(
                f"{self._name} must hold {', '.join(missing)} to be continued, so that all its frames hold the same; "
                "it was written by an earlier version of mpsim or another program. It can be read as it is: move it, "
                "or choose another file."
            )
        if wrong := discrepancy(sim, now, first, last):
            raise OutputError(
                f"{self._name} can be continued only by the run that wrote it; {wrong}. Nothing was written. Choose "
                "another file, or replace this one with mode='w'."
            )

    def _writing(self) -> contextlib.AbstractContextManager[None]:
        rule = "be in a folder that can be written to, with room on its disk"
        instead = "What was written before is complete. Choose another place, or make room."
        return files.writable("a trajectory", self.path, rule, instead)

    def close(self) -> None:
        """Close the file. May be called again."""
        self._closed = True
        if self._writer is not None:
            with self._writing():
                try:
                    self._writer.close()
                finally:
                    self._lock.release()  # which fails, too, where a network disk is gone
        self._ranks.close()
