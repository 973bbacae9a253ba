"""Files: written completely or not at all, opened without trust, locked, and tables in them."""

import contextlib
import errno
import fcntl
import os
import re
import secrets
import socket
import stat
import weakref
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import psutil

from mpsim.core import checks
from mpsim.core.deferred_signals import interrupts_held_back
from mpsim.errors import MpsimError, OutputError

# --- Opens files of unknown origin: checks kind and size before it reads the content

_KINDS = {stat.S_IFIFO: "a named pipe", stat.S_IFCHR: "a device", stat.S_IFBLK: "a device", stat.S_IFSOCK: "a socket"}


def opened(path: str | os.PathLike[str]) -> BinaryIO:
    """A regular file, open for reading. Nothing else is read: a pipe would block, a device has no end.

    An OSError says what is wrong, a ValueError that no file can have that name.
    """
    with interrupts_held_back():  # Ctrl-C could leave a descriptor open that has no owner yet
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        try:
            kind = stat.S_IFMT(os.fstat(descriptor).st_mode)
            if kind == stat.S_IFDIR:
                raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
            if kind != stat.S_IFREG:
                raise OSError(errno.EINVAL, f"it is {_KINDS.get(kind, 'something else')}, not a file")
            return os.fdopen(descriptor, "rb")
        except BaseException:
            os.close(descriptor)
            raise


def content(path: str | os.PathLike[str], most: int) -> bytes:
    """All bytes of a regular file, at most `most`; errors as of `opened`, and an OSError if there are more."""
    with opened(path) as file:
        size = os.fstat(file.fileno()).st_size
        found = file.read(size + 1) if size <= most else b""
    if max(size, len(found)) > most:
        raise OSError(errno.EFBIG, f"it has {max(size, len(found)):,} bytes, and at most {most:,} are read")
    return found


def text(path: Path, most: int) -> str:
    """The text of a regular UTF-8 file of at most `most` bytes, without the mark that editors may put before it."""
    return content(path, most).decode("utf-8-sig")


def ending_as(example: str, path: str | os.PathLike[str], what: str) -> Path:
    """The path of a file, which must end as an example does; what: it holds, in words."""
    ending, name = Path(example).suffix, os.fsdecode(path) if isinstance(path, str | os.PathLike) else ""
    if Path(name).suffix != ending:
        raise checks.refusal(f"the path of {what}", f"end in {ending}", checks.brief(path), f"Use {example!r}.")
    return Path(name)


# --- Locks a file, so that it has only one writer in all processes


class FileLock:
    """Keeps other writers from a file or folder until it is released, is collected, or the process ends.

    A lock of the system, by `flock`: it holds among those that ask for it, in this process and in others, hinders no
    reader and leaves nothing behind. Without a file, or on a file system without locks, nothing is locked. Forks of the
    process do not keep the lock: workers of a pool that outlive a killed owner would keep the next one from the file.

    Raises:
        OutputError: if another writer has the file.
    """

    def __init__(self, path: Path):
        self._path = path
        self._close: weakref.finalize[..., FileLock] | None = None
        self.renew()

    def renew(self) -> None:
        """Lock the file that is there now: another may have taken its place."""
        self.release()
        try:
            descriptor = os.open(self._path, os.O_RDONLY | os.O_NONBLOCK)  # a pipe must not wait for its other end
        except OSError:
            return
        self._close = weakref.finalize(self, _unlock, descriptor, os.getpid())
        _locks.add(self)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self.release()
            raise OutputError(
                f"{str(self._path)!r} is being written by another writer, of this process or another. What both write "
                "would be lost. Close that one first, as the end of its `with` block does, or choose another file."
            ) from None
        except OSError:
            self.release()

    def release(self) -> None:
        """Release the file. May be called again."""
        if self._close is not None:
            self._close()


_locks: weakref.WeakSet[FileLock] = weakref.WeakSet()


def _leave_to_owner() -> None:
    """In a fork: close the copies of the descriptors of locks."""
    for lock in list(_locks):
        with contextlib.suppress(OSError):
            lock.release()


os.register_at_fork(after_in_child=_leave_to_owner)


