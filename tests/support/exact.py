"""Runs of the exact solver without simulation and processes, and what tests ask of them."""

import math
import os
import subprocess
import sys

import numpy as np

from mpsim.features.capsules import lists_of_cells, with_images
from mpsim.kernels.events import records, solver, state
from mpsim.kernels.events.boundary import Box
from mpsim.kernels.events.cells import plan_cells
from mpsim.kernels.events.features.capsules import Capsules
from mpsim.kernels.events.features.friction import Friction
from mpsim.kernels.events.features.hooks import BARE
from mpsim.kernels.events.features.piston import Wall


class Run:
    """A store with its box and law, and short names for what the tests ask of them."""

    def __init__(
        self,
        position,
        velocity,
        width,
        height,
        radius=0.5,
        periodic=(False, False),
        gravity=None,
        restitution=None,
        wall_restitution=None,
        contact_time=1e-12,
        mass=None,
        image=False,
        friction=None,
        wall_friction=None,
        spin=None,
        steps=None,
        cells=None,
        capsules=(),
        moving_wall=None,
        absorbing=(),
    ):
        position = np.asarray(position, dtype=float).reshape(-1, 2)
        velocity = np.asarray(velocity, dtype=float).reshape(-1, 2)
        radii = None if np.isscalar(radius) else np.asarray(radius, dtype=float)
        mass = None if mass is None else np.asarray(mass, dtype=float)
        largest = 2.0 * (radius if radii is None else radii.max())
        count, cells = len(position), cells or plan_cells(width, height, largest, len(position))
        shapes = state.layout(count, cells)
        if steps:
            shapes["step_head"] = (np.int32, (steps,))
        # Whatever stands in memory before.
        self.store = state.store_of({name: np.full(shape, 7, dtype)[()] for name, (dtype, shape) in shapes.items()})
        self.box = Box(float(width), float(height), *periodic, *cells, float(radius) if radii is None else 0.0)
        spin = None if spin is None else np.array(spin, dtype=float)
        image = np.zeros((count, 2), np.int64) if image else None
        columns = {"radius": radii, "mass": mass, "image": image, "spin": spin}
        columns["exits"] = np.zeros((count, 3)) if absorbing else None
        columns = {name: values for name, values in columns.items() if values is not None}
        laws = {"gravity": gravity, "restitution": restitution, "wall_restitution": wall_restitution}
        laws |= {
            "friction": friction and Friction(*friction),
            "wall_friction": wall_friction and Friction(*wall_friction),
        }
        if absorbing:
            laws["absorbing"] = tuple(edge in absorbing for edge in range(4))
        if moving_wall:
            edge, start, stop, speed = moving_wall
            laws["moving_wall"] = Wall(edge, start, stop, speed, (stop - start) / speed)
        if len(capsules):
            laws["capsules"] = capsules_of(np.array(capsules, float), (width, height), periodic, largest / 2, cells)
        arrays = {name: np.full_like(values, 7) for name, values in columns.items()}
        self.features = BARE._replace(**laws, **arrays, contact_time=contact_time)
        self.placed = state.place(position, velocity, columns, 0.0, *self.system)
        self.time = 0.0
        if self.placed[0] == records.REACHED:
            solver.schedule(*self.system)

    @property
    def system(self):
        return self.store, self.box, self.features

    def advance(self, until, max_events=10**9):
        self.time = until
        *_, progress, seen, _, totals, clock = solver.nothing_to_play()
        call = until, 1, max_events, math.inf, progress, seen, np.zeros(1, np.int64), totals, clock
        return solver.advance_frames(*self.system, *call)[1:]

    def state(self, time=None):
        found = state.read_out(*self.system, self.time if time is None else time)
        return found["position"], found["velocity"]

    def tally(self, entry):
        """Impulse on a wall, by side, or a virial, in the units of the scene."""
        tally, unit = self.store.tally, self.box.impulse_unit if entry < records.VIRIAL else self.box.virial_unit
        return (int(tally.coarse[entry]) + int(tally.fine[entry]) / 2.0**records.FINE) * unit

    @property
    def walls(self):
        """Impulse on each wall, by side."""
        return np.array([self.tally(side) for side in range(4)])

    def spin(self):
        """In the order of the discs as given; zeros of smooth ones."""
        found = state.read_out(*self.system, self.time, ["spin"] if self.features.spin is not None else [])
        return found.get("spin", np.zeros(len(self.store.disc)))

    def count(self, what):
        return int(self.store.counter[what])

    def present(self):
        return self.store.clock.origin + self.store.clock.now


def capsules_of(rows, size, periodic, reach, cells):
    """Rows (ax, ay, bx, by, radius) as the kernels have them."""
    images = with_images(rows, size, periodic, reach).capsule
    lists, shift = lists_of_cells(images, size, reach, cells)
    return Capsules(images, lists.near, lists.listed, int(lists.grid[1]), shift)


def gas(count, packing, seed, radius=0.5, spread=0.0):
    """Discs on a square lattice with Gaussian velocities, no total momentum: position, velocity, radius, side."""
    rng = np.random.default_rng(seed)
    side = math.ceil(math.sqrt(count))
    radii = radius * (1.0 - spread * rng.random(count))
    length = math.sqrt(math.pi * (radii**2).sum() / packing)
    grid = (np.arange(side) + 0.5) * (length / side)
    position = np.stack(np.meshgrid(grid, grid), -1).reshape(-1, 2)[:count]
    velocity = rng.normal(size=(count, 2))
    return position, velocity - velocity.mean(0), (radii if spread else radius), length


