"""Opens files of unknown origin: checks kind and size before it reads the content."""

import errno
import json
import os
import stat
from pathlib import Path
from typing import Any, BinaryIO

from mpsim.core.deferred_signals import interrupts_held_back
from mpsim.core.garbage import garbage_collection_paused

_KINDS = {
    stat.S_IFIFO: "a named pipe",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
}


def opened(path: str | os.PathLike[str]) -> BinaryIO:
    """A regular file, open for reading. Nothing else is read: a pipe would block, a device has no end.

    Raises:
        OSError: if it cannot be opened or is no regular file; its strerror says which.
        ValueError: if no file can have that name.
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
    """All bytes of a regular file, at most `most`.

    Raises:
        OSError: likewise, and if there are more.
        ValueError: if no file can have that name.
    """
    with opened(path) as file:
        size = os.fstat(file.fileno()).st_size
        found = file.read(most + 1) if size <= most else b""
    if max(size, len(found)) > most:
        raise OSError(errno.EFBIG, f"it has {max(size, len(found)):,} bytes, and at most {most:,} are read")
    return found


def text(path: Path, most: int) -> str:
    """The text of a regular UTF-8 file of at most `most` bytes, without the mark that editors may put before it.

    Raises:
        OSError, ValueError: likewise; a UnicodeDecodeError is one of the latter.
    """
    return content(path, most).decode("utf-8-sig")


def json_value(path: Path, most: int) -> Any:
    """The value in a regular JSON file of at most `most` bytes.

    Raises:
        OSError, ValueError, RecursionError: likewise, and if it is no JSON.
    """
    written = text(path, most)
    with garbage_collection_paused():
        return json.loads(written)
