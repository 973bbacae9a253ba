"""The naive method: all pairs in index order, in one process."""

from typing import Any, NamedTuple

from mpsim.engine.solvers.block import BlockSolver
from mpsim.engine.workers.shared import SharedBlock
from mpsim.engine.workers.worker import kernel_arguments
from mpsim.kernels import layout
from mpsim.kernels.frame.stepping import run_naive


class NaiveArguments(NamedTuple):
    """Arguments of `run_naive`, in its order: views of the block. There is one buffer, which is never sorted."""

    discs: layout.Discs
    features: Any
    parameters: Any
    control: Any
    team: Any
    tally: Any
    times: Any


def naive_arguments(block: SharedBlock) -> NaiveArguments:
    """What `run_naive` is called with."""
    grid = kernel_arguments(block, 0)
    return NaiveArguments(grid.a, grid.features, grid.parameters, grid.control, grid.team, grid.tally, grid.times)


class NaiveSolver(BlockSolver):
    """Frames by testing all pairs i < j in index order."""

    def _load_kernels(self) -> None:
        arguments = naive_arguments(self._block)
        control = arguments.control.copy()
        control.frames = 0
        run_naive(*arguments._replace(control=control))

    def _run_command(self, workers: int) -> int:
        return run_naive(*naive_arguments(self._block))
