"""Trajectories as GSD, the binary format of HOOMD-blue, through the `gsd` library; OVITO and freud read it too.

The schema centres boxes at the origin and has single precision, which loses bits. So each frame also holds mpsim's own
data under log/: the exact positions, velocities, radii and masses, the numbers of the discs, box, origin and time.
Arrays of per-disc data are written even for frames without discs, because readers take what a frame lacks from the
first frame of the file.
"""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mpsim.core import files
from mpsim.core.columns import in_state
from mpsim.core.late import imported
from mpsim.errors import MpsimError, TrajectoryError, reason_of
from mpsim.output.frames import Frame

_PER_DISC = {"position": "position", "velocity": "velocity", "radius": "radius", "mass": "mass", "id": "ids"}
"""Arrays under log/particles/mpsim/, and the attributes of a Frame that they are; further columns go by their names."""


def _library(module: str) -> Any:
    return imported(module, "a trajectory that ends in .gsd", "gsd", "let the path end in .xyz, which needs nothing")


class GsdWriter:
    """Appends frames to a file that is open for it."""

    def __init__(self, path: Path, mode: str):
        self._path = path
        self._hoomd = _library("gsd.hoomd")
        self._file: Any = self._open({"a": "r+" if path.exists() and path.stat().st_size else "w"}.get(mode, mode))

    def write(self, frame: Frame) -> None:
        """Append a frame, and pass it to the operating system."""
        made = self._hoomd.Frame()
        made.configuration.step = frame.frame
        made.configuration.dimensions = 2
        made.configuration.box = [*frame.box, 0, 0, 0, 0]
        made.particles.N = len(frame.position)
        made.particles.types = ["disc"]
        made.particles.diameter = (2 * frame.radius).astype(np.float32)
        made.particles.mass = frame.mass.astype(np.float32)
        if "image" in frame.known:
            made.particles.image = np.pad(np.asarray(frame.image, np.int32), ((0, 0), (0, 1)))
        try:
            for name, values in _chunks_of(frame):  # not by `append`, which would hold all of them, and copies
                self._file.file.write_chunk(name, np.ascontiguousarray(values))
                del values  # before the next ones are made
            self._file.append(made)
            self._file.flush()
        except RuntimeError as error:
            raise OSError(0, str(error)) from error

    def truncate(self, frames: int) -> None:
        """Keep only the first frames. The library cannot shorten a file, so they are copied to another."""
        if frames == len(self._file):
            return
        self.close()
        with files.atomic_write(self._path) as file:
            _copy(self._path, Path(file.name), frames)
        self._file = self._open("r+")

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _open(self, mode: str) -> Any:
        try:
            return self._hoomd.open(str(self._path), mode)
        except RuntimeError as error:
            raise TrajectoryError(f"a trajectory can be continued only if it is whole GSD; {error}.") from None


class GsdReader:
    """Reads frames that mpsim wrote, from a file that stays open."""

    def __init__(self, path: Path):
        self._path = path
        self._file: Any = self._opened()

    def _opened(self) -> Any:
        hoomd = _library("gsd.hoomd")
        try:
            files.opened(self._path).close()  # the library would wait for the other end of a pipe
            return hoomd.open(str(self._path), "r")
        except (RuntimeError, OSError) as error:
            raise self._damaged("the file", reason_of(error)) from None

    def refresh(self) -> None:
        """Look for frames written since the library opened the file; it knows only the earlier ones."""
        before, self._file = self._file, self._opened()
        before.close()

    def __len__(self) -> int:
        return len(self._file)

    def number(self, index: int) -> int:
        """The frame of the simulation that is at an index."""
        step = self._undamaged(index, lambda: self._chunk(index, "configuration/step"))
        return 0 if step is None else int(step[0])

    def read(self, index: int) -> Frame:
        """One frame, or raise a TrajectoryError that says what is wrong with it."""
        return self._undamaged(index, lambda: self._read(index))

    def _undamaged(self, index: int, read: Callable[[], Any]) -> Any:
        try:
            return read()
        except (MpsimError, TimeoutError):  # the latter of the user
            raise
        except Exception as error:  # what the library makes of a damaged file has no end
            raise self._damaged(f"frame {index}", f"{type(error).__name__}: {error!s:.200}") from None

    def _damaged(self, what: str, reason: str) -> TrajectoryError:
        return TrajectoryError(
            f"a trajectory that ends in .gsd must be a whole GSD file; {what} of {str(self._path)!r} cannot be read "
            f"({reason}). If it was copied while it was written, copy it again."
        )

    def _read(self, index: int) -> Frame:
        where = f"frame {index} of {str(self._path)!r}"
        sides = self._chunk(index, "log/mpsim/box")
        if sides is None:
            raise TrajectoryError(
                f"{where} must hold the box under log/mpsim/box, as mpsim writes it; it does not. Read GSD of other "
                "programs by the package gsd, and make a Scene of it."
            )
        names = {**_PER_DISC, **{column.name: column.name for column in in_state()}}
        found = {ours: self._chunk(index, f"log/particles/mpsim/{name}") for name, ours in names.items()}
        known: dict[str, Any] = {name: array for name, array in found.items() if array is not None}
        known["time"] = float(self._chunk(index, "log/mpsim/time")[0])
        box, origin = ((float(x), float(y)) for x, y in (sides, self._chunk(index, "log/mpsim/origin")))
        x, y = (bool(wrap) for wrap in self._chunk(index, "log/mpsim/periodic"))
        position = known.pop("position")
        return Frame(self.number(index), box, origin, (x, y), position, self._path, known)

    def _chunk(self, index: int, name: str) -> Any:
        """The data of a frame under a name; None if there are none."""
        file = self._file.file
        return file.read_chunk(frame=index, name=name) if file.chunk_exists(frame=index, name=name) else None

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def _chunks_of(frame: Frame) -> Iterator[tuple[str, NDArray[Any]]]:
    """The vectors of the discs in single precision, and mpsim's own data, by name, each made when it is needed."""
    size = np.asarray(frame.box)
    yield "particles/position", _three(frame.position, np.asarray(frame.origin) + size / 2)
    yield "particles/velocity", _three(frame.velocity, 0.0)
    for name, ours in _PER_DISC.items():
        yield f"log/particles/mpsim/{name}", getattr(frame, ours)
    for column in in_state():
        if column.name in frame.known:
            yield f"log/particles/mpsim/{column.name}", frame.known[column.name]
    yield "log/mpsim/time", np.array([frame.time])
    yield "log/mpsim/box", size
    yield "log/mpsim/origin", np.array(frame.origin)
    yield "log/mpsim/periodic", np.array(frame.periodic, np.uint8)
    yield "log/mpsim/single", np.array([frame.position.dtype == np.float32], np.uint8)


def _three(plane: NDArray[np.floating], origin: ArrayLike) -> NDArray[np.float32]:
    """Vectors from an origin, with a z of 0, in single precision."""
    found = np.zeros((len(plane), 3), np.float32)
    np.subtract(plane, origin, out=found[:, :2], casting="same_kind")
    return found


def _copy(source: Path, target: Path, frames: int) -> None:
    low = _library("gsd.fl")
    with low.open(str(source), "r") as old:
        options = {"application": old.application, "schema": old.schema, "schema_version": old.schema_version}
        names = old.find_matching_chunk_names("")
        with low.open(str(target), "w", **options) as new:
            for frame in range(frames):
                for name in names:
                    if old.chunk_exists(frame=frame, name=name):
                        new.write_chunk(name, old.read_chunk(frame=frame, name=name))
                new.end_frame()
