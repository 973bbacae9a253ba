"""Scenes and reports in a notebook: a small picture and small tables."""

import html
import io
import math

import matplotlib
import numpy as np
from PIL import Image

from mpsim.engine.report import Report
from mpsim.output.drawing import MOST_DISCS, STYLE, draw_discs, new_figure, speeds_of
from mpsim.output.figures import phases_of
from mpsim.output.frontier import cost_text, error_text, measure_text, unresolved_text
from mpsim.scene.scene import Scene
from mpsim.studies.tradeoff import label
from mpsim.studies.tune import Tuned

INCHES = 3.2  # longer side of a still
COLOURS = 48  # colours of a still: more hardly show, and fewer make it small


def scene_png(scene: Scene) -> bytes:
    """A scene as a PNG of less than 100 kB, coloured by speed; of very many discs, only some are drawn."""
    step = max(math.ceil(scene.count / MOST_DISCS), 1)
    speeds = speeds_of(scene.velocity[::step])
    with matplotlib.rc_context(fname=STYLE):
        longer = max(scene.width, scene.height)
        figure = new_figure(max(INCHES * scene.width / longer, 1), max(INCHES * scene.height / longer, 0.6) + 0.3)
        axes = figure.add_subplot()
        discs = draw_discs(axes, scene.position[::step], scene, radii=scene.radii[::step])
        discs.set_array(speeds)
        discs.set_cmap("viridis")
        if step > 1 or len(speeds) > 5000:
            discs.set_linewidth(0)
        words = f"{scene.count:,} discs" if step == 1 else f"{len(speeds):,} of {scene.count:,} discs"
        axes.set_title(f"{words}, packing {scene.packing:.3g}", fontsize=9)
        file = io.BytesIO()
        figure.savefig(file, dpi=90, format="png")
    small = io.BytesIO()
    with Image.open(file) as picture:
        picture.convert("RGB").quantize(COLOURS).save(small, format="PNG", optimize=True)
    return small.getvalue()


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
    return table(rows, "report.plot() draws it")


def tuned_html(tuned: Tuned) -> str:
    """The answer of `tune` as a table: the settings, their cost, and each error beside its budget."""
    rows = [("settings", label(tuned.settings)), ("cost", f"{cost_text(tuned.cost)} ns per disc and unit of time")]
    rows += [
        (name.replace("_", " "), f"{error_text(name, tuned.errors[name])}, budget {budget:g}")
        for name, budget in tuned.budgets.items()
    ]
    rows += [("claim", "exact" if tuned.exact else "verified with new runs"), ("averages over", tuned.starts)]
    rows.append(("tried", f"{len(tuned.tried)} candidates"))
    rows += [("mpsim warns", tuned.warning)] if tuned.warning else []
    unresolved = unresolved_text(tuned.errors.values())
    return table(rows, f"the cheapest settings inside the budgets; errors against {tuned.reference}; <: {unresolved}")


def table(rows: list[tuple[str, str]], caption: str) -> str:
    """Names and values as an HTML table."""
    lines = [f"<tr><th>{html.escape(name)}</th><td>{html.escape(value)}</td></tr>" for name, value in rows]
    return f"<table><caption>{html.escape(caption)}</caption><tbody>{''.join(lines)}</tbody></table>"
