"""Text files of frames, compressed by gzip or not: where each frame lies, and the numbers in its lines."""

import codecs
import contextlib
import functools
import gzip
import os
import re
import sys
import warnings
import weakref
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from mpsim.core import untrusted
from mpsim.errors import TrajectoryError, TrajectoryWarning, level_of_caller
from mpsim.output.frames import Frame, Given

LONGEST_LINE = 2**20
"""Bytes of a line at most."""

MOST_BYTES = 2**31
"""Bytes of a frame in a compressed file at most, which may unpack to a thousand times its size."""

LONGEST_NUMBER = 17
"""Digits of the number of a frame, or of the number of its discs, at most."""


class LineError(Exception):
    """The index of a line in its frame, and what is wrong with it, in words that follow the name of the line."""


class Lines:
    """The lines of a file that is scanned for frames.

    Attributes:
        begin: offset of the line that `first` found.
        unended: whether the file ended in the last line, before its newline.
        even: whether that line has as many words as the one before it.
    """

    def __init__(self, file: BinaryIO):
        self._file = file
        self._row = 0
        self.begin: int = 0
        self.unended: bool = False
        self.even: bool = True

    def first(self) -> bytes:
        """The next line that is not blank, or its beginning if it is too long; empty at the end of the file."""
        while (line := self._file.readline(LONGEST_LINE)) and not line.strip():
            pass
        self._row, self.begin = 1, self._file.tell() - len(line)
        self.unended = not line.endswith(b"\n") if line else self.unended
        return line.removeprefix(codecs.BOM_UTF8)

    def next(self, count: int = 1) -> bytes:
        """Read that many lines. Returns the last one.

        Raises:
            EOFError: if the file ends before it.
            LineError: if one is too long.
        """
        line, end = b"", self._row + count
        lines = iter(functools.partial(self._file.readline, LONGEST_LINE), b"")
        for each in islice(lines, min(count, sys.maxsize)):
            if not each.endswith(b"\n"):  # as only the last line of a file may
                self.unended, self.even = True, not line or len(each.split()) == len(line.split())
                if len(each) == LONGEST_LINE:
                    if b"\0" in each:  # as it is where ranks were killed as they wrote
                        raise EOFError
                    raise LineError(self._row, f"must have less than {LONGEST_LINE:,} bytes; it has more.")
            self._row += 1
            line = each
        if self._row < end:
            raise EOFError
        return line


class Scan(NamedTuple):
    """Where each complete frame of a file begins, and where the last one ends.

    Attributes:
        offsets: of the frames, and of the end of the last one.
        lost: bytes of an incomplete frame at the end.
        unended: whether the last line of the last frame is the end of the file, without a newline.
    """

    offsets: list[int]
    lost: int
    unended: bool


Skip = Callable[[Lines, bytes], bool]
"""Skips a frame whose first line is given. Returns whether its last line may lack its newline.

It raises EOFError if the file ends within the frame, LineError if that is no frame.
"""


def scan(path: Path, skip: Skip, known: Sequence[int] = (0,)) -> Scan:
    """Find the frames of a file, which is streamed, not held.

    known: offsets from an earlier scan; that part is not read again.

    Raises:
        TrajectoryError: if it is no such file.
    """
    with _opened(path) as file:
        offsets = [offset for offset in known if offset <= os.fstat(file.fileno()).st_size]
        file.seek(offsets[-1])
        lines = Lines(file)
        try:
            while head := lines.first():
                if not skip(lines, head) and lines.unended:
                    raise EOFError
                offsets.append(file.tell())
        except EOFError:
            return Scan(offsets, file.tell() - offsets[-1], False)
        except LineError as error:
            if lines.unended and len(offsets) > 1:  # cut off in a line that says how the frame goes on
                return Scan(offsets, file.tell() - offsets[-1], False)
            raise _located(error, path, len(offsets) - 1, lines.begin) from None
        except DAMAGED as error:
            raise _damaged(path, len(offsets) - 1, error) from None
    return Scan(offsets, 0, lines.unended and len(offsets) > 1)


