"""Trajectories: frames of a run in one file, written while it runs and read back one by one.

`.xyz` and `.extxyz` are extended XYZ, which needs no other package; `.gsd` is GSD, which needs the package gsd. OVITO
opens both. If the process is killed, at most the frame that was being written is lost. Text dumps of LAMMPS are read.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, overload

from numpy.typing import ArrayLike

from mpsim.core import checks
from mpsim.core.joint_file import JointFile
from mpsim.engine.simulation import Simulation, jointly
from mpsim.errors import InputError, TrajectoryError, reason_of
from mpsim.features.edges import BoundaryName
from mpsim.output.first_rank import FirstRank
from mpsim.output.frame_file import ENDINGS, READERS, FrameFile, ending_of, unwritable
from mpsim.output.frames import Frame, Given, Reader, frame_of
from mpsim.output.ownership import Ownership
from mpsim.output.xyz import write_jointly


@checks.known_names_of_methods
class Trajectory:
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
            part = object.__new__(Trajectory)
            part.path, part.given, part._reader = self.path, self.given, self._reader
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

    def __enter__(self) -> Trajectory:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

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
        """Turn an error of the system into a TrajectoryError, as of a file that was replaced or removed."""
        try:
            yield
        except OSError as error:
            reason = reason_of(error)
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
            comm: for method="mpi", the communicator of the simulation: all its ranks make this call. They write
                extended XYZ together; GSD is written by the first rank.

        Raises:
            InputError: naming the argument, its rule and the value received.
            OutputError: if the file exists (mode "x"), has another writer that is still open, in this process or
                another (if the file system has locks), or cannot be written, or if the package gsd is missing.
        """
        return TrajectoryWriter(path, every, mode=mode, comm=comm)


class TrajectoryWriter:
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
        self.path: Path = _path_of(path, ENDINGS)
        self.every: int = checks.whole("every", every, 1, 10**12, "1 writes every frame.")
        checks.choice("mode", mode, ("x", "w", "a"))
        self.frames: int = 0
        self.seconds: float = 0.0
        advice = "Open one for each by mpsim.Trajectory.write(...); for the same run, resumed, with mode='a'."
        self._ownership = Ownership("trajectory", self.path, advice, comm is not None)
        self._first_rank = FirstRank(comm)
        self._file: FrameFile | None = None  # of the first rank
        self._joint: JointFile | None = None  # of ranks that write together
        try:
            self._first_rank.once(lambda: self._open(mode))
            if comm is not None and ENDINGS[self.path.suffix.lower()].is_joint:
                self._joint = self._first_rank.opened(self.path)
        except BaseException:
            self._first_rank.close()
            raise

    def _open(self, mode: str) -> None:
        self._file = FrameFile(self.path, mode)

    def observe(self, sim: Simulation, collisions: int) -> None:
        """Write the present frame, unless it is there already."""
        started = time.perf_counter()
        self._ownership.bind_or_check(sim)
        if self._joint is not None and not sim.scene.absorbing:
            self.frames += self._append_jointly(sim, self._joint)
        else:  # numbers of discs that have gaps are not those of lines
            self.frames += sim.once(lambda: self._held().append(sim, frame_of(sim), self.every))
        self.seconds += time.perf_counter() - started

    def _held(self) -> FrameFile:
        assert self._file is not None  # of the first rank, as `_ownership` has looked
        return self._file

    def _append_jointly(self, sim: Simulation, file: JointFile) -> bool:
        """Write the present frame on all ranks, unless the file has it. Returns whether it was written."""
        begin = sim.once(lambda: self._held().begin_of(sim, frame_of(sim), self.every))
        if begin is None:
            return False
        try:
            jointly(sim, lambda team: write_jointly(file, team, frame_of(sim), begin))
        except OSError as error:
            self._first_rank.alone(lambda: self._held().cut(begin))
            raise unwritable(self.path, error) from error
        self._first_rank.alone(lambda: self._held().note(sim.frame))
        return True

    def __enter__(self) -> TrajectoryWriter:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file. May be called again."""
        self._ownership.close(f"To write more frames, use mpsim.Trajectory.write({str(self.path)!r}, mode='a').")
        if self._joint is not None:
            try:
                self._joint.sync()
            except OSError as error:
                raise unwritable(self.path, error) from error
            finally:
                self._joint.close()
        if self._file is not None:
            self._file.close()
        self._first_rank.close()


def _hint(path: Any, endings: Iterable[str]) -> str:
    """Advice on what to give instead, if the path is the folder of a run."""
    if isinstance(path, str | os.PathLike) and os.path.isdir(path):  # False too for what no path can be
        found = sorted(p for p in Path(os.fsdecode(path)).glob("*") if ending_of(p) in endings)
        if found:
            return f"It is a folder; use {str(found[0])!r}."
    return "Use 'run.xyz'."


def _path_of(path: str | os.PathLike[str], endings: Iterable[str]) -> Path:
    """A path that ends as a trajectory does."""
    if not isinstance(path, str | os.PathLike) or ending_of(path) not in endings:
        raise InputError(f"a trajectory's path must end in {', '.join(endings)}; got {path!r}. {_hint(path, endings)}")
    return Path(os.fsdecode(path))
