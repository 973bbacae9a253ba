"""Trajectories as GSD, the binary format of HOOMD-blue, through the `gsd` library; OVITO and freud read it too.

The schema centres boxes at the origin and has single precision, which loses bits. So each frame also holds mpsim's own
data under log/: the exact positions, velocities, radii and masses, the numbers of the discs, box, origin and time.
Arrays of per-disc data are written even for frames without discs, because readers take what a frame lacks from the
first frame of the file.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mpsim.core import checks, files
from mpsim.core.columns import IN_STATE
from mpsim.core.late import imported
from mpsim.errors import MpsimError, TrajectoryError, reason_of
from mpsim.output.frames import Frame, Given

_PER_DISC = {"position": "position", "velocity": "velocity", "radius": "radius", "mass": "mass", "id": "ids"}
"""Arrays under log/particles/mpsim/, and the attributes of a Frame that they are; further columns go by their names."""


def _library(module: str) -> Any:
    return imported(module, "a trajectory that ends in .gsd", "gsd", "let the path end in .xyz, which needs nothing")


class GsdWriter:
    """Appends frames to a file, which is new (mode "x") or continued ("a")."""

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
    """Reads frames of a file that stays open."""

    def __init__(self, path: Path, given: Given):
        self._path, self._given = path, given
        self._file: Any = self._opened()
        self._later: dict[str, bool] = {}

    def _opened(self) -> Any:
        hoomd = _library("gsd.hoomd")
        try:
            files.opened(self._path).close()  # the library would wait for the other end of a pipe
            return hoomd.open(str(self._path), "r")
        except (RuntimeError, OSError) as error:
            raise _not_whole(f"{str(self._path)!r} cannot be read: {reason_of(error)}") from None

    def refresh(self) -> None:
        """Look for frames written since the library opened the file; it knows only the earlier ones."""
        before, self._file = self._file, self._opened()
        before.close()
        self._later = {}

    def __len__(self) -> int:
        return len(self._file)

    def read(self, index: int) -> Frame:
        """One frame: what mpsim wrote, or the standard fields of a file from another program."""
        try:
            return self._read(index)
        except (MpsimError, TimeoutError):
            raise
        except Exception as error:  # what the library makes of a damaged file has no end
            why = f"({type(error).__name__}: {error!s:.200})"
            raise _not_whole(f"frame {index} of {str(self._path)!r} cannot be read {why}") from None

    def _read(self, index: int) -> Frame:
        box = self._chunk(index, "log/mpsim/box")
        if box is not None:
            return self._of_mpsim(index, *map(float, box))
        found = self._file[index]
        box, discs, where = found.configuration.box, found.particles, f"frame {index} of {str(self._path)!r}"
        if box is None or not (0 < box[:2].min() <= box[:2].max() < np.inf) or np.any(box[3:]):
            raise TrajectoryError(f"{where} must have an upright rectangular box; got {box!r}.")
        if discs.N > 1 and not self._has(index, "position", discs.N):
            raise TrajectoryError(f"{where} must hold the places of its {discs.N} discs; it does not.")
        known: dict[str, Any] = {}
        if self._has(index, "velocity"):
            known["velocity"] = discs.velocity
        if self._has(index, "image"):
            known["image"] = discs.image[:, :2].astype(np.int64)
        if self._has(index, "mass", discs.N):
            known["mass"] = discs.mass.astype(np.float64)
        radius = _radius_of_shapes(discs, where)
        if radius is None and self._has(index, "diameter", discs.N):
            radius = discs.diameter.astype(np.float64) / 2
        if radius is not None:
            known["radius"] = radius
        place = np.column_stack([discs.position[:, :2] + box[:2] / 2, discs.position[:, 2]])
        for name, values in {"position": place, **known}.items():
            if len(bad := np.unique(np.nonzero(~np.isfinite(values))[0])):
                raise TrajectoryError(
                    f"{where} must hold finite numbers; got {name} {values[bad[0]]} of disc {bad[0]}."
                )
        both = float(box[0]), float(box[1])
        step = int(found.configuration.step)
        return self._given.frame(where, step, both, (0.0, 0.0), None, place, self._path, known)

    def _has(self, index: int, name: str, count: int | None = None) -> bool:
        """Whether the file holds a quantity of the discs of a frame: its own, or that of the first frame.

        HOOMD writes what changes as discs move into the first frame only, unless it is told otherwise: then later
        frames lack it. It leaves out zeros, so frames lack nothing if any later one has it.

        count: number of the discs, if the quantity stays the same as they move.
        """
        file, chunk = self._file.file, f"particles/{name}"
        if file.chunk_exists(frame=index, name=chunk):
            return True
        if count is not None:
            number = self._chunk(0, "particles/N")
            return file.chunk_exists(frame=0, name=chunk) and number is not None and int(number[0]) == count
        if chunk not in self._later:
            self._later[chunk] = any(file.chunk_exists(frame=each, name=chunk) for each in range(1, len(self)))
        return self._later[chunk]

    def _of_mpsim(self, index: int, width: float, height: float) -> Frame:
        """A frame that mpsim wrote."""
        names = {**_PER_DISC, **{column.name: column.name for column in IN_STATE}}
        found = {ours: self._chunk(index, f"log/particles/mpsim/{name}") for name, ours in names.items()}
        known: dict[str, Any] = {name: array for name, array in found.items() if array is not None}
        known["time"] = float(self._chunk(index, "log/mpsim/time")[0])
        left, low = map(float, self._chunk(index, "log/mpsim/origin"))
        x, y = (bool(wrap) for wrap in self._chunk(index, "log/mpsim/periodic"))
        place, step = known.pop("position"), self._chunk(index, "configuration/step")
        number = 0 if step is None else int(step[0])
        where, box = f"frame {index} of {str(self._path)!r}", (width, height)
        return self._given.frame(where, number, box, (left, low), (x, y), place, self._path, known)

    def _chunk(self, index: int, name: str) -> Any:
        """The data of a frame under a name; None if there are none."""
        file = self._file.file
        return file.read_chunk(frame=index, name=name) if file.chunk_exists(frame=index, name=name) else None

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def _not_whole(what: str) -> TrajectoryError:
    return TrajectoryError(
        f"a trajectory that ends in .gsd must be a whole GSD file; {what}. If it was copied while it was written, copy "
        "it again."
    )


def _radius_of_shapes(discs: Any, where: str) -> NDArray[np.float64] | None:
    """Radii by the shapes of their types, as hard-particle Monte Carlo has them; None if the types have no shapes."""
    given = dict(enumerate(discs.type_shapes))
    shapes = {int(each): given.get(int(each), {}) for each in np.unique(discs.typeid)}
    if not any(shapes.values()):
        return None
    for each, shape in shapes.items():
        diameter = shape.get("diameter")
        if shape.get("type") != "Sphere" or not (isinstance(diameter, int | float) and 0 < diameter < np.inf):
            raise TrajectoryError(
                f"{where} must hold discs, of shape Sphere with a diameter above 0; got {checks.brief(shape)} of type "
                f"{each}."
            )
    return np.array([shapes[int(each)]["diameter"] / 2 for each in discs.typeid], np.float64)


def _chunks_of(frame: Frame) -> Iterator[tuple[str, NDArray[Any]]]:
    """The vectors of the discs in single precision, and mpsim's own data, by name, each made when it is needed."""
    size = np.asarray(frame.box)
    yield "particles/position", _three(frame.position, np.asarray(frame.origin) + size / 2)
    yield "particles/velocity", _three(frame.velocity, 0.0)
    for name, ours in _PER_DISC.items():
        yield f"log/particles/mpsim/{name}", getattr(frame, ours)
    for column in IN_STATE:
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
        with low.open(str(target), "w", **options) as new:
            for frame in range(frames):
                for name in old.find_matching_chunk_names(""):
                    if old.chunk_exists(frame=frame, name=name):
                        new.write_chunk(name, old.read_chunk(frame=frame, name=name))
                new.end_frame()
