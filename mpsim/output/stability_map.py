"""The stability map as heat maps: where correct, where degraded and by how much, where refused."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.patches import Patch, Rectangle

from mpsim.output.drawing import STYLE, new_figure, save_figure
from mpsim.studies.extremes import AXES, PACKINGS, STEP_FRACTIONS
from mpsim.studies.stability import FORBIDDEN, MAP, MAP_ROWS, TOLERANCE, Outcome

LEVELS = (0.0, 0.1, 0.5, 1.0, 2.0, 5.0, math.inf)
"""Borders between colours: an error as a multiple of its tolerance. Up to 1 is correct."""

COLOURS = ("#08306B", "#2171B5", "#6BAED6", "#FEE391", "#FE9929", "#CC4C02")
"""Blues for correct, yellow to brown for degraded: safe for colour-blind readers, and in grey by lightness."""

WORDS = ("below 0.1", "to 0.5", "to 1", "degraded: to 2", "to 5", "above 5")

REFUSED, BAD, NOTHING = "#BBBBBB", "#000000", "#FFFFFF"


def save(outcomes: Sequence[Outcome], folder: Path) -> list[Path]:
    """One picture for each axis that was tried, and one of steps and packings; returns the files."""
    made = []
    for name in dict.fromkeys(outcome.axis for outcome in outcomes):
        chosen = [outcome for outcome in outcomes if outcome.axis == name]
        path = folder / f"{name}.png"
        with matplotlib.rc_context(fname=STYLE):
            _draw_pairs(chosen, path) if name == MAP else _draw_axis(name, chosen, path)
        made.append(path)
    return made


def _draw_axis(name: str, outcomes: Sequence[Outcome], path: Path) -> None:
    """Rows of settings against values along the axis."""
    values = list(dict.fromkeys(_text(outcome.value) for outcome in outcomes))
    rows = list(dict.fromkeys(outcome.row for outcome in outcomes))
    by_place = {(outcome.row, _text(outcome.value)): outcome for outcome in outcomes}
    figure = new_figure(max(7.5, 3.6 + 0.5 * len(values)), 1.8 + 0.27 * len(rows))
    axes = figure.add_subplot()
    _cells(axes, [[by_place.get((row, value)) for value in values] for row in rows])
    axes.set_xticks(range(len(values)), values, rotation=90 if max(map(len, values)) > 5 else 0)
    axes.set_yticks(range(len(rows)), rows, fontsize=8)
    axes.set(xlabel=AXES[name].title, title=f"{name}: largest error, as a multiple of what counts as correct")
    _legend(figure)
    save_figure(figure, path)


def _draw_pairs(outcomes: Sequence[Outcome], path: Path) -> None:
    """A panel for each row of settings: packing against the displacement in a step."""
    figure = new_figure(11, 8)
    by_place = {(outcome.row, *map(float, outcome.value)): outcome for outcome in outcomes}
    for panel, row in zip(figure.subplots(2, 2).flat, MAP_ROWS, strict=True):
        table = [
            [by_place.get((row.label, part, packing)) for part in STEP_FRACTIONS] for packing in reversed(PACKINGS)
        ]
        _cells(panel, table)
        panel.set_xticks(range(len(STEP_FRACTIONS)), map(_text, STEP_FRACTIONS))
        panel.set_yticks(range(len(PACKINGS)), map(_text, reversed(PACKINGS)))
        panel.set(xlabel=AXES["step"].title, ylabel="packing fraction", title=row.label)
    figure.suptitle("Largest error, as a multiple of what counts as correct; !: with a warning")
    _legend(figure)
    save_figure(figure, path)


def _cells(axes: Any, table: Sequence[Sequence[Outcome | None]]) -> None:
    """Colour each outcome; mark refused ones by R, warnings by !, forbidden ones by X."""
    levels = np.array([[_excess(outcome) for outcome in row] for row in table])
    norm = BoundaryNorm([*LEVELS[:-1], 1e300], len(COLOURS))
    axes.imshow(levels, cmap=ListedColormap(COLOURS), norm=norm, aspect="auto", interpolation="nearest")
    axes.grid(visible=False)
    for y, row in enumerate(table):
        for x, outcome in enumerate(row):
            mark, colour, face = _mark(outcome)
            if face is not None:
                axes.add_patch(Rectangle((x - 0.5, y - 0.5), 1, 1, color=face, linewidth=0))
            if mark:
                axes.text(x, y, mark, ha="center", va="center", color=colour, fontsize=8)


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


def _legend(figure: Any) -> None:
    patches = [Patch(color=colour, label=word) for colour, word in zip(COLOURS, WORDS, strict=True)]
    patches.append(Patch(color=REFUSED, label="R: refused"))
    patches.append(Patch(color=BAD, label="X: forbidden"))
    figure.legend(handles=patches, loc="outside lower center", ncols=8, fontsize=8, handlelength=1.2)


def _text(value: Any) -> str:
    return value if isinstance(value, str) else f"{value:g}"