def _opened(path: Path) -> contextlib.AbstractContextManager[BinaryIO]:
    """The content of a file, open for reading."""
    file = untrusted.opened(path)
    return _unpacked(file) if _is_compressed(path) else file


def _is_compressed(path: Path) -> bool:
    return path.suffix.lower() == ".gz"


@contextlib.contextmanager
def _unpacked(file: BinaryIO) -> Iterator[BinaryIO]:
    with file, gzip.GzipFile(fileobj=file) as content:
        yield cast(BinaryIO, content)


DAMAGED = EOFError, zlib.error, gzip.BadGzipFile
"""Errors of a compressed file that is damaged or cut off."""


def _damaged(path: Path, index: int, error: Exception) -> TrajectoryError:
    return TrajectoryError(
        f"a trajectory that ends in .gz must be compressed by gzip; frame {index} of {str(path)!r} cannot be read "
        f"({error!s:.120}). If it was copied, copy it again."
    )


def _located(error: LineError, path: Path, index: int, begin: int) -> TrajectoryError:
    """The error in a line of a frame that begins at an offset, with the number of the line in the file."""
    line, words = error.args
    with _opened(path) as file, contextlib.suppress(*DAMAGED):
        while piece := file.read(min(begin, LONGEST_LINE)):
            line += piece.count(b"\n")
            begin -= len(piece)
    return TrajectoryError(f"frame {index} of {str(path)!r}, line {line + 1}, {words}")


class TextReader:
    """Reads frames at their positions in a file.

    Args:
        path: of the file.
        given: what its frames may lack.
    """

    def __init__(self, path: Path, given: Given | None = None):
        self._path = path
        self._given = given or Given()
        self._held = contextlib.ExitStack()
        weakref.finalize(self, self._held.close)
        self._content: BinaryIO | None = None  # of a compressed file, which is not opened anew for each frame
        self._offsets, lost, unended = scan(path, self._skip)
        name = f"the trajectory {str(path)!r}"
        if lost:
            warnings.warn(
                f"{name} ends in the middle of a frame, as after a kill; the last {lost} bytes are not read. Its "
                f"{len(self)} complete frames can be read.",
                TrajectoryWarning,
                stacklevel=level_of_caller(),
            )
        if unended:
            warnings.warn(
                f"{name} ends without the end of a line. Its last frame is read; if its writer was killed, the last "
                "number may be cut short.",
                TrajectoryWarning,
                stacklevel=level_of_caller(),
            )

    def _skip(self, lines: Lines, head: bytes) -> bool:
        """Skip a frame, as `Skip`."""
        raise NotImplementedError

    def _frame(self, where: str, index: int, lines: list[str]) -> Frame:
        """The frame of an index, which consists of these lines, or raises LineError."""
        raise NotImplementedError

    def __len__(self) -> int:
        return len(self._offsets) - 1

    def refresh(self) -> None:
        """Look for frames written since the last call; if the file has been replaced, for all frames."""
        self.close()
        known = [0] if _is_compressed(self._path) else self._offsets
        try:
            self._offsets = scan(self._path, self._skip, known).offsets
        except TrajectoryError:
            self._offsets = scan(self._path, self._skip).offsets

    def number(self, index: int) -> int:
        """The frame of the simulation that is at an index; the index itself if the file does not say."""
        return self.read(index).frame

    def read(self, index: int) -> Frame:
        """One frame.

        Raises:
            TrajectoryError: naming what the file lacks.
        """
        start, end = self._offsets[index : index + 2]
        begin, where = start, f"frame {index} of {str(self._path)!r}"
        try:
            content = self._bytes(start, end)
            begin += len(content) - len(content.lstrip())
            return self._frame(where, index, content.lstrip().decode("utf-8-sig", "replace").split("\n"))
        except DAMAGED as error:
            raise _damaged(self._path, index, error) from None
        except LineError as error:
            raise _located(error, self._path, index, begin) from None

    def _bytes(self, start: int, end: int) -> bytes:
        if not _is_compressed(self._path):
            with _opened(self._path) as file:
                file.seek(start)
                return file.read(end - start)
        if end - start > MOST_BYTES:
            raise LineError(0, f"must begin a frame of at most {MOST_BYTES:,} bytes; it has {end - start:,}.")
        if self._content is None:
            self._content = self._held.enter_context(_opened(self._path))
        self._content.seek(start)
        return self._content.read(end - start)

    def close(self) -> None:
        """Close the file; one that is not compressed is open only while a frame is read."""
        self._content = None
        self._held.close()


