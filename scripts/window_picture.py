"""The figure of one window of the exact solver in two tiles, with the depth of errors."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from exact_windows import Found, Tiles, divided
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from numpy.typing import NDArray

import mpsim
from mpsim.engine.solvers.event_tiles import HALO
from mpsim.kernels.events.records import BAND
from mpsim.kernels.events.windows import MOST_COLLISIONS
from mpsim.output.drawing import new_figure

OWN, RIGHT, WRONG, BANDED, BEYOND = "#0072B2", "#A6D4F2", "#D55E00", "#F0E442", "#F2F2F2"

PACKINGS = {0.2: ("#E69F00", "o"), 0.4: ("#0072B2", "s"), 0.65: ("#009E73", "^"), 0.7: ("#CC79A7", "D")}
LENGTHS = np.arange(0.1, 2.05, 0.1)
"""Of windows, in collisions divided by discs."""

BORDER, STARTS, WIDE_HALO = 120, 10, 30
"""Cells along the border, windows of each length, and the halo of these: wider than anything comes in."""


class Tiled(NamedTuple):
    """A gas in two tiles side by side, left and right, that has forgotten its start."""

    sim: mpsim.Simulation
    tiles: Tiles
    once: float  # the time in which collisions are as many as discs
    cell: float  # width of a cell [length]

    def depths(self, place: int, found: Found, truth: Found, halo: int) -> NDArray[np.float64]:
        """How far inside the halo's outer edge each disc lies that a tile does not have as it truly is [cells]."""
        border = self.tiles.edges[0, 1, 0]
        along = truth.position[:, 0] / self.cell
        depth = border + halo - along if place == 0 else along - (border - halo)
        return depth[found.differs(truth) & (depth > 0)]


def gas_in_tiles(packing: float, width: float, height: float) -> Tiled:
    """A gas of discs of radius 0.5, which must be closed."""
    count = round(packing * width * height * 4 / np.pi)
    scene = mpsim.Scene.lattice(count=count, width=width, height=height, radius=0.5, temperature=1.0, seed=1)
    with divided(2):
        sim = mpsim.Simulation(scene, mpsim.Settings(dt=0.25, method="event"))
    sim.run(until=20.0)
    report = sim.run(frames=40)
    tiles = Tiles(sim)
    return Tiled(sim, tiles, report.frames * 0.25 * count / report.collisions, width / tiles.cells[0])


# --- how far it comes in ------------------------------------------------------------------------------------------


def deepest(packing: float) -> NDArray[np.float64]:
    """How far what is unknown comes in [cells], shape (lengths, windows of two tiles)."""
    gas = gas_in_tiles(packing, BORDER, BORDER)
    found = np.zeros((len(LENGTHS), 2 * STARTS))
    with gas.sim:
        for start in range(STARTS):
            for row, length in enumerate(LENGTHS * gas.once):
                truth = gas.tiles.true(length)
                for place in range(2):
                    wrong = gas.depths(place, gas.tiles.of_tile(place, length, WIDE_HALO), truth, WIDE_HALO)
                    found[row, 2 * start + place] = wrong.max(initial=0.0)
            gas.sim.run(frames=8)
    return found


def draw_depths(axes: Axes) -> None:
    """The curves, and the halo's width."""
    for packing, (colour, marker) in PACKINGS.items():
        found = deepest(packing)
        axes.plot(LENGTHS, found.mean(axis=1), color=colour, marker=marker, markevery=2, label=f"packing {packing:g}")
        axes.plot(LENGTHS, found.max(axis=1), color=colour, linewidth=1.0, linestyle=":")
    axes.axhline(HALO, color="black", linewidth=1.2)
    axes.axhline(HALO - BAND, color="black", linewidth=1.2, linestyle="--")
    axes.axvline(MOST_COLLISIONS, color="#777777", linewidth=1.0)
    axes.text(0.03, HALO + 0.2, f"the halo: {HALO} cells")
    axes.text(0.03, HALO - BAND + 0.2, "above this line it is compared, and noticed")
    axes.text(MOST_COLLISIONS + 0.02, 0.3, "the longest window")
    axes.set(
        xlim=(0, 2), ylim=(0, 13), xlabel="collisions in the window / discs", ylabel="depth of what is wrong [cells]"
    )
    handles, _ = axes.get_legend_handles_labels()
    handles.append(Line2D([], [], color="#555555", linewidth=1.0, linestyle=":", label=f"the worst of {2 * STARTS}"))
    axes.legend(handles=handles, loc="lower right", fontsize=10)
    axes.set_title(f"How deep it gets along {BORDER} cells of border, on average: alike at any packing", loc="left")


