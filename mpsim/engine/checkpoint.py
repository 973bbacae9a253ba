"""Checkpoints: the complete state of a simulation in one file without executable code.

A checkpoint is a NumPy .npz without pickled objects: one JSON header, and arrays. It is written as every file is (see
mpsim.core.atomic); the one before is kept as <name>.previous. A kill at any moment leaves a whole checkpoint under
<name>. Reading verifies sizes first, then a digest over everything, then whether a simulation can be in such a state.
"""

import contextlib
import dataclasses
import errno
import json
import os
import platform
import shutil
import warnings
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from mpsim.core import atomic, joint_file, untrusted
from mpsim.core.archive import DAMAGE, ArrayFile, Arrays
from mpsim.core.archive_layout import laid_out
from mpsim.core.chunks import Array
from mpsim.core.joint_archive import piece_of, write_around, write_contents
from mpsim.core.joint_file import write_at
from mpsim.core.sizes import of_each_disc
from mpsim.core.team import Alone, Team
from mpsim.engine.checkpoint_digest import digest_of, joined_digest
from mpsim.engine.checkpoint_scene import ARRAYS, scene_from, scene_parts
from mpsim.engine.journal import JOURNAL, UNCHANGED, Changed, changed_in, packed
from mpsim.engine.older_formats import in_this_format
from mpsim.errors import (
    CheckpointError,
    CheckpointWarning,
    InputError,
    OutputError,
    is_of_the_system,
    level_of_caller,
)
from mpsim.features import FEATURES
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings, settings_from

FORMAT = 7
"""Version of the format. A file of a newer one is refused, by number; one of format 1 lacks the image flags and
virials by component, one of format 2 is that of smooth discs, one of format 3 has sizes of each disc even if equal,
one of format 4 no lattice, in one of format 5 the exact solver counts impulses in real numbers, in one of format 6 some
columns have their components first, the digest is over all at once, and nothing has been changed between frames."""

HEADER = "mpsim_checkpoint"
"""Name of the first array, the header. So the name stands at the start of the file, and tells its kind."""

_START = b"PK\x03\x04"
_NAME_AT = 30

MOST_HEADER = 2**26
"""Bytes of the header at most: features of the scene are in it, discs are not."""

DAMAGED_DISK = (errno.EIO, errno.EBADMSG, errno.EUCLEAN)
"""Errors of the system by which a disk, or its checksums, say that the content is lost."""

_NO_STATE = (ValueError, LookupError, TypeError, AttributeError, ArithmeticError, RecursionError)
"""What content raises that is no state of a simulation."""

VERSIONS: dict[str, str] = {"python": platform.python_version(), "numpy": np.__version__, "numba": numba.__version__}
"""Of what runs, whatever is installed when a checkpoint is written."""

SIZES = ("radii", "masses")
"""Arrays of a solver that are written as one number, shape (), where all discs have the same; the header has the number
of discs."""

ALONE: Team = Alone()
"""One process, which writes all of a file."""


@dataclasses.dataclass(frozen=True)
class Checkpoint:
    """What a file holds.

    Attributes:
        path: of the file that was read (the previous one, if the newest is damaged).
        scene, settings: at the start of the simulation.
        run: plain values that the engine needs to continue, such as the frame and what emitters have done.
        arrays: of the solver.
        digest: over all that the file holds.
        changed: what has been changed since the start.
    """

    path: Path
    scene: Scene
    settings: Settings
    run: dict[str, Any]
    arrays: Arrays
    digest: str
    changed: Changed = UNCHANGED


Verified = tuple[Path, str, tuple[int, ...]]
"""A file whose digest is right: its path, that digest, and its `_identity`."""

Check = Callable[[Checkpoint], None]
"""Raises ValueError for a checkpoint in which no simulation can have been."""


