"""The complete state of a simulation: `Snapshot` in memory, and checkpoints, one file without executable code.

A checkpoint is a NumPy .npz without pickled objects: one JSON header, and arrays. It is written as every file is (see
mpsim.core.files); the one before is kept as <name>.previous. A kill at any moment leaves a whole checkpoint under
<name>. Reading verifies sizes first, then a digest over everything, then whether a simulation can be in such a state.
"""

from __future__ import annotations

import contextlib
import dataclasses
import errno
import hashlib
import json
import math
import os
import platform
import shutil
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from mpsim.core import checks, files
from mpsim.core.archive import DAMAGE, ArrayFile, Arrays, write_arrays
from mpsim.core.columns import Array, chunks_of
from mpsim.engine.changes import Change, terms_after
from mpsim.engine.emission import Progress
from mpsim.engine.journal import JOURNAL, packed, table_of, unpacked
from mpsim.engine.solvers.base import MOST_STEPS, SolverState, Terms, count_in, demand
from mpsim.engine.solvers.methods import capabilities_of, choose, solver_of
from mpsim.engine.step_limits import MOST_SUBSTEPS
from mpsim.errors import (
    CheckpointError,
    CheckpointWarning,
    InputError,
    OutputError,
    is_of_the_system,
    level_of_caller,
)
from mpsim.features import FEATURES, NUMBERS, PER_DISC, VECTORS, feature
from mpsim.features.properties import has_masses, has_radii
from mpsim.scene.scene import LARGEST_COUNT, Scene
from mpsim.scene.settings import Settings

# --- A moment of a simulation in memory


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Snapshot:
    """Copies of all that the next frame of a simulation depends on, by `Simulation.snapshot`.

    `Simulation.restore` goes back to it, any number of times, and `Simulation.from_snapshot` starts another simulation
    from it. It stays valid when its simulation is closed, is freed like any other object, and can be pickled, for other
    processes with the same version of mpsim.

    Attributes:
        frame, time: number of frames since the start, and simulated time [time].
        start: scene and settings at the start of the simulation.
        changes: made since the start, as in `Simulation.journal`.
        terms: scene and settings in force, and since when.
        arrays: of the discs, read-only.
        emission: how far the emitters were.

    >>> from mpsim import Scene, Simulation
    >>> with Simulation(Scene.random(count=50, packing=0.2, radius=0.5, seed=1)) as sim:
    ...     snap = sim.snapshot()
    ...     report = sim.run(frames=10)
    ...     sim.restore(snap)
    >>> snap
    <Snapshot: 50 discs, frame 0, time 0>
    """

    frame: int
    time: float
    start: tuple[Scene, Settings]
    changes: tuple[Change, ...]
    terms: Terms
    arrays: SolverState
    emission: Progress

    def __post_init__(self) -> None:
        for array in self.arrays.values():
            if isinstance(array, np.ndarray):
                array.setflags(write=False)

    def __reduce__(self) -> tuple[Any, ...]:
        return Snapshot, tuple(vars(self).values())  # arrays that a pickle holds come back writable

    @property
    def count(self) -> int:
        """Number of discs, removed ones included."""
        return count_in(self.arrays)

    @property
    def nbytes(self) -> int:
        """Memory of its arrays [bytes]: 32 a disc for smooth discs in steps, 100 with `event`."""
        shared = [id(self.arrays[name]) for name in ("radii", "masses")]  # with the simulation
        return sum(array.nbytes for array in self.arrays.values() if id(array) not in shared)

    def __repr__(self) -> str:
        return f"<Snapshot: {self.count} discs, frame {self.frame}, time {self.time:g}>"


# --- The scene of a checkpoint: plain values in its header, and arrays

OF_LATTICE = ("count", "temperature", "seed")
"""Numbers of a lattice that are written beside what other scenes have too."""

ARRAYS = ("position", "velocity", *PER_DISC, *VECTORS)  # arrays that a scene may have

OF_VALUES = [each for each in FEATURES if not (each.numbers or each.vectors or each.per_disc)]
"""Features that are given as values of classes or words, not as numbers of the scene or of each disc."""


