"""Tables of text: of a trade-off study, and of a report for a notebook."""

import html
import io
import math
import shutil
import textwrap

import numpy as np
from rich.cells import cell_len
from rich.console import Console
from rich.table import Table
from rich.text import Text as Words

from mpsim.core.text import with_error
from mpsim.engine.report import Report
from mpsim.engine.solvers.methods import METHODS
from mpsim.kernels.records import PHASES
from mpsim.measure.registry import ERRORS, OBSERVABLES
from mpsim.measure.statistics import FEWEST_BLOCKS, Measure
from mpsim.studies import deviations
from mpsim.studies.deviations import FEW_RUNS, RESOLVED, Deviation
from mpsim.studies.tradeoff import Row, Tradeoff

# --- Trade-off studies

UNITS = {name: OBSERVABLES[name].unit for name in ERRORS if OBSERVABLES[name].unit != "%"}
"""Units of errors; those of all others are per cent."""

WIDTH = 220  # columns of the page where there is no terminal
FRAME = 3  # characters that a column of a table takes beside its text: a line and two spaces


def header(table: Tradeoff) -> list[str]:
    """Headers of the columns."""
    errors = [f"{name.replace('_', ' ')} [{UNITS.get(name, '%')}]" for name in table.measures]
    return ["settings", "ns / (disc time)", "ran", "bytes per disc", *errors]


def cells(row: Row, measures: tuple[str, ...]) -> list[str]:
    """One row in words: errors with their standard errors in brackets, `<` if they are not resolved."""
    if row.cost is None:
        return [row.label, f"failed: {row.failure}"]
    ran = f"{row.cost.method} x{row.cost.workers}"
    errors = [error_text(name, row.errors[name]) for name in measures]
    spread = (row.cost.high - row.cost.low) / 2  # half the distance of the quartiles
    cost = with_error(row.cost.median, spread) if spread > 0 else f"{row.cost.median:.3g}"
    return [row.label, cost, ran, f"{row.cost.memory:.0f}", *errors]


def error_text(name: str, error: Deviation) -> str:
    """An error such as "-1.92(6)"; "< 0.12" if it is not resolved, "n/m" if it is not measurable."""
    scale = 1.0 if name in UNITS else 100.0
    if not error.measurable:
        return "n/m"
    if not error.resolved and 0 < error.bound < math.inf:
        return f"< {scale * error.bound:.2g}"
    if error.exact:
        return "0"
    return with_error(scale * error.value, scale * error.error)


def measure_text(name: str, measure: Measure) -> str:
    """A measure in words such as "2.240(16)"; if its error is not known, the words say why."""
    if math.isnan(measure.error):
        return f"{measure.value:.6g} ({_why_no_error(name, measure)})"
    if measure.settled:
        return repr(measure)
    bound = "at most" if measure.upper else "at least"
    return f"{measure!r} (error {bound} {measure.error:.2g}, not settled: run longer or start later)"


def _why_no_error(name: str, measure: Measure) -> str:
    what = OBSERVABLES[name]
    if what.drift or what.error == "largest":
        return "one number per run, without an error"
    if what.error == "depth" and not measure.samples:
        return "no overlaps"
    return "too few samples for an error" if measure.samples < FEWEST_BLOCKS else "error unknown"


def terminal_table(table: Tradeoff, width: int | None = None) -> str:
    """The table with lines; if it is wider than the terminal, it is split into parts, each with the settings."""
    width = shutil.get_terminal_size((WIDTH, 24)).columns if width is None else width
    heads, rows = header(table), [cells(row, table.measures) for row in table.rows]
    rows = [line if len(line) == len(heads) else [line[0], "failed", *[""] * (len(heads) - 2)] for line in rows]
    columns = [[head, *column] for head, *column in zip(heads, *rows, strict=True)]
    widths = [max([*map(cell_len, column[1:]), *map(len, column[0].split())]) for column in columns]
    parts = [
        _grid([columns[index] for index in part], [widths[index] for index in part]) for part in _parts(widths, width)
    ]
    console = Console(width=max(width, 2 * max(widths) + 9), record=True, file=io.StringIO())
    lines = textwrap.wrap(title(table), max(width, 20))
    for part in parts:
        console.print(part)
    lines += [line.rstrip() for line in console.export_text(styles=False).splitlines()]
    for text in [f"{row.label} failed: {row.failure}" for row in table.rows if row.cost is None] + reasons(table):
        lines += textwrap.wrap(text, max(width, 20))
    return "\n".join(lines)


