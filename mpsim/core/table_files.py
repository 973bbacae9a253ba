"""Writes tables as text (CSV, JSON) or Parquet, each completely or not at all."""

import io
import os
from pathlib import Path
from typing import Any

from mpsim.core import atomic, checks
from mpsim.core.optional_packages import imported
from mpsim.errors import InputError, OutputError

CSV, JSON, TEXT, PARQUET = ".csv", ".json", ".txt", ".parquet"
"""Endings of the files of tables; TEXT may be CSV or JSON."""

StrPath = str | os.PathLike[str]


def written(text: str, path: StrPath | None, table: str, ending: str) -> str:
    """A table as text, also written to `path`, if given.

    Args:
        text: of the table.
        path: of the file; an existing one is replaced.
        table: what it is, such as "the table of a sweep".
        ending: of files of this format.

    Raises:
        InputError: if it is no path, or ends neither so nor in TEXT.
        OutputError: if it cannot be written.
    """
    if path is not None:
        _demand_ending(path, table, ending, TEXT)
        _write(text.encode("utf-8", "backslashreplace"), path, table)  # a lone surrogate, as in names of files
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
        InputError: if it is no path, or has another ending.
        OutputError: if pyarrow is not installed, or the file cannot be written.
    """
    _demand_ending(path, table, PARQUET)
    demand_parquet()
    content = io.BytesIO()
    frame.to_parquet(content, engine="pyarrow", index=False)
    _write(content.getvalue(), path, table)


def _demand_ending(path: object, table: str, *endings: str) -> None:
    """Refuse what is no path, or one without any of these endings, of which the first is suggested."""
    if not isinstance(path, str | os.PathLike):
        raise InputError(f"the path of {table} must be a str or a Path; got {checks.brief(path)}. Use 'table.csv'.")
    target = Path(os.fsdecode(path))
    if target.suffix.lower() not in endings:
        instead = ", or to_parquet" if target.suffix.lower() == PARQUET else ""
        raise InputError(
            f"{table} must be a file that ends in {' or '.join(endings)} here; got {str(target)!r}. "
            f"Use {target.stem + endings[0]!r}{instead}."
        )


def _write(content: bytes, path: StrPath, table: str) -> None:
    try:
        atomic.write_bytes(path, content)
    except OSError as error:
        raise OutputError(
            f"{table} must be a file that can be written; got {os.fspath(path)!r} ({error.strerror or error}). "
            "Choose another place."
        ) from error
