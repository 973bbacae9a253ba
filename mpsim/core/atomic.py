"""Files that are whole: what was there before, or the new content, whenever the process or the machine dies.

The content goes to a draft beside the file. The draft has a random name, at which nobody can have planted a link, and
is made anew (O_EXCL) without following one (O_NOFOLLOW). It is forced to the disk and takes the name of the file in one
step; then the folder is forced to the disk. So two that write one file at once never meet: the later one counts.

The mode bits are those of the file that is replaced, or else what the umask leaves, as of any new file. A symbolic link
at the name is refused: through it another file would be lost, and replacing the link would lose the link. So is what is
no regular file, and a file that may not be written. What grows row by row or frame by frame (trajectories, the table of
measures) cannot be written like this: see there.
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
"""Names of drafts: the process and the machine that write them, and chance."""

_LONGEST_ENDING = 16
"""Characters of a file's ending that its draft has too: libraries that write by name choose the format by it."""


@contextlib.contextmanager
def atomic_write(path: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """A new file, open for writing, that takes the name `path` at the end of the block, unless that raises.

    Its attribute `name` is the path of the draft, for libraries that write by name; it has the ending of `path`.

    Raises:
        OSError: what `check_target` raises, or the system.

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
            os.fchmod(file.fileno(), mode)  # what the umask has taken away
        yield file
        file.flush()
        os.fsync(file.fileno())


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write a file of UTF-8 text, as `atomic_write` does."""
    with atomic_write(path) as file:
        file.write(text.encode())


@contextlib.contextmanager
def draft_of(path: Path) -> Iterator[Path]:
    """A random name beside `path`. What has it at the end of the block is renamed to `path`, unless the block raises.

    What processes of this machine that were killed have left in the folder is removed.
    """
    _remove_leftovers(path.parent)
    who = f"{os.getpid()}-{socket.gethostname()}"
    draft = path.with_name(f".mpsim-{who}-{secrets.token_hex(16)}.tmp{path.suffix[:_LONGEST_ENDING]}")
    try:
        yield draft
        draft.replace(path)
        _sync_folder(path.parent)
    finally:
        # After the renaming there is none, except where both were names of one file: that renames nothing.
        with contextlib.suppress(OSError):
            draft.unlink()


def check_target(path: Path) -> int | None:
    """Make sure that a file can be written at a path, before long work or right before it is.

    Returns:
        Mode bits of the file that is there; None where there is none.

    Raises:
        OSError: if its folder is missing or cannot be written to; if what is there is a symbolic link, no regular file,
            or protected from writing.
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
        raise OSError(errno.EINVAL, "it is no regular file", str(path))
    if not os.access(path, os.W_OK):
        raise PermissionError(errno.EACCES, "it is protected from writing", str(path))
    return mode & 0o777


def _remove_leftovers(folder: Path) -> None:
    """Remove the drafts of processes of this machine that have ended."""
    with contextlib.suppress(OSError):  # a folder may take new files and not be listed
        for name in os.listdir(folder):
            found = _DRAFT.fullmatch(name)
            if found and found[2] == socket.gethostname() and not psutil.pid_exists(int(found[1])):
                with contextlib.suppress(OSError):
                    (folder / name).unlink()


def _sync_folder(folder: Path) -> None:
    """Force the names in a folder to the disk, where the folder may be read and its file system can do that."""
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