def changed(line: str) -> LineError:
    """The error for a frame that is not where it was."""
    return LineError(
        0,
        f"must be where it was when the file was opened; its first line is {line!r:.80} now. The file has been "
        "changed: open it again.",
    )


_FORTRAN = re.compile(r"(\d\.?)[dD]([+-]?\d)")


def table(
    lines: list[str], first: int, columns: Sequence[tuple[str, int]], kinds: Mapping[str, type], says: str
) -> dict[str, NDArray[Any]]:
    """The numbers of some columns, by name, each of shape (N, width).

    Args:
        lines: of the discs.
        first: index in the frame of the first one.
        columns: names and widths of all columns in a line.
        kinds: float or int, of those that are read.
        says: what in the frame names the columns, and a verb, for error texts.

    Raises:
        LineError: for a line with another number of columns, or without a finite number where one must be.
    """
    dtype = np.dtype([(f"{i}", kinds.get(name, "U1"), (width,)) for i, (name, width) in enumerate(columns)])
    found = np.zeros(0, dtype)
    for text in (lines, None):
        rows = [_FORTRAN.sub(r"\1e\2", line) for line in lines] if text is None else text
        try:
            found = np.atleast_1d(np.loadtxt(rows, dtype, comments=None)) if lines else found
            break
        except ValueError as error:
            if text is None:
                raise _wrong(rows, first, columns, kinds, says, str(error)) from None
    if len(found) < len(lines):
        raise _wrong(lines, first, columns, kinds, says, "blank lines")
    values = {name: found[f"{i}"] for i, (name, _) in enumerate(columns) if name in kinds}
    for name, array in values.items():
        infinite = np.flatnonzero(~np.isfinite(array).all(axis=1))
        if len(infinite):
            row = infinite[0]
            raise LineError(first + int(row), f"must hold finite numbers in its column {name}; got {array[row]}.")
    return values


def _wrong(
    rows: list[str], first: int, columns: Sequence[tuple[str, int]], kinds: Mapping[str, type], says: str, error: str
) -> LineError:
    """What is wrong with the first line that is not as it should be; `error` if that is not found."""
    names = [name for name, width in columns for _ in range(width)]
    for line, text in enumerate(rows, first):
        words = text.split()
        if len(words) != len(names):
            return LineError(
                line,
                f"must have {len(names)} columns, as its {says}; got a line with {len(words)}: "
                f"{' '.join(words)!r:.80}. The file is damaged, or another program has written it wrongly.",
            )
    for line, text in enumerate(rows, first):
        for name, word in zip(names, text.split(), strict=True):
            try:
                np.array(kinds.get(name, str)(word), kinds.get(name))
            except (ValueError, OverflowError):
                whole = ", whole ones of at most 64 bits" * (kinds[name] is int)
                return LineError(line, f"must hold numbers in its column {name}{whole}; got {word!r:.80}.")
    return LineError(first, f"and the next ones must be a table of numbers; got this error: {error:.120}.")


def real(text: str, key: str, line: int) -> float:
    """A finite number under a key.

    Raises:
        LineError: if it is none.
    """
    try:
        value = float(_FORTRAN.sub(r"\1e\2", text))
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise LineError(line, f"must hold finite numbers under {key}; got {text!r:.80}.")
    return value