def scene_parts(scene: Scene) -> tuple[dict[str, Any], Arrays]:
    """A scene as plain values and arrays, exact to the bit; a lattice as the numbers that it is made of."""
    plain: dict[str, Any] = {
        name: getattr(scene, name) for name in ("width", "height", "restitution", "wall_restitution", "boundary")
    }
    lattice = scene._on_lattice
    names = ARRAYS if lattice is None else (*PER_DISC, *VECTORS)
    arrays = {name: np.asarray(value) for name in names if (value := getattr(scene, name)) is not None}
    given = [each for each in OF_VALUES if each.argument in vars(scene)]
    plain |= {each.argument: feature.plain(each.of(scene), each.classes) for each in given}
    plain |= {name: value for name, default in NUMBERS.items() if (value := getattr(scene, name)) != default}
    if scene.duration is not None:
        plain["duration"] = scene.duration
    if scene.settings is not None:
        plain["settings"] = table_of(scene.settings)
    plain |= {name: value for name in ("picture_interval", "measures") if (value := getattr(scene, name))}
    if lattice is not None:
        plain["lattice"] = {name: getattr(lattice, name) for name in OF_LATTICE} | {"digest": lattice.digest_of_some()}
    return plain, arrays


def scene_from(plain: dict[str, Any], arrays: Arrays) -> Scene:
    """The scene from its plain values and arrays, as `scene_parts` returns them."""
    values: dict[str, Any] = plain | {name: each if each.ndim else each.item() for name, each in arrays.items()}
    for each in OF_VALUES:
        if each.argument in plain:
            values[each.argument] = feature.restored(plain[each.argument], each.classes)
    if "settings" in values:
        values["settings"] = Settings(**values["settings"])
    lattice = values.pop("lattice", None)
    return Scene(**values) if lattice is None else _on_lattice(lattice, values)


def _on_lattice(lattice: dict[str, Any], values: dict[str, Any]) -> Scene:
    """The scene whose discs start on a lattice, of which OF_LATTICE and a digest are given, with its other values."""
    if not isinstance(lattice, dict) or lattice.keys() != {*OF_LATTICE, "digest"}:
        raise ValueError(f"its lattice must have {', '.join(OF_LATTICE)} and digest; got {lattice!r:.60}")
    scene = Scene.lattice(**{name: lattice[name] for name in OF_LATTICE}, **values)
    start = scene._on_lattice
    if start is None or start.digest_of_some() != lattice["digest"]:
        raise ValueError("its lattice has other discs here: another version of NumPy has drawn other random numbers")
    return scene


FORMAT = 8  # version of the format. Only files of this one are read

HEADER = "mpsim_checkpoint"
"""Name of the first array, the header. So the name stands at the start of the file, and tells its kind."""

DIGEST = "digest"  # name of the last array, a digest over all that stands before it

_DIGEST_BYTES = 16

_START = b"PK\x03\x04"
_NAME_AT = 30

MOST_HEADER = 2**26  # bytes of the header at most: features of the scene are in it, discs are not

DAMAGED_DISK = (errno.EIO, errno.EBADMSG, errno.EUCLEAN)
"""Errors of the system by which a disk, or its checksums, say that the content is lost."""

_NO_STATE = (ValueError, LookupError, TypeError, AttributeError, ArithmeticError, RecursionError)
"""What content raises that is no state of a simulation."""

VERSIONS: dict[str, str] = {"python": platform.python_version(), "numpy": np.__version__, "numba": numba.__version__}
"""Of what runs, whatever is installed when a checkpoint is written."""

SIZES = ("radii", "masses")
"""Arrays of a solver that are written as one number, shape (), where all discs have the same; the header has the number
of discs."""


class Checkpoint(NamedTuple):
    """What a file holds.

    Attributes:
        snapshot: the moment at which it was written.
        digest: over all that the file holds.
    """

    snapshot: Snapshot
    digest: str


