"""Writes tables as text (CSV, JSON) or Parquet, each completely or not at all."""

import io
import os
from pathlib import Path
from typing import Any

from mpsim.core import atomic, checks
from mpsim.core.errors import InputError, OutputError
from mpsim.core.optional_packages import imported

PARQUET = ".parquet"

StrPath = str | os.PathLike[str]


def written(text: str, path: StrPath | None, table: str) -> str:
    """A table as text, also written to `path`, if given.

    Args:
        text: of the table.
        path: of the file; an existing one is replaced.
        table: what it is, such as "the table of a sweep".

    Raises:
        InputError: if it is no path, or ends as a file of another format does.
        OutputError: if it cannot be written.
    """
    if path is not None:
        if _checked(path, table).suffix == PARQUET:
            raise InputError(f"{table} is text here, and {os.fspath(path)!r} is not a text file. Use to_parquet.")
        _write(text.encode(), path, table)
    return text


def demand_parquet() -> None:
    """Refuse to begin without what writes Parquet.

    Raises:
        OutputError: if pyarrow is not installed.
    """
    imported("pyarrow", "a Parquet file", "sweep", "use to_csv")


def write_parquet(frame: Any, path: StrPath, table: str) -> None:
    """Write a pandas.DataFrame without its index as Parquet.

    Raises:
        InputError: if it is no path.
        OutputError: if pyarrow is not installed, or the file cannot be written.
    """
    _checked(path, table)
    demand_parquet()
    content = io.BytesIO()
    frame.to_parquet(content, engine="pyarrow", index=False)
    _write(content.getvalue(), path, table)


def _checked(path: object, table: str) -> Path:
    if not isinstance(path, str | os.PathLike):
        raise InputError(f"the path of {table} must be a str or a Path; got {checks.brief(path)}. Use 'table.csv'.")
    return Path(os.fsdecode(path))


def _write(content: bytes, path: StrPath, table: str) -> None:
    try:
        atomic.write_bytes(path, content)
    except OSError as error:
        raise OutputError(
            f"{table} must be a file that can be written; got {os.fspath(path)!r} ({error.strerror or error}). "
            "Choose another place."
        ) from error
