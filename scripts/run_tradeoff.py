"""Costs and errors of settings on three scenes: tables and pictures under results/tradeoff/.

python scripts/run_tradeoff.py                    all scenes, some minutes on two cores
python scripts/run_tradeoff.py dense --fresh      one scene, anew
python scripts/run_tradeoff.py --full --docs docs/accuracy.md    longer runs, more of them, and the page renewed

An interrupted call continues where it stopped. Scenes: 200 discs in a square box at packing 0.1, 0.4 and 0.7, kT = 1.
"""

import multiprocessing
import signal
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import harness
import matplotlib
import numpy as np
from harness import exit_code, fill_page, made_by, make_folder, parser_of, progress_bar, say
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from rich.progress import TaskID

import mpsim
from mpsim import Settings, Tradeoff
from mpsim.core.machine import usable_cores
from mpsim.engine.solvers.methods import capabilities_of
from mpsim.output.drawing import STYLE, new_figure, plain_ticks, save_figure
from mpsim.output.tables import UNITS, cells, header, reasons, title
from mpsim.studies.tradeoff import Row

SCENES = {"dilute": (0.1, 160.0), "medium": (0.4, 40.0), "dense": (0.7, 15.0)}
"""Packing fraction, and length of a run [time]."""

REPLICAS = 16

FULL = 2, 4
"""Factors of the number of runs and of their length with --full."""

SHOWN = {
    "frontier-medium-pressure.png": "medium/frontier-pressure.png",
    "overview-dense.png": "dense/overview.png",
    **{f"{name}.md": f"{name}/table.md" for name in SCENES},
}
"""Pictures and tables that docs/accuracy.md shows or links to."""

ASIDE = ("ran", "bytes per disc", "energy drift", "momentum drift")  # columns that a page does without


def markdown_table(table: Tradeoff) -> str:
    """The table for a page of the docs, with the exact solver and what "auto" has chosen."""
    heads = header(table)
    kept = [column for column, head in enumerate(heads) if not head.startswith(ASIDE)]
    rows = []
    for row in table.rows:
        if row.settings.method in ("auto", "event"):
            texts = [" ".join(cell.split()).replace("|", "\\|") for cell in cells(row, table.measures)]
            texts += [""] * (len(heads) - len(texts))
            rows.append([texts[column] for column in kept])
    return "\n".join([harness.table([heads[column] for column in kept], rows), "", title(table), *reasons(table)])


FAMILIES = {
    "impact": ("#0072B2", "o"),
    "impact x2": ("#009E73", "s"),
    "push": ("#D55E00", "^"),
    "event": ("#000000", "*"),
    "reflect": ("#CC79A7", "v"),
    "float32": ("#E69F00", "D"),
}
"""Colour (Okabe and Ito, safe for colour-blind readers) and marker of each family of settings."""

OTHER = ("#56B4E9", "P")
GREY = "#B0B0B0"

ZERO = 0.03  # position of errors of exactly 0, as a fraction of the width: a logarithmic axis has none for them
BAND = 0.06  # fraction of the width, at the left, that is kept for them

COST = "cost [ns per disc and unit of time]"


def family(settings: Settings) -> str:
    """The family in FAMILIES to which settings belong, or their name if they belong to none."""
    if not capabilities_of(settings).has_steps:
        return settings.method
    if settings.precision == "float32":
        return "float32"
    if settings.law == "reflect":
        return "reflect"
    return settings.contact + (f" x{settings.passes}" if settings.passes > 1 else "")


def frontier(table: Tradeoff, measure: str) -> Figure:
    """Cost against one error, both logarithmic, with error bars.

    The Pareto front, settings that no other beats on both cost and accuracy, is coloured and labelled (the number is
    dt); other settings are grey. For an error that is not resolved, an arrow points left from its bound (value and two
    standard errors). Errors of exactly 0 are in the band at the left.
    """
    front = table.frontier(measure)
    with matplotlib.rc_context(fname=STYLE):
        figure = new_figure(8, 6)
        axes = figure.add_subplot()
        draw(axes, table, measure, front)
        axes.set(xlabel=axis_label(measure), ylabel=COST)
        axes.set_title(_title(table), fontsize=10)
        figure.legend(handles=_legend(table.rows), loc="outside lower center", ncols=4, fontsize=9)
        _label_front(axes, front, measure)
    return figure