def _unlock(descriptor: int, owner: int) -> None:
    """Unlock a file, though a fork of its owner may still have it open; in such a fork, leave the lock to the owner."""
    if os.getpid() == owner:
        with contextlib.suppress(OSError):  # there was no lock
            fcntl.flock(descriptor, fcntl.LOCK_UN)
    os.close(descriptor)


# --- Writes a file completely or not at all: it has its old or its new content, even after a crash
#
# The content goes to a draft beside the file. The draft has a random name, where no link can have been planted, and is
# created (O_EXCL) without following one (O_NOFOLLOW). It is flushed to the disk and renamed in one step; then the
# folder is flushed to the disk. So two processes that write one file at once do not disturb each other: the later one
# wins.
#
# A replaced file keeps its mode bits; a new one has those that the umask leaves. A symbolic link is refused: writing
# through it would overwrite another file, and replacing it would lose the link. So is anything but a regular file, and
# a file that may not be written. Files that grow row by row or frame by frame (trajectories, the table of measures)
# cannot be written like this: see their modules.

_DRAFT = re.compile(r"\.mpsim-(\d{1,7})-(.+)-[0-9a-f]{32}\.tmp(\..*)?")
"""Names of drafts: the process and the machine that write them, and random digits."""

_LONGEST_ENDING = 16
"""Largest length of a file's ending that its draft keeps: libraries that write by name choose the format by it."""


class WrittenError(OSError):
    """A file has its new content and its name, but something after that has failed: the error's strerror says what."""


@contextlib.contextmanager
def writable(
    what: str,
    path: str | os.PathLike[str],
    rule: str = "be a file that can be written",
    instead: str = "Choose another place.",
) -> Iterator[None]:
    """Turn an error of the system in the block into an OutputError: `what` must `rule`; got the path and the reason.

    A text that UTF-8 cannot express counts as one.
    """
    try:
        yield
    except MpsimError:
        raise
    except (OSError, UnicodeEncodeError) as error:
        got = f"{os.fsdecode(path)!r} ({getattr(error, 'strerror', None) or error})"
        if isinstance(error, WrittenError):
            rule, instead = "be safe on its disk", "Check that disk."
        refused = checks.refusal(what, rule, got, instead, OutputError)
        refused.__notes__ = getattr(error, "__notes__", [])  # on which rank
        raise refused from error


@contextlib.contextmanager
def atomic_write(path: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """A new file, open for writing, that is renamed to `path` at the end of the block, unless the block raises.

    Its attribute `name` is the path of the draft, for libraries that write by name; it has the ending of `path`.
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
    """Write a UTF-8 text file by `atomic_write`; a lone surrogate, as in names of files, is written as its number."""
    with atomic_write(path) as file:
        file.write(text.encode("utf-8", "backslashreplace"))


@contextlib.contextmanager
def draft_of(path: Path) -> Iterator[Path]:
    """A random name beside `path`. The file of that name is renamed to `path` at the end of the block.

    If the block raises, it is removed. So are drafts in the folder that killed processes of this machine have left.
    """
    _remove_leftovers(path.parent)
    who = f"{os.getpid()}-{socket.gethostname()}"
    draft = path.with_name(f".mpsim-{who}-{secrets.token_hex(16)}.tmp{path.suffix[:_LONGEST_ENDING]}")
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


def check_target(path: Path) -> int | None:
    """Check that a file can be written at a path: before long work, or right before writing.

    Returns:
        Mode bits of the existing file; None if there is none.

    Raises:
        OSError: if its folder is missing or cannot be written to; if the path is a symbolic link, no regular file,
            or write-protected.
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
    return mode & 0o777


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


# --- Writes tables as CSV, each completely or not at all


def written(text: str, path: str | os.PathLike[str] | None, table: str) -> str:
    """A table as text, also written to `path`, if given, which ends in .csv or .txt and is replaced.

    table: what it is, such as "a table of times".
    """
    if path is None:
        return text
    if not isinstance(path, str | os.PathLike):
        raise checks.refusal(f"the path of {table}", "be a str or a Path", checks.brief(path), "Use 'table.csv'.")
    target = Path(os.fsdecode(path))
    if target.suffix.lower() not in (".csv", ".txt"):
        rule = "be a file that ends in .csv or .txt here"
        raise checks.refusal(table, rule, repr(str(target)), f"Use {target.stem + '.csv'!r}.")
    with writable(table, target):
        write_text(target, text)
    return text