def place_of(path: str | os.PathLike[str]) -> Path:
    """The file that a path means, absolute, links followed."""
    if not isinstance(path, str | os.PathLike) or not os.fspath(path) or "\0" in os.fsdecode(path):
        raise InputError(f"the path of a checkpoint must be a file name; got {path!r}. Give one such as 'run.mpsim'.")
    try:
        return Path(os.path.realpath(os.fsdecode(path)))
    except FileNotFoundError:
        raise InputError(
            f"the relative path {path!r} needs the current folder, which has been removed. Give an absolute path, or "
            "change to a folder that exists (os.chdir)."
        ) from None


def checked_place(path: str | os.PathLike[str]) -> Path:
    """`place_of`, if a checkpoint can be written there and nothing else would be lost."""
    target = place_of(path)
    with _writable(target):
        _check_place(target)
    return target


def _writable(target: Path) -> contextlib.AbstractContextManager[None]:
    """Turn errors of the system into an OutputError that says what is needed."""
    rule = "be in a folder that can be written to, with room on its disk"
    instead = "What was there before is untouched. Choose another place, or make room."
    return files.writable("the checkpoint", target, rule, instead)


def _check_place(target: Path) -> None:
    if not target.parent.is_dir():
        folder = str(target.parent)
        remedy = f"{folder!r} is a file: give another one" if target.parent.exists() else f"Make {folder!r}"
        raise OutputError(f"a checkpoint needs a folder that exists; got {str(target)!r}. {remedy}.")
    for path in (target, _previous(target)):
        if path.is_dir() or (path.exists() and not path.is_file()):
            raise OutputError(f"a checkpoint must be a file; {str(path)!r} is not. Give the name of a file in it.")
        if path.exists() and not _is_of_our_kind(path):
            raise OutputError(
                f"a checkpoint may replace only a checkpoint; {str(path)!r} is a file of another kind. "
                "Choose another name, or remove it."
            )
    files.check_target(target)


def write(path: str | os.PathLike[str], snapshot: Snapshot) -> Path:
    """Write a checkpoint, arrays in chunks; the file that was there is kept beside it as <name>.previous."""
    target = place_of(path)
    header, arrays = _packed(snapshot)
    digest = hashlib.blake2b(digest_size=_DIGEST_BYTES)

    def everything() -> Iterator[tuple[str, Array]]:
        yield HEADER, np.frombuffer(header, np.uint8)
        for name, array in arrays.items():
            digest.update(_title(name, array))
            yield name, array
        yield DIGEST, np.frombuffer(digest.digest(), np.uint8)

    with _writable(target):
        _check_place(target)
        with _kept_as_previous(target), files.atomic_write(target) as file:
            write_arrays(file, everything(), digest.update)
    return target


def digest_of(header: bytes, arrays: Arrays) -> bytes:
    """Digest over header and arrays, names, dtypes and shapes included."""
    digest = hashlib.blake2b(header, digest_size=_DIGEST_BYTES)
    for name, array in arrays.items():
        digest.update(_title(name, array))
        for chunk in chunks_of(array):
            content: Any = chunk.reshape(-1).view(np.uint8)
            digest.update(content)
    return digest.digest()


def _title(name: str, array: Array) -> bytes:
    return f"{name} {array.dtype.str} {array.shape}".encode()


def read(path: str | os.PathLike[str], mapped: bool = False) -> Checkpoint:
    """Read and verify a checkpoint; where it is damaged or missing, the one before, with a warning that names both.

    mapped: whether arrays stay in the pages of the file.

    Raises:
        CheckpointError: if there is none, or none that is whole, or it is of another format, or it cannot be read for
            a reason that is no damage, such as a missing right: the one before is not taken then.
    """
    target = place_of(path)
    try:
        return _verified(target, mapped)
    except _DamagedError as damage:
        previous = _previous(target)
        try:
            found = _verified(previous, mapped)
        except _DamagedError as older:
            raise CheckpointError(
                f"the checkpoint {str(target)!r} must be a complete file that `save` has written; {damage}. The "
                f"previous one, {str(previous)!r}, cannot be used either: {older}. Start again, or give another path."
            ) from None
        warnings.warn(
            f"the checkpoint {str(target)!r} cannot be used: {damage}. Continuing from the previous one, "
            f"{str(previous)!r}, at frame {found.snapshot.frame}. Check that disk.",
            CheckpointWarning,
            stacklevel=level_of_caller(),
        )
        return found


