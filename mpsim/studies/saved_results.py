"""Saved results of a trade-off study: by key, in memory and in a file."""

import json
import os
import time
from pathlib import Path
from typing import Any

from mpsim.core import atomic, untrusted
from mpsim.errors import InputError, OutputError

FORMAT = 3
"""Of the file: results of runs that were divided or counted differently must not be mixed."""

SAVE_EVERY = 1.0
"""Seconds between two writes of the file."""

MOST_BYTES = 2**23
"""Largest size of the file: thousands of runs with all their errors."""


class SavedResults:
    """Results by key, in memory and, if there is a path, in a JSON file that is always complete."""

    def __init__(self, path: str | Path | None, scene: str):
        self._path = None if path is None else checked_path(path)
        self._results: dict[str, Any] = {}
        self._title = {"format": FORMAT, "scene": scene}
        self._plan: str | None = None
        self.reference: str | None = None
        self._open = False
        self._saved = time.monotonic()
        if self._path is not None and self._path.exists():
            self._plan, self.reference, self._results = _loaded(self._path, self._title)

    def open(self, plan: str, reference: str) -> None:
        """Start to save results of a plan and a reference, which must be those of an existing file."""
        if self._plan not in (None, plan):
            raise _other(self._path)
        self._plan, self.reference, self._open = plan, reference, True

    def __contains__(self, key: str) -> bool:
        return key in self._results

    def __getitem__(self, key: str) -> Any:
        return self._results[key]

    def put(self, key: str, value: Any) -> None:
        """Add a result; it is written to the file within SAVE_EVERY seconds, or at the end."""
        self._results[key] = value
        if time.monotonic() - self._saved > SAVE_EVERY:
            self.save()

    def save(self) -> None:
        """Write the file; if the process is killed, the old or the new one remains."""
        self._saved = time.monotonic()
        if self._path is not None and self._open:
            results = {key: value for key, value in self._results.items() if "machine" not in value}
            kept = {"title": self._title, "plan": self._plan, "reference": self.reference, "results": results}
            try:
                atomic.write_text(self._path, json.dumps(kept))
            except OSError as error:
                raise OutputError(
                    f"path must be a file in a folder that can be written to, with room on its disk; got "
                    f"{str(self._path)!r} ({error.strerror or error}). Make room, or give another path."
                ) from error


def checked_path(path: str | os.PathLike[str]) -> Path:
    """A path that can be written, checked before the long work.

    Raises:
        InputError: if it cannot.
    """
    try:
        atomic.check_target(Path(path))
    except (OSError, TypeError, ValueError) as error:  # the last two: no path at all
        raise InputError(
            f"path must be a file in a folder that can be written to; got {path!r} "
            f"({getattr(error, 'strerror', None) or error}). Make the folder, or give another path."
        ) from None
    return Path(path)


def _loaded(path: Path, title: dict[str, Any]) -> tuple[str, str, dict[str, Any]]:
    try:
        kept = untrusted.json_value(path, MOST_BYTES)
        found, plan, reference, results = kept["title"], kept["plan"], kept["reference"], dict(kept["results"])
    except (OSError, ValueError, TypeError, KeyError, RecursionError) as error:
        raise InputError(
            f"path must be a file of an earlier trade-off study, or none yet; {path} cannot be read as one "
            f"({error!s:.200}). Remove it, or give another path."
        ) from None
    if found != title:
        raise _other(path)
    return plan, reference, results


def _other(path: Path | None) -> InputError:
    return InputError(
        f"path must be a file of the same scene and the same lengths of runs; {path} is of others. "
        "Remove it, or give another path."
    )
