"""Figures of the stability map: outcomes of all trials, and how large their errors are."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle
from stability import AXES, FORBIDDEN, MAP, MAP_ROWS, PACKINGS, STEP_FRACTIONS, TOLERANCE, Outcome

from mpsim.output.drawing import STYLE, new_figure, save_figure

LEVELS = (0.0, 0.1, 0.5, 1.0, 2.0, 5.0, 1e300)
"""Borders between colours: an error as a multiple of its tolerance. Up to 1 is correct."""

COLOURS = ("#08306B", "#2171B5", "#6BAED6", "#FEE391", "#FE9929", "#CC4C02")
"""Blues for correct, yellow to brown for degraded: safe for colour-blind readers, and in grey by lightness."""

WORDS = ("correct: to 0.1", "correct: to 0.5", "correct: to 1", "degraded: to 2", "degraded: to 5", "degraded: above 5")

MOST_VALUES = 12
"""Values along an axis that a panel shows: more are divided among several panels."""

WIDTH, ROW, LETTER, TEXT = 7.5, 0.2, 0.08, 9
"""Width of a picture, which is that of a page; height of a row, width of a letter [inch]; size of texts [pt]."""

REFUSED, BAD, NOTHING = "#BBBBBB", "#000000", "#FFFFFF"


def save(outcomes: Sequence[Outcome], folder: Path) -> None:
    """One picture for each axis that was tried, and one of steps and packings."""
    for name in dict.fromkeys(outcome.axis for outcome in outcomes):
        chosen = [outcome for outcome in outcomes if outcome.axis == name]
        with matplotlib.rc_context(fname=STYLE):
            figure = _pairs(chosen) if name == MAP else _along(name, chosen)
            _explain(figure)
            save_figure(figure, folder / f"{name}.png")


def _along(name: str, outcomes: Sequence[Outcome]) -> Figure:
    """Rows of settings against values along the axis, in panels of at most MOST_VALUES, one below the other."""
    values = list(dict.fromkeys(_text(outcome.value) for outcome in outcomes))
    rows = list(dict.fromkeys(outcome.row for outcome in outcomes))
    by_place = {(outcome.row, _text(outcome.value)): outcome for outcome in outcomes}
    count = math.ceil(len(values) / MOST_VALUES)
    wide = math.ceil(len(values) / count)  # of each panel; the last one may have empty columns
    height = ROW * len(rows) + 0.5 + LETTER * max(map(len, values))
    figure = new_figure(WIDTH, 1.0 + count * height)
    panels = _panels(figure, count)
    for panel, first in zip(panels, range(0, len(values), wide), strict=True):
        shown = values[first : first + wide]
        padded = [*shown, *[""] * (wide - len(shown))]
        _cells(panel, [[by_place.get((row, value)) for value in padded] for row in rows])
        panel.set_xticks(range(len(shown)), shown, rotation=90 if max(map(len, values)) > 5 else 0)
        panel.set_yticks(range(len(rows)), rows)
    panels[-1].set_xlabel(AXES[name].title)
    return figure


def _pairs(outcomes: Sequence[Outcome]) -> Figure:
    """A panel for each row of settings: packing against the displacement in a step."""
    figure = new_figure(WIDTH, 1.0 + len(MAP_ROWS) * (ROW * len(PACKINGS) + 0.75))
    by_place = {(outcome.row, *map(float, outcome.value)): outcome for outcome in outcomes}
    panels = _panels(figure, len(MAP_ROWS))
    for panel, row in zip(panels, MAP_ROWS, strict=True):
        down = [[by_place.get((row.label, part, packing)) for part in STEP_FRACTIONS] for packing in PACKINGS[::-1]]
        _cells(panel, down)
        panel.set_xticks(range(len(STEP_FRACTIONS)), map(_text, STEP_FRACTIONS))
        panel.set_yticks(range(len(PACKINGS)), map(_text, reversed(PACKINGS)))
        panel.set(ylabel="packing fraction", title=row.label)
    panels[-1].set_xlabel(AXES["step"].title)
    return figure


def _panels(figure: Figure, count: int) -> list[Axes]:
    """Panels one below the other, with text that is legible at the width of a page."""
    panels = list(figure.subplots(count, 1, squeeze=False).flat)
    for panel in panels:
        panel.tick_params(labelsize=TEXT, length=2)
        for text in (panel.xaxis.label, panel.yaxis.label, panel.title):
            text.set_size(TEXT + 1)
    return panels


def _cells(axes: Axes, table: Sequence[Sequence[Outcome | None]]) -> None:
    """Colour each outcome; mark refused ones by R, warnings by !, forbidden ones by X."""
    levels = np.array([[_excess(outcome) for outcome in row] for row in table])
    norm = BoundaryNorm(LEVELS, len(COLOURS))
    axes.imshow(levels, cmap=ListedColormap(COLOURS), norm=norm, aspect="auto", interpolation="nearest")
    axes.grid(visible=False)
    for y, row in enumerate(table):
        for x, outcome in enumerate(row):
            mark, colour, face = _mark(outcome)
            if face is not None:
                axes.add_patch(Rectangle((x - 0.5, y - 0.5), 1, 1, color=face, linewidth=0))
            axes.text(x, y, mark, ha="center", va="center", color=colour, fontsize=TEXT)


def _mark(outcome: Outcome | None) -> tuple[str, str, str | None]:
    """Text of a cell, its colour, and a background colour if that does not show an error."""
    if outcome is None:
        return "", "black", NOTHING
    if outcome.kind == "refused":
        return "R", "black", REFUSED
    if outcome.kind in FORBIDDEN:
        return "X", "white", BAD
    return ("!" if outcome.told else ""), "black" if _excess(outcome) > 0.5 else "white", None


def _excess(outcome: Outcome | None) -> float:
    """The largest error of an outcome, as a multiple of its tolerance."""
    if outcome is None or not outcome.worst:
        return 0.0
    return min(outcome.errors[outcome.worst] / TOLERANCE[outcome.worst], 1e299)


def _explain(figure: Figure) -> None:
    """Legend and title above the panels."""
    patches = [Patch(color=colour, label=word) for colour, word in zip(COLOURS, WORDS, strict=True)]
    patches += [Patch(color=REFUSED, label="R: refused"), Patch(color=BAD, label="X: forbidden")]
    title = "Largest error, as a multiple of its limit; !: with a warning"
    style = {"fontsize": TEXT, "handlelength": 1.2, "title_fontsize": TEXT + 2}
    figure.legend(handles=patches, loc="outside upper center", ncols=4, title=title, **style)


def _text(value: Any) -> str:
    return value if isinstance(value, str) else f"{value:g}"