def method_of(path: str | os.PathLike[str]) -> str | None:
    """The method that the header of a checkpoint names; None if it cannot be read: then `read` says why."""
    with contextlib.suppress(_DamagedError, CheckpointError, *_NO_STATE):
        own = place_of(path)
        with _damage_reported(own), files.opened(own) as file, ArrayFile(file) as archive:
            return str(_header_of(archive)[1]["settings"]["method"])
    return None


class _DamagedError(Exception):
    """A file cannot be used; the text says why."""


def _packed(snapshot: Snapshot) -> tuple[bytes, dict[str, Array]]:
    """The header of a file, as text, and its arrays."""
    (scene, settings), arrays = snapshot.start, snapshot.arrays
    plain, parts = scene_parts(scene)
    everything: dict[str, Array] = {f"scene.{name}": value for name, value in parts.items()}
    once = {name: np.asarray(sizes[0]) for name in SIZES if _are_equal(sizes := np.asarray(arrays[name]))}
    everything |= {f"solver.{name}": value for name, value in sorted({**arrays, **once}.items())}
    if snapshot.changes:
        everything[JOURNAL] = packed(snapshot.changes)
    header: dict[str, Any] = {
        "format": FORMAT,
        "versions": VERSIONS,
        "settings": table_of(settings),
        "scene": plain,
        "run": {"frame": snapshot.frame, "emission": snapshot.emission},
        "discs": snapshot.count,
    }
    text = json.dumps(header).encode()
    if len(text) > MOST_HEADER:
        number = {each.argument: len(each.of(scene)) for each in FEATURES if each.kinds and each.several}
        counts = " and ".join(f"{count:,} {name}" for name, count in number.items())
        raise OutputError(
            f"{' and '.join(number)} must take at most {MOST_HEADER:,} bytes of a checkpoint's header, or it could not "
            f"be read again; got {len(text):,} bytes for {counts}. Use fewer; one Polyline takes the place of many."
        )
    return text, everything


def _are_equal(sizes: NDArray[np.float64]) -> bool:
    return len(sizes) > 0 and (sizes.strides == (0,) or bool((sizes == sizes[0]).all()))


def _previous(target: Path) -> Path:
    return target.parent / f"{target.name}.previous"


def _is_of_our_kind(path: Path) -> bool:
    """Whether a file begins as a checkpoint does, damaged or not; an empty file may be replaced."""
    with path.open("rb") as file:
        start = file.read(_NAME_AT + len(HEADER))
    return start[:_NAME_AT].startswith(_START) and start[_NAME_AT:].decode("latin-1") == HEADER if start else True


def _is_complete(path: Path) -> bool:
    """Whether a checkpoint is there that ends as it should: one that is cut off must not push out the one before it.

    A file is written to its end before it has its name, so it is cut off only by others, as by a copy that was
    interrupted. Its content is not read, which would take as long as to write it.
    """
    try:
        with path.open("rb") as file, ArrayFile(file) as archive:
            return HEADER in archive.names
    except (FileNotFoundError, *DAMAGE):
        return False


@contextlib.contextmanager
def _kept_as_previous(target: Path) -> Iterator[None]:
    """Keep the present file as <name>.previous once the body of the `with` has replaced it.

    Not before, so that there is a whole file at every moment.
    """
    if not _is_complete(target):
        yield
        return
    is_written, unflushed = False, None
    try:
        with files.draft_of(_previous(target)) as second:
            _link(target, second)
            try:
                yield
            except files.WrittenError as error:  # the new file has its name already, so the old one gets its own too
                unflushed = error
            is_written = True
    except OSError as error:
        if not is_written or isinstance(error, files.WrittenError):
            raise
        why = f"it is written, but the one before it may be lost ({error.strerror})"
        raise files.WrittenError(error.errno, why) from error
    if unflushed is not None:
        raise unflushed