def reasons(table: Tradeoff) -> list[str]:
    """Why some errors are not measurable, one line for each reason."""
    found = {(name, error.reason): None for row in table.rows for name, error in row.errors.items() if error.reason}
    return [f"n/m, {name.replace('_', ' ')}: {reason}" for name, reason in found]


def title(table: Tradeoff) -> str:
    """The scene, the reference, the length of the runs, and the meaning of the signs."""
    errors = [error for row in table.rows for error in row.errors.values()]
    freedom = min((each.freedom for each in errors if each.measurable), default=math.inf)
    few = f", or {deviations.t_from_z(RESOLVED, freedom):.3g} with so few runs" if freedom + 1 < FEW_RUNS else ""
    return (
        f"{table.scene}; errors against {table.reference}; "
        f"averages over {table.starts}; runs of {table.until:.3g}, short ones of "
        f"{table.short:.3g}; <: not resolved, below {RESOLVED:g} standard errors{few}; n/m: not measurable"
    )


def _parts(widths: list[int], width: int) -> list[list[int]]:
    """Columns of each part, of which column 0 is always the first."""
    parts, used = [[0]], widths[0] + FRAME + 1
    for index, each in enumerate(widths[1:], start=1):
        if used + each + FRAME > width and len(parts[-1]) > 1:
            parts.append([0])
            used = widths[0] + FRAME + 1
        parts[-1].append(index)
        used += each + FRAME
    return parts


def _grid(columns: list[list[str]], widths: list[int]) -> Table:
    """One part. Texts are no markup: a unit in brackets is not a style."""
    grid = Table()
    for (head, *_), width in zip(columns, widths, strict=True):
        left = head in ("settings", "ran")
        grid.add_column(Words("\n".join(textwrap.wrap(head, width))), justify="left" if left else "right", no_wrap=True)
    for line in zip(*(column[1:] for column in columns), strict=True):
        grid.add_row(*map(Words, line))
    return grid


# --- Reports, for a notebook


def phases_of(report: Report) -> dict[str, str]:
    """The phases that took any time, and their names for this method."""
    words = METHODS[report.method].phases
    return {name: words.get(name, name) for name in PHASES if report.phase_seconds[name].any()}


def report_html(report: Report) -> str:
    """A report as a table: what ran, and the time of a frame and of its phases."""
    rows = [("method", f"{report.method}, {report.workers} worker{'s' * (report.workers > 1)}")]
    rows += [("frames", f"{report.frames:,}"), ("collisions", f"{report.collisions:,}")]
    if report.frames:
        low, median, high = np.quantile(report.frame_seconds, [0.05, 0.5, 0.95]) * 1e6
        rows.append(("time of a frame", f"median {median:.3g} µs (5 % to 95 %: {low:.3g} to {high:.3g} µs)"))
        seconds = {word: float(report.phase_seconds[name].sum()) for name, word in phases_of(report).items()}
        shares = [f"{word} {100 * part / sum(seconds.values()):.0f} %" for word, part in seconds.items()]
        rows.append(("phases", ", ".join(shares)))
    if report.compile_seconds:
        rows.append(("compiling before", f"{report.compile_seconds:.1f} s"))
    rows += [(name, measure_text(name, measure)) for name, measure in report.measures.items()]
    lines = [f"<tr><th>{html.escape(name)}</th><td>{html.escape(value)}</td></tr>" for name, value in rows]
    return f"<table><caption>report.plot() draws it</caption><tbody>{''.join(lines)}</tbody></table>"
