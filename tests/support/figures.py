"""The table of what the physics tests found, as Markdown: the figures of the docs are those that were asserted."""

import shlex
import subprocess
import sys
from collections.abc import Iterable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path


@dataclass
class Figures:
    """Rows gathered by tests: `figures.note("B1", "exact", "force on a wall", 5.641119, "5.63992(189)")`."""

    rows: list[tuple[str, ...]] = field(default_factory=list)

    def note(self, check: str, solver: str, quantity: str, expected: object, found: object, control: str = "") -> None:
        """Add a row. `control`: what must fail, and how it did."""
        self.rows.append(tuple(str(cell) for cell in (check, solver, quantity, expected, found, control)))

    def write(self, path: Path) -> None:
        """Write all rows, sorted by check, with date, commit and command."""
        lines = [
            "| check | solver | quantity | expected | found | negative control (must fail) |",
            "|---|---|---|---|---|---|",
        ]
        lines += [f"| {' | '.join(row)} |" for row in together(sorted(self.rows, key=_order))]
        git = ["git", "describe", "--always", "--dirty"]
        commit = subprocess.run(git, capture_output=True, text=True, check=False).stdout.strip()
        command = f"python -m pytest {shlex.join(sys.argv[1:])}"
        lines += ["", f"{datetime.now(UTC):%Y-%m-%d}, commit {commit}, `{command}`."]
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("\n".join(lines) + "\n")


def together(rows: Iterable[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """Rows that differ in solver or quantity alone become one: whatever was tried came to the same.

    >>> together([("R8", "grid", "SIGTERM", "1", "1", ""), ("R8", "event", "SIGTERM", "1", "1", "")])
    [('R8', 'grid; event', 'SIGTERM', '1', '1', '')]
    """
    rows = list(rows)
    for place in (1, 2):
        groups: dict[tuple[str, ...], list[str]] = {}
        for row in rows:
            groups.setdefault((*row[:place], *row[place + 1 :]), []).append(row[place])
        rows = [(*key[:place], _joined(cells), *key[place:]) for key, cells in groups.items()]
    return rows


def _joined(cells: list[str]) -> str:
    """Cells in one; what all begin with, up to ": ", once."""
    first, colon, _ = cells[0].partition(": ")
    if len(cells) > 1 and colon and all(each.startswith(first + colon) for each in cells):
        return first + colon + "; ".join(each.removeprefix(first + colon) for each in cells)
    return "; ".join(dict.fromkeys(cells))


def _order(row: tuple[str, ...]) -> tuple[str, int]:
    """Sort key of a row: A2 before A10."""
    check = row[0]
    digits = "".join(c for c in check if c.isdigit())
    return check[:1], int(digits or 0)