def _link(target: Path, second: Path) -> None:
    """Give a file a second name; a copy has it where the file system has no hard links."""
    try:
        os.link(target, second)
    except OSError as error:
        if error.errno not in (errno.EPERM, errno.EOPNOTSUPP, errno.ENOSYS, errno.EMLINK):
            raise
        with target.open("rb") as old, second.open("xb") as new:
            shutil.copyfileobj(old, new)
            new.flush()
            os.fsync(new.fileno())


@contextlib.contextmanager
def _damage_reported(path: Path) -> Iterator[None]:
    """Turn errors into _DamagedError if the file is damaged, and into CheckpointError if it cannot be read.

    Only for a damaged file the one before it is taken. Errors that have nothing to do with the file pass: too little
    memory, an interrupt, an exception of a signal handler.
    """
    try:
        yield
    except FileNotFoundError:
        raise _DamagedError("there is no such file") from None
    except DAMAGE as error:
        raise _DamagedError(f"it cannot be read ({type(error).__name__}: {error})") from None
    except OSError as error:
        if error.errno in DAMAGED_DISK:
            raise _DamagedError(f"it cannot be read ({error.strerror})") from None
        if not is_of_the_system(error):
            raise
        raise CheckpointError(
            f"the checkpoint {str(path)!r} must be a file that can be read; got: {error.strerror}. It may be "
            "undamaged, so the previous one is not used. Fix this, or give another path."
        ) from error


def _verified(path: Path, mapped: bool) -> Checkpoint:
    """The checkpoint of a file whose digest is right, and in which a simulation can have been."""
    with _damage_reported(path), files.opened(path) as file, ArrayFile(file) as archive:
        text, header = _header_of(archive)
        format_version = int(header["format"])
        if format_version != FORMAT:
            is_newer = format_version > FORMAT
            raise CheckpointError(
                f"the checkpoint {str(path)!r} must be of format {FORMAT}, which this version of mpsim reads; it is of "
                f"format {format_version}, {'of a newer version' if is_newer else 'from a development version'}. "
                f"{'Use a newer mpsim.' if is_newer else 'Start again from its scene.'}"
            )
        take = archive.map if mapped else archive.read
        arrays = {name: take(name) for name in archive.names if name not in (HEADER, DIGEST)}
        digest = archive.read(DIGEST).tobytes()
        if digest_of(text, arrays) != digest:
            raise _DamagedError("its content does not match its digest")
    try:
        with np.errstate(all="ignore"):
            return Checkpoint(_checked(_made_from(header, arrays), header["run"]), digest.hex())
    except _NO_STATE as error:  # the digest is right, so somebody has made it so; still nothing may break
        raise _DamagedError(f"its content is not a state of a simulation ({type(error).__name__}: {error})") from None


def _header_of(archive: ArrayFile) -> tuple[bytes, dict[str, Any]]:
    """The header as text, and what it says."""
    if HEADER not in archive.names:
        raise ValueError("it is not a checkpoint of mpsim")
    text = archive.read(HEADER)
    if text.dtype != np.uint8 or text.ndim != 1 or text.size > MOST_HEADER:
        raise ValueError("its header is not a text of reasonable length")
    header = json.loads(text.tobytes())
    if not isinstance(header, dict):
        raise ValueError("its header is not a table")
    return text.tobytes(), header


