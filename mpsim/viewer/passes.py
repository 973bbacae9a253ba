"""Shows one frame pass by pass, with the worker that resolves each contact."""

from typing import Any

from mpsim.engine.simulation import Simulation, next_frame_in_passes
from mpsim.engine.solvers.grid import Pass, has_passes_by_grid
from mpsim.engine.solvers.methods import capabilities_of
from mpsim.errors import InputError


class PassView:
    """Shows the passes of the next frame one after the other. The simulation itself does not change meanwhile.

    >>> from mpsim import Scene, Settings
    >>> view = PassView()
    >>> with Simulation(Scene.random(count=50, packing=0.4, radius=0.5, seed=1), Settings(method="grid")) as sim:
    ...     names = [view.next(sim).name, view.next(sim).name]
    ...     view.is_last
    True
    >>> names
    ['even', 'odd']
    """

    def __init__(self) -> None:
        self._passes: list[Pass] = []
        self._shown = -1

    @property
    def is_open(self) -> bool:
        """Whether a pass is shown."""
        return self._shown >= 0

    @property
    def is_last(self) -> bool:
        """Whether the last pass of the frame is shown. Its discs are where the frame leaves them."""
        return self.is_open and self._shown == len(self._passes) - 1

    def next(self, sim: Simulation) -> Pass:
        """The next pass. After the last pass of a frame comes the first pass of the following frame.

        Raises:
            InputError: if the method or the scene has no passes.
        """
        if not self.is_open or self.is_last:
            self._passes, self._shown = next_frame_in_passes(sim), -1
        self._shown += 1
        return self._passes[self._shown]

    def demand_end(self, digest: str) -> None:
        """Check that the frame has ended as its last pass did; digest: that of the simulation after the frame.

        Raises:
            InputError: if not, for example because the frame was divided into more steps than the one before.
        """
        if self._passes[self._shown].state.digest() != digest:
            raise InputError(
                "the passes that were shown must end where the frame does; this frame was divided into other steps "
                "than the one before. Show the next one."
            )

    def offer(self, sim: Simulation) -> dict[str, Any] | None:
        """The message for pages if frames have no passes but would have them with the method grid; None otherwise.

        >>> from mpsim import Scene, Settings
        >>> with Simulation(Scene.random(count=5, packing=0.2, radius=0.5, seed=1), Settings(method="naive")) as sim:
        ...     PassView().offer(sim)["offer"]
        'The method naive tests all pairs of discs at once, so a frame has no passes. The method grid has passes.'
        """
        if _has_columns(sim) or not has_passes_by_grid(sim.scene, sim.settings, sim.radii):
            return None
        what = "method naive tests all pairs of discs at once"
        if not capabilities_of(sim.settings).has_steps:
            what = "exact solver resolves one collision after another"
        return {"name": None, "offer": f"The {what}, so a frame has no passes. The method grid has passes."}

    def close(self) -> None:
        """Stop showing passes."""
        self._passes, self._shown = [], -1

    def told(self) -> dict[str, Any]:
        """The message for pages, for `wire.text_of`. Its `name` is that of the pass; None: no pass is shown."""
        if not self.is_open:
            return {"name": None}
        shown = self._passes[self._shown]
        return {
            "name": shown.name,
            "number": shown.number + 1,
            "of": len(self._passes),
            "contacts": shown.contacts,
            "columns": shown.columns,
            "brackets": shown.brackets.tolist(),
            "owners": shown.owners.tolist(),
        }


def _has_columns(sim: Simulation) -> bool:
    try:
        sim.columns()
    except InputError:
        return False
    return True
