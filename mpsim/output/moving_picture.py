"""A picture of a simulation that is updated for each frame of an animation."""

import contextlib
import tempfile
from collections.abc import Iterable, Iterator
from typing import IO, Any, NamedTuple

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mpsim.core import checks
from mpsim.core.state import Box, State
from mpsim.engine.simulation import Simulation
from mpsim.output.colour_scale import SPEED, ColourScale, percentile_scale, speeds_of
from mpsim.output.drawing import (
    LIGHT,
    STYLE,
    Theme,
    closed_off,
    colour_bar,
    colour_discs,
    draw_discs,
    figure_around,
    on_scale,
    with_images,
)

PIXELS = 480
"""Length of the longer side of the box in a picture."""

DPI = 100

IN_MEMORY = 2**27
"""Bytes of moments that are kept in memory; what is more lies in a file."""


class Moment(NamedTuple):
    """What a picture shows of a simulation.

    Attributes:
        time: [time].
        walls: x_low, x_high, y_low, y_high [length].
        position: shape (N, 2), float32 [length]; NaN of absorbed discs.
        radius: shape (N,), float32 [length].
        values: numbers to colour by, shape (N,), float32; of length 0 if there are none.
    """

    time: float
    walls: Box
    position: NDArray[np.float32]
    radius: NDArray[np.float32]
    values: NDArray[np.float32]

    @property
    def present(self) -> NDArray[np.bool_]:
        """Which discs have not been absorbed, shape (N,)."""
        return np.isfinite(self.position[:, 0])


def moment_of(sim: Simulation, colour: str | None) -> Moment:
    """The present moment; colour: one of KINDS, or None."""
    state = sim.state
    assert state.box is not None  # the walls of a simulation are known
    position = state.position.astype(np.float32)
    position[~state.present] = np.nan
    values = np.zeros(0) if colour is None else KINDS[colour].values(sim, state)
    return Moment(sim.time, state.box, position, sim.radii.astype(np.float32), values.astype(np.float32))


@contextlib.contextmanager
def kept(moments: Iterable[Moment]) -> Iterator[Iterator[Moment]]:
    """All moments, in order; large ones are kept in a temporary file."""
    with tempfile.SpooledTemporaryFile(IN_MEMORY) as file:
        number = 0
        for moment in moments:
            _write(file, moment)
            number += 1
        file.seek(0)
        yield (_read(file) for _ in range(number))


def _write(file: IO[bytes], moment: Moment) -> None:
    for array in (np.array([moment.time, *moment.walls]), *moment[2:]):
        np.lib.format.write_array(file, array, allow_pickle=False)


def _read(file: IO[bytes]) -> Moment:
    numbers, position, radius, values = (np.lib.format.read_array(file, allow_pickle=False) for _ in range(4))
    time, *walls = numbers.tolist()
    return Moment(time, tuple(walls), position, radius, values)  # pyright: ignore[reportArgumentType]