def place_of(path: str | os.PathLike[str]) -> Path:
    """The file that a path means, absolute, links followed.

    Raises:
        InputError: if it is no path, or a relative one in a folder that has been removed.
    """
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
    """`place_of`, if a checkpoint can be written there and nothing else would be lost.

    Raises:
        InputError, OutputError: with the rule and what is there.
    """
    target = place_of(path)
    with _as_output_error(target):
        _check_place(target)
    return target


@contextlib.contextmanager
def _as_output_error(target: Path) -> Iterator[None]:
    """Turn errors of the system into an OutputError that says what is needed."""
    try:
        yield
    except OutputError:
        raise
    except OSError as error:
        if isinstance(error, atomic.WrittenError):
            text = f"the checkpoint {str(target)!r} must be safe on its disk; {error.strerror}. Check that disk."
        else:
            text = (
                f"the checkpoint {str(target)!r} must be in a folder that can be written to, with room on its disk; "
                f"got {error.strerror or error}. What was there before is untouched. Choose another place, or make "
                "room."
            )
        failed = OutputError(text)
        failed.__notes__ = getattr(error, "__notes__", [])  # on which rank
        raise failed from error


def _check_place(target: Path) -> None:
    if not target.parent.is_dir():
        raise OutputError(f"a checkpoint needs a folder that exists; got {str(target)!r}. Make {str(target.parent)!r}.")
    for path in (target, _previous(target)):
        if path.is_dir() or (path.exists() and not path.is_file()):
            raise OutputError(f"a checkpoint must be a file; {str(path)!r} is not. Give the name of a file in it.")
        if path.exists() and not _is_of_our_kind(path):
            raise OutputError(
                f"a checkpoint may replace only a checkpoint; {str(path)!r} is a file of another kind. "
                "Choose another name, or remove it."
            )
    atomic.check_target(target)


def write(
    path: str | os.PathLike[str],
    scene: Scene,
    settings: Settings,
    run: dict[str, Any],
    arrays: Mapping[str, Array],
    team: Team = ALONE,
    changed: Changed = UNCHANGED,
) -> Path:
    """Write a checkpoint; the file that was there is kept beside it as <name>.previous.

    Args:
        path, scene, settings, run: as read back; the same in all processes that write.
        arrays: of the solver, which may be read in chunks, by all processes at once.
        team: the processes that write, each its share. The first one makes the file, and renames it when all have
            written and flushed theirs.

    Raises:
        OutputError: if one of them cannot write; on all, and what was there before is still there.
    """
    target = place_of(path)
    header, everything = _packed(scene, settings, run, arrays, changed)
    with _as_output_error(target), contextlib.ExitStack() as replacing:
        file: Any = None  # of the first process

        def begin() -> int:
            nonlocal file
            _check_place(target)
            replacing.enter_context(_kept_as_previous(target))
            file = replacing.enter_context(atomic.atomic_write(target))
            return len(_text_of(header))

        length = team.once(begin)  # others may have other versions of what is named in the header
        top, *members = laid_out({HEADER: np.zeros(length, np.uint8), **everything})
        with joint_file.begun(team, file) as joint:
            pieces = write_contents(joint, team, members, everything)

        def end() -> None:
            digests = {name: [piece.digest for piece in found] for name, found in pieces.items()}
            text = _text_of(header | {"digest": joined_digest(header, everything, digests)})
            write_at(file.fileno(), text, top.begin)
            write_around(file.fileno(), [top, *members], {HEADER: [piece_of(text)], **pieces})
            replacing.close()

        team.once(end)
    return target


def read(path: str | os.PathLike[str], check: Check, mapped: bool = False) -> Checkpoint:
    """Read and verify a checkpoint; where it is damaged or missing, the one before, with a warning that names both.

    mapped: whether arrays stay in the pages of the file.

    Raises:
        CheckpointError: if there is none, or none that is whole, or it is of a newer version, or it cannot be read for
            a reason that is no damage, such as a missing right: the one before is not taken then.
    """
    target = place_of(path)
    try:
        return _verified(target, check, mapped)
    except _DamagedError as damage:
        previous = _previous(target)
        try:
            found = _verified(previous, check, mapped)
        except _DamagedError as older:
            raise CheckpointError(
                f"the checkpoint {str(target)!r} must be a complete file that `save` has written; {damage}. The "
                f"previous one, {str(previous)!r}, cannot be used either: {older}. Start again, or give another path."
            ) from None
        warnings.warn(
            f"the checkpoint {str(target)!r} cannot be used: {damage}. Continuing from the previous one, "
            f"{str(previous)!r}, at frame {found.run['frame']}. Check that disk.",
            CheckpointWarning,
            stacklevel=level_of_caller(),
        )
        return found


