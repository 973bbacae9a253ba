"""`Scene`: what is simulated."""

from __future__ import annotations

import copy
import dataclasses
import functools
import hashlib
import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mpsim.core import checks
from mpsim.core.checks import ReadOnly
from mpsim.core.columns import IMAGE, Column, equal_sizes
from mpsim.core.late import view
from mpsim.core.state import Box, State, moved_into, no_state
from mpsim.errors import InputError
from mpsim.features import FEATURES, PER_DISC
from mpsim.features.baths import ThermalWalls, Thermostat
from mpsim.features.capsules import CapsuleIndex
from mpsim.features.edges import BoundaryName, Edge, MovingWall, check_boundary, wraps_of
from mpsim.features.emitters import Emitter, check_edges
from mpsim.features.feature import Continuation, Deepest, Feature, given, tuple_of
from mpsim.features.obstacles import Obstacle, capsules_of, check_obstacles
from mpsim.features.piston import Piston, check_piston
from mpsim.features.properties import Restitution, check_acceleration, check_friction, check_gravity, check_radius
from mpsim.kernels.geometry import RADIUS
from mpsim.scene import starts
from mpsim.scene.settings import NAMES, Settings, check_recommended, check_settings

SLOWEST, FASTEST = 1e-6, 10.0
"""Bounds of the rate of compression. Collisions per disc grow as its inverse; at the fastest, discs hardly move."""

LARGEST_COUNT = 100_000_000
"""More discs than this is taken for a mistake (a scene of this size needs some 10 GB)."""


CHANGEABLE: dict[str, Callable[[Any, Any], Any] | None] = {
    "gravity": lambda scene, value: check_gravity(value),
    "restitution": lambda scene, value: checks.between("restitution", value, 0, 1),
    "wall_restitution": lambda scene, value: checks.between("wall_restitution", value, 0, 1),
    "obstacles": lambda scene, value: check_obstacles(value, scene.width, scene.height),
    "emitters": lambda scene, value: tuple_of("emitters", value, (Emitter,)),
    "piston": lambda scene, value: check_piston(value, scene),
    **dict.fromkeys(("friction", "wall_friction", "thermostat", "thermal_walls", "_has_gaps", "_piston_from")),
}
"""The arguments that can change in the scene of a simulation, and the check of each; None: the caller checks it."""


