"""One scene run in every way that must not change a bit: on workers, in pieces, after a resume or a death, replayed.

A test file names its scene and makes a class of `SameBits` with it: pytest then collects the tests.
"""

import os
import signal
from pathlib import Path
from typing import Any, ClassVar

import pytest

import mpsim
from support.compare import assert_same_bits
from support.scenes import gas, simulate, state_after

FRAMES = 40


class SameBits:
    """Tests of a scene with features that `grid` and `event` can do.

    Attributes:
        features: arguments of the scene.
        packing: of its discs.
        dt: of the stepped methods.
    """

    features: ClassVar[dict[str, Any]]
    packing: ClassVar[float] = 0.4
    dt: ClassVar[float] = 0.02

    @classmethod
    def scene(cls, count: int = 1500, **change: Any) -> mpsim.Scene:
        return gas(count, cls.packing, seed=2, **{**cls.features, **change})

    def begun(self, **more: Any) -> mpsim.Simulation:
        return simulate(self.scene(), dt=self.dt, contact="impact", **{"method": "grid", **more})

    @pytest.fixture(scope="class")
    @classmethod
    def expected(cls) -> mpsim.State:
        """By `grid`, in one piece."""
        return state_after(cls.scene(), FRAMES, method="grid", dt=cls.dt, contact="impact")

    @pytest.mark.parametrize("workers", [1, 2, 3])
    def test_any_number_of_workers_has_the_bits_of_grid(self, workers: int, expected: mpsim.State) -> None:
        with self.begun(method="parallel", workers=workers) as sim:
            assert sim.run(frames=FRAMES).collisions > 100
            assert_same_bits(sim.state, expected, f"{workers} workers")

    def test_pieces_and_a_resume_have_the_same_bits(self, expected: mpsim.State, tmp_path: Path) -> None:
        with self.begun() as sim:
            for frames in (1, 7, 12):
                sim.run(frames=frames)
            path = sim.save(tmp_path / "run")
        with mpsim.Simulation.resume(path, workers=2) as sim:
            sim.run(frames=FRAMES - 20)
            assert_same_bits(sim.state, expected, "resumed")

    def test_a_healed_run_has_the_same_bits(self, expected: mpsim.State) -> None:
        with self.begun(method="parallel", workers=2, on_worker_death="restart") as sim:
            sim.run(frames=FRAMES // 2)
            os.kill(sim.pids[0], signal.SIGKILL)
            sim.run(frames=FRAMES - FRAMES // 2)
            assert_same_bits(sim.state, expected, "healed")

    def test_a_session_is_played_again(self, expected: mpsim.State, tmp_path: Path) -> None:
        with self.begun() as sim:
            sim.run(frames=FRAMES // 2)
            sim.change(dt=self.dt / 2)
            sim.kick([3, 4], [1.0, 0.0])
            sim.run(frames=FRAMES // 2)
            journal, digest = sim.journal, sim.digest()
        assert digest != expected.digest(), "the control"
        for source, workers in ((journal, 1), (journal.save(tmp_path / "session.toml"), 2)):
            with mpsim.Simulation.replay(source, method="parallel", workers=workers) as again:
                assert again.digest() == digest

    def test_the_exact_solver_has_the_same_bits_in_pieces_and_after_a_resume(self, tmp_path: Path) -> None:
        small = self.scene(100)
        whole = state_after(small, 40, method="event", dt=0.05)
        with simulate(small, method="event", dt=0.05) as sim:
            sim.run(frames=1)
            sim.run(until=0.62)
            path = sim.save(tmp_path / "run")
        with mpsim.Simulation.resume(path) as sim:
            sim.run(frames=40 - sim.frame)
            assert_same_bits(sim.state, whole, "resumed")

    def assert_other_bits(self, expected: mpsim.State, **change: Any) -> None:
        """The control: of another scene the bits are others, by `grid` and by `event`."""
        other = self.scene(**change)
        assert state_after(other, FRAMES, method="grid", dt=self.dt, contact="impact").digest() != expected.digest()
        ends = [state_after(each, 20, method="event", dt=0.05) for each in (self.scene(100), self.scene(100, **change))]
        assert ends[0].digest() != ends[1].digest()