def kinetic(velocity, mass=None):
    return 0.5 * ((velocity**2).sum(1) * (1.0 if mass is None else mass)).sum()


PEGS = [(1.5, 1.5, 1.5, 1.5, 0.3), (1.5, 3.0, 3.0, 2.9, 0.05), (0.0, 3.0, 0.2, 3.0, 0.0), (3.0, 0.0, 3.1, 1.4, 0.0)]
"""Obstacles between nine discs at packing 0.35: a peg, a bar, and two thin walls at the edge of the box."""

CONFIGURATIONS = {
    "plain": {},
    "gravity": dict(gravity=(0.3, -1.0)),
    "masses": dict(mass=True),
    "radii": dict(spread=0.6),
    "restitution": dict(restitution=0.9, wall_restitution=0.8, contact_time=1e-3),
    "periodic": dict(periodic=(True, True)),
    "rough": dict(friction=(0.3, 0.5), wall_friction=(0.2, -0.5), spin=True),
    "rough with everything": dict(gravity=(0.2, -0.7), mass=True, spread=0.5, restitution=0.95, wall_restitution=0.9,
                                  contact_time=1e-3, periodic=(True, False), friction=(math.inf, 0.9),
                                  wall_friction=(0.4, 0.0), spin=True),
    "obstacles": dict(capsules=PEGS),
    "obstacles under gravity": dict(capsules=PEGS, gravity=(0.3, -1.0)),
    "rough obstacles with everything": dict(capsules=PEGS, gravity=(0.2, -0.7), mass=True, restitution=0.95,
                                            wall_restitution=0.9, contact_time=1e-3, periodic=(True, False),
                                            friction=(0.3, 0.5), wall_friction=(0.4, 0.0), spin=True),
    "piston": dict(moving_wall=(1, 4.49, 3.6, -0.1)),
    "piston under gravity": dict(moving_wall=(2, 0.0, 0.3, 0.05), gravity=(0.3, -1.0), wall_friction=(0.4, 0.0),
                                 spin=True),
    "absorbing": dict(absorbing=(1,), gravity=(0.1, -1.0)),
    "channel with everything": dict(gravity=(0.2, -0.7), mass=True, spread=0.5, restitution=0.95,
                                    wall_restitution=0.9, contact_time=1e-3, periodic=(True, False)),
}  # fmt: skip


def follow(run, twin, count):
    """Play `count` events on both, comparing halfway to the next event: the largest difference ever seen.

    Fewer where nothing is left to happen.
    """
    worst = 0.0
    size = np.array([run.box.width, run.box.height])
    for k in range(1, count + 1):
        twin.step()
        wait = twin.next_event()[0]
        assert wait > 1e-12
        twin.fly(0.5 * wait if wait < math.inf else 1.0)
        assert run.advance(twin.time) == (records.REACHED, -1)
        assert run.count("pairs") + run.count("walls") == k
        x, v = run.state()
        away = x - np.array(twin.x)
        away -= size * np.round(away / size) * run.box[2:4]
        turned = run.spin()
        worst = max(worst, np.abs(away).max(), np.abs(v - np.array(twin.v)).max(), np.abs(turned - twin.spin).max())
        # Chaos multiplies a rounding by e in a third of a time unit: the twin goes on from the solver's state.
        twin.x, twin.v, twin.spin = x.tolist(), v.tolist(), turned.tolist()
        if wait == math.inf:
            break
    assert run.count("guarded") == twin.guards
    return worst


def two_discs(seed, length, radius, periodic):
    """A random start of two discs of total energy 2: uniform without overlap, velocities uniform on the sphere."""
    rng = np.random.default_rng(seed)
    while True:
        x = rng.uniform(0.0 if periodic else radius, length if periodic else length - radius, (2, 2))
        r = x[1] - x[0]
        if periodic:
            r -= length * np.round(r / length)
        if r @ r > 4.0 * radius**2:
            break
    v = rng.normal(size=(2, 2))
    if periodic:
        v -= v.mean(0)
    return x, v * math.sqrt(2.0 / kinetic(v))


EVERYTHING = dict(gravity=(0.2, -0.7), restitution=0.98, wall_restitution=0.97, contact_time=1e-5, image=True)


def everything(seed=9):
    position, velocity, radius, length = gas(49, 0.4, seed, spread=0.5)
    mass = np.random.default_rng(seed).uniform(0.5, 2.0, 49)
    return Run(position, velocity, length, length, radius, mass=mass, periodic=(True, False), **EVERYTHING)


def bits(run, time=None):
    x, v = run.state(time)
    return x.tobytes() + v.tobytes()


def same_arrays(a, b):
    pairs = zip((*a.store, a.features.image), (*b.store, b.features.image), strict=True)
    return all(x is None or x.tobytes() == y.tobytes() for x, y in pairs)


SCRIPT = """
import sys; sys.path.insert(0, {tests!r})
import hashlib
from support import exact
run = exact.everything()
print(run.advance(1.0), run.store.counter, hashlib.sha256(exact.bits(run)).hexdigest())
"""


def in_a_new_process(code, **environment):
    here = os.path.dirname(os.path.abspath(__file__))
    options = dict(capture_output=True, text=True, timeout=120, cwd=here)
    return subprocess.run([sys.executable, "-c", code], env={**os.environ, **environment}, check=True, **options).stdout
