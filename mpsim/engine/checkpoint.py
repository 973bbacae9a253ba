"""Checkpoints: the whole state of a simulation in one file that is never half written, and nothing in it is code.

A checkpoint is a NumPy .npz without pickled objects: one JSON header, and arrays. It is written to a file of its own
name beside the target, forced to the disk, and renamed; the one before is kept as <name>.previous. A kill at any moment
leaves a whole checkpoint under one of the two names. Reading verifies sizes first, then a digest over everything, then
whether a simulation can be in such a state.
"""

import contextlib
import dataclasses
import errno
import hashlib
import json
import os
import platform
import secrets
import shutil
import socket
import warnings
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from mpsim.engine.archive import ArrayFile, Arrays, write_arrays
from mpsim.errors import CheckpointError, CheckpointWarning, InputError, OutputError
from mpsim.features import Emitter, FixedDisc, Piston, Polyline
from mpsim.scene import Scene
from mpsim.settings import Settings

FORMAT = 2
"""Version of the format. A file of a newer one is refused, by number; one of format 1 lacks the counts of periods and
virials by component."""

HEADER = "mpsim_checkpoint"
"""Name of the first array, the header. So the name stands at the start of the file, and tells its kind."""

_START = b"PK\x03\x04"
_NAME_AT = 30

MOST_HEADER = 2**26
"""Bytes of the header at most: obstacles and emitters are in it, discs are not."""

KINDS = {kind.__name__: kind for kind in (FixedDisc, Polyline, Emitter, Piston)}

PER_DISC = ("position", "velocity", "radius", "mass", "acceleration", "gravity")


@dataclasses.dataclass(frozen=True)
class Checkpoint:
    """What a file holds.

    Attributes:
        path: of the file that was read (the previous one, if the newest is damaged).
        scene, settings: of the simulation.
        run: plain values that the engine needs to go on, such as the frame and what emitters have done.
        arrays: of the solver.
    """

    path: Path
    scene: Scene
    settings: Settings
    run: dict[str, Any]
    arrays: Arrays


Check = Callable[[Checkpoint], None]
"""Raises ValueError for a checkpoint in which no simulation can have been."""


def place_of(path: str | os.PathLike[str]) -> Path:
    """The file that a path means, absolute, links followed.

    Raises:
        InputError: if it is no path.
    """
    if not isinstance(path, str | os.PathLike) or not os.fspath(path) or "\0" in os.fsdecode(path):
        raise InputError(f"the path of a checkpoint must be a file name; got {path!r}. Give one such as 'run.mpsim'.")
    return Path(os.path.realpath(os.fsdecode(path)))


def checked_place(path: str | os.PathLike[str]) -> Path:
    """`place_of`, if a checkpoint can be written there and nothing else would be lost.

    Raises:
        InputError, OutputError: with the rule and what is there.
    """
    target = place_of(path)
    with _errors_told(target):
        _check_place(target)
    return target


@contextlib.contextmanager
def _errors_told(target: Path) -> Iterator[None]:
    """Turn errors of the system into an OutputError that says what is needed."""
    try:
        yield
    except OutputError:
        raise
    except OSError as error:
        raise OutputError(
            f"the checkpoint {str(target)!r} must be in a folder that can be written to, with room on its disk; "
            f"got {error.strerror or error}. What was there before is untouched. Choose another place, or make room."
        ) from error


def _check_place(target: Path) -> None:
    if not target.parent.is_dir():
        raise OutputError(f"a checkpoint needs a folder that exists; got {str(target)!r}. Make {str(target.parent)!r}.")
    for path in (target, _previous(target)):
        if path.is_dir() or (path.exists() and not path.is_file()):
            raise OutputError(f"a checkpoint must be a file; {str(path)!r} is none. Give the name of a file in it.")
        if path.exists() and not _is_of_our_kind(path):
            raise OutputError(
                f"a checkpoint may replace only a checkpoint; {str(path)!r} is a file of another kind. "
                "Choose another name, or remove it."
            )


def write(path: str | os.PathLike[str], scene: Scene, settings: Settings, run: dict[str, Any], arrays: Arrays) -> Path:
    """Write a checkpoint; the file that was there is kept beside it as <name>.previous.

    Raises:
        OutputError: if the file cannot be written; what was there before is still there.
    """
    target = checked_place(path)
    beside = _beside(target)
    with _errors_told(target), _removed_at_the_end(beside):
        _remove_leftovers(target)
        with beside.open("xb") as file:
            write_arrays(file, _packed(scene, settings, run, arrays))
            file.flush()
            os.fsync(file.fileno())
        _keep_previous(target)
        beside.replace(target)
        _sync(target.parent)  # the renaming itself
    return target


