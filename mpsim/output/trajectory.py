"""Trajectories: frames of a run in one file, written while it runs and read back one by one.

`.xyz` and `.extxyz` are extended XYZ, which needs no other package; `.gsd` is GSD, which needs the package gsd. OVITO
opens both. A kill at any moment costs at most the frame that was being written.
"""

import logging
import os
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple, overload

from mpsim.core import atomic, checks
from mpsim.core.errors import InputError, OutputError, TrajectoryError, TrajectoryWarning, level_of_caller
from mpsim.engine.simulation import Simulation
from mpsim.output.continuation import discrepancy, lacking
from mpsim.output.frames import Frame, Reader, Writer, frame_of
from mpsim.output.gsd import GsdReader, GsdWriter
from mpsim.output.ownership import FileLock, Ownership
from mpsim.output.xyz import XyzReader, XyzWriter

logger: logging.Logger = logging.getLogger("mpsim")


class Format(NamedTuple):
    """A format of trajectories: its usual ending, without the dot, and what reads and writes it."""

    name: str
    reader: Callable[[Path], Reader]
    writer: Callable[[Path, str], Writer]


XYZ, GSD = Format("xyz", XyzReader, XyzWriter), Format("gsd", GsdReader, GsdWriter)

ENDINGS: dict[str, Format] = {".xyz": XYZ, ".extxyz": XYZ, ".gsd": GSD}

FORMATS: tuple[str, ...] = tuple(dict.fromkeys(each.name for each in ENDINGS.values()))
"""Names of all formats."""


class Trajectory:
    """A trajectory that is read: a sequence of frames, each read from the file when it is asked for.

    Args:
        path: ends in .xyz, .extxyz or .gsd; written by mpsim or by another program.

    Raises:
        InputError: for another ending.
        TrajectoryError: if the file cannot be read; naming what it lacks.

    Warns:
        TrajectoryWarning: if the file ends in the middle of a frame; that frame is left out.

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

    def __init__(self, path: str | os.PathLike[str]):
        self.path: Path = _path_of(path)
        if not self.path.is_file():
            raise TrajectoryError(f"a trajectory must be a file that can be read; {str(self.path)!r} is none.")
        self._reader: Reader = ENDINGS[self.path.suffix.lower()].reader(self.path)
        self._range = range(len(self._reader))

    def __len__(self) -> int:
        return len(self._range)

    @overload
    def __getitem__(self, index: int) -> Frame: ...

    @overload
    def __getitem__(self, index: slice) -> "Trajectory": ...

    def __getitem__(self, index: int | slice) -> "Frame | Trajectory":
        if isinstance(index, slice):
            part = object.__new__(Trajectory)
            part.path, part._reader, part._range = self.path, self._reader, self._range[index]
            return part
        try:
            return self._reader.read(self._range[index])
        except IndexError:
            raise IndexError(f"the trajectory has {len(self)} frames; got index {index}.") from None

    def __iter__(self) -> Iterator[Frame]:
        return map(self._reader.read, self._range)

    def __enter__(self) -> "Trajectory":
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file. Not needed for extended XYZ, whose file is open only while a frame is read."""
        self._reader.close()

    def __repr__(self) -> str:
        return f"<Trajectory: {len(self)} frames in {str(self.path)!r}>"

    @staticmethod
    def write(path: str | os.PathLike[str], every: int = 1, *, mode: str = "x") -> "TrajectoryWriter":
        """An observer for `Simulation.run(observe=...)` that writes a trajectory of one simulation.

        Args:
            path: ends in .xyz, .extxyz (extended XYZ) or .gsd (needs the package gsd).
            every: frames of the simulation from one frame of the file to the next, >= 1.
            mode: "x" for a new file only, "w" to replace an existing file, "a" to continue one, as after
                `Simulation.resume`: frames after that of the simulation, written after its checkpoint, are dropped
                and written again with the same bits.

        Raises:
            InputError: naming the argument, its rule and the value received.
            OutputError: if the file is there already (mode "x"), is written by another writer that is still open, in
                this process or another (where the file system has locks), or cannot be written, or if the package gsd
                is missing.
        """
        return TrajectoryWriter(path, every, mode=mode)


