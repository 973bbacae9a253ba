"""The file of a trajectory while it is written, frame by frame, by one process."""

import logging
import os
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from mpsim.core import atomic
from mpsim.core.file_lock import FileLock
from mpsim.engine.simulation import Simulation
from mpsim.errors import OutputError, TrajectoryWarning, level_of_caller
from mpsim.output.continuation import discrepancy, lacking
from mpsim.output.frames import Frame, Given, Reader, Writer
from mpsim.output.gsd import GsdReader, GsdWriter
from mpsim.output.lammps import DumpReader
from mpsim.output.xyz import XyzReader, XyzWriter

logger: logging.Logger = logging.getLogger("mpsim")


class Format(NamedTuple):
    """A format of trajectories that is written: its usual ending, without the dot, and what writes it.

    is_joint: whether ranks write it together.
    """

    name: str
    writer: Callable[[Path, str], Writer]
    is_joint: bool = False


XYZ, GSD = Format("xyz", XyzWriter, is_joint=True), Format("gsd", GsdWriter)

ENDINGS: dict[str, Format] = {".xyz": XYZ, ".extxyz": XYZ, ".gsd": GSD}
"""Formats that are written, by the endings of their files."""

READERS: dict[str, Callable[[Path, Given], Reader]] = {
    ".xyz": XyzReader,
    ".extxyz": XyzReader,
    ".gsd": GsdReader,
    ".lammpstrj": DumpReader,
    ".dump": DumpReader,
    ".xyz.gz": XyzReader,
    ".extxyz.gz": XyzReader,
    ".lammpstrj.gz": DumpReader,
    ".dump.gz": DumpReader,
}
"""What reads a file, by its ending."""

FORMATS: tuple[str, ...] = tuple(dict.fromkeys(each.name for each in ENDINGS.values()))
"""Names of all formats that are written."""


def ending_of(path: str | os.PathLike[str]) -> str:
    """The ending of a file, such as .xyz.gz.

    >>> ending_of("run/a.1.XYZ.gz"), ending_of("a.dump"), ending_of("xyz")
    ('.xyz.gz', '.dump', '')
    """
    suffixes = [suffix.lower() for suffix in Path(os.fsdecode(path)).suffixes]
    return "".join(suffixes[-2:] if suffixes[-1:] == [".gz"] else suffixes[-1:])


class FrameFile:
    """A file to which frames are appended, locked against other writers.

    Args:
        path: with one of the ENDINGS.
        mode: "x" for a new file only, "w" to replace an existing one, "a" to continue one.

    Raises:
        OutputError: if the file exists (mode "x"), has another writer, or cannot be written.

    Attributes:
        last: number of the frame that was written last; -1: none.
    """

    def __init__(self, path: Path, mode: str):
        self._path = path
        self.last: int = -1
        if mode == "x" and path.exists():
            raise OutputError(
                f"the trajectory {str(path)!r} exists already, and is not overwritten. Choose another name, or "
                "use mode='w' to replace it, mode='a' to continue it."
            )
        if path.exists() and not path.is_file():
            raise OutputError(f"a trajectory must be a file; {str(path)!r} is not. Choose another name.")
        if mode != "x":
            FileLock(path).release()  # before the file is emptied, if nobody writes it
        self._unchecked = mode == "a" and path.exists() and path.stat().st_size > 0
        kind = ENDINGS[path.suffix.lower()].writer
        try:
            # A trajectory grows frame by frame, under its own name: a kill costs the frame in hand, not all of them.
            if mode == "w":  # never through a link
                atomic.check_target(path)
                path.unlink(missing_ok=True)
            self._writer: Writer = kind(path, "x" if mode == "w" else mode)
        except OutputError:
            raise
        except OSError as error:
            raise unwritable(path, error) from error
        try:
            self._lock = FileLock(path)
        except OutputError:  # another writer was faster
            self._writer.close()
            raise

    def append(self, sim: Simulation, now: Frame, every: int) -> bool:
        """Write the present frame, unless the file has it. Returns whether it was written.

        Args:
            sim: whose frame it is.
            now: the frame.
            every: frames of the simulation between two of the file.
        """
        if not self._is_due(sim, now, every):
            return False
        try:
            self._writer.write(now)
        except OSError as error:
            raise unwritable(self._path, error) from error
        self.last = now.frame
        return True

    def begin_of(self, sim: Simulation, now: Frame, every: int) -> int | None:
        """Where in the file ranks write the present frame together; None if it is there. Arguments as for `append`."""
        assert isinstance(self._writer, XyzWriter)
        return self._writer.end if self._is_due(sim, now, every) else None

    def note(self, frame: int) -> None:
        """Count a frame that was written jointly."""
        self.last = frame

    def cut(self, end: int) -> None:
        """Cut off the remains of a failed frame."""
        assert isinstance(self._writer, XyzWriter)
        self._writer.cut(end)

    def close(self) -> None:
        """Close the file. May be called again."""
        try:
            try:
                self._writer.close()
            finally:
                self._lock.release()  # which fails, too, where a network disk is gone
        except OSError as error:
            raise unwritable(self._path, error) from error

    def _is_due(self, sim: Simulation, now: Frame, every: int) -> bool:
        """Whether the file does not have the present frame yet; arguments as of `append`."""
        if self._unchecked:
            self._continue(sim, now.whole(), every)
            self._unchecked = False
        return now.frame > self.last

    def _continue(self, sim: Simulation, now: Frame, every: int) -> None:
        """Cut the file back to the frame of the simulation, after a check that it belongs to it."""
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            reader: Reader = READERS[self._path.suffix.lower()](self._path, Given())
        for each in caught:
            logger.warning("mpsim: %s It is cut off.", each.message)
        try:
            kept = len(reader)
            while kept and reader.number(kept - 1) > sim.frame:
                kept -= 1
            if kept < len(reader):
                logger.info("mpsim: %d frames of %s are written anew.", len(reader) - kept, self._path)
            ends = [reader.read(index) for index in (0, max(kept - 1, 0))] if len(reader) else []
        finally:
            reader.close()
        if ends:
            self._demand_same_run(sim, now, *ends)
        if kept:
            last = ends[1]
            if last.frame < sim.frame - every:
                warnings.warn(
                    f"the trajectory {str(self._path)!r} continues at frame {sim.frame}, and its last frame was "
                    f"{last.frame}: those between are missing.",
                    TrajectoryWarning,
                    stacklevel=level_of_caller(),
                )
            self.last = last.frame
        self._writer.truncate(kept)
        self._lock.renew()

    def _demand_same_run(self, sim: Simulation, now: Frame, first: Frame, last: Frame) -> None:
        """Refuse to continue a file of another run, or one that lacks what mpsim writes now."""
        name = f"the trajectory {str(self._path)!r}"
        missing = lacking(last)
        if missing:
            raise OutputError(
                f"{name} must hold {', '.join(missing)} to be continued, so that all its frames hold the same; it was "
                "written by an earlier version of mpsim or another program. It can be read as it is: move it, or "
                "choose another file."
            )
        wrong = discrepancy(sim, now, first, last)
        if wrong:
            raise OutputError(
                f"{name} can be continued only by the run that wrote it; {wrong}. Nothing was written. Choose another "
                "file, or replace this one with mode='w'."
            )


def unwritable(path: Path, error: OSError) -> OutputError:
    """The error raised in place of a system error."""
    return OutputError(
        f"the trajectory {str(path)!r} must be in a folder that can be written to, with room on its disk; "
        f"got {error.strerror or error}. What was written before is complete. Choose another place, or make room."
    )
