"""Makes the pictures of the tutorial and of the explanations.

python scripts/run_docs_figures.py                       under results/docs/
python scripts/run_docs_figures.py --out docs/pictures   as the pages show them
"""

import re
import sys
import tempfile
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from harness import DOCS, make_folder, parser_of
from matplotlib.axes import Axes
from matplotlib.legend_handler import HandlerTuple
from matplotlib.patches import Rectangle

import mpsim
from mpsim.engine.solvers.stepped import Grid, grid_for
from mpsim.output.animation import DPI
from mpsim.output.drawing import STYLE, draw_discs, new_figure
from mpsim.scene.scenefile import load

WORKERS = (("#0072B2", "#7CC4EC"), ("#D55E00", "#F0B84B"))
"""Two shades for each worker, so that brackets beside each other differ."""

AT_REST = "#EEEEEE"
HEAP_TIME = 20.0


def dense_gas() -> tuple[mpsim.Scene, Grid]:
    """A small dense gas, and the cells that mpsim sorts it into."""
    scene = mpsim.Scene.random(count=36, width=9.0, height=5.5, radius=0.5, seed=4)
    return scene, grid_for(scene, scene.count, scene.largest_radius, "float64")


def swatch(colour: str) -> Rectangle:
    """A colour in a legend."""
    return Rectangle((0, 0), 1, 1, color=colour)


def cells(axes: Axes, scene: mpsim.Scene, grid: Grid, columns_only: bool = False) -> None:
    """Lines between cells, and the numbers of the columns below."""
    wide, high = scene.width / grid.columns, scene.height / grid.rows
    for column in range(1, grid.columns):
        axes.axvline(column * wide, color="#999999", linewidth=0.7, zorder=3)
    for row in range(1, 1 if columns_only else grid.rows):
        axes.axhline(row * high, color="#999999", linewidth=0.7, zorder=3)
    for column in range(grid.columns):
        axes.text((column + 0.5) * wide, -0.15, str(column), ha="center", va="top")


def passes(path: Path) -> None:
    """Which columns meet which in each pass, and who does it."""
    scene, grid = dense_gas()
    wide = scene.width / grid.columns
    half = grid.columns // 2
    column_of = np.minimum((scene.position[:, 0] / wide).astype(int), grid.columns - 1)
    figure = new_figure(11, 4.4)
    for panel, first in zip(figure.subplots(1, 2), (0, 1), strict=True):
        colours = np.full(grid.columns, AT_REST, dtype=object)
        brackets = list(range(first, grid.columns, 2))
        for number, column in enumerate(brackets):
            colours[column : column + 2] = WORKERS[column >= half][number % 2]
        draw_discs(panel, scene.position, scene, [colours[column] for column in column_of])
        for column in brackets:
            place = (column * wide, 0), (min(column + 2, grid.columns) - column) * wide, scene.height
            panel.add_patch(Rectangle(*place, color=colours[column], alpha=0.25, zorder=0.5))
            panel.add_patch(Rectangle(*place, fill=False, linewidth=2.2, zorder=4))
        cells(panel, scene, grid, columns_only=True)
        panel.set_title(f"{'odd' if first else 'even'} columns: {', '.join(map(str, brackets))}")
        belongs = f"columns 0 to {half - 1} belong to worker 0, {half} to {grid.columns - 1} to worker 1"
        panel.set_xlabel(belongs, labelpad=18)
    handles: list[Any] = [tuple(map(swatch, shades)) for shades in (*WORKERS, (AT_REST,))]
    words = ["done by worker 0", "done by worker 1", "not touched in this pass"]
    figure.legend(
        handles, words, loc="outside lower center", ncols=3, handler_map={tuple: HandlerTuple(None)}, handlelength=3
    )
    figure.savefig(path)