class TrajectoryWriter:
    """Writes frames of a run to a file; made by `Trajectory.write`, and used in a `with` block.

    It belongs to the first simulation that it observes: another one is refused by an OutputError, and after `close`
    any is. One that continues a file (mode "a") refuses a simulation that cannot have written it.

    Attributes:
        path: of the file.
        every: frames of the simulation between two frames of the file.
        frames: written so far.
        seconds: that writing took [s].
    """

    def __init__(self, path: str | os.PathLike[str], every: int = 1, *, mode: str = "x"):
        self.path: Path = _path_of(path)
        self.every: int = checks.whole("every", every, 1, 10**12, "1 writes every frame.")
        checks.choice("mode", mode, ("x", "w", "a"))
        self.frames: int = 0
        self.seconds: float = 0.0
        self._last = -1
        advice = "Open one for each by mpsim.Trajectory.write(...); for the same run, resumed, with mode='a'."
        self._ownership = Ownership("trajectory", self.path, advice)
        if mode == "x" and self.path.exists():
            raise OutputError(
                f"the trajectory {str(self.path)!r} is there already, and is not overwritten. Choose another name, or "
                "use mode='w' to replace it, mode='a' to continue it."
            )
        if self.path.exists() and not self.path.is_file():
            raise OutputError(f"a trajectory must be a file; {str(self.path)!r} is none. Choose another name.")
        if mode != "x":
            FileLock(self.path).release()  # before the file is emptied, if nobody writes it
        self._unchecked = mode == "a" and self.path.exists() and self.path.stat().st_size > 0
        kind = ENDINGS[self.path.suffix.lower()].writer
        try:
            # A trajectory grows frame by frame, under its own name: a kill costs the frame in hand, not all of them.
            if mode == "w":  # never through a link
                atomic.check_target(self.path)
                self.path.unlink(missing_ok=True)
            self._writer: Writer = kind(self.path, "x" if mode == "w" else mode)
        except OutputError:
            raise
        except OSError as error:
            raise self._unwritable(error) from error
        try:
            self._lock = FileLock(self.path)
        except OutputError:  # another writer was faster
            self._writer.close()
            raise

    def look(self, sim: Simulation, collisions: int) -> None:
        """Write the present frame, unless it is there already."""
        started = time.perf_counter()
        self._ownership.bind_or_check(sim)
        if self._unchecked:
            self._continue(sim)
            self._unchecked = False
        if sim.frame > self._last:
            try:
                self._writer.write(frame_of(sim))
            except OSError as error:
                raise self._unwritable(error) from error
            self._last = sim.frame
            self.frames += 1
        self.seconds += time.perf_counter() - started

    def _continue(self, sim: Simulation) -> None:
        """Cut the file back to the frame of the simulation, after checking that it belongs to it."""
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            reader: Reader = ENDINGS[self.path.suffix.lower()].reader(self.path)
        for each in caught:
            logger.warning("mpsim: %s It is cut off.", each.message)
        try:
            kept = len(reader)
            while kept and reader.number(kept - 1) > sim.frame:
                kept -= 1
            if kept < len(reader):
                logger.info("mpsim: %d frames of %s are written anew.", len(reader) - kept, self.path)
            ends = [reader.read(index) for index in (0, max(kept - 1, 0))] if len(reader) else []
        finally:
            reader.close()
        if ends:
            self._demand_same_run(sim, *ends)
        if kept:
            last = ends[1]
            if last.frame < sim.frame - self.every:
                warnings.warn(
                    f"the trajectory {str(self.path)!r} continues at frame {sim.frame}, and its last frame was "
                    f"{last.frame}: those between are missing.",
                    TrajectoryWarning,
                    stacklevel=level_of_caller(),
                )
            self._last = last.frame
        self._writer.truncate(kept)
        self._lock.renew()

    def _demand_same_run(self, sim: Simulation, first: Frame, last: Frame) -> None:
        """Refuse to continue a file of another run, or one that does not hold what is written today."""
        name = f"the trajectory {str(self.path)!r}"
        missing = lacking(last)
        if missing:
            raise OutputError(
                f"{name} must hold {', '.join(missing)} to be continued, so that all its frames hold the same; it was "
                "written by an earlier version of mpsim or another program. It can be read as it is: move it, or "
                "choose another file."
            )
        wrong = discrepancy(sim, first, last)
        if wrong:
            raise OutputError(
                f"{name} can be continued only by the run that wrote it; {wrong}. Nothing was written. Choose another "
                "file, or replace this one with mode='w'."
            )

    def _unwritable(self, error: OSError) -> OutputError:
        return OutputError(
            f"the trajectory {str(self.path)!r} must be in a folder that can be written to, with room on its disk; got "
            f"{error.strerror or error}. What was written before is whole. Choose another place, or make room."
        )

    def __enter__(self) -> "TrajectoryWriter":
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file. May be called again."""
        self._ownership.close(f"To write more frames, use mpsim.Trajectory.write({str(self.path)!r}, mode='a').")
        self._writer.close()
        self._lock.release()


def _hint(path: Any) -> str:
    """What to use instead: perhaps the folder of a run was given."""
    if isinstance(path, str | os.PathLike) and os.path.isdir(path):  # False too for what no path can be
        found = sorted(p for p in Path(os.fsdecode(path)).glob("*") if p.suffix.lower() in ENDINGS)
        if found:
            return f"It is a folder; use {str(found[0])!r}."
    return "Use 'run.xyz'."


def _path_of(path: str | os.PathLike[str]) -> Path:
    """A path that ends as a trajectory does."""
    if not isinstance(path, str | os.PathLike) or Path(os.fsdecode(path)).suffix.lower() not in ENDINGS:
        raise InputError(f"a trajectory's path must end in {', '.join(ENDINGS)}; got {path!r}. {_hint(path)}")
    return Path(os.fsdecode(path))
