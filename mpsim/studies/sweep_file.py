"""The file of a sweep: a header, and one line of JSON for each finished run.

A line is written by one system call when its run is done. So Ctrl-C leaves complete lines, and a kill leaves at most
one incomplete line, which the next sweep removes with a warning. Only one sweep at a time may use the file.
"""

import json
import os
import warnings
from pathlib import Path
from typing import Any

from mpsim.core import untrusted
from mpsim.core.file_lock import FileLock
from mpsim.errors import InputError, OutputError, SweepWarning, level_of_caller, reason_of
from mpsim.studies.saved_results import checked_path
from mpsim.studies.sweep_points import Point, text_of

FORMAT = "mpsim sweep 1"

MOST_BYTES = 2**32
"""Largest size of a file: some ten million runs."""

_BEGIN = '{"format": "mpsim sweep '
"""With this every file begins: text that does not is no sweep, and is left alone."""

Key = tuple[str, int]


class SweepFile:
    """The finished runs of a sweep, in memory and, if there is a path, in a file.

    Args:
        path: of the file, or None.
        title: of what the runs are: "function", "parameters", "seeded" and further facts, plain values.
        source: digest of the source of the function; if the file has another one, a warning is raised.

    Raises:
        InputError: if the file is one of another sweep, is damaged, cannot be written to, or is in use.
    """

    def __init__(self, path: str | os.PathLike[str] | None, title: dict[str, Any], source: str | None):
        self._results: dict[Key, dict[str, Any]] = {}
        self._path: Path | None = None
        self._descriptor = -1
        if path is not None:
            self._open(checked_path(path), title, source)

    def __enter__(self) -> "SweepFile":
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def get(self, point: Point) -> dict[str, Any] | None:
        """The outcome of a run, as `run_point` gives it; None if it is not there."""
        return self._results.get(point.key)

    def put(self, point: Point, outcome: dict[str, Any]) -> None:
        """Add the outcome of a run, in the file as well.

        Raises:
            OutputError: if it cannot be written; the file is as it was before.
        """
        self._results[point.key] = outcome
        if self._path is not None:
            kept = {name: value for name, value in outcome.items() if name != "wrong"}
            self._append({"point": point.plain, "run": point.run, "seed": point.seed, **kept})

    def close(self) -> None:
        """Hand the file to the disk, and to the next sweep."""
        if self._descriptor >= 0:
            descriptor, self._descriptor = self._descriptor, -1
            try:
                os.fsync(descriptor)
            finally:
                os.close(descriptor)
                self._lock.release()

    def _open(self, path: Path, title: dict[str, Any], source: str | None) -> None:
        flags = os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW | os.O_CLOEXEC
        try:
            self._descriptor = os.open(path, flags, 0o666)
            self._lock = FileLock(path)
        except OutputError:
            os.close(self._descriptor)
            raise InputError(
                f"path must be a file that no other sweep has; {path} is being written by another one, of this process "
                "or another. Wait for its end, or give another path."
            ) from None
        except OSError as error:
            raise InputError(
                f"path must be a file that can be written to; got {str(path)!r} ({error.strerror}). Give another path."
            ) from None
        self._path = path
        try:
            whole = self._read(path, title, source)
            os.ftruncate(self._descriptor, whole)
            if not whole:
                self._append({"format": FORMAT, **title, "source": source})
        except BaseException:
            self.close()
            raise

    def _read(self, path: Path, title: dict[str, Any], source: str | None) -> int:
        """Take what is there; returns the length of its whole lines, in bytes."""
        try:
            content = untrusted.content(path, MOST_BYTES)
        except (OSError, ValueError) as error:
            raise _unreadable(path, reason_of(error)) from None
        if content and not (content.startswith(_BEGIN.encode()) or _BEGIN.encode().startswith(content)):
            raise _unreadable(path, f"it does not begin with {_BEGIN}")
        whole, _, torn = content.rpartition(b"\n")
        if torn:
            warnings.warn(
                f"the last line of {path} was cut off, as by a kill, and is dropped: its run is repeated.",
                SweepWarning,
                stacklevel=level_of_caller(),
            )
        if not whole:
            return 0
        first, *lines = whole.split(b"\n")
        head = _value(path, 1, first)
        _demand_same(path, head, title)
        if not lines:
            return 0  # the head is written anew, for a function that was put right before any run was done
        _warn_if_changed(path, head, title, source)
        for number, line in enumerate(lines, start=2):
            self._take(path, number, _value(path, number, line))
        return len(whole) + 1

    def _take(self, path: Path, number: int, row: dict[str, Any]) -> None:
        try:
            key = text_of(dict(row["point"])), int(row["run"])
            seconds, versions = float(row["seconds"]), dict(row["versions"])
            outcome: dict[str, Any] = {"seconds": seconds, "versions": versions}
            if "failure" in row:
                outcome |= {"failure": str(row["failure"]), "traceback": str(row["traceback"])}
            else:
                outcome["values"] = dict(row["values"])
        except (KeyError, TypeError, ValueError) as error:
            raise _unreadable(path, f"line {number} is not a row: {type(error).__name__} {error}") from None
        self._results[key] = outcome

    def _append(self, line: dict[str, Any]) -> None:
        content = (json.dumps(line) + "\n").encode()
        before = os.fstat(self._descriptor).st_size
        try:
            written = 0
            while written < len(content):
                written += os.write(self._descriptor, content[written:])
        except OSError as error:
            os.ftruncate(self._descriptor, before)
            raise OutputError(
                f"the file of a sweep must have room on its disk; {self._path} cannot be written ({error.strerror}). "
                "Make room and call again: the runs that it holds are not repeated."
            ) from error


def _value(path: Path, number: int, line: bytes) -> dict[str, Any]:
    try:
        value = json.loads(line)
        if not isinstance(value, dict):
            raise ValueError("it is not a JSON object")
    except (ValueError, RecursionError) as error:
        raise _unreadable(path, f"line {number}: {error}") from None
    return value  # pyright: ignore[reportUnknownVariableType]


def _demand_same(path: Path, head: dict[str, Any], title: dict[str, Any]) -> None:
    """Refuse the file of another sweep, by the first fact in which it differs."""
    for name, wanted in {"format": FORMAT, **title}.items():
        found = head.get(name)
        if found != json.loads(json.dumps(wanted)):
            raise InputError(
                f"path must be a file of the same sweep, or none yet; {path} has {_words(name, found)}, and this sweep "
                f"{_words(name, wanted)}. Give another path, or remove the file."
            )


def _warn_if_changed(path: Path, head: dict[str, Any], title: dict[str, Any], source: str | None) -> None:
    """Warn of rows that may be those of another function of the same name."""
    if source is not None and head.get("source") not in (None, source):
        warnings.warn(
            f"the source of {title['function']} has changed since {path} was begun: its rows come from the earlier "
            "version. Remove the file, or give another path, to run them again.",
            SweepWarning,
            stacklevel=level_of_caller(),
        )


def _words(name: str, value: Any) -> str:
    return f"{name} {json.dumps(value, ensure_ascii=False):.200}"


def _unreadable(path: Path, reason: str) -> InputError:
    return InputError(
        f"path must be a file of an earlier sweep, or none yet; {path} cannot be read as one ({reason:.200}). Give "
        "another path, or remove the file."
    )