def neighbours(path: Path) -> None:
    """The cells at which one disc looks."""
    scene, grid = dense_gas()
    wide, high = scene.width / grid.columns, scene.height / grid.rows
    cell = np.minimum((scene.position / (wide, high)).astype(int), (grid.columns - 1, grid.rows - 1))
    middle = np.array([grid.columns // 2 - 1, grid.rows // 2])
    disc = int(abs(cell - middle).sum(axis=1).argmin())
    column, row = cell[disc]
    looked_at = ((0, 0), (0, 1), (1, -1), (1, 0), (1, 1))
    figure = new_figure(6.2, 4.1)
    axes = figure.add_subplot()
    colours = np.full(scene.count, AT_REST, dtype=object)
    looks, seen = WORKERS[1][0], WORKERS[0][1]
    for across, up in looked_at:
        colours[(cell == (column + across, row + up)).all(axis=1)] = seen
    colours[disc] = looks
    draw_discs(axes, scene.position, scene, colours)
    for across, up in looked_at:
        place = ((column + across) * wide, (row + up) * high)
        axes.add_patch(Rectangle(place, wide, high, color=seen, alpha=0.35, linewidth=0, zorder=0.5))
    cells(axes, scene, grid)
    axes.set_title("The orange disc looks at the blue cells")
    axes.set_xlabel("column", labelpad=18)
    figure.savefig(path)


def funnel(path: Path) -> None:
    """The scene that the tutorial's last page writes, as it is after the run there."""
    text = (DOCS / "tutorial" / "5-your-own-scene.md").read_text()
    file, until = re.search(r"```toml\n(.*?)```", text, re.DOTALL), re.search(r"run\(until=([\d.]+)\)", text)
    if not (file and until):
        raise ValueError("the tutorial's last page must hold a scene file and run it until a time")
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder, "funnel.toml")
        source.write_text(file[1])
        found = load(source)
    with mpsim.Simulation(found.scene) as sim:
        sim.run(until=float(until[1]))
        mpsim.draw(sim).savefig(path, dpi=DPI)


def poured(friction: float) -> mpsim.Scene:
    """A column of 200 grains of four sizes, which is let go above a floor of grains that are glued to it."""
    index = np.arange(200)
    row, column = np.divmod(index, 10)
    radius = np.array([0.25, 0.2, 0.225, 0.175])[(index * index // 3) % 4]
    places = np.stack([15 + 0.53 * (column - 4.5) + 0.1 * (row % 2), 0.52 * (row + 1)], axis=1)
    return mpsim.Scene(
        width=30, height=14, position=places, velocity=np.zeros((200, 2)), radius=radius, gravity=(0, -1),
        restitution=0.3, wall_restitution=0.3, friction=friction, wall_friction=friction,
        obstacles=[mpsim.FixedDisc((place / 2, 0), 0.25) for place in range(61)],
    )  # fmt: skip


def heap(path: Path) -> None:
    """The same column of grains with friction and without, a while after it was let go."""
    figure = new_figure(7.2, 3.6)
    for place, friction in enumerate((0.6, 0.0)):
        scene = poured(friction)
        with mpsim.Simulation(scene, mpsim.Settings(dt=0.01, method="grid", passes=4)) as sim:
            sim.run(until=HEAP_TIME)
            position = sim.state.position
        axes = figure.add_subplot(2, 1, place + 1)
        draw_discs(axes, position, scene)
        axes.set_ylim(0, 5)
        axes.set_title(f"friction {friction:g}, time {HEAP_TIME:g}" if friction else f"no friction, time {HEAP_TIME:g}")
    figure.savefig(path, dpi=DPI)


PICTURES = {each.__name__: each for each in (passes, neighbours, funnel, heap)}


def main() -> int:
    parser = parser_of(__doc__)
    parser.add_argument("pictures", nargs="*", metavar="PICTURE", help=f"{', '.join(PICTURES)}; default: all")
    parser.add_argument("--out", type=Path, default=Path("results/docs"))
    options = parser.parse_args()
    if unknown := set(options.pictures) - PICTURES.keys():
        parser.error(f"no picture is called {', '.join(sorted(unknown))}; there are {', '.join(PICTURES)}")
    make_folder(options.out)
    for name in options.pictures or PICTURES:
        with matplotlib.rc_context(fname=STYLE):
            PICTURES[name](options.out / f"{name}.png")
        print(options.out / f"{name}.png")
    return 0


if __name__ == "__main__":
    sys.exit(main())
