"""A method that mpsim does not know, as the solver protocol asks for it: one class, and one line of the registry."""

import math

import numpy as np
import pytest
from support.scenes import lattice

import mpsim
from mpsim.engine.solvers import methods
from mpsim.engine.solvers.base import Capabilities, Solver
from mpsim.engine.solvers.grid import GridSolver
from mpsim.engine.solvers.slices import Slice
from mpsim.engine.solvers.snapshots import shapes_in_each
from mpsim.kernels.layout import PHASES


class Ghosts(Solver):
    """Discs that fly straight on through everything. No more than what is abstract is defined."""

    capabilities = Capabilities(has_steps=False)

    def __init__(self, scene, settings, choice):
        super().__init__(scene, settings, choice)
        self._progress = np.zeros(2, np.int64)
        self._kept = {"position": scene.position.copy(), "velocity": scene.velocity.copy()}
        self.open = False

    def start(self):
        self.open = True

    def close(self):
        self.open = False

    def advance(self, frames, workers, stop=math.inf):
        for _ in range(frames):
            self._kept["position"] += self._settings.dt * self._kept["velocity"]
        self._progress[0] += frames
        return Slice(np.ones((1, frames, len(PHASES)), np.int64), 0, None)

    def set_tallied(self, tallied):
        self.tallied = tallied

    @property
    def frame(self):
        return int(self._progress[0])

    @property
    def time(self):
        return self.frame * self._settings.dt

    def reached(self, time):
        return time <= self.time

    def state(self):
        return mpsim.State(self._kept["position"].copy(), self._kept["velocity"].copy())

    def add(self, new, choice):
        added = {"position": new.position, "velocity": new.velocity}
        self._kept = {name: np.concatenate([self._kept[name], more]) for name, more in added.items()}
        self._radii, self._masses = np.append(self._radii, new.radius), np.append(self._masses, new.mass)
        self.count, self.choice = len(self._radii), choice

    def snapshot(self):
        each = {"radii": self._radii, "masses": self._masses, "progress": self._progress}
        return {name: array.copy() for name, array in (self._kept | each).items()}

    def restore(self, snapshot, choice, room=0):
        kept = {name: array.copy() for name, array in snapshot.items()}
        self._radii, self._masses, self._progress = (kept.pop(name) for name in ("radii", "masses", "progress"))
        self._kept, self.count, self.choice, self.open = kept, len(self._radii), choice, True

    @staticmethod
    def snapshot_shapes(scene, settings, count):
        flight = np.dtype(float), (count, 2)
        return {"position": flight, "velocity": flight} | shapes_in_each(count)

    @staticmethod
    def check_snapshot(scene, settings, snapshot):
        if not np.isfinite(snapshot["velocity"]).all():
            raise ValueError("ghosts have finite velocities")

    @property
    def array_names(self):
        return tuple(self._kept)

    def resources(self):
        return (0,), 0


@pytest.fixture
def settings(monkeypatch):
    """Settings of the new method, once it is registered."""
    monkeypatch.setitem(methods.METHODS, "ghosts", methods.Method(Ghosts))
    monkeypatch.setattr("mpsim.scene.settings.METHODS", ("ghosts",))
    return mpsim.Settings(method="ghosts", dt=0.5)


def test_a_new_method_is_a_class_and_a_line_of_the_registry(settings, tmp_path):
    scene, seen = lattice(3, 3), []
    with mpsim.Simulation(scene, settings) as sim:
        report = sim.run(frames=4, progress=lambda done, of: seen.append(done))
        assert (report.method, report.workers, report.frames, report.guarded, sim.time) == ("ghosts", 1, 4, 0, 2.0)
        assert np.array_equal(sim.state.position, scene.position + 4 * 0.5 * scene.velocity)
        assert (seen[-1], sim.substeps, sim.pids, sim.absorbed.any()) == (4, 1, [], False)
        sim.add((1.0, 1.0), (0.5, 0.0))
        path = sim.save(tmp_path / "run")
        sim.run(frames=3)
        with mpsim.Simulation.resume(path) as again:
            again.run(frames=3)
            assert (again.count, again.digest()) == (10, sim.digest())
        solver = sim._solver
        assert solver.open
    assert not solver.open


def test_what_a_method_cannot_do_is_refused_by_its_capabilities(settings):
    with mpsim.Simulation(lattice(3, 3), settings) as sim, pytest.raises(mpsim.InputError, match="this run is by 'gho"):
        sim.columns()


def test_a_snapshot_from_a_file_is_checked_by_its_method(settings, tmp_path, monkeypatch):
    whole = Ghosts.snapshot
    monkeypatch.setattr(Ghosts, "snapshot", lambda self: whole(self) | {"velocity": self._kept["velocity"] * np.nan})
    with mpsim.Simulation(lattice(3, 3), settings) as sim:
        path = sim.save(tmp_path / "run")
    with pytest.raises(mpsim.CheckpointError, match="ghosts have finite velocities"):
        mpsim.Simulation.resume(path)


@pytest.mark.parametrize("missing", sorted(Solver.__abstractmethods__))
def test_a_method_that_lacks_a_member_cannot_be_made(missing, settings):
    members = {name: getattr(Ghosts, name) for name in Ghosts.__abstractmethods__ | set(vars(Ghosts))}
    lacking = type("Lacking", (Solver,), {name: each for name, each in members.items() if name != missing})
    with pytest.raises(TypeError, match=f"abstract.*{missing}"):
        lacking(lattice(3, 3), settings, methods.choose(9, settings))


def test_auto_keeps_its_solver_where_the_next_one_cannot_be_had(monkeypatch):
    """The tenth disc wants the grid. It is refused, and nine go on as if nobody had asked."""
    monkeypatch.setattr(methods, "NAIVE_UP_TO", 9)
    scene, tenth = lattice(3, 3), ((1.0, 1.0), (0.1, 0.0))
    with mpsim.Simulation(scene) as sim, mpsim.Simulation(scene) as other:
        sim.run(frames=3)
        with monkeypatch.context() as refusing:
            refusing.setattr(GridSolver, "_load_kernels", refuse)
            with pytest.raises(mpsim.errors.SharedMemoryError, match="no more"):
                sim.add(*tenth)
        assert (sim.count, sim.run(frames=3).method) == (9, "naive")
        other.run(frames=6)
        assert sim.digest() == other.digest()
        sim.add(*tenth)
        assert (sim.count, sim.run(frames=3).method) == (10, "grid")


def refuse(solver):
    raise mpsim.errors.SharedMemoryError("no more")