def method_of(path: str | os.PathLike[str]) -> str | None:
    """The method that the header of a checkpoint names; None if it cannot be read: then `read` says why."""
    with contextlib.suppress(_DamagedError, CheckpointError, *_NO_STATE):
        own = place_of(path)
        with _damage_reported(own), untrusted.opened(own) as file, ArrayFile(file) as archive:
            return str(_header_of(archive)["settings"]["method"])
    return None


def read_together(
    path: str | os.PathLike[str], check: Check, once: Callable[[Callable[[], Verified]], Verified]
) -> Checkpoint:
    """`read` by processes that share a simulation: the first one verifies the file; none holds its arrays in memory.

    One that has another file there, such as a copy on the disk of its machine, verifies that itself.

    Args:
        path, check: as of `read`.
        once: what an act gives that the first of them does.

    Raises:
        CheckpointError: as `read`, of all; of one that has a damaged file there, another one, or none.
    """

    def verify() -> Verified:
        found = read(path, check, mapped=True)
        return found.path, found.digest, _identity(found.path)

    own, digest, identity = once(verify)
    try:
        found = _made_from(own, *_unpacked(own, mapped=True, verified=identity))
    except _DamagedError as damage:
        raise _differs(own, str(damage)) from None
    if found.digest != digest:
        raise _differs(own, "it is another file")
    return found


def _identity(file: Path | int) -> tuple[int, ...]:
    """What a file has on all machines that share its disk, and no copy of it; the number of the disk differs."""
    found = os.stat(file)
    return found.st_ino, found.st_size, found.st_mtime_ns, found.st_ctime_ns


def _differs(path: Path, how: str) -> CheckpointError:
    return CheckpointError(
        f"the checkpoint {str(path)!r} must be the same file on all ranks; on {platform.node()} {how}. Give all of "
        "them one that they can read."
    )


class _DamagedError(Exception):
    """A file cannot be used; the text says why."""


def _packed(
    scene: Scene, settings: Settings, run: dict[str, Any], arrays: Mapping[str, Array], changed: Changed
) -> tuple[dict[str, Any], dict[str, Array]]:
    """The header of a file, without its digest, and its arrays."""
    plain, parts = scene_parts(scene)
    everything: dict[str, Array] = {f"scene.{name}": value for name, value in parts.items()}
    once = {name: np.asarray(sizes[0]) for name in SIZES if _are_equal(sizes := np.asarray(arrays[name]))}
    everything |= {f"solver.{name}": value for name, value in sorted({**arrays, **once}.items())}
    if changed.changes:
        everything[JOURNAL], run = packed(changed.changes), run | {"origin": list(changed.origin)}
    header: dict[str, Any] = {
        "format": FORMAT,
        "versions": VERSIONS,
        "settings": dataclasses.asdict(settings),
        "scene": plain,
        "run": run,
        "discs": len(arrays["radii"]),
    }
    header = json.loads(json.dumps(header)) | {"digest": "0" * 32}  # as it will be read
    length = len(_text_of(header))
    if length > MOST_HEADER:
        number = {each.argument: len(each.of(scene)) for each in FEATURES if each.kinds and each.several}
        counts = " and ".join(f"{count:,} {name}" for name, count in number.items())
        raise OutputError(
            f"{' and '.join(number)} must take at most {MOST_HEADER:,} bytes of a checkpoint's header, or it could not "
            f"be read again; got {length:,} bytes for {counts}. Use fewer; one Polyline takes the place of many."
        )
    return header, everything


