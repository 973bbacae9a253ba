"""mpsim itself: method grid on one process, parallel on several, or event; contact push or impact."""

import numpy as np
from numpy.typing import NDArray
from peers.engine import Plan, Run, Start

import mpsim
from mpsim.scene.settings import Contact, MethodName


class Engine(Run):
    """A simulation with contact `impact`, the default."""

    contact: Contact = "impact"
    method: MethodName | None = None

    def __init__(self, start: Start, plan: Plan):
        scene = mpsim.Scene(
            width=start.width,
            height=start.height,
            position=start.position,
            velocity=start.velocity,
            radius=start.radius,
        )
        settings = mpsim.Settings(
            dt=plan.dt,
            method=self.method or ("parallel" if plan.threads > 1 else "grid"),
            workers=plan.threads,
            contact=self.contact,
            precision=plan.precision,
        )
        self._sim = mpsim.Simulation(scene, settings)
        self._frame_perimeter = plan.dt * 2 * (start.width + start.height)
        self._counting, self.impulses = plan.counting, np.zeros(1)

    def run(self, frames: int) -> None:
        report = self._sim.run(frames=frames, measures=["pressure"] if self._counting else None)
        if self._counting:
            self.impulses += report.measures["pressure"].value * frames * self._frame_perimeter

    def state(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        state = self._sim.state
        return state.position.astype(np.float64), state.velocity.astype(np.float64)

    def close(self) -> None:
        self._sim.close()


class Push(Engine):
    """A simulation with contact `push`, the report's."""

    contact: Contact = "push"


class Exact(Engine):
    """The exact solver."""

    method: MethodName | None = "event"