def read(path: str | os.PathLike[str], check: Check) -> Checkpoint:
    """Read and verify a checkpoint; where it is damaged or missing, the one before, with a warning that names both.

    Raises:
        CheckpointError: if there is none, or none that is whole, or it is of a newer version.
    """
    target = place_of(path)
    try:
        return _verified(target, check)
    except _DamagedError as damage:
        previous = _previous(target)
        try:
            found = _verified(previous, check)
        except _DamagedError as older:
            raise CheckpointError(
                f"the checkpoint {str(target)!r} must be a whole file that `save` has written; {damage}. The one "
                f"before, {str(previous)!r}, cannot be used either: {older}. Start anew, or give another path."
            ) from None
        warnings.warn(
            f"the checkpoint {str(target)!r} cannot be used: {damage}. Going on from the one before, "
            f"{str(previous)!r}, at frame {found.run['frame']}. Look after that disk.",
            CheckpointWarning,
            stacklevel=3,
        )
        return found


def digest_of(header: dict[str, Any], arrays: Arrays) -> str:
    """Hex digest over header and arrays, names, dtypes and shapes included."""
    digest = hashlib.blake2b(digest_size=16)
    digest.update(
        json.dumps({name: header[name] for name in sorted(header) if name != "digest"}, sort_keys=True).encode()
    )
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {array.dtype.str} {array.shape}".encode())
        content: Any = array.reshape(-1).view(np.uint8)
        digest.update(content)
    return digest.hexdigest()


def scene_parts(scene: Scene) -> tuple[dict[str, Any], Arrays]:
    """A scene as plain values and arrays, exact to the bit."""
    plain: dict[str, Any] = {
        name: getattr(scene, name)
        for name in ("width", "height", "restitution", "wall_restitution", "boundary", "absorbing")
    }
    arrays = {name: np.asarray(value) for name in PER_DISC if (value := getattr(scene, name)) is not None}
    plain["obstacles"] = [_plain(each) for each in scene.obstacles]
    plain["emitters"] = [_plain(each) for each in scene.emitters]
    plain["piston"] = None if scene.piston is None else _plain(scene.piston)
    if scene.duration is not None:
        plain["duration"] = scene.duration
    return plain, arrays


def scene_from(plain: dict[str, Any], arrays: Arrays) -> Scene:
    """The scene that `scene_parts` took apart."""
    values: dict[str, Any] = {
        **plain,
        **{name: value if value.ndim else value.item() for name, value in arrays.items()},
    }
    values["obstacles"] = [_made(each) for each in plain["obstacles"]]
    values["emitters"] = [_made(each) for each in plain["emitters"]]
    values["piston"] = None if plain["piston"] is None else _made(plain["piston"])
    return Scene(**values)


def _plain(feature: Any) -> list[Any]:
    return [type(feature).__name__, dataclasses.asdict(feature)]


def _made(pair: list[Any]) -> Any:
    kind, fields = pair
    return KINDS[kind](**fields)


class _DamagedError(Exception):
    """A file cannot be used; the text says why."""


def _packed(scene: Scene, settings: Settings, run: dict[str, Any], arrays: Arrays) -> Arrays:
    """All that goes into a file, the header first."""
    plain, parts = scene_parts(scene)
    everything = {f"scene.{name}": value for name, value in parts.items()}
    everything |= {f"solver.{name}": np.ascontiguousarray(value) for name, value in arrays.items()}
    header: dict[str, Any] = {
        "format": FORMAT,
        "versions": {"python": platform.python_version()} | {name: version(name) for name in ("numpy", "numba")},
        "settings": dataclasses.asdict(settings),
        "scene": plain,
        "run": run,
    }
    header = json.loads(json.dumps(header))  # as it will be read
    header["digest"] = digest_of(header, everything)
    return {HEADER: np.frombuffer(json.dumps(header).encode(), np.uint8), **everything}


def _previous(target: Path) -> Path:
    return target.with_name(f"{target.name}.previous")


def _beside(target: Path) -> Path:
    """A name beside the target that no other process or machine uses."""
    return target.with_name(f".{target.name}.{socket.gethostname()}-{os.getpid()}-{secrets.token_hex(4)}.tmp")


@contextlib.contextmanager
def _removed_at_the_end(path: Path) -> Iterator[None]:
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            path.unlink()


