"""Writes a file completely or not at all: it has its old or its new content, even after a crash.

The content goes to a draft beside the file. The draft has a random name, where no link can have been planted, and is
created (O_EXCL) without following one (O_NOFOLLOW). It is flushed to the disk and renamed in one step; then the folder
is flushed to the disk. So two processes that write one file at once do not disturb each other: the later one wins.

A replaced file keeps its mode bits; a new one has those that the umask leaves. A symbolic link is refused: writing
through it would overwrite another file, and replacing it would lose the link. So is anything but a regular file, and a
file that may not be written. Files that grow row by row or frame by frame (trajectories, the table of measures) cannot
be written like this: see their modules.
"""

import contextlib
import errno
import os
import re
import secrets
import socket
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import psutil

_DRAFT = re.compile(r"\.mpsim-(\d{1,7})-(.+)-[0-9a-f]{32}\.tmp(\..*)?")
"""Names of drafts: the process and the machine that write them, and random digits."""

_LONGEST_ENDING = 16
"""Largest length of a file's ending that its draft keeps: libraries that write by name choose the format by it."""


class WrittenError(OSError):
    """A file has its new content and its name, but something after that has failed: the error's strerror says what."""


@contextlib.contextmanager
def atomic_write(path: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """A new file, open for writing, that is renamed to `path` at the end of the block, unless the block raises.

    Its attribute `name` is the path of the draft, for libraries that write by name; it has the ending of `path`.

    Raises:
        OSError: from `check_target` or the system.

    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with atomic_write(f"{folder}/a.txt") as file:
    ...         before, _ = os.listdir(folder), file.write(b"whole")
    ...     len(before), os.listdir(folder), Path(folder, "a.txt").read_text()
    (1, ['a.txt'], 'whole')
    """
    target = Path(path)
    mode = check_target(target)

    def opened(name: str, flags: int) -> int:
        return os.open(name, flags | os.O_NOFOLLOW, 0o666 if mode is None else mode)

    with draft_of(target) as draft, open(draft, "xb", opener=opened) as file:
        if mode is not None:
            os.fchmod(file.fileno(), mode)  # restores what the umask has removed
        yield file
        file.flush()
        os.fsync(file.fileno())


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write a UTF-8 text file by `atomic_write`."""
    write_bytes(path, text.encode())


def write_bytes(path: str | os.PathLike[str], content: bytes) -> None:
    """Write a file by `atomic_write`."""
    with atomic_write(path) as file:
        file.write(content)


@contextlib.contextmanager
def draft_of(path: Path) -> Iterator[Path]:
    """A random name beside `path`. The file of that name is renamed to `path` at the end of the block.

    If the block raises, it is removed. So are drafts in the folder that killed processes of this machine have left.
    """
    draft = _draft_for(path)
    try:
        yield draft
        draft.replace(path)
        try:
            _sync_folder(path.parent)
        except OSError as error:
            why = f"it is written, but its folder could not be flushed to the disk ({error.strerror})"
            raise WrittenError(error.errno, why, str(path)) from error
    finally:
        # After the renaming there is no draft, except where both names were links to one file: that renames nothing.
        with contextlib.suppress(OSError):
            draft.unlink()


@contextlib.contextmanager
def scratch_beside(path: Path) -> Iterator[BinaryIO]:
    """A new file of a random name beside `path`, open for writing, that is removed at the end of the block."""
    scratch = _draft_for(path)
    try:
        with open(scratch, "xb") as file:
            yield file
    finally:
        with contextlib.suppress(OSError):
            scratch.unlink()


def _draft_for(path: Path) -> Path:
    """A random name beside `path`, after drafts that killed processes have left there are removed."""
    _remove_leftovers(path.parent)
    who = f"{os.getpid()}-{socket.gethostname()}"
    return path.with_name(f".mpsim-{who}-{secrets.token_hex(16)}.tmp{path.suffix[:_LONGEST_ENDING]}")


def check_target(path: Path) -> int | None:
    """Check that a file can be written at a path: before long work, or right before writing.

    Returns:
        Mode bits of the existing file; None if there is none.

    Raises:
        OSError: if its folder is missing or cannot be written to; if the path is a symbolic link, no regular file,
            write-protected, or mounted.
    """
    if not path.parent.is_dir():
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(path.parent))
    if not os.access(path.parent, os.W_OK | os.X_OK):
        raise PermissionError(errno.EACCES, "its folder cannot be written to", str(path))
    try:
        mode = path.lstat().st_mode
    except FileNotFoundError:
        return None
    if stat.S_ISLNK(mode):
        raise OSError(errno.ELOOP, "it is a symbolic link, which is not followed", str(path))
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(mode):
        raise OSError(errno.EINVAL, "it is not a regular file", str(path))
    if not os.access(path, os.W_OK):
        raise PermissionError(errno.EACCES, "it is protected from writing", str(path))
    if _is_mounted(path):
        raise OSError(
            errno.EBUSY, "it is a mounted file, which cannot be replaced: mount its folder instead", str(path)
        )
    return mode & 0o777


def _is_mounted(path: Path) -> bool:
    """Whether a file is itself a mount, as by `docker run -v FILE:FILE`."""
    with contextlib.suppress(OSError):  # without /proc nobody knows; the renaming fails then
        return os.path.realpath(path) in {each.mountpoint for each in psutil.disk_partitions(all=True)}
    return False


def _remove_leftovers(folder: Path) -> None:
    """Remove the drafts of processes of this machine that have ended."""
    with contextlib.suppress(OSError):  # a folder may be writable but not readable
        for name in os.listdir(folder):
            found = _DRAFT.fullmatch(name)
            if found and found[2] == socket.gethostname() and not psutil.pid_exists(int(found[1])):
                with contextlib.suppress(OSError):
                    (folder / name).unlink()


def _sync_folder(folder: Path) -> None:
    """Flush the names in a folder to the disk, if the folder is readable and its file system can do that."""
    try:
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    except PermissionError:
        return
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.EOPNOTSUPP):
            raise
    finally:
        os.close(descriptor)
