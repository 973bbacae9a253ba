"""`Scene`: what is simulated."""

from __future__ import annotations

import copy
import functools
import hashlib
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mpsim.core import checks
from mpsim.core.checks import ReadOnly
from mpsim.core.state import Box, State, no_state, view
from mpsim.errors import InputError
from mpsim.features import FEATURES
from mpsim.features.absorption import check_edges
from mpsim.features.baths import ThermalWalls, Thermostat, check_thermal_walls, check_thermostat
from mpsim.features.capsules import CapsuleIndex
from mpsim.features.edges import BoundaryName, Edge, MovingWall, check_boundary, kinds_of, wraps_of
from mpsim.features.emitters import Emitter, check_emitters
from mpsim.features.feature import Deepest, Moment
from mpsim.features.laws import Restitution, check_friction
from mpsim.features.obstacles import Obstacle, capsules_of, check_obstacles
from mpsim.features.piston import Piston, check_piston
from mpsim.features.properties import check_acceleration, check_gravity, check_radius
from mpsim.scene import placement, starts
from mpsim.scene.discs import HasDiscs, Lattice, demand_equal_discs, demand_sites, demand_whole_box, start_of
from mpsim.scene.placement import placed
from mpsim.scene.settings import Recommends, Settings, check_recommended
from mpsim.scene.starts import overlaps_in_words

# --- A scene in one line, for its repr


def brief(scene: Any) -> str:
    """Number of discs, their sizes, the box, and what else the scene has."""
    discs = f"{scene.count} disc{'s' * (scene.count != 1)}"
    if not np.ndim(scene.radius):
        discs += f" of radius {scene.largest_radius:g}"
    elif scene.count:
        discs += f" of radii {scene.radii.min():g} to {scene.radii.max():g}"
    extras = [each.brief(scene) for each in sorted(FEATURES, key=lambda each: each.several)]
    extras += [f"{name} {getattr(scene, name):g}" for name in Restitution.numbers if getattr(scene, name) < 1]
    axes = "".join(axis for axis, wraps in zip("xy", scene.periodic, strict=True) if wraps)
    extras += [f"periodic {axes}"] if axes else []
    low, high = scene.walls_at(0.0)
    size = " x ".join(f"{side:g}" for side in high - low)
    if (high - low).tolist() != [scene.width, scene.height]:
        size += f" of {scene.width:g} x {scene.height:g}"
    return f"<Scene: {discs} in {size}, packing {scene.packing:.3g}{''.join(', ' + text for text in extras if text)}>"


# --- A scene that continues from a state of a run of it: with what the present discs have at that time


def move_to_state(scene: Any, state: State, time: float) -> None:
    """Change a scene, a copy that nothing else refers to, so that it starts from a state: see `Scene.starting_from`.

    Raises:
        InputError: if the number of discs differs, or a number is not finite.
    """
    if not isinstance(state, State):  # pyright: ignore[reportUnnecessaryIsInstance] - callers without a checker
        raise no_state("state must be a State", state)
    count, shape, meaning = scene.count, (scene.count, 2), f"({scene.count}, 2)"
    if len(state.position) != count:
        raise InputError(
            f"a state for starting_from must hold the scene's {count} discs; got {len(state.position)}. "
            "Make a new Scene for another number of discs."
        )
    written, state = state.position[state.present], placed(state, scene)
    position = checks.finite_array("position", state.position, shape, meaning)
    velocity = checks.finite_array("velocity", state.velocity, shape, meaning)
    for feature in [each for each in FEATURES if each.is_in(scene)]:
        if state.box is not None:
            vars(scene)[feature.argument] = feature.continued(scene, Moment(state.box, time))
        for column in feature.columns:
            if column.given and column.in_state and (values := getattr(state, column.name)) is not None:
                shape = column.rows(count)
                vars(scene)[column.name] = checks.finite_array(column.name, values, shape, f"{shape}")
    vary(scene, lambda: f"state {state.digest()}")
    _keep(scene, state.present)
    low, high = scene.limits(scene.radius)
    inside = np.clip(position[state.present], low, high)
    rounding = 8 * checks.resolution(written) * np.abs(written).max(initial=max(scene.width, scene.height))
    moved = np.abs(inside - position[state.present])
    scene.start_anew(np.where(moved <= rounding, inside, position[state.present]), velocity[state.present])
    for array in (scene.position, scene.velocity):
        array.flags.writeable = False


def vary(scene: Any, variation: Callable[[], str]) -> None:
    """Give a scene, a copy that nothing else refers to, other random numbers for its run, derived from a text."""
    for feature in FEATURES:
        if feature.draws and feature.is_in(scene):
            vars(scene)[feature.argument] = feature.redrawn(scene, variation())