# --- two tiles ----------------------------------------------------------------------------------------------------


def draw_tile(axes: Axes, gas: Tiled, place: int, found: Found, truth: Found) -> None:
    """What one tile holds at the end of a window."""
    border, (columns, rows) = gas.tiles.edges[0, 1, 0], gas.tiles.cells
    places = found.position / gas.cell
    own = places[:, 0] < border if place == 0 else places[:, 0] >= border
    wrong = found.differs(truth)
    colours = np.where(wrong, WRONG, np.where(own, OWN, RIGHT))[found.here]
    size = np.full(len(colours), 1 / gas.cell)
    discs = EllipseCollection(
        size, size, 0 * size, units="xy", offsets=places[found.here], offset_transform=axes.transData
    )
    discs.set(facecolor=colours, edgecolor="#00000080", linewidth=0.4, zorder=2)
    axes.add_collection(discs)
    outer = border + HALO if place == 0 else border - HALO
    beyond = (outer, columns) if place == 0 else (0, outer)
    axes.add_patch(Rectangle((beyond[0], 0), beyond[1] - beyond[0], rows, color=BEYOND, linewidth=0, zorder=0))
    axes.text(sum(beyond) / 2, rows / 2, "not loaded", ha="center", va="center", color="#666666")
    axes.add_patch(Rectangle((border - BAND, 0), 2 * BAND, rows, color=BANDED, alpha=0.55, linewidth=0, zorder=1))
    axes.axvline(border, color="black", linewidth=1.4, zorder=3)
    axes.axvline(outer, color="black", linewidth=1.0, linestyle="--", zorder=3)
    depth = gas.depths(place, found, truth, HALO).max(initial=0.0)
    inner = outer - depth if place == 0 else outer + depth
    axes.annotate(
        "", (inner, -0.7), (outer, -0.7), annotation_clip=False, arrowprops={"arrowstyle": "->", "color": WRONG}
    )
    axes.text(outer, -1.2, f"{depth:.1f} cells", ha="right" if place == 0 else "left", va="top", color=WRONG)
    axes.set(xlim=(0, columns), ylim=(0, rows), aspect="equal", xticks=[], yticks=[])
    axes.grid(False)
    for side in axes.spines.values():
        side.set_visible(True)


def window(path: Path) -> None:
    """Two tiles at the end of a window, and how far what is unknown comes in by its length."""
    figure = new_figure(8.0, 7.6)
    *panels, below = figure.subplots(3, 1, height_ratios=(1.0, 1.0, 1.75))
    gas = gas_in_tiles(0.4, 62.0, 14.0)
    with gas.sim:
        truth = gas.tiles.true(gas.once)
        for place, (axes, name) in enumerate(zip(panels, "AB", strict=True)):
            found = gas.tiles.of_tile(place, gas.once, HALO)
            draw_tile(axes, gas, place, found, truth)
            axes.set_ylabel(f"tile {name}", rotation=0, ha="right", va="center")
    handles: list[Any] = [
        Patch(color=OWN, label="own, as in truth"), Patch(color=RIGHT, label="in the halo, as in truth"),
        Patch(color=WRONG, label="wrong"), Patch(color=BANDED, alpha=0.55, label="compared"),
    ]  # fmt: skip
    panels[0].set_title("One window, as two tiles have played it: wrong only where it does not count", loc="left")
    panels[1].legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=4)
    draw_depths(below)
    figure.savefig(path)