def _text_of(header: dict[str, Any]) -> bytes:
    return json.dumps(header).encode()


def _are_equal(sizes: NDArray[np.float64]) -> bool:
    return len(sizes) > 0 and (sizes.strides == (0,) or bool((sizes == sizes[0]).all()))


def _previous(target: Path) -> Path:
    return target.with_name(f"{target.name}.previous")


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
        with atomic.draft_of(_previous(target)) as second:
            _link(target, second)
            try:
                yield
            except atomic.WrittenError as error:  # the new file has its name already, so the old one gets its own too
                unflushed = error
            is_written = True
    except OSError as error:
        if not is_written or isinstance(error, atomic.WrittenError):
            raise
        why = f"it is written, but the one before it may be lost ({error.strerror})"
        raise atomic.WrittenError(error.errno, why) from error
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


def _unpacked(path: Path, mapped: bool = False, verified: tuple[int, ...] = ()) -> tuple[dict[str, Any], Arrays]:
    """Header and arrays of a file whose digest is right.

    Args:
        path: of the file.
        mapped: whether arrays stay in its pages.
        verified: `_identity` of the file of which the digest is known to be right.
    """
    with _damage_reported(path), untrusted.opened(path) as file, ArrayFile(file) as archive:
        header = _header_of(archive)
        format_version, said = int(header["format"]), str(header["digest"])
        if format_version <= FORMAT:
            take = archive.map if mapped else archive.read
            arrays = {name: take(name) for name in archive.names if name != HEADER}
            if _identity(file.fileno()) != verified and digest_of(header, arrays) != said:
                raise _DamagedError("its content does not match its digest")
            return header, in_this_format(arrays, format_version)
    raise CheckpointError(
        f"the checkpoint {str(path)!r} is of format {format_version}; this version of mpsim reads up to {FORMAT}. Use "
        "a newer mpsim."
    )


def _header_of(archive: ArrayFile) -> dict[str, Any]:
    if HEADER not in archive.names:
        raise ValueError("it is not a checkpoint of mpsim")
    text = archive.read(HEADER)
    if text.dtype != np.uint8 or text.ndim != 1 or text.size > MOST_HEADER:
        raise ValueError("its header is not a text of reasonable length")
    header = json.loads(text.tobytes())
    if not isinstance(header, dict):
        raise ValueError("its header is not a table")
    return header


def _verified(path: Path, check: Check, mapped: bool) -> Checkpoint:
    checkpoint = _made_from(path, *_unpacked(path, mapped))
    with _as_no_state():
        check(checkpoint)
    return checkpoint


@contextlib.contextmanager
def _as_no_state() -> Iterator[None]:
    """Report content that is no state of a simulation as damage."""
    try:
        with np.errstate(all="ignore"):
            yield
    except _NO_STATE as error:  # the digest is right, so somebody has made it so; still nothing may break
        raise _DamagedError(f"its content is not a state of a simulation ({type(error).__name__}: {error})") from None


def _made_from(path: Path, header: dict[str, Any], found: Arrays) -> Checkpoint:
    """A checkpoint from the header and the arrays of its file."""
    with _as_no_state():
        parts = _named("scene.", found), _named("solver.", found)
        if len(parts[0]) + len(parts[1]) + (JOURNAL in found) != len(found) or not parts[0].keys() <= set(ARRAYS):
            raise ValueError(f"it holds arrays that belong to nothing; got {sorted(found)}")
        scene = scene_from(header["scene"], parts[0])
        settings = settings_from(header["settings"])
        arrays = of_each_disc(parts[1], SIZES, header.get("discs"))
        changed = changed_in(header["run"], found[JOURNAL]) if JOURNAL in found else UNCHANGED
        return Checkpoint(path, scene, settings, header["run"], arrays, str(header["digest"]), changed)


def _named(prefix: str, arrays: Arrays) -> Arrays:
    return {name.removeprefix(prefix): value for name, value in arrays.items() if name.startswith(prefix)}