class Picture:
    """The figure of a simulation, updated before each frame of an animation.

    Discs that have left through an absorbing edge are hidden.

    Args:
        sim: what is shown.
        pixels: length of the longer side of the box.
        colour: as in `animate`.
        scale: of the speeds; None: that of the speeds now.
        theme: colours of everything except discs.
    """

    def __init__(
        self,
        sim: Simulation,
        pixels: int = PIXELS,
        colour: str | None = "speed",
        scale: ColourScale | None = None,
        theme: Theme = LIGHT,
    ):
        if colour is not None:
            checks.choice("colour", colour, KINDS)
        scene = self._scene = sim.scene
        self._sim, self._colour, self._theme = sim, colour, theme
        inches = pixels / DPI / max(scene.width, scene.height)
        size = scene.width * inches, scene.height * inches
        with matplotlib.rc_context(theme.style, fname=STYLE):
            self.figure: Figure = figure_around(scene, size, beside=(1.2, 0.5), below=(0.4, 1.4), theme=theme)
            self.axes: Axes = self.figure.add_subplot()
            self._kind = KINDS[colour](sim, self.axes, scale) if colour is not None else None
            self._discs = self._draw(scene.position, scene.radii)
            if self._kind is not None:
                bar = colour_bar(self.axes, self._discs, scene, self._kind.label, self._kind.scale.outside)
                if self._kind.ticks is not None:
                    bar.set_ticks(list(self._kind.ticks), labels=list(self._kind.ticks.values()))
            self._title = self.axes.set_title("time 0.00")
        self._closed = closed_off(scene, scene.box, theme)
        if self._closed is not None:
            self.axes.add_patch(self._closed)
        self.figure.draw_without_rendering()
        # The layout is found once; solving it again for each picture would take most of the time.
        self.figure.set_layout_engine("none")

    def _draw(self, position: NDArray[np.floating], radii: NDArray[np.floating]) -> EllipseCollection:
        """New discs: the sizes of a collection cannot change."""
        discs = draw_discs(self.axes, position, self._scene, radii=radii, theme=self._theme)
        if self._kind is not None:
            colour_discs(discs, np.zeros(len(radii)), self._kind.scale)
            if self._kind.colours is not None:
                discs.set_cmap(self._kind.colours)
        self._drawn = len(radii)
        return discs

    def update(self) -> None:
        """Show the simulation as it is now."""
        self.show(moment_of(self._sim, self._colour))

    def show(self, moment: Moment) -> None:
        """Show a moment of the simulation."""
        if len(moment.radius) != self._drawn:
            self._discs.remove()
            self._discs = self._draw(moment.position, moment.radius)
        self._discs.set_offsets(with_images(moment.position, self._scene))
        if self._kind is not None:
            self._discs.set_array(on_scale(moment.values, self._kind.scale))
        closed = closed_off(self._scene, moment.walls)
        if self._closed is not None and closed is not None:
            self._closed.set_bounds(*closed.get_bbox().bounds)
        number = int(np.count_nonzero(moment.present))
        self._title.set_text(f"time {moment.time:.2f}, {number} disc{'s' * (number != 1)}")


class _Speed:
    """Colour by speed."""

    label, ticks, colours = SPEED, None, None

    def __init__(self, sim: Simulation, axes: Axes, scale: ColourScale | None):
        self.scale = percentile_scale(self.values(sim, sim.state)[~sim.absorbed]) if scale is None else scale

    @staticmethod
    def values(sim: Simulation, state: State) -> NDArray[np.floating]:
        return speeds_of(state.velocity)


class _Worker:
    """Colour by the worker that owns a disc's column."""

    label = "worker"

    def __init__(self, sim: Simulation, axes: Axes, scale: ColourScale | None):
        sim.columns()  # which refuses methods without columns
        workers = 1 + len(sim.pids)
        self.scale = ColourScale(-0.5, workers - 0.5)
        self.ticks = {number: str(number) for number in range(workers)} if workers <= len(CATEGORIES) else None
        self.colours = ListedColormap([CATEGORIES[number % len(CATEGORIES)] for number in range(workers)])

    @staticmethod
    def values(sim: Simulation, state: State) -> NDArray[np.floating]:
        return sim.columns().owner.astype(float)


class _Parity:
    """Colour by whether the column of a disc is even or odd, over the columns of the start."""

    label, scale, ticks = "column of the disc", ColourScale(-0.5, 1.5), {0: "even", 1: "odd"}
    colours = ListedColormap(["#56B4E9", "#D55E00"])

    def __init__(self, sim: Simulation, axes: Axes, scale: ColourScale | None):
        number = sim.columns().number
        for column in range(number):
            edges = sim.scene.width / number * np.array([column, column + 1])
            axes.axvspan(*edges, color=self.colours(column % 2), alpha=0.15, linewidth=0, zorder=0)

    @staticmethod
    def values(sim: Simulation, state: State) -> NDArray[np.floating]:
        return (sim.columns().of_disc % 2).astype(float)


KINDS: dict[str, Any] = {"speed": _Speed, "worker": _Worker, "parity": _Parity}
"""What discs can be coloured by."""

CATEGORIES = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#F0E442", "#000000")
"""Colours of Okabe & Ito, neighbours far apart."""