CHANGEABLE: dict[str, Callable[[Any, Any], Any]] = {
    "gravity": lambda scene, value: check_gravity(value),
    "restitution": lambda scene, value: checks.fraction("restitution", value),
    "wall_restitution": lambda scene, value: checks.fraction("wall_restitution", value),
    "friction": lambda scene, value: value,
    "wall_friction": lambda scene, value: value,
    "obstacles": lambda scene, value: check_obstacles(value, scene.width, scene.height),
    "emitters": lambda scene, value: check_emitters(value),
    "piston": lambda scene, value: check_piston(value, scene.boundary, scene.width, scene.height, scene.absorbing),
    "piston_began": lambda scene, value: value,
    "thermostat": lambda scene, value: value,
    "thermal_walls": lambda scene, value: value,
    "has_gaps": lambda scene, value: value,
}
"""The arguments that `change_to` can change, and the check of each; the caller has checked those that are kept."""


def change_to(scene: Any, values: Mapping[str, Any]) -> None:
    """Give a scene, a copy that nothing else refers to, other values of some arguments.

    Raises:
        InputError: naming the argument, its rule and the value received.
    """
    for name, value in values.items():
        checks.choice("an argument of Scene.replace", name, CHANGEABLE)
        vars(scene)[name] = CHANGEABLE[name](scene, value)


def _keep(scene: Any, kept: NDArray[np.bool_]) -> None:
    """Keep what the discs of a mask, shape (count,), have of their own, and drop the others."""
    if kept.all():
        return
    for name, each in chain.from_iterable(feature.all_per_disc.items() for feature in FEATURES):
        values = getattr(scene, name)
        if isinstance(values, np.ndarray):
            vars(scene)[name] = each.check(values[kept], int(kept.sum()))


SLOWEST, FASTEST = 1e-6, 10.0
"""Bounds of the rate of compression. Collisions per disc grow as its inverse; at the fastest, discs hardly move."""

LARGEST_COUNT = 100_000_000
"""More discs than this is taken for a mistake (a scene of this size needs some 10 GB)."""