def _made_from(header: dict[str, Any], found: Arrays) -> Snapshot:
    """The moment from the header and the arrays of its file."""
    parts = _named("scene.", found), _named("solver.", found)
    if len(parts[0]) + len(parts[1]) + (JOURNAL in found) != len(found) or not parts[0].keys() <= set(ARRAYS):
        raise ValueError(f"it holds arrays that belong to nothing; got {sorted(found)}")
    scene, settings = scene_from(header["scene"], parts[0]), Settings(**header["settings"])
    arrays, discs = parts[1], header.get("discs", -1)
    once = [name for name in SIZES if name in arrays and not arrays[name].ndim]
    # A list: an interrupt while a generator that is not at its end is thrown away would be lost.
    if once and not any([array.ndim and len(array) == discs for array in arrays.values()]):
        raise ValueError(f"it has no array for {discs!r:.30} discs")  # whose sizes would take any memory
    arrays |= {name: np.broadcast_to(arrays[name], discs) for name in once}
    frame, emission = header["run"]["frame"], header["run"]["emission"]
    changes = unpacked(found[JOURNAL], frame) if JOURNAL in found else ()
    terms = terms_after(scene, settings, changes)
    return Snapshot(frame, terms.time_of(frame), (scene, settings), changes, terms, arrays, emission)


def _named(prefix: str, arrays: Arrays) -> Arrays:
    return {name.removeprefix(prefix): value for name, value in arrays.items() if name.startswith(prefix)}


# --- Checks whether the state in a checkpoint is possible for its scene


def _checked(found: Snapshot, run: dict[str, Any]) -> Snapshot:
    """The moment; raise ValueError for one in which no simulation can have been, saying why."""
    arrays, (scene, settings, origin), count = found.arrays, found.terms, found.count
    demand(run.get("origin", [*origin]) == [*origin], f"its origin must be {[*origin]}; got {run.get('origin')!r:.60}")
    demand(scene.count <= count <= LARGEST_COUNT, f"it has {count} discs; its scene has {scene.count}")
    solver_of(choose(count, settings).method).check_snapshot(scene, settings, arrays)
    _check_sizes(scene, arrays)
    frames, second = arrays["progress"].tolist()
    demand(0 <= frames <= MOST_STEPS and second >= 0, f"frames and steps must be >= 0; got {frames}, {second}")
    frame = origin.frame + frames
    demand(found.frame == frame, f"its frame must be {frame}; got {found.frame!r}")
    _check_emission(scene, found.emission, count)
    if capabilities_of(settings).has_steps:  # every frame has had as many: those that are set, or that were chosen
        most = max(MOST_SUBSTEPS, settings.substeps) if settings.on_fast == "substep" else settings.substeps
        each, rest = divmod(second, frames) if frames else (settings.substeps, second)
        demand(rest == 0 and settings.substeps <= each <= most, f"{frames} frames cannot have {second} steps")
    return found


def _check_sizes(scene: Scene, arrays: Arrays) -> None:
    """Radii and masses: those of the scene first, and no disc larger than its largest."""
    radii, masses = arrays["radii"], arrays["masses"]
    for name, values, own in (("radii", radii, scene.radii), ("masses", masses, scene.masses)):
        demand(checks.equal(values[: len(own)], own), f"{name} must begin with those of the scene")
        demand((np.isfinite(values) & (values > 0)).all(), f"{name} must be finite and > 0")
    demand((radii <= scene.largest_radius).all(), "radii must be at most that of the scene's largest disc")
    demand(has_radii(scene) or (radii == scene.largest_radius).all(), "all discs of this scene have one radius")
    demand(has_masses(scene) or (masses == 1).all(), "all discs of this scene have mass 1")


def _check_emission(scene: Scene, emission: Any, count: int) -> None:
    """What emitters have done: whole numbers, one each, and no more discs than there are."""
    known = isinstance(emission, dict) and emission.keys() - {"since"} == {"emitted", "due"}
    demand(known, "emission must have emitted and due")
    for name, values in emission.items():
        demand(isinstance(values, list) and len(values) == len(scene.emitters), f"{name} must be one per emitter")
        if name == "since":
            fit = all(type(value) is float and math.isfinite(value) for value in values)
        else:
            fit = all(type(value) is int and 0 <= value <= MOST_STEPS for value in values)
        demand(fit, f"{name} must be times, or else whole numbers")
    demand(sum(emission["emitted"]) <= count - scene.count, "emitters cannot have added more discs than there are")
