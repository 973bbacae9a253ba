"""One frame of the method grid, pass by pass, on a copy of the discs.

A solver runs whole frames in one call of its kernel. Here the parts of a step that ranks call one by one
(`kernels/frame/rank.py`) run the same frame, one part at a time, so that the discs can be looked at in between. They
are the same compiled loops in the same order, and so the end has the bits of the solver's own frame.
"""

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mpsim.core.state import State
from mpsim.engine.feature_arrays import giant_radius
from mpsim.engine.solvers.base import Choice, Solver
from mpsim.engine.solvers.grid import GridSolver
from mpsim.engine.workers.worker import kernel_arguments
from mpsim.errors import InputError
from mpsim.kernels import layout
from mpsim.kernels.frame.rank import run_part
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings

ALONE = Choice("grid", (1,))


class Pass(NamedTuple):
    """One pass of a frame.

    Attributes:
        name: "even" or "odd".
        number: of the pass in its frame, from 0.
        state: of the discs after it.
        contacts: resolved in it.
        brackets: first column of each bracket, which is resolved with the next column: no two have a column in common,
            shape (K,). Of a periodic axis the last column's next one is the first.
        owners: worker that resolves each bracket, shape (K,).
        columns: of the grid, of equal width.
    """

    name: str
    number: int
    state: State
    contacts: int
    brackets: NDArray[np.int64]
    owners: NDArray[np.int64]
    columns: int


class PassSolver(GridSolver):
    """A grid in one process, whose next frame is run pass by pass.

    Args:
        scene, settings: in force.
    """

    def __init__(self, scene: Scene, settings: Settings):
        super().__init__(scene, settings, ALONE)

    def frame_in_passes(self, owners: NDArray[np.int64]) -> list[Pass]:
        """Run one frame, and return its passes in order.

        Args:
            owners: worker of each column, shape (columns,).

        Raises:
            DivergedError: if a disc is not finite after it has moved.
        """
        self._write_command(1, 1, math.inf)
        self._deal(1)
        control, found = self._control, list[Pass]()
        control.race_free, passes = 0, int(control.passes)  # or both passes of inner columns come with the sort
        for _ in range(int(control.substeps)):
            control.in_order = 0
            self._run_part(layout.MOVE)
            if control.signals[layout.BAD]:
                raise self._failure(layout.BAD_STATE)
            for number in range(passes):
                self._team["stop"] = self._grid.columns
                self._run_part(layout.EVEN if number else layout.SORT)
                found.append(self._seen("even", len(found), owners))
                self._run_part(layout.ODD)
                found.append(self._seen("odd", len(found), owners))
        control.race_free = 1
        control.done += 1
        return found

    @property
    def _team(self) -> Any:
        return self._block.arrays["team"]

    def _run_part(self, part: int) -> None:
        control = self._control
        control.part, control.ahead = part, layout.NO_FRAME
        run_part(*kernel_arguments(self._block, 0))

    def _seen(self, name: str, number: int, owners: NDArray[np.int64]) -> Pass:
        """The pass that has just been run."""
        contacts = int(self._team["collisions"].sum())
        self._team["collisions"] = 0
        columns = self._grid.columns
        first = np.arange(number % 2, columns, 2)
        if not self._scene.periodic[0]:  # what lies beyond the last column is empty
            first = first[first < max(columns - 1, 1)]
        return Pass(name, number, self.state(), contacts, first, owners[first], columns)


def frame_in_passes(solver: Solver, scene: Scene, settings: Settings) -> list[Pass]:
    """The next frame of a solver, pass by pass, on a copy of its discs.

    Args:
        solver: that runs the simulation; it stays as it is.
        scene, settings: in force.

    Raises:
        InputError: for a method or a scene whose frame is not made of an even and an odd pass alone.
    """
    _refuse(solver, scene, settings)
    assert isinstance(solver, GridSolver)  # or it is refused
    copy = PassSolver(scene, settings)
    copy.origin = solver.origin
    try:
        copy.restore(solver.snapshot(), ALONE)
        copy.divide(solver.substeps)
        return copy.frame_in_passes(solver.owners())
    finally:
        copy.close()


def has_passes_by_grid(scene: Scene, settings: Settings, radii: NDArray[np.float64]) -> bool:
    """Whether frames of the method grid are made of an even and an odd pass alone; radii: of the discs, shape (N,)."""
    return not any(_reasons(scene, settings, has_giants=giant_radius(radii) is not None))


def _refuse(solver: Solver, scene: Scene, settings: Settings) -> None:
    by_columns = isinstance(solver, GridSolver)
    first = "" if by_columns else f"method {solver.choice.method!r}, which has no columns"
    if solver.choice.processes.unguarded:
        first = "unguarded=True, which has no passes"
    reason = first or next(_reasons(scene, settings, has_giants=by_columns and solver.has_giants), None)
    if reason:
        raise InputError(
            f"one pass at a time needs frames that are made of an even and an odd pass; this simulation has "
            f"{reason}. Use Settings(method='grid' or 'parallel'), --method on the command line, and a scene "
            "without that."
        )


def _reasons(scene: Scene, settings: Settings, has_giants: bool) -> Iterator[str]:
    """Why frames of a grid are not made of an even and an odd pass alone; none if they are."""
    if scene.emitters:
        yield "emitters, which add discs inside a frame"
    if has_giants:
        yield "discs far larger than the others, which have a phase of their own"