class Scene(ReadOnly):
    """Discs in a box. It is checked when made; its arrays are read-only copies. Unused features cost nothing.

    Args:
        width, height: inner size of the box, x in [0, width], y in [0, height] [length], > 0.
        position: centres, shape (N, 2) [length], at least one radius from the walls (along a periodic axis: in the
            box); N may be 0. Discs may overlap: the first frames push them apart.
        velocity: shape (N, 2) [length/time].
        radius: of every disc, or one each, shape (N,) [length], > 0, at most half of the box.
        mass: one each, shape (N,) [mass], > 0; None: 1 each.
        gravity: (gx, gy), one acceleration for all discs [length/time^2].
        acceleration: one per disc, shape (N, 2) [length/time^2].
        restitution: of two discs, from 0 (perfectly inelastic) to 1 (elastic) [dimensionless].
        wall_restitution: of a disc and a wall or an obstacle, likewise.
        friction: Coulomb's friction coefficient of two discs, >= 0 [dimensionless]: the largest ratio of the tangential
            to the normal impulse, infinite for discs that never slide. With friction, discs spin.
        wall_friction: of a disc and a wall or an obstacle, likewise.
        tangential_restitution: for contacts that do not slide: minus the ratio of the tangential relative velocity of
            the surfaces after the contact to that before, from -1 (smooth) through 0 (they stick) to 1 (perfectly
            rough) [dimensionless].
        spin: angular velocity at the start, counter-clockwise, of all discs or one each, shape (N,) [1/time]; None: 0.
        boundary: "walls" or "periodic", or one for x and one for y. A periodic axis is at least two diameters long.
        obstacles: FixedDisc, Polyline and Circle objects, in the box.
        emitters: Emitter objects, which add discs while the scene runs.
        absorbing: edges, of "left", "right", "bottom", "top", at which discs leave for good.
        piston: a wall that moves, or a list of such walls.
        thermostat: a Thermostat, which gives discs new velocities at random.
        thermal_walls: ThermalWalls, which discs leave with new velocities.
        duration: recommended length of a run [time], > 0. It and the following are not part of the digest.
        settings: recommended Settings, used by runs that are given none; None: the defaults.
        picture_interval: recommended time between two pictures of an animation or a trajectory [time], > 0.
        measures: recommended measures: names as for `Simulation.run(measures=...)`.

    Raises:
        InputError: naming the argument, its rule and the value received.

    >>> scene = Scene(width=4, height=3, position=[[1, 1], [3, 2]], velocity=[[1, 0], [0, 0]], radius=0.5)
    >>> scene.count, round(scene.packing, 3)
    (2, 0.131)
    """

    _instead = "Make another Scene; sim.change(...) changes a simulation that runs"
    _set_once = frozenset({
        "width", "height", "radius", "mass", "gravity", "acceleration", "restitution", "wall_restitution", "boundary",
        "obstacles", "emitters", "absorbing", "piston",
    })  # fmt: skip
    friction: float = 0.0
    wall_friction: float = 0.0
    tangential_restitution: float = 0.0
    spin: NDArray[np.float64] | None = None
    thermostat: Thermostat | None = None
    thermal_walls: ThermalWalls | None = None
    duration: float | None = None
    settings: Settings | None = None
    picture_interval: float | None = None
    measures: tuple[str, ...] = ()
    _start: starts.Start
    _has_gaps: bool = False  # discs have been removed from the simulation whose scene this is
    _piston_from: tuple[float, float | None] = (0.0, None)  # time and place at which it got its speed there
    _is_changed: bool = False  # there, and not checked as a whole since, as a scene is when it is made
    _redraw: Callable[[int], Scene] | None = None  # makes another start of it, from a seed
    _capsules: tuple[float, NDArray[np.float64]] | None = None
    _capsule_index: CapsuleIndex | None = None
    _overlaps: str | None = None

    def __init__(
        self,
        *,
        width: float,
        height: float,
        position: ArrayLike,
        velocity: ArrayLike,
        radius: ArrayLike,
        mass: ArrayLike | None = None,
        gravity: ArrayLike | None = None,
        acceleration: ArrayLike | None = None,
        restitution: float = 1.0,
        wall_restitution: float = 1.0,
        friction: float = 0.0,
        wall_friction: float = 0.0,
        tangential_restitution: float = 0.0,
        spin: ArrayLike | None = None,
        boundary: BoundaryName | Sequence[BoundaryName] = "walls",
        obstacles: Sequence[Obstacle] | Obstacle = (),
        emitters: Sequence[Emitter] | Emitter = (),
        absorbing: Sequence[Edge] | Edge = (),
        piston: Piston | Iterable[Piston] | None = None,
        thermostat: Thermostat | None = None,
        thermal_walls: ThermalWalls | None = None,
        duration: float | None = None,
        settings: Settings | None = None,
        picture_interval: float | None = None,
        measures: Sequence[str] | str = (),
    ):
        self.width: float = checks.positive("width", width, "[length]")
        self.height: float = checks.positive("height", height, "[length]")
        self._start = starts.start_of(position, velocity)
        count = checks.whole("the number of discs", self.count, 0, LARGEST_COUNT, "Give a number in this range.")
        self.radius: float | NDArray[np.float64] = check_radius(radius, count)
        self.mass: NDArray[np.float64] | None = None if mass is None else checks.masses(mass, count)
        self.gravity: NDArray[np.float64] | None = check_gravity(gravity)
        self.acceleration: NDArray[np.float64] | None = check_acceleration(acceleration, count)
        self.restitution: float = checks.between("restitution", restitution, 0, 1)
        self.wall_restitution: float = checks.between("wall_restitution", wall_restitution, 0, 1)
        vars(self).update(check_friction(friction, wall_friction, tangential_restitution, spin, count))
        self.boundary: tuple[str, str] = check_boundary(boundary)
        self.obstacles: tuple[Obstacle, ...] = check_obstacles(obstacles, self.width, self.height)
        self.emitters: tuple[Emitter, ...] = tuple_of("emitters", emitters, (Emitter,))
        self.absorbing: tuple[str, ...] = check_edges(absorbing, self.boundary)
        self.piston: Piston | tuple[Piston, ...] | None = check_piston(piston, self)
        vars(self).update(
            given("thermostat", thermostat, Thermostat) | given("thermal_walls", thermal_walls, ThermalWalls)
        )
        vars(self).update(check_recommended(duration, settings, picture_interval, measures))
        starts.demand_room(self.largest_radius, self.width, self.height, self.boundary)
        self._check()

    # --- discs

    @property
    def count(self) -> int:
        """Number of discs."""
        return self._start.count

    @property
    def position(self) -> NDArray[np.float64]:
        """Centres, shape (N, 2), read-only [length]. Those of a lattice are computed when first needed, and kept."""
        return self._start.position

    @property
    def velocity(self) -> NDArray[np.float64]:
        """Velocities, shape (N, 2), read-only [length/time], as `position`."""
        return self._start.velocity

    def rows(self, first: int, last: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Positions and velocities of some discs, without those of the others where the scene is `Scene.lattice`.

        Args:
            first, last: the first disc and the one after the last, 0 <= first <= last <= count.

        Returns:
            Two arrays of shape (last - first, 2) [length], [length/time]: views of arrays that were given.

        Raises:
            InputError: if the scene has no such discs.

        >>> scene = Scene.lattice(count=1_000_000, packing=0.5, radius=0.5)
        >>> position, velocity = scene.rows(500_000, 500_003)
        >>> position.shape, bool((abs(position[:, 0] - scene.width / 2) < 1).all())
        ((3, 2), True)
        """
        first = checks.whole("first", first, 0, self.count, "Give the number of a disc.")
        last = checks.whole("last", last, first, self.count, "Give the number after that of a disc.")
        return self._start.positions(first, last), self._start.velocities(first, last)

    @functools.cached_property
    def largest_radius(self) -> float:
        """Radius of the largest disc, emitters' discs included [length]."""
        return float(self._every_radius().max(initial=0.0))

    @functools.cached_property
    def smallest_radius(self) -> float:
        """Radius of the smallest disc, emitters' discs included [length]."""
        return float(self._every_radius().min(initial=self.largest_radius))

    def _every_radius(self) -> NDArray[np.float64]:
        return np.append(np.ravel(self.radius), [e.radius for e in self.emitters if e.radius is not None])

    @property
    def radii(self) -> NDArray[np.float64]:
        """Radius of each disc, shape (N,), read-only [length]."""
        return self.radius if isinstance(self.radius, np.ndarray) else equal_sizes(self.radius, self.count)

    @property
    def masses(self) -> NDArray[np.float64]:
        """Mass of each disc, shape (N,), read-only [mass]."""
        return equal_sizes(1.0, self.count) if self.mass is None else self.mass

    @property
    def packing(self) -> float:
        """Packing fraction at the start: area of the discs over that of the box between its walls."""
        low, high = self.walls_at(0.0)
        (width, height), radii = (high - low).tolist(), self.radii
        parts = (radii[first:last] / width * (radii[first:last] / height) for first, last in self._start.pieces())
        return math.pi * sum(float(part.sum()) for part in parts)

    def digest(self) -> str:
        """Hex digest of everything that a run depends on, without recommendations; equal digests mean equal bits.

        >>> made = Scene.random(count=100, packing=0.4, radius=0.5, seed=1)
        >>> Scene.load("gas").digest() == made.digest()
        True
        """
        digest = hashlib.blake2b(digest_size=16)
        made = {"position": self._start.positions, "velocity": self._start.velocities}
        for name in sorted(self.__getstate__().keys() - {*NAMES, "_start", "_is_changed"} | made.keys(), key=_plain):
            digest.update(f"{_plain(name)} ".encode())
            if name in made:
                digest.update(f"{(self.count, 2)} ".encode())
                for first, last in self._start.pieces():
                    digest.update(np.ascontiguousarray(made[name](first, last), "<f8").tobytes())
                continue
            value = getattr(self, name)
            if isinstance(value, np.ndarray):
                array = np.ascontiguousarray(value, "<f8")
                digest.update(f"{array.shape} ".encode() + array.tobytes())
            else:
                digest.update(f"{value!r} ".encode())  # in which floats lose no bit
        return digest.hexdigest()

    # --- the box

    @property
    def periodic(self) -> tuple[bool, bool]:
        """Whether x, and whether y, is periodic."""
        return wraps_of(self.boundary)

    @property
    def box(self) -> Box:
        """The box: x_low, x_high, y_low, y_high [length]. A wall that moves may start inside it."""
        return self._box_at(0.0)

    def walls_at(self, time: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Lower left and upper right corner (x, y) of the box at a time: a wall may have moved [length].

        Raises:
            InputError: for a time that is not a number >= 0; it may be infinite, where no wall moves for ever.

        >>> Scene.load("piston").walls_at(float("inf"))[1].tolist()
        [20.0, 20.0]
        """
        time = checks.time_to_come("time", time)
        if any(time == wall.rests == math.inf for wall in self._moving_walls):
            raise InputError("time must be finite in a scene with a wall that never rests; got inf. Choose one.")
        box = self._box_at(time)
        return np.array(box[::2]), np.array(box[1::2])

    def limits(
        self, radius: float | NDArray[np.float64], time: float = 0.0
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Smallest and largest centre coordinates of discs of a radius at a time, shapes (2,) or (N, 2) [length]."""
        low, high = self.walls_at(time)
        margin = np.multiply.outer(np.asarray(radius), ~np.array(self.periodic))
        return low + margin, high - margin

    def capsules_at(self, time: float) -> NDArray[np.float64]:
        """Obstacles as capsules (segments with a radius), read-only, shape (K, 5): ax, ay, bx, by, radius [length].

        time: at which they are there, as obstacles may move [time].
        """
        return self._capsules_at(time)[:, : RADIUS + 1]

    # --- files, and other starts

    @classmethod
    def load(cls, source: str | os.PathLike[str]) -> Scene:
        """A scene that comes with mpsim, or one from a scene file.

        Args:
            source: a name, such as "gas", or a path that ends in .toml. The file may refer to arrays in its own folder
                or below; nothing in it is executed. mpsim.scene.scenefile.load also returns its texts.

        Raises:
            InputError: if there is no such scene; SceneFileError, a subclass, lists everything that is wrong in a file.

        >>> Scene.load("gas")
        <Scene: 100 discs of radius 0.5 in 14.0125 x 14.0125, packing 0.4>
        """
        return view("scene_from_file", source).scene

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a scene file, from which `load` restores the same scene, bit for bit.

        Args:
            path: ends in .toml; an existing file is replaced. Arrays of more than 64 rows go to .npy files beside it.

        Raises:
            InputError: if the path does not end in .toml.
            OutputError: if it cannot be written.
        """
        view("scene_to_file", self, path)

    def redrawn(self, seed: int) -> Scene:
        """Another start of the same kind: drawn at random like this one, and with other random numbers during its run.

        Args:
            seed: which one, >= 0; the same seed gives the same start.

        Raises:
            InputError: if this scene was not drawn at random, by `Scene.random`, `Scene.lattice` or a file with random
                places or velocities.

        >>> scene = Scene.random(count=50, packing=0.2, radius=0.5, seed=1)
        >>> bool((scene.redrawn(3).position == scene.position).any()), scene.redrawn(3).packing == scene.packing
        (False, True)
        """
        seed = checks.whole("seed", seed, 0, 2**63 - 1, "Any whole number will do.")
        if self._redraw is None:
            raise InputError(
                "another start needs a scene that was drawn at random, by Scene.random, Scene.lattice or a scene file "
                f"with random places or velocities; got {self!r}, whose discs were given. Make other starts yourself."
            )
        other = self._redraw(seed)
        other._vary(lambda: f"start {seed}")
        return other

    def starting_from(self, state: State, time: float = 0.0) -> Scene:
        """The same scene with the positions, velocities and spins of a state, to continue from there.

        Absorbed discs are left out, with all their properties. A piston starts where the state has it. Image flags
        start at 0. A thermostat gets another seed, which follows from its own and the state.

        Args:
            state: of as many discs as the scene has, absorbed ones included. Coordinates may lie beyond a wall by the
                rounding of their precision (float32 if each is a float32 number); they are moved to the wall.
            time: of the run at which the state was, such as sim.time: motions go on from there [time].

        Raises:
            InputError: if the number of discs differs, or the state does not fit the box.

        >>> scene = Scene(width=4, height=3, position=[[1, 1]], velocity=[[1, 0]], radius=0.5, gravity=(0, -1))
        >>> scene.starting_from(State(np.array([[2.0, 2.0]]), np.array([[0.0, 0.0]]))).position.tolist()
        [[2.0, 2.0]]
        """
        if not isinstance(state, State):  # pyright: ignore[reportUnnecessaryIsInstance] - callers without a checker
            raise no_state("state must be a State", state)
        if len(state.position) != self.count:
            raise InputError(
                f"a state for starting_from must hold the scene's {self.count} discs; got {len(state.position)}. "
                "Make a new Scene for another number of discs."
            )
        time, present = checks.time_to_come("time", time), state.present
        written, state = state.position[present], self._placed(state)
        meaning = f"({self.count}, 2)"
        position = checks.finite_array("position", state.position, (self.count, 2), meaning)[present]
        velocity = checks.finite_array("velocity", state.velocity, (self.count, 2), meaning)[present]
        other = copy.copy(self)
        other._forget_run()  # what is absent is left out, and time begins anew
        for feature in self._features:
            if state.box is not None:
                vars(other)[feature.argument] = feature.continued(other, Continuation(state.box, time))
            for column in feature.columns:
                if column.given and column.in_state and (values := getattr(state, column.name)) is not None:
                    shape = column.rows(self.count)
                    vars(other)[column.name] = checks.finite_array(column.name, values, shape, f"{shape}")
        other._vary(lambda: f"state {state.digest()}")
        other._keep(present)
        inside = np.clip(position, *other.limits(other.radius))
        rounding = 8 * checks.resolution(written) * np.abs(written).max(initial=max(self.width, self.height))
        other._start_anew(np.where(np.abs(inside - position) <= rounding, inside, position), velocity)
        other._check_inside("position", other.position, other.radius)
        return other

    def compressed(self, packing: float, *, rate: float = 0.01) -> Scene:
        """The same discs in a smaller box of the same shape, at a higher packing fraction, without overlap.

        By the algorithm of Lubachevsky and Stillinger (J. Stat. Phys. 60, 561, 1990): discs fly and collide by the
        exact solver while their radii grow in proportion to time; then the box and all places are scaled down. Each
        disc keeps its radius, and the total kinetic energy is unchanged. Gravity, accelerations, restitution, friction
        and a thermostat do not act during compression. The same scene gives the same bits; `redrawn` compresses another
        start.

        Args:
            packing: packing fraction of the whole box, also between walls; above that of the scene.
            rate: speed at which the mean diameter grows, as a fraction of the thermal speed sqrt(kT/m) [1], from 1e-6
                to 10. The time needed is inversely proportional to it. Equal discs order when it is low, and jam in
                disorder when it is high; discs of two sizes jam at about 0.84 (O'Hern et al., Phys. Rev. E 68, 011306,
                2003).

        Raises:
            InputError: naming the argument, its rule and the value received; for a scene whose discs overlap or are all
                at rest, or one with obstacles, emitters, absorbing edges or a piston; or if the discs jam before they
                reach the packing; the error names the one they reached [1].

        >>> scene = Scene.random(count=100, packing=0.5, radius=0.5, boundary="periodic", seed=1)
        >>> dense = scene.compressed(0.75)
        >>> dense, dense.overlaps_at_start()
        (<Scene: 100 discs of radius 0.5 in 10.2333 x 10.2333, packing 0.75, periodic xy>, '')
        """
        return view("compressed", self, packing, rate)

    def overlaps_at_start(self) -> str:
        """Overlaps in words, for a warning: between discs, through periodic borders too, and with obstacles.

        >>> places, rest = [[2, 2], [2.75, 2]], np.zeros((2, 2))
        >>> Scene(width=9, height=9, position=places, velocity=rest, radius=0.5).overlaps_at_start()
        '1 pair of discs overlaps at the start: discs 0 and 1, by 0.25'
        """
        if self._overlaps is None:
            self._overlaps = starts.overlaps_in_words(self)
        return self._overlaps

    @classmethod
    def random(
        cls,
        *,
        count: int,
        radius: ArrayLike,
        mass: ArrayLike | None = None,
        temperature: float = 1.0,
        seed: int = 0,
        packing: float | None = None,
        width: float | None = None,
        height: float | None = None,
        boundary: BoundaryName | Sequence[BoundaryName] = "walls",
        obstacles: Sequence[Obstacle] | Obstacle = (),
        inside: Sequence[float] | Obstacle | None = None,
        **others: Any,
    ) -> Scene:
        """Discs at random places without overlap, with thermal velocities.

        Args:
            count: number of discs, >= 0.
            radius: of every disc, or one each, shape (count,) [length], > 0.
            mass: likewise [mass], > 0; None: 1 each.
            temperature: kT: the mean of m v_x^2 and m v_y^2 over the discs [mass length^2/time^2], >= 0. Velocities are
                normally distributed, of zero total momentum from 2 discs on, and scaled so that this mean is exact.
                Two discs therefore have opposite momenta, and only the direction is random: between walls a special
                start, whose averages are not those of `measure.reference.two_discs`. For others use Scene(...).
            seed: of the random numbers, >= 0; the same seed gives the same scene.
            packing: packing fraction, from which the side of a square box follows, 0 < packing <= 0.8.
            width, height: the box, instead of packing.
            boundary, obstacles: as for Scene. Discs do not overlap obstacles, whose area packing ignores.
            inside: part of the box for the discs: (x_low, y_low, x_high, y_high) of their centres, or a Circle
                or a closed Polyline around them. None: all of it, between pistons as they start.
            others: further arguments of Scene, such as gravity or duration.

        Positions come from random sequential addition up to packing 0.4. Denser scenes start from a hexagonal lattice
        or, with discs of several sizes, periodic axes or obstacles, from overlap removal. Monte Carlo steps (Metropolis
        et al. 1953) then bring them near equilibrium. For still denser scenes, use `compressed`.

        Raises:
            InputError: naming the argument, its rule and the value received; if no arrangement is found.

        >>> scene = Scene.random(count=1000, packing=0.3, radius=0.5, seed=7)
        >>> round(scene.packing, 12), round(float((scene.velocity**2).mean()), 12)
        (0.3, 1.0)
        >>> mixture = Scene.random(count=90, packing=0.7, radius=[0.5] * 30 + [0.2] * 60, boundary="periodic")
        >>> round(mixture.packing, 12)
        0.7
        """
        _check_others(cls.random, others)
        count = checks.whole("count", count, 0, LARGEST_COUNT, "Give a number in this range.")
        seed = checks.whole("seed", seed, 0, 2**63 - 1, "Any whole number will do.")
        radius = check_radius(radius, count)
        masses = None if mass is None else checks.masses(mass, count)
        temperature = checks.non_negative("temperature", temperature, "[mass length^2/time^2]")
        edges = check_boundary(boundary)
        width, height = starts.box_for(count, radius, packing, width, height, edges)
        solid = check_obstacles(obstacles, width, height)
        rng = np.random.default_rng(seed)
        region = None if inside is None else starts.check_region("inside", inside)
        room = room_at_start((width, height), edges, radius, others.get("piston"))
        room = room._replace(capsules=capsules_of(solid, 0.0))
        position = starts.random_places(radius, count, room, region, rng)
        velocity = starts.thermal_velocities(count, temperature, masses, rng)
        box: dict[str, Any] = {"width": width, "height": height, "boundary": edges, "obstacles": solid, **others}
        made = cls(position=position, velocity=velocity, radius=radius, mass=masses, **box)
        kind: dict[str, Any] = {"count": count, "radius": radius, "mass": mass, "temperature": temperature, **box}
        made._redraw = lambda other: cls.random(**kind, inside=inside, seed=_seed_of(seed, other))
        return made

    @classmethod
    def groups(
        cls,
        groups: Iterable[Mapping[str, Any]],
        *,
        packing: float | None = None,
        width: float | None = None,
        height: float | None = None,
        **others: Any,
    ) -> Scene:
        """Groups of discs, each placed by its own rule, one after the other: what `[[discs]]` are in a scene file.

        Args:
            groups: of each the keys of a `[[discs]]` table with their values, such as places, count, radius, mass,
                temperature, seed; region may also be a Circle or a closed Polyline.
            packing: packing fraction, from which the side of a square box follows, > 0.
            width, height: the box, instead of packing.
            others: further arguments of Scene, such as gravity or obstacles.

        Raises:
            InputError: naming all that is wrong, by group and key.

        >>> large = {"position": [[3, 3]], "radius": 1.5, "mass": 20}
        >>> small = {"places": "random", "count": 30, "radius": 0.2, "region": (0.2, 0.2, 5.8, 3.8)}
        >>> Scene.groups([large, small], width=6, height=6, gravity=(0, -1))
        <Scene: 31 discs of radii 0.2 to 1.5 in 6 x 6, packing 0.301, mass, gravity>
        """
        _check_others(cls.groups, others)
        return view("scene_of_groups", groups, {"packing": packing, "width": width, "height": height}, others)

    @classmethod
    def lattice(
        cls,
        *,
        count: int,
        radius: float,
        packing: float | None = None,
        width: float | None = None,
        height: float | None = None,
        temperature: float = 1.0,
        seed: int = 0,
        boundary: BoundaryName | Sequence[BoundaryName] = "walls",
        **others: Any,
    ) -> Scene:
        """Equal discs near the sites of a hexagonal lattice that fills the box, with thermal velocities.

        Each disc is computed from its number. So `rows` needs memory only for the range asked for, and a checkpoint or
        another process gets the arguments instead of arrays (a scene file holds arrays). Discs are numbered column by
        column. Each is displaced from its site at random, by less than half of the gap to its neighbours, so that none
        overlap.

        Args:
            count: number of discs, >= 0.
            radius: of every disc [length], > 0. Each has mass 1.
            packing: packing fraction, from which the side of a square box follows, > 0; up to about 0.9 in large boxes.
            width, height: the box, instead of packing.
            temperature: kT: the mean of v_x^2 and v_y^2 over the discs [length^2/time^2], >= 0. Velocities are normally
                distributed, of zero total momentum from 2 discs on, and scaled so that this mean is exact.
            seed: of the random numbers, >= 0; the same seed gives the same scene.
            boundary: as for Scene.
            others: further arguments of Scene, such as gravity or duration, except mass and obstacles.

        Raises:
            InputError: naming the argument, its rule and the value received; if the lattice has no room for the discs.

        >>> scene = Scene.lattice(count=100_000, packing=0.5, radius=0.5, seed=7)
        >>> scene
        <Scene: 100000 discs of radius 0.5 in 396.333 x 396.333, packing 0.5>
        """
        _check_others(cls.lattice, others)
        count = checks.whole("count", count, 0, LARGEST_COUNT, "Give a number in this range.")
        seed = checks.whole("seed", seed, 0, 2**63 - 1, "Any whole number will do.")
        starts.demand_equal_discs(radius, others)
        radius = checks.positive("radius", radius, "[length]")
        temperature = checks.non_negative("temperature", temperature, "[length^2/time^2]")
        edges = check_boundary(boundary)
        width, height = starts.box_for(count, radius, packing, width, height, edges)
        start: Any = starts.Lattice(count, radius, width, height, wraps_of(edges), temperature, seed)
        starts.demand_sites(start, packing)
        kind: dict[str, Any] = {"radius": radius, "width": width, "height": height, "boundary": edges, **others}
        made = cls(position=start, velocity=start, **kind)
        starts.demand_whole_box(made)
        kind |= {"count": count, "temperature": temperature}
        made._redraw = lambda other: cls.lattice(**kind, seed=_seed_of(seed, other))
        return made

    # --- for people

    def _repr_png_(self) -> bytes:
        """A small picture for notebooks."""
        return view("scene_png", self)

    def __repr__(self) -> str:
        discs = f"{self.count} disc{'s' * (self.count != 1)}"
        if not np.ndim(self.radius):
            discs += f" of radius {self.largest_radius:g}"
        elif self.count:
            discs += f" of radii {self.radii.min():g} to {self.radii.max():g}"
        extras = [each.brief(self) for each in sorted(FEATURES, key=lambda each: bool(each.several))]
        extras += [f"{name} {getattr(self, name):g}" for name in Restitution.numbers if getattr(self, name) < 1]
        axes = "".join(axis for axis, wraps in zip("xy", self.periodic, strict=True) if wraps)
        extras += [f"periodic {axes}"] if axes else []
        low, high = self.walls_at(0.0)
        size = " x ".join(f"{side:g}" for side in high - low)
        if (high - low).tolist() != [self.width, self.height]:
            size += f" of {self.width:g} x {self.height:g}"
        return f"<Scene: {', '.join(filter(None, [f'{discs} in {size}', f'packing {self.packing:.3g}', *extras]))}>"

    # --- for the rest of mpsim

    def __getstate__(self) -> dict[str, Any]:
        """All that the scene holds, without how it was made; of a lattice its numbers, without arrays."""
        return {name: value for name, value in vars(self).items() if name not in _DERIVED}

    @property
    def _on_lattice(self) -> starts.Lattice | None:
        """The lattice on which the discs start; None if their places were given."""
        return self._start if isinstance(self._start, starts.Lattice) else None

    def _velocities_in_pieces(self) -> Iterator[tuple[int, NDArray[np.float64]]]:
        """The first disc of each piece, and the velocities of the discs in it, shape (K, 2) [length/time]."""
        return ((first, self._start.velocities(first, last)) for first, last in self._start.pieces())

    def _placed(self, state: State) -> State:
        """A state in the coordinates of the scene, each disc at its image in the box.

        A state of a file has a box of its own, which may begin anywhere, and discs that other programs have not
        wrapped. Walls at rest coincide. A state without a box has that of the scene.
        """
        box = self.box if state.box is None else state.box
        corner, moving = [box[0], box[2]], [wall.edge for wall in self._moving_walls]
        for low in (0, 2):
            if low in moving:  # of two walls that move, none tells where the box begins: as in states of this scene
                corner[low // 2] = 0.0 if low + 1 in moving else box[low + 1] - (self.width, self.height)[low // 2]
        return moved_into(state, box, self.periodic, (corner[0], corner[1]))

    def _start_anew(self, position: NDArray[np.float64], velocity: NDArray[np.float64]) -> None:
        """Let the scene, a copy that nothing else refers to, start from arrays of shape (N, 2)."""
        self._start = starts.GivenStart(checks.read_only(position), checks.read_only(velocity))

    def _without_discs(self) -> Scene:
        """A copy in which no disc starts, for checks of the rest."""
        other = copy.copy(self)
        vars(other)["radius"] = self.largest_radius
        other._start_anew(np.zeros((0, 2)), np.zeros((0, 2)))
        return other

    @property
    def _loses_discs(self) -> bool:
        """Whether discs can be absent: absorbed at an edge, or removed from a simulation of this scene."""
        return bool(self.absorbing) or self._has_gaps

    def _replace(self, **values: Any) -> Scene:
        """The scene of a simulation whose parameters, obstacles or discs are changed.

        Args:
            values: by name, of arguments in CHANGEABLE, of which some are checked, others by the caller.
        """
        other = copy.copy(self)
        other._is_changed = True
        for name, value in values.items():
            check = CHANGEABLE[name]
            vars(other)[name] = value if check is None else check(other, value)
        return other

    def _begun(self) -> Scene:
        """The scene as a simulation of it begins: all discs are there, and pistons at their starts.

        Raises:
            InputError: for one that was changed in a simulation, and as it now is has no room for its start.
        """
        if not self._is_changed:
            return self
        other = copy.copy(self)
        other._forget_run()
        other._check()
        return other

    def _forget_run(self) -> None:
        for name in ("_has_gaps", "_piston_from", "_is_changed"):
            vars(self).pop(name, None)

    def _check(self) -> None:
        """Refuse discs outside the box, and what does not fit the rest of the scene."""
        if self._on_lattice is None:  # whose discs are inside by construction
            self._check_inside("position", self.position, self.radius)
        for feature in self._features:
            feature.check(self)

    def _vary(self, variation: Callable[[], str]) -> None:
        """Give the scene, a copy that nothing else refers to, other random numbers for its run, derived from a text."""
        for feature in FEATURES:
            if feature.draws and feature.is_in(self):
                value = feature.of(self)
                digest = hashlib.blake2b(f"{value.seed} {variation()}".encode(), digest_size=8).digest()
                seed = int.from_bytes(digest, "little") >> 1
                vars(self)[feature.argument] = dataclasses.replace(value, seed=seed)

    def _keep(self, kept: NDArray[np.bool_]) -> None:
        """Keep what the discs of a mask, shape (count,), have of their own, and drop the others."""
        if not kept.all():
            for name, each in PER_DISC.items():
                if isinstance(values := getattr(self, name), np.ndarray):
                    vars(self)[name] = each.check(values[kept], int(kept.sum()))

    @functools.cached_property
    def _features(self) -> tuple[Feature, ...]:
        return tuple(each for each in FEATURES if each.is_in(self))

    @functools.cached_property
    def _columns(self) -> list[Column]:
        own = [IMAGE] if any(self.periodic) else []
        there = [each for each in FEATURES if each.is_in(self) or (self._has_gaps and each.removes_discs)]
        return own + [column for feature in there for column in feature.columns]

    @functools.cached_property
    def _moving_walls(self) -> tuple[MovingWall, ...]:
        """The walls that move; () if all are at rest."""
        return tuple(wall for feature in self._features for wall in feature.moving_walls(self))

    @functools.cached_property
    def _surface_speed(self) -> float:
        """The highest speed of a moving wall or obstacle [length/time]; 0: all are at rest."""
        return max((feature.surface_speed(self) for feature in self._features), default=0.0)

    @functools.cached_property
    def _driving_speed(self) -> float:
        """The highest speed to which a surface can drive discs, also along itself [length/time]; 0: none moves."""
        running = max((feature.running_speed(self) for feature in self._features), default=0.0)
        return max(self._surface_speed, running)

    @functools.cached_property
    def _works(self) -> tuple[int | str, ...]:
        """What does work on discs or heats them, as `Simulation.work` names it; () if nothing does."""
        return tuple(name for feature in self._features for name in feature.works(self))

    def _box_at(self, time: float) -> Box:
        """The box at a time >= 0 [time]: x_low, x_high, y_low, y_high [length]."""
        edges = [0.0, self.width, 0.0, self.height]
        for wall in self._moving_walls:
            edges[wall.edge] = wall.place(time)
        return edges[0], edges[1], edges[2], edges[3]

    def _to_nearest_image(self, difference: NDArray[Any], box: Box | None = None) -> NDArray[np.float64]:
        """Differences of positions, shape (..., 2), to the nearest image along periodic axes of the box, or another."""
        x_low, x_high, y_low, y_high = box or self.box
        period = np.where(self.periodic, (x_high - x_low, y_high - y_low), np.inf)
        return difference - np.round(difference / period) * np.where(self.periodic, period, 0.0)

    def _smallest_sides(self) -> tuple[float, float]:
        """Width and height of the box with all walls that move at their innermost places [length]."""
        edges = [0.0, self.width, 0.0, self.height]
        for wall in self._moving_walls:
            edges[wall.edge] = wall.innermost
        return edges[1] - edges[0], edges[3] - edges[2]

    def _check_inside(
        self, name: str, position: NDArray[np.float64], radius: float | NDArray[np.float64], time: float = 0.0
    ) -> None:
        """Refuse discs, of one radius or one each, that are not in the box at a time.

        Raises:
            InputError: naming the first centre that is less than one radius from a wall; name: of the argument.
        """
        low, high = self.limits(radius, time)
        # A centre may touch the wall to within rounding of the box's own coordinates.
        slack = 4 * np.finfo(np.float64).eps * max(self.width, self.height)
        outside = np.argwhere(((position < low - slack) | (position > high + slack)).any(axis=1))
        if len(outside):
            index = int(outside[0, 0])
            walls = " and ".join(f"the {wall.name}'s" for wall in self._moving_walls)
            now = f", {walls} place at time {time:g} included" if walls and time > 0 else ""
            region = np.concatenate([np.broadcast_to(limit, position.shape)[index] for limit in (low, high)])
            raise InputError(
                f"{name}[{index}] must lie in {starts.region_in_words(region)} (one "
                f"radius from the walls{now}); got {tuple(position[index].tolist())} (discs outside: {len(outside)}). "
                "Move the disc or enlarge the box."
            )

    @functools.cached_property
    def _obstacles_move(self) -> bool:
        return any(each.motion is not None for each in self.obstacles)

    def _capsules_at(self, time: float) -> NDArray[np.float64]:
        """Obstacles as rows of `kernels.geometry`, read-only: the same array until they have moved."""
        if self._capsules is None or (self._obstacles_move and self._capsules[0] != time):
            self._capsules, self._capsule_index = (time, checks.read_only(capsules_of(self.obstacles, time))), None
        return self._capsules[1]

    def _capsule_index_at(self, time: float) -> CapsuleIndex:
        """The obstacles at a time, indexed for repeated queries of overlap."""
        capsules = self._capsules_at(time)
        if self._capsule_index is None:
            self._capsule_index = CapsuleIndex(capsules, (self.width, self.height), self.periodic)
        return self._capsule_index

    def _deepest(self, position: NDArray[np.float64], radius: NDArray[np.float64], time: float = 0.0) -> Deepest | None:
        """The disc that overlaps an obstacle most; None if no disc does.

        Args:
            position: centres, in the box, shape (N, 2) [length].
            radius: one each, shape (N,) [length].
            time: at which to look: obstacles may move [time].
        """
        return next(filter(None, (each.deepest(self, position, radius, time) for each in self._features)), None)


_DERIVED = {
    "_redraw", "_capsules", "_capsule_index", "_overlaps",
    *(name for name, each in vars(Scene).items() if isinstance(each, functools.cached_property)),
}  # fmt: skip
"""Attributes that copies of a scene do not have."""


def _plain(name: str) -> str:
    return name.lstrip("_")


def _check_others(draw: Callable[..., Scene], others: Iterable[str]) -> None:
    """Refuse names that are arguments neither of `draw`, a constructor of scenes, nor of Scene."""
    names = (*checks.names_of(draw), *checks.names_of(Scene.__init__))
    known = [name for name in names if name not in ("position", "velocity")]
    checks.known_arguments(f"Scene.{draw.__name__}", others, known)


def _seed_of(first: int, other: int) -> int:
    """The seed of another start, by its number, of a scene that was drawn with the seed `first`."""
    return int.from_bytes(hashlib.blake2b(f"{first} {other}".encode(), digest_size=7).digest(), "big")


def room_at_start(size: tuple[float, float], boundary: tuple[str, str], radius: Any, piston: Any) -> starts.Room:
    """An empty box, whose walls are where a run finds them. radius: of the discs to be placed there, one or many."""
    room, nobody = starts.Room(size, wraps_of(boundary)), np.zeros((0, 2))
    if piston is None:
        return room
    box: dict[str, Any] = {"width": size[0], "height": size[1], "boundary": boundary, "piston": piston}
    box["wall_friction"] = 1.0  # for a piston with a surface velocity: that the scene has none is refused later
    walls = Scene(position=nobody, velocity=nobody, radius=float(np.max(radius, initial=0.0)) or 1.0, **box).box
    return room._replace(walls=walls) if walls != (0.0, size[0], 0.0, size[1]) else room


# --- Scenes as arguments


def no_scene(value: object) -> InputError:
    """The error for a value that should be a scene; for a text, which may be a scene's name, it says how to load it."""
    remedy = f"Use mpsim.Scene.load({value!r})" if isinstance(value, str) else "Make one with Scene(...)"
    return InputError(f"scene must be an mpsim.Scene; got {type(value).__name__}. {remedy}.")


def settings_for(scene: Scene, settings: Settings | None) -> Settings:
    """The settings for a run: those given, else those that the scene recommends, else the defaults.

    Raises:
        InputError: if scene is not a Scene, or settings are not Settings.
    """
    if not isinstance(scene, Scene):  # pyright: ignore[reportUnnecessaryIsInstance] - callers without a checker
        raise no_scene(scene)
    if settings is None:
        return scene.settings or Settings()
    return check_settings(settings)


def frames_between_pictures(scene: Scene, settings: Settings) -> int | None:
    """The recommended picture interval in frames of these settings, at least 1; None without one."""
    if scene.picture_interval is None:
        return None
    return max(round(scene.picture_interval / settings.dt), 1)