def overview(table: Tradeoff) -> Figure:
    """All errors of a table as small pictures, each like that of `frontier` but without labels."""
    columns = min(len(table.measures), 3)
    rows = -(-len(table.measures) // columns)
    with matplotlib.rc_context(fname=STYLE):
        figure = new_figure(1 + 3.4 * columns, 1.3 + 2.7 * rows)
        panels = figure.subplots(rows, columns, sharey=True, squeeze=False)
        for panel, measure in zip(panels.flat, table.measures, strict=False):
            draw(panel, table, measure, table.frontier(measure), size=4)
            panel.set_xlabel(axis_label(measure), fontsize=10)
            panel.tick_params(labelsize=9)
        for panel in panels.flat[len(table.measures) :]:
            panel.set_visible(False)
        figure.supylabel(COST, fontsize=11)
        figure.suptitle(_title(table), fontsize=11)
        figure.legend(handles=_legend(table.rows), loc="outside lower center", ncols=4, fontsize=9)
    return figure


def _title(table: Tradeoff) -> str:
    scene = table.scene.strip("<>").removeprefix("Scene: ")
    return f"{scene}\nerrors against {table.reference.split(',')[0]}"


def axis_label(measure: str) -> str:
    """Name and unit of an error."""
    unit = UNITS.get(measure, "%").replace("diam.", "diameters")
    return f"|error|: {measure.replace('_', ' ')} [{unit}]"


def draw(axes: Axes, table: Tradeoff, measure: str, front: Sequence[Row], size: float = 6) -> None:
    """Points, error bars and the front of one error; axes and their limits."""
    axes.set(xscale="log", yscale="log")
    rows = _drawable(table, measure)
    _limits(axes, rows, measure)
    if any(_place(row, measure)[0] == 0 for row in rows):
        _band(axes)
    plain_ticks(axes.yaxis)
    _step_line(axes, front, measure)
    on_front = {id(row) for row in front}
    for row in sorted(rows, key=lambda row: id(row) in on_front):
        colour, marker = FAMILIES.get(family(row.settings), OTHER)
        chosen = id(row) in on_front
        _point(axes, row, measure, (colour if chosen else GREY, marker, size if chosen else 0.8 * size))


def _drawable(table: Tradeoff, measure: str) -> list[Row]:
    """Rows with a place in the picture: those that ran to the end, with an error that is a number."""
    rows = [row for row in table.rows if row.cost is not None and measure in row.errors]
    return [row for row in rows if np.isfinite(row.errors[measure].magnitude)]


def _place(row: Row, measure: str) -> tuple[float, float]:
    """Error (its bound, if it is not resolved) in the unit of the axis, and cost."""
    assert row.cost is not None
    return row.errors[measure].magnitude * _scale(measure), row.cost.median


def _scale(measure: str) -> float:
    return 1.0 if measure in UNITS else 100.0


def _limits(axes: Axes, rows: Sequence[Row], measure: str) -> None:
    """Limits with room for every point, and at the left for the band of those that are exactly 0."""
    places = np.array([_place(row, measure) for row in rows]).reshape(-1, 2)
    errors = places[places[:, 0] > 0, 0]
    low, high = (errors.min(), errors.max()) if len(errors) else (1e-3, 1.0)
    decades = max(np.log10(high / low), 0.5)
    axes.set_xlim(low / 10 ** (0.22 * decades), high * 10 ** (0.1 * decades))
    if len(places):
        decades = max(np.log10(places[:, 1].max() / places[:, 1].min()), 0.3)
        axes.set_ylim(places[:, 1].min() / 10 ** (0.1 * decades), places[:, 1].max() * 10 ** (0.13 * decades))


def _band(axes: Axes) -> None:
    """The place of errors of exactly 0."""
    axes.fill_between([0, BAND], 0, 1, transform=axes.transAxes, color="#F0F0F0", linewidth=0, zorder=0.7)
    axes.text(ZERO, 0.012, "0", transform=axes.transAxes, ha="center", va="bottom", fontsize=9, color="#555555")


def _step_line(axes: Axes, front: Sequence[Row], measure: str) -> None:
    """The least cost for each error: constant until the next setting of the front is needed."""
    if not front:
        return
    left, right = axes.get_xlim()
    places = [_place(row, measure) for row in front]
    line = [(right, places[0][1])]
    for error, cost in places:
        line += [(line[-1][0], cost), (error if error > 0 else left, cost)]
    x, y = zip(*line, strict=True)
    axes.plot(x, y, color="#555555", linewidth=1.2, zorder=1.5)


def _point(axes: Axes, row: Row, measure: str, look: tuple[str, str, float]) -> None:
    """One setting: its marker, its error bars or its arrow."""
    colour, marker, size = look
    assert row.cost is not None
    error, cost = _place(row, measure)
    size = 1.5 * size if marker == "*" else size
    bars = [[max(cost - row.cost.low, 0)], [max(row.cost.high - cost, 0)]]
    style = {"color": colour, "marker": marker, "markersize": size, "elinewidth": 1, "zorder": 3}
    if error == 0:
        style |= {"transform": axes.get_yaxis_transform(), "clip_on": False}
        axes.plot([ZERO], [cost], **{key: value for key, value in style.items() if key != "elinewidth"})
        return
    if row.errors[measure].resolved:
        noise = row.errors[measure].error * _scale(measure)
        axes.errorbar([error], [cost], bars, [[min(noise, 0.9 * error)], [noise]], **style)
        return
    axes.errorbar([error], [cost], bars, **style, markerfacecolor="white")
    arrow = {"arrowstyle": "<|-", "color": colour, "linewidth": 1, "shrinkA": 0, "shrinkB": size / 2}
    axes.annotate("", (error, cost), (-2.6 * size, 0), textcoords="offset points", arrowprops=arrow)


def _legend(rows: Sequence[Row]) -> list[Line2D]:
    names = list(dict.fromkeys(family(row.settings) for row in rows))
    names.sort(key=lambda name: list(FAMILIES).index(name) if name in FAMILIES else len(FAMILIES))
    handles = []
    for name in names:
        colour, marker = FAMILIES.get(name, OTHER)
        handles.append(Line2D([], [], color=colour, marker=marker, linestyle="", label=name))
    handles.append(Line2D([], [], color=GREY, marker="o", linestyle="", label="another is cheaper and more accurate"))
    arrow = {"color": "#555555", "marker": "$\\leftarrow$", "markersize": 9, "linestyle": ""}
    handles.append(Line2D([], [], label="upper bound: not resolved", **arrow))
    handles.append(Line2D([], [], color="#555555", linewidth=1.2, label="least cost"))
    return handles


def _label_front(axes: Axes, front: Sequence[Row], measure: str) -> None:
    """Names beside the points of the front, to the right above the step line."""
    for row in front:
        error, cost = _place(row, measure)
        axes.annotate(
            " ".join([family(row.settings), *[f"{row.settings.dt:.3g}"] * (row.settings.method != "event")]),
            (error or ZERO, cost),
            xycoords=axes.transData if error else axes.get_yaxis_transform(),
            xytext=(8, 6),
            textcoords="offset points",
            fontsize=9,
            color=FAMILIES.get(family(row.settings), OTHER)[0],
            zorder=4,
        )


def main() -> None:
    """Compare, print, draw, and renew the page if asked for."""
    parser = parser_of(__doc__)
    parser.add_argument("scenes", nargs="*", metavar="scene", help=f"{', '.join(SCENES)} (default: all)")
    parser.add_argument("--full", action="store_true", help="longer runs and more of them")
    parser.add_argument("--fresh", action="store_true", help="forget what earlier calls have kept")
    parser.add_argument("--out", type=Path, default=Path("results/tradeoff"), help="default: results/tradeoff")
    parser.add_argument("--docs", type=Path, help="page whose tables and pictures are renewed: docs/accuracy.md")
    options = parser.parse_args()
    if unknown := [name for name in options.scenes if name not in SCENES]:
        parser.error(f"scene must be one of {', '.join(SCENES)}; got {unknown[0]!r}.")
    more, longer = FULL if options.full else (1, 1)
    made = made_by()
    # Processes, whose short runs do not wait for each other's Python as threads would. Ctrl-C is for the one that
    # started them.
    context, leave = multiprocessing.get_context("forkserver"), (signal.SIGINT, signal.SIG_IGN)
    with ProcessPoolExecutor(usable_cores(), context, signal.signal, leave) as pool, progress_bar() as progress:
        for name in options.scenes or SCENES:
            packing, until = SCENES[name]
            folder, task = options.out / name, progress.add_task(name, total=1)
            make_folder(folder)
            kept = folder / ("runs-full.jsonl" if options.full else "runs.jsonl")
            if options.fresh:
                kept.unlink(missing_ok=True)

            def tick(done: int, of: int, what: str, name: str = name, task: TaskID = task) -> None:
                progress.update(task, completed=done, total=of, description=f"{name}: {what}")

            scene = mpsim.Scene.random(count=200, packing=packing, radius=0.5, seed=1)
            how = {"until": until * longer, "replicas": REPLICAS * more, "path": kept}
            table = mpsim.tradeoff(scene, **how, executor=pool, progress=tick)
            (folder / "table.md").write_text(f"{markdown_table(table)}\n\n{made}\n")
            save_figure(frontier(table, "pressure"), folder / "frontier-pressure.png")
            save_figure(overview(table), folder / "overview.png")
            say(f"{name}. {table}")
    if options.docs:
        shown = {name: options.out / source for name, source in SHOWN.items() if (options.out / source).exists()}
        fill_page(options.docs, {"made": made}, shown)


if __name__ == "__main__":
    sys.exit(exit_code(main))