class Scene(ReadOnly, HasDiscs, Recommends):
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
        obstacles: FixedDisc and Polyline objects, in the box.
        emitters: Emitter objects, which add discs while the scene runs.
        absorbing: edges, of "left", "right", "bottom", "top", at which discs leave for good.
        piston: one wall that moves.
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
    has_gaps: bool = False  # discs have been removed from the simulation whose scene this is
    piston_began: float = 0.0  # when the piston left its start in that simulation [time]
    _redraw: Callable[[int], Scene] | None = None
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
        piston: Piston | None = None,
        thermostat: Thermostat | None = None,
        thermal_walls: ThermalWalls | None = None,
        duration: float | None = None,
        settings: Settings | None = None,
        picture_interval: float | None = None,
        measures: Sequence[str] | str = (),
    ):
        self.width: float = checks.positive("width", width, "[length]")
        self.height: float = checks.positive("height", height, "[length]")
        self._start = start_of(position, velocity)
        count = checks.whole("the number of discs", self.count, 0, LARGEST_COUNT, "Give a number in this range.")
        self.radius: float | NDArray[np.float64] = check_radius(radius, count)
        self.mass: NDArray[np.float64] | None = None if mass is None else checks.masses(mass, count)
        self.gravity: NDArray[np.float64] | None = check_gravity(gravity)
        self.acceleration: NDArray[np.float64] | None = check_acceleration(acceleration, count)
        self.restitution: float = checks.fraction("restitution", restitution)
        self.wall_restitution: float = checks.fraction("wall_restitution", wall_restitution)
        vars(self).update(check_friction(friction, wall_friction, tangential_restitution, spin, count))
        self.boundary: tuple[str, str] = check_boundary(boundary)
        self.obstacles: tuple[Obstacle, ...] = check_obstacles(obstacles, self.width, self.height)
        self.emitters: tuple[Emitter, ...] = check_emitters(emitters)
        self.absorbing: tuple[str, ...] = check_edges(absorbing, self.boundary)
        self.piston: Piston | None = check_piston(piston, self.boundary, self.width, self.height, self.absorbing)
        vars(self).update(check_thermostat(thermostat) | check_thermal_walls(thermal_walls))
        vars(self).update(check_recommended(duration, settings, picture_interval, measures))
        starts.demand_room(self.largest_radius, self.width, self.height, self.boundary)
        if self.on_lattice is None:  # whose discs are inside by construction
            self.check_inside("position", self.position, self.radius)
        for feature in FEATURES:
            feature.check(self)

    def deepest(self, position: NDArray[np.float64], radius: NDArray[np.float64], time: float = 0.0) -> Deepest | None:
        """The disc that overlaps an obstacle most; None if no disc does.

        Args:
            position: centres, in the box, shape (N, 2) [length].
            radius: one each, shape (N,) [length].
            time: at which to look: obstacles may move [time].
        """
        return next(filter(None, (feature.deepest(self, position, radius, time) for feature in FEATURES)), None)

    @property
    def dissipates(self) -> bool:
        """Whether contacts lose energy in other ways than through restitution, such as by friction."""
        return any(feature.dissipates(self) for feature in FEATURES)

    @property
    def loses_discs(self) -> bool:
        """Whether discs can be absent: absorbed at an edge, or removed from a simulation of this scene."""
        return bool(self.absorbing) or self.has_gaps

    def replace(self, **values: Any) -> Scene:
        """The same scene with other values of some arguments, for a simulation of it that is changed.

        Args:
            values: by name: gravity, restitution, wall_restitution, friction, wall_friction, obstacles, emitters,
                piston, piston_began, thermostat, thermal_walls, has_gaps.
        """
        other = copy.copy(self)
        change_to(other, values)
        return other

    @property
    def moving_wall(self) -> MovingWall | None:
        """The wall that a feature of the scene moves; None if all are at rest."""
        return placement.the_moving_wall(self)

    def walls_at(self, time: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Lower left and upper right corner (x, y) of the box at a time: a wall may have moved [length].

        Raises:
            InputError: for a time that is not a number >= 0; it may be infinite.

        >>> Scene.load("piston").walls_at(float("inf"))[1].tolist()
        [20.0, 20.0]
        """
        box = self.box_at(checks.time_to_come("time", time))
        return np.array(box[::2]), np.array(box[1::2])

    def limits(
        self, radius: float | NDArray[np.float64], time: float = 0.0
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Smallest and largest centre coordinates of discs of a radius at a time, shapes (2,) or (N, 2) [length]."""
        return placement.limits_at(self, radius, time)

    def check_inside(
        self, name: str, position: NDArray[np.float64], radius: float | NDArray[np.float64], time: float = 0.0
    ) -> None:
        """Refuse discs that are not in the box.

        Args:
            name: of the argument, for the text of the error.
            position: centres, shape (N, 2) [length].
            radius: of every disc, or one each, shape (N,) [length].
            time: at which to check: a wall may have moved [time].

        Raises:
            InputError: naming the first centre that is less than one radius from a wall.
        """
        placement.check_inside(self, name, position, radius, time)

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

    @property
    def can_redraw(self) -> bool:
        """Whether `redrawn` can make other starts of the same kind."""
        return self._redraw is not None

    def redraw_with(self, make: Callable[[int], Scene]) -> Scene:
        """This scene; from now on `redrawn` calls `make` with a seed."""
        self._redraw = make
        return self

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
        vary(other, lambda: f"start {seed}")
        return other

    @property
    def periodic(self) -> tuple[bool, bool]:
        """Whether x, and whether y, is periodic."""
        return wraps_of(self.boundary)

    @property
    def box(self) -> Box:
        """The box: x_low, x_high, y_low, y_high [length]. A wall that moves may start inside it."""
        return self.box_at(0.0)

    def box_at(self, time: float) -> Box:
        """The box at a time >= 0 [time]: x_low, x_high, y_low, y_high [length]."""
        edges = [0.0, self.width, 0.0, self.height]
        if (wall := self.moving_wall) is not None:
            edges[wall.edge] = wall.place(time)
        return edges[0], edges[1], edges[2], edges[3]

    @property
    def capsules(self) -> NDArray[np.float64]:
        """`capsules_at` the start."""
        return self.capsules_at(0.0)

    def capsules_at(self, time: float) -> NDArray[np.float64]:
        """Obstacles as capsules (segments with a radius), read-only, shape (K, 5): ax, ay, bx, by, radius [length].

        time: at which they are there, as obstacles may move [time].
        """
        if self._capsules is None or self._capsules[0] != time:
            moving = any(each.motion is not None for each in self.obstacles)
            if self._capsules is None or moving:
                capsules = capsules_of(self.obstacles, time)
                capsules.flags.writeable = False
                self._capsules, self._capsule_index = (time, capsules), None
        return self._capsules[1]

    def capsule_index(self, time: float) -> CapsuleIndex:
        """The obstacles at a time, indexed for repeated queries of overlap."""
        capsules = self.capsules_at(time)
        if self._capsule_index is None:
            self._capsule_index = CapsuleIndex(capsules, (self.width, self.height), self.periodic)
        return self._capsule_index

    @property
    def surface_speed(self) -> float:
        """The highest speed of a moving wall or obstacle [length/time]; 0: all are at rest."""
        return max(feature.surface_speed(self) for feature in FEATURES)

    @property
    def packing(self) -> float:
        """Packing fraction at the start: area of the discs over that of the box between its walls."""
        low, high = self.walls_at(0.0)
        width, height = (high - low).tolist()
        return self.packing_in(width, height)

    def starting_from(self, state: State, time: float = 0.0) -> Scene:
        """The same scene with the positions, velocities and spins of a state, to continue from there.

        Absorbed discs are left out, with all their properties. The piston starts where the state has it. Image flags
        start at 0. A thermostat gets another seed, which follows from its own and the state.

        Args:
            state: of as many discs as the scene has, absorbed ones included. Coordinates may lie beyond a wall by the
                rounding of their precision (float32 if each is a float32 number); they are moved to the wall.
            time: of the run at which the state was, such as sim.time: obstacles that move go on from there [time].

        Raises:
            InputError: if the number of discs differs, or the state does not fit the box.

        >>> scene = Scene(width=4, height=3, position=[[1, 1]], velocity=[[1, 0]], radius=0.5, gravity=(0, -1))
        >>> scene.starting_from(State(np.array([[2.0, 2.0]]), np.array([[0.0, 0.0]]))).position.tolist()
        [[2.0, 2.0]]
        """
        other = copy.copy(self)
        for name in ("has_gaps", "piston_began"):  # what is absent is left out, and time begins anew
            vars(other).pop(name, None)
        move_to_state(other, state, checks.time_to_come("time", time))
        other.check_inside("position", other.position, other.radius)
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

        >>> import mpsim
        >>> scene = mpsim.Scene.random(count=100, packing=0.5, radius=0.5, boundary="periodic", seed=1)
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
            self._overlaps = overlaps_in_words(self)
        return self._overlaps

    def _repr_png_(self) -> bytes:
        """A small picture for notebooks."""
        return view("scene_png", self)

    def __repr__(self) -> str:
        return brief(self)

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
        width, height, packing = starts.box_for(count, radius, packing, width, height, edges)
        starts.demand_random_packing(packing)
        solid = check_obstacles(obstacles, width, height)
        rng = np.random.default_rng(seed)
        if isinstance(radius, float) and all(kind.has_walls for kind in kinds_of(edges)) and not solid:
            position = placement.random_places(count, width, height, radius, rng)
        else:
            radii, wraps, capsules = np.broadcast_to(radius, count), wraps_of(edges), capsules_of(solid, 0.0)
            position = placement.random_polydisperse(radii, width, height, rng, wraps, capsules)
        velocity = starts.thermal_velocities(count, temperature, masses, rng)
        box: dict[str, Any] = {"width": width, "height": height, "boundary": edges, "obstacles": solid, **others}
        made = cls(position=position, velocity=velocity, radius=radius, mass=masses, **box)
        kind: dict[str, Any] = {"count": count, "radius": radius, "mass": mass, "temperature": temperature, **box}
        return made.redraw_with(functools.partial(_drawn_again, cls.random, kind, seed))

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
        >>> bool((scene.rows(70_000, 70_100)[0] == scene.position[70_000:70_100]).all())
        True
        """
        _check_others(cls.lattice, others)
        count = checks.whole("count", count, 0, LARGEST_COUNT, "Give a number in this range.")
        seed = checks.whole("seed", seed, 0, 2**63 - 1, "Any whole number will do.")
        demand_equal_discs(radius, others)
        radius = checks.positive("radius", radius, "[length]")
        temperature = checks.non_negative("temperature", temperature, "[length^2/time^2]")
        edges = check_boundary(boundary)
        width, height, _ = starts.box_for(count, radius, packing, width, height, edges)
        start: Any = Lattice(count, radius, width, height, wraps_of(edges), temperature, seed)
        demand_sites(start, packing)
        kind: dict[str, Any] = {"radius": radius, "width": width, "height": height, "boundary": edges, **others}
        made = cls(position=start, velocity=start, **kind)
        demand_whole_box(made)
        kind |= {"count": count, "temperature": temperature}
        return made.redraw_with(functools.partial(_drawn_again, cls.lattice, kind, seed))


def _check_others(draw: Callable[..., Scene], others: Iterable[str]) -> None:
    """Refuse names that are arguments neither of `draw`, Scene.random or Scene.lattice, nor of Scene."""
    names = {*checks.names_of(draw), *checks.names_of(Scene.__init__)} - {"position", "velocity"}
    checks.known_arguments(f"Scene.{draw.__name__}", others, names)


def _drawn_again(draw: Callable[..., Scene], arguments: dict[str, Any], first: int, seed: int) -> Scene:
    """The scene that `draw`, Scene.random or Scene.lattice, has made with the seed `first`, made with another seed."""
    other = hashlib.blake2b(f"{first} {seed}".encode(), digest_size=7).digest()
    return draw(**arguments, seed=int.from_bytes(other, "big"))
