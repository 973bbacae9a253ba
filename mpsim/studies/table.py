"""Tables of studies: as CSV, as JSON and as a DataFrame."""

import csv
import io
import json
from pathlib import Path
from typing import Any, ClassVar

from mpsim.core.files import CSV, JSON, written
from mpsim.core.late import imported
from mpsim.core.text import json_text


class Table:
    """A table of plain values."""

    _what: ClassVar[str]
    """The table in words."""

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns."""
        raise NotImplementedError

    def _heads(self) -> list[str]:
        """The first line of the CSV."""
        return list(self.columns)

    def _records(self) -> list[dict[str, Any]]:
        """The rows by name of a column."""
        raise NotImplementedError

    def _facts(self) -> dict[str, Any]:
        """What holds for all rows."""
        raise NotImplementedError

    def to_csv(self, path: str | Path | None = None) -> str:
        """The table as CSV, one line for each row; also written to `path`, if given.

        The header of a column whose unit is known is "name [unit]". Values that a row does not have are empty.

        Raises:
            InputError: if the path has the ending of another format.
            OutputError: if the file cannot be written.
        """
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(self._heads())
        writer.writerows([record.get(name) for name in self.columns] for record in self._records())
        return written(text.getvalue(), path, self._what, CSV)

    def to_json(self, path: str | Path | None = None) -> str:
        """The attributes of the table as JSON, its rows as plain values; also written to `path`, if given.

        Numbers that are not finite become null.

        Raises:
            InputError: if the path has the ending of another format.
            OutputError: if the file cannot be written.
        """
        return written(json_text({**self._facts(), "rows": self._records()}) + "\n", path, self._what, JSON)

    def to_pandas(self) -> Any:
        """The table as a pandas.DataFrame, one line for each row; its `attrs` hold what `to_json` writes beside rows.

        Raises:
            OutputError: if pandas is not installed.
        """
        pandas = imported("pandas", "a DataFrame", "sweep", "use to_csv or to_json, which need nothing")
        records = self._records()
        frame = pandas.DataFrame({name: [record.get(name) for record in records] for name in self.columns})
        frame.attrs = json.loads(json_text(self._facts()))
        return frame
