"""The first look at a scene: whether its exact solver is quick enough is a matter of running, not of compiling."""

from types import SimpleNamespace

import pytest
from support.scenes import gas

import mpsim
from mpsim.studies import preliminary


class Clock:
    """A clock that only a simulation moves on: by `starting` when made, by `running` when run."""

    def __init__(self, starting: float = 0.0, running: float = 0.0):
        self.now = 0.0
        clock = self

        class Slow(mpsim.Simulation):
            def __init__(self, *arguments):
                clock.now += starting
                super().__init__(*arguments)

            def run(self, *arguments, **options):
                clock.now += running
                return super().run(*arguments, **options)

        self.simulation = Slow

    def thread_time(self) -> float:
        return self.now


def reference(clock: Clock, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setattr(preliminary, "time", SimpleNamespace(thread_time=clock.thread_time))
    monkeypatch.setattr(preliminary, "Simulation", clock.simulation)
    return preliminary.preliminary_run(gas(20, 0.2, seed=1)).reference_name


def test_a_start_that_compiles_for_minutes_does_not_make_the_exact_solver_too_slow(monkeypatch):
    assert reference(Clock(starting=10 * preliminary.EXACT_SECONDS), monkeypatch) == preliminary.EXACT


def test_an_exact_solver_that_runs_for_minutes_is_too_slow(monkeypatch):
    """Negative control. Of a stepped look that takes as long, the error says so."""
    with pytest.raises(
        mpsim.InputError, match="a trade-off study needs a scene whose preliminary run takes less than 20 s"
    ):
        reference(Clock(running=10 * preliminary.EXACT_SECONDS), monkeypatch)


def test_a_step_is_timed_along_the_run_where_emitters_let_a_scene_grow():
    """Of the first steps, of one disc, the forecast for 200 of them was a hundredth of what they took."""
    emitters = [mpsim.Emitter((2 + 3 * k, 2.0), (1.0, 20.0), interval=0.4) for k in range(10)]
    box = {"width": 33, "height": 30, "position": [[1, 29]], "velocity": [[1, 0]], "radius": 0.5}
    scene = mpsim.Scene(**box, emitters=emitters)
    first, along = (
        min(preliminary._step_seconds(scene, 0.002, until, 10.0) for _ in range(3)) for until in (None, 10.0)
    )
    assert along > 5 * first


@pytest.mark.parametrize("until", [1e12, 1e308])
def test_runs_that_never_end_are_refused_at_once(until):
    with pytest.raises(
        mpsim.InputError, match=r"^until must be at most \S+, in which a disc flies 1e\+11 diameters; got 1e"
    ):
        preliminary.preliminary_run(gas(20, 0.2), until)