def _remove_leftovers(target: Path) -> None:
    """Remove what processes of this machine that were killed while they wrote this checkpoint have left behind."""
    start = f".{target.name}.{socket.gethostname()}-"
    for path in target.parent.iterdir():
        if path.name.startswith(start) and path.name.endswith(".tmp"):
            pid = path.name.removeprefix(start).split("-")[0]
            if pid.isdecimal() and not psutil.pid_exists(int(pid)):
                with contextlib.suppress(OSError):
                    path.unlink()


def _is_of_our_kind(path: Path) -> bool:
    """Whether a file begins as a checkpoint does, damaged or not; an empty one is nobody's loss."""
    try:
        with path.open("rb") as file:
            start = file.read(_NAME_AT + len(HEADER))
    except OSError:
        return False
    return start[:_NAME_AT].startswith(_START) and start[_NAME_AT:].decode("latin-1") == HEADER if start else True


def _keep_previous(target: Path) -> None:
    """Give the present file a second name, so that no moment is without a whole one under its own.

    A damaged one must not push out the one before it.
    """
    try:
        _unpacked(target)
    except _DamagedError:
        return
    except CheckpointError:
        pass  # of a newer version, which is no damage
    second = _beside(target)
    with _removed_at_the_end(second):
        try:
            os.link(target, second)
        except OSError as error:
            if error.errno not in (errno.EPERM, errno.EOPNOTSUPP, errno.ENOSYS, errno.EMLINK):
                raise
            shutil.copyfile(target, second)  # the file system has no hard links
            _sync(second)
        second.replace(_previous(target))


def _sync(path: Path) -> None:
    """Force a file, or the names in a folder, to the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _unpacked(path: Path) -> tuple[dict[str, Any], Arrays]:
    """Header and arrays of a file whose digest is right."""
    try:
        if path.exists() and not path.is_file():
            raise ValueError("it is not a file")
        with path.open("rb") as file:
            archive = ArrayFile(file)
            header = _header_of(archive)
            format_version, said = int(header["format"]), str(header["digest"])
            if format_version > FORMAT:
                raise CheckpointError(
                    f"the checkpoint {str(path)!r} is of format {format_version}; this version of mpsim reads up to "
                    f"{FORMAT}. Use a newer mpsim."
                )
            arrays = {name: archive.read(name) for name in archive.names if name != HEADER}
        found = digest_of(header, arrays)
    except CheckpointError:
        raise
    except FileNotFoundError:
        raise _DamagedError("there is no such file") from None
    except Exception as error:  # what a damaged zip file, array or text can raise has no end
        raise _DamagedError(f"it cannot be read ({type(error).__name__}: {error})") from None
    if found != said:
        raise _DamagedError("its content does not match its digest")
    return header, _of_format_1(arrays) if format_version < FORMAT else arrays


def _of_format_1(arrays: Arrays) -> Arrays:
    """Arrays as format 2 has them: the exact solver counted no virials by component, and counts them from there on."""
    names = ("solver.tally", "solver.seen")
    counts = {name: arrays[name] for name in names if name in arrays and arrays[name].shape in ((5,), (6,))}
    return arrays | {name: np.insert(array, 5, [0.0, 0.0]) for name, array in counts.items()}


def _header_of(archive: ArrayFile) -> dict[str, Any]:
    if HEADER not in archive.names:
        raise ValueError("it is no checkpoint of mpsim")
    text = archive.read(HEADER)
    if text.dtype != np.uint8 or text.ndim != 1 or text.size > MOST_HEADER:
        raise ValueError("its header is no text of reasonable length")
    header = json.loads(text.tobytes())
    if not isinstance(header, dict):
        raise ValueError("its header is no table")
    return header


def _verified(path: Path, check: Check) -> Checkpoint:
    header, arrays = _unpacked(path)
    try:
        parts = _named("scene.", arrays), _named("solver.", arrays)
        if len(parts[0]) + len(parts[1]) != len(arrays) or not parts[0].keys() <= set(PER_DISC):
            raise ValueError(f"it holds arrays that belong to nothing; got {sorted(arrays)}")
        scene = scene_from(header["scene"], parts[0])
        settings = Settings(**header["settings"])
        found = Checkpoint(path, scene, settings, header["run"], parts[1])
        check(found)
    except Exception as error:  # the digest is right, so somebody has made it so; still nothing may break
        raise _DamagedError(f"its content is no state of a simulation ({type(error).__name__}: {error})") from None
    return found


def _named(prefix: str, arrays: Arrays) -> Arrays:
    return {name.removeprefix(prefix): value for name, value in arrays.items() if name.startswith(prefix)}
