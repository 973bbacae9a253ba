"""Observables of one state: energies, momentum, overlaps, speeds; the deviation between two states; discs for freud.

Everything is computed in float64, whatever the precision of the state. Masses are those of the scene, 1 if it has none.
Absorbed discs do not count. Along a periodic axis, distances are between nearest images, and displacements are
unwrapped. If discs were added since the start, a state holds more discs than its scene; then all discs must be equal.
Functions that sum over discs take a state, or an object that reads it in chunks.
"""

# pyright: reportPrivateUsage=false
# Names of Scene that begin with an underscore are for all of mpsim.

from __future__ import annotations

import functools
import math
import operator
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mpsim.core import checks
from mpsim.core.checks import Floats
from mpsim.core.columns import equal_sizes
from mpsim.core.state import Box, Discs, State, count_of, parts_of, present_in
from mpsim.errors import InputError, NotMeasurableError
from mpsim.features.feature import has_losses, mean_mass, thermal_speed
from mpsim.scene.scene import Scene
from mpsim.scene.starts import TOUCHING, Overlap, Room, overlaps

# --- Sums over discs in float64, in chunks, so that no process has to hold all discs
#
# The sums of the chunks are added in the order of the discs' numbers, so the result has the same bits wherever the
# discs are. If all discs fit in one chunk, it has the bits of a single sum. Only discs that are present count.


class Chunk(NamedTuple):
    """Consecutive discs: the rows of their numbers, and their state. Properties, checked, are of the K present ones."""

    rows: slice
    state: State

    @property
    def number(self) -> int:
        """K."""
        return int(np.count_nonzero(self.state.present))

    @property
    def position(self) -> Floats:
        """Positions, shape (K, 2) [length]."""
        return finite("position", self.state.position)[present_in(self.state)]

    @property
    def velocity(self) -> Floats:
        """Velocities, shape (K, 2) [length/time]."""
        return finite("velocity", self.state.velocity)[present_in(self.state)]

    def of(self, each: Floats) -> Floats:
        """Their rows of an array of all discs, shape (K, ...)."""
        return np.ascontiguousarray(each[self.rows])[present_in(self.state)]


def parts(discs: Discs) -> Iterator[Chunk]:
    """The discs in the order of their numbers, a chunk at a time; at least one part."""
    return (Chunk(*each) for each in parts_of(discs))


def total(discs: Discs, term: Callable[[Chunk], Any]) -> Any:
    """The sum of a term over all parts; the term gives numbers, or arrays of one shape.

    >>> total(State(np.zeros((3, 2)), np.ones((3, 2))), lambda part: part.velocity.sum(axis=0)).tolist()
    [3.0, 3.0]
    """
    return functools.reduce(operator.add, map(term, parts(discs)))  # not `sum`, which rounds as its version of Python


def finite(name: str, values: NDArray[np.floating]) -> Floats:
    """What a state has of its discs, a copy, checked to be finite."""
    return checks.finite_array(f"state.{name}", values, values.shape, f"{values.shape}")


SAME_BOX = 1e-4  # difference of two boxes, as a fraction of a side, that may come from a file


def demand_scene(scene: object, discs: Discs) -> None:
    """Refuse, naming it, what is no scene, such as a state, and a scene in whose box the discs are not."""
    if not isinstance(scene, Scene):
        raise InputError(f"scene must be a Scene; got {type(scene).__name__}. Use sim.scene; the state comes first.")
    if (box := getattr(discs, "box", None)) is None:
        return
    fixed = [axis for axis in (0, 1) if all(wall.axis != axis for wall in scene._moving_walls)]
    sides = np.divide(sides_of(box), (scene.width, scene.height))
    if (np.abs(sides[fixed] - 1) > SAME_BOX).any():
        rule, got = f"be that of the state, whose box is {_in_words(box)}", f"one of {_in_words(scene.box)}"
        raise checks.refusal("scene", rule, got, "Use the scene of the simulation that the state comes from.")


def placed(discs: Any, scene: Scene) -> Any:
    """The discs in the coordinates of their scene, in its box: see `Scene._placed`. Those of ranks are there."""
    count_of(discs)  # which refuses what is no state
    demand_scene(scene, discs)
    if not isinstance(discs, State):
        return discs
    found = scene._placed(discs)
    beyond = np.abs(found.position / (scene.width, scene.height) - 0.5).max(axis=1) > 0.5 + SAME_BOX
    if (beyond & found.present).any():
        disc = int(np.flatnonzero(beyond & found.present)[0])
        raise InputError(
            f"the discs of a state must be in its box, {_in_words(scene.box)}; got disc {disc} at "
            f"{tuple(found.position[disc].tolist())} in it. Use a box that holds every disc: by the Lattice and "
            "Origin of a file, by State(..., box=...), or a periodic one."
        )
    return found


def sides_of(box: Box) -> tuple[float, float]:
    """Width and height of a box [length]."""
    return box[1] - box[0], box[3] - box[2]


def _in_words(box: Box) -> str:
    return "{:g} x {:g}".format(*sides_of(box))


def masses_of(name: str, scene: Scene, discs: Discs) -> Floats:
    """Mass of each disc, shape (N,) [mass], as `one_of_each`. It includes discs that were added if all masses are 1."""
    demand_scene(scene, discs)
    if scene.mass is None and all(emitter.mass in (None, 1.0) for emitter in scene.emitters):
        return equal_sizes(1.0, count_of(discs))
    return one_of_each(name, "mass", scene.masses, discs)


def radii_of(name: str, scene: Scene, discs: Discs) -> Floats:
    """Radius of each disc, shape (N,) [length], as `one_of_each`."""
    demand_scene(scene, discs)
    if isinstance(scene.radius, float) and scene.smallest_radius == scene.largest_radius:
        return equal_sizes(scene.radius, count_of(discs))
    return one_of_each(name, "radius", scene.radii, discs)


def one_of_each(name: str, what: str, values: Floats, discs: Discs) -> Floats:
    """Values of the scene, one for each disc; an InputError that names the caller for another number of them."""
    if len(values) != (count := count_of(discs)):
        raise InputError(
            f"{name} needs one {what} of the scene per disc; got {len(values)} and {count} discs. "
            f"Make a scene that holds all discs, with the {what} of each."
        )
    return values


def mass_and_momentum(discs: Discs, masses: Floats) -> tuple[float, Floats]:
    """Sums of m [mass] and of m v, shape (2,) [mass length/time]; masses: shape (N,)."""

    def term(part: Chunk) -> Floats:
        mass = part.of(masses)
        return np.array([mass.sum(), *(mass[:, None] * part.velocity).sum(axis=0)])

    mass, *momentum = total(discs, term)
    return float(mass), np.array(momentum)


def number_and_squares(discs: Discs, masses: Floats, drift: Any = 0.0) -> tuple[int, float]:
    """Number of discs, and the sum of m (v - drift)^2, twice their energy of translation [mass length^2/time^2]."""

    def term(part: Chunk) -> Floats:
        squares = part.velocity - drift
        np.square(squares, out=squares)
        squares *= part.of(masses)[:, None]
        return np.array([len(squares), squares.sum()])

    number, squares = total(discs, term).tolist()
    return int(number), squares


def energy_of_translation(discs: Discs, masses: Floats) -> float:
    """Sum of m v^2 / 2 [mass length^2/time^2]; masses: shape (N,)."""
    return 0.5 * number_and_squares(discs, masses)[1]


def energy_of_rotation(discs: Discs, masses: Floats, radii: Floats) -> float:
    """Sum of m a^2 spin^2 / 4 [mass length^2/time^2], 0 of discs that do not spin; masses, radii: shape (N,)."""

    def term(part: Chunk) -> float:
        if part.state.spin is None:
            return 0.0
        spin = finite("spin", part.state.spin)[present_in(part.state)]
        return float((part.of(masses) * (part.of(radii) * spin) ** 2).sum())

    return 0.25 * total(discs, term)


def flow_of_momentum(discs: Discs, scene: Scene) -> tuple[float, float, float]:
    """Sums of m v_x v_x, m v_y v_y, m v_x v_y [mass length^2/time^2], without a mean flow that nothing changes.

    That is the flow along periodic axes; but a heat bath changes the momentum of the whole gas, which then is one more
    thermal motion, not a flow.
    """
    masses = masses_of("pressure", scene, discs)
    mass, flow = mass_and_momentum(discs, masses)
    kept = (False, False) if is_heated(scene) else scene.periodic
    drift = flow * kept / max(mass, 1e-300)

    def squares(part: Chunk) -> Floats:
        mass, (x, y) = part.of(masses), (part.velocity - drift).T
        # no BLAS: its bits follow its threads
        return np.array([(mass * x * x).sum(), (mass * y * y).sum(), (mass * x * y).sum()])

    xx, yy, xy = total(discs, squares).tolist()
    return xx, yy, xy


def is_heated(scene: Scene) -> bool:
    """Whether a thermostat or a thermal wall changes the energy of discs."""
    return any(each.heats for each in scene._features)


def memory_of_baths(scene: Scene, temperature: float) -> float:
    """Time in which heat baths exchange the energy of a gas, at least; inf without any [time].

    Where contacts lose energy, a gas at T in a bath at B relaxes faster: they lose ~ T^(3/2), which balances the bath.

    Args:
        scene: the scene.
        temperature: kT of the gas, > 0 [mass length^2/time^2].
    """
    rate = sum(each.exchange_rate(scene, temperature) for each in scene._features)
    if has_losses(scene):
        rate *= max(1.5 * mean_mass(scene) * thermal_speed(scene) ** 2 / temperature - 0.5, 1.0)
    return 1 / rate if rate else float("inf")


# --- Results


@dataclass(frozen=True)
class SpeedDistribution:
    """Distribution of speeds, and the Maxwell distribution of the same mean square.

    Attributes:
        edges: shape (bins + 1,), of the bins [length/time].
        value: shape (bins,), density of speeds: fraction of discs in a bin, divided by its width [time/length].
        maxwell: shape (bins,), the same for the Maxwell distribution, its mean over each bin [time/length].
    """

    edges: Floats
    value: Floats
    maxwell: Floats


@dataclass(frozen=True)
class TrajectoryDeviation:
    """Distances of the discs from their positions in a reference state.

    Attributes:
        rms: root mean square [length].
        largest: largest distance [length].
        disc: the disc with the largest distance.
    """

    rms: float
    largest: float
    disc: int


# --- Observables


def kinetic_energy(state: Discs, scene: Scene) -> float:
    """Kinetic energy, sum of m v^2 / 2 over the discs [mass length^2/time^2], >= 0. `scene`: that of the state.

    It includes `rotational_energy`.

    Raises:
        InputError: if the state is not finite, or holds more or fewer discs than the scene has masses.

    >>> scene = Scene(width=9, height=9, position=[[1, 1], [5, 5]], velocity=[[3, 4], [0, 1]], radius=0.5)
    >>> kinetic_energy(State(scene.position, scene.velocity), scene)
    13.0
    """
    translation = energy_of_translation(state, masses_of("kinetic_energy", scene, state))
    is_smooth = next(parts(state)).state.spin is None
    return translation if is_smooth else translation + rotational_energy(state, scene)


def rotational_energy(state: Discs, scene: Scene) -> float:
    """Kinetic energy of rotation, sum of m a^2 spin^2 / 4 over the discs [mass length^2/time^2]; 0 for smooth ones.

    The moment of inertia of a uniform disc of radius a is m a^2 / 2. `scene`: that of the state. In equilibrium, which
    perfectly rough discs reach, it is half of the energy of translation: one degree of freedom of three.

    Raises:
        InputError: if the state is not finite, or holds more or fewer discs than the scene has masses or radii.

    >>> places, rest = [[1, 1], [5, 5]], np.zeros((2, 2))
    >>> scene = Scene(width=9, height=9, position=places, velocity=rest, radius=0.5, friction=0.5, spin=[4, 0])
    >>> rotational_energy(State(scene.position, scene.velocity, spin=scene.spin), scene)
    1.0
    """
    name = "rotational_energy"
    return energy_of_rotation(state, masses_of(name, scene, state), radii_of(name, scene, state))


def potential_energy(state: Discs, scene: Scene) -> float:
    """Potential energy of gravity and of each disc's own acceleration, -sum of m_i (g + a_i).r_i from the box's origin.

    [mass length^2/time^2], 0.0 for a scene with neither. Kinetic plus potential energy is constant in exact motion [D].

    Raises:
        InputError: if the state is not finite, or holds more or fewer discs than the scene has accelerations or masses;
            if a field points along a periodic axis, where there is no potential.

    >>> scene = Scene(width=4, height=3, position=[[1, 2]], velocity=[[0, 0]], radius=0.5, gravity=(0, -10))
    >>> potential_energy(State(scene.position, scene.velocity), scene)
    20.0
    """
    state = placed(state, scene)
    name, gravity, acceleration = "potential_energy", scene.gravity, scene.acceleration
    if has_periodic_field(scene):
        raise InputError(
            "potential_energy needs fields that point along axes with walls; got one along a periodic axis, round "
            "which discs fall without end. Give that axis walls, or compare kinetic energies."
        )
    masses = masses_of(name, scene, state)
    own = None if acceleration is None else one_of_each(name, "acceleration", acceleration, state)

    def work(part: Chunk) -> Floats:
        moment = part.of(masses)[:, None] * part.position
        of_gravity = 0.0 if gravity is None else (moment @ gravity).sum()
        return np.array([of_gravity, 0.0 if own is None else (moment * part.of(own)).sum()])

    of_gravity, of_own = total(state, work).tolist()
    return 0.0 - of_gravity - of_own


def has_periodic_field(scene: Scene) -> bool:
    """Whether gravity or an acceleration points along a periodic axis."""
    fields = (np.atleast_2d(field) for field in (scene.gravity, scene.acceleration) if field is not None)
    return any(bool(field[:, list(scene.periodic)].any()) for field in fields)


def momentum(state: Discs, scene: Scene) -> Floats:
    """Total momentum, sum of m v, shape (2,) [mass length/time]. `scene`: that of the state.

    Raises:
        InputError: if the state is not finite, or holds more or fewer discs than the scene has masses.

    >>> scene = Scene(width=9, height=9, position=[[1, 1], [5, 5]], velocity=[[3, 4], [0, 1]], radius=0.5)
    >>> momentum(State(scene.position, scene.velocity), scene).tolist()
    [3.0, 5.0]
    """
    return mass_and_momentum(state, masses_of("momentum", scene, state))[1]


def temperature(state: Discs, scene: Scene, *, remove_drift: bool = False) -> float:
    """Temperature kT: mean of m v_x^2 and m v_y^2 over the discs [mass length^2/time^2], >= 0.

    Args:
        state, scene: the state and its scene.
        remove_drift: subtract the velocity of the centre of mass, and divide by N - 1 instead of N: correct if the
            total momentum is conserved, as in a periodic box, or if the gas flows; wrong with walls or a thermostat.

    Raises:
        InputError: if there is no disc (two are needed with `remove_drift`), or the state is not finite, or holds more
            or fewer discs than the scene has masses.

    >>> scene = Scene(width=9, height=9, position=[[1, 1], [5, 5]], velocity=[[3, 0], [1, 0]], radius=0.5)
    >>> state = State(scene.position, scene.velocity)
    >>> temperature(state, scene), temperature(state, scene, remove_drift=True)
    (2.5, 1.0)
    """
    masses, drift = masses_of("temperature", scene, state), 0.0
    remove_drift = checks.truth("remove_drift", remove_drift)
    if remove_drift:
        count = total(state, lambda part: part.number)
        _demand_discs("temperature", count, 2)
        mass, momentum = mass_and_momentum(state, masses)
        drift = (momentum / count) / (mass / count)
    count, squares = number_and_squares(state, masses, drift)
    _demand_discs("temperature", count, 1)
    return squares / (2 * (count - 1 if remove_drift else count))


def overlap(state: State, scene: Scene, radii: Floats | None = None) -> Overlap:
    """Number of overlapping pairs, their largest and mean depth. O(N) by cells of the largest diameter.

    Overlaps within the rounding of the state's precision (TOUCHING) count as touching. Along a periodic axis the
    nearest images count. Overlaps with capsules are not included.

    Args:
        state, scene: the state and its scene.
        radii: of the discs of the state, absorbed ones included, shape (N,) [length]; None: those of the scene.

    Raises:
        InputError: if the state is not finite, or holds more or fewer discs than there are radii.

    >>> scene = Scene(width=9, height=9, position=[[1, 1], [1.75, 1], [5, 5]], velocity=np.zeros((3, 2)), radius=0.5)
    >>> overlap(State(scene.position, scene.velocity), scene)
    Overlap(pairs=1, largest=0.25, mean=0.25, worst=(0, 1))
    """
    inside = placed(state, scene)
    farthest = float(np.abs(state.position).max(initial=max(scene.width, scene.height)))
    rounding = TOUCHING * float(np.finfo(state.position.dtype).eps) * farthest
    if radii is None:
        each = radii_of("overlap", scene, inside)
    else:
        each = one_of_each("overlap", "radius", checks.finite_array("radii", radii, (None,), "(N,)"), inside)
    discs, (x, y) = Chunk(slice(None), inside), sides_of(inside.box or scene.box)
    size = x if scene.periodic[0] else scene.width, y if scene.periodic[1] else scene.height
    found = overlaps(discs.position, discs.of(each), Room(size, scene.periodic), rounding)
    if found.worst is None:
        return found
    i, j = np.flatnonzero(inside.present)[list(found.worst)].tolist()
    return replace(found, worst=(i, j))


def speed_kurtosis(state: Discs) -> float:
    """Fourth moment of the speeds over the square of the second, <v^4>/<v^2>^2 [1], >= 1.

    1 for equal speeds, 2 for a Maxwell distribution in two dimensions, `reference.speed_kurtosis` for N discs in
    equilibrium; kurtosis/2 - 1 is the excess a_2. A mixture of masses is far above 2: evaluate each species by itself.

    Raises:
        InputError: if no disc moves, or the state is not finite.

    >>> speed_kurtosis(State(np.zeros((2, 2)), np.array([[1.0, 0.0], [0.0, 3.0]])))
    1.64
    """
    unit = _moving_unit("speed_kurtosis", state)

    def powers(part: Chunk) -> Floats:
        squares = _squares(part, unit)
        return np.array([len(squares), squares.sum(), (squares**2).sum()])

    count, second, fourth = total(state, powers)
    return float((fourth / count) / (second / count) ** 2)


def speed_distribution(state: State, bins: int = 50) -> SpeedDistribution:
    """Distribution of speeds, and Maxwell's of the same mean square, with density (v/kT) exp(-v^2/(2 kT)) in 2-D.

    In a mixture of masses, give the state of one species, State(position[species], velocity[species]).

    Args:
        state: the state; speeds include its drift, if any.
        bins: number of bins of equal width from 0 to the largest speed.

    Raises:
        InputError: if no disc moves, or the state is not finite.

    Source: for Maxwell's distribution in 2-D, squared speeds are exponential: P(< v) = 1 - exp(-v^2/(2 kT)).

    >>> found = speed_distribution(State(np.zeros((2, 2)), np.array([[1.0, 0.0], [0.0, 3.0]])), bins=3)
    >>> found.value.tolist(), found.maxwell.round(3).tolist()
    ([0.0, 0.5, 0.5], [0.181, 0.369, 0.284])
    """
    unit = _moving_unit("speed_distribution", state)
    squares = _squares(Chunk(slice(None), state), unit)
    speed = unit * np.sqrt(squares)
    number = checks.whole("bins", bins, 1, 1_000_000, "About 50 bins are usual.")
    edges = np.linspace(0, float(speed.max()), number + 1)
    below, width = -np.expm1(-((edges / unit) ** 2) / float(squares.mean())), np.diff(edges)
    counted, _ = np.histogram(speed, edges)
    return SpeedDistribution(edges, counted / (len(speed) * width), np.diff(below) / width)


def mean_squared_displacement(before: State, after: State, scene: Scene | None = None) -> float:
    """Mean over the discs of |r(after) - r(before)|^2 [length^2], >= 0, for the same discs in the same order.

    Displacements are unwrapped by image flags (`State.image`). Discs that are absent in one of the states are left out.

    Args:
        before, after: the states, both with image flags or both without, as those made by hand.
        scene: that of the states. Without image flags, nearest images along its periodic axes count, which is right if
            no disc has moved by half of that axis; without a scene, positions are taken as they are.

    Raises:
        InputError: if the states have no disc in common or different numbers of them, or are not finite; if only one
            has image flags; if one has crossed a border of a box that has changed.

    Source: Einstein (1905): 4 D t at long times in two dimensions, with the diffusion coefficient D.

    >>> mean_squared_displacement(State(np.zeros((2, 2)), np.zeros((2, 2))), State(np.ones((2, 2)), np.zeros((2, 2))))
    2.0
    >>> scene = Scene(width=10, height=10, position=[[5, 5]], velocity=[[3, 0]], radius=0.5, boundary="periodic")
    >>> start = State(scene.position, scene.velocity, image=np.array([[0, 0]]), box=scene.box)
    >>> end = State(np.array([[7.0, 5.0]]), scene.velocity, image=np.array([[1, 0]]), box=scene.box)
    >>> mean_squared_displacement(start, end)
    144.0
    """
    name = "mean_squared_displacement"
    common = _common(before, after, name)
    common = common[before.present[common] & after.present[common]]
    _demand_discs(name, len(common), 1)
    if (before.image is None) != (after.image is None):
        raise InputError(
            f"{name} needs image flags (State.image) in both states or in neither; got them in one. Take both "
            "from a simulation, or give the scene's start as State(..., image=numpy.zeros((N, 2), int), box=scene.box)."
        )
    if before.image is None or after.image is None:
        moved = _difference(before, after, common, scene)
    else:
        if scene is not None:
            before, after = placed(before, scene), placed(after, scene)
        _demand_one_box(before, after, common)
        moved = finite("position", after.unwrapped)[common] - finite("position", before.unwrapped)[common]
    return float((moved**2).sum(axis=1).mean())


def trajectory_error(state: State, reference: State, scene: Scene | None = None) -> TrajectoryDeviation:
    """Deviation of the discs from their positions in a reference state at the same time, such as the exact solver's.

    Two correct solvers agree for about 20 Lyapunov times only, in a gas at packing 0.3 for 7 units of time. Discs that
    are absent in both states are left out; one that is absent in one of them counts where it left the box.

    Args:
        state, reference: the states.
        scene: that of the states. Along its periodic axes the nearest images count; None: positions as they are.

    Raises:
        InputError: if the states hold no disc or different numbers of them, or are not finite.

    >>> trajectory_error(State(np.array([[3.0, 4.0], [0, 0]]), np.zeros((2, 2))), State(*np.zeros((2, 2, 2))))
    TrajectoryDeviation(rms=3.5355339059327378, largest=5.0, disc=0)
    """
    common = _common(state, reference, "trajectory_error")
    distance = np.hypot(*_difference(state, reference, common, scene).T)
    worst = int(distance.argmax())
    return TrajectoryDeviation(math.sqrt(float((distance**2).mean())), float(distance[worst]), int(common[worst]))


def to_freud(state: State, scene: Scene) -> tuple[Any, NDArray[np.float32]]:
    """The discs that are present, in freud's form: a two-dimensional box, and points, shape (K, 3) [length].

    freud computes pair correlations, structure factors, bond-orientational order, Voronoi cells, clusters and more from
    these. Points are relative to the middle of the box, in float32, which is what freud computes in. If a piston has
    moved a wall, the box is that of the state.

    Args:
        state: at any moment.
        scene: that of the state; it says which axes are periodic.

    Raises:
        InputError: if the state is not finite.
        NotMeasurableError: if the package freud-analysis is not installed.

    >>> scene = Scene.random(count=50, packing=0.2, radius=0.5, seed=1, boundary="periodic")
    >>> discs = to_freud(State(scene.position, scene.velocity), scene)
    >>> import freud
    >>> psi = freud.order.Hexatic(k=6).compute(discs, neighbors={"num_neighbors": 6}).particle_order
    >>> pairs = freud.density.RDF(bins=20, r_max=4.0).compute(discs)
    >>> psi.shape, pairs.rdf.shape
    ((50,), (20,))
    """
    state = placed(state, scene)
    places = finite("position", state.position)[state.present]
    try:
        import freud  # noqa: PLC0415  # pyright: ignore[reportMissingTypeStubs]
    except ImportError as error:
        raise NotMeasurableError(
            f"to_freud needs freud-analysis, which cannot be imported ({error}). Run pip install freud-analysis."
        ) from None
    x_low, x_high, y_low, y_high = scene.box if state.box is None else state.box
    box = freud.box.Box(Lx=x_high - x_low, Ly=y_high - y_low, is2D=True)
    box.periodic = (*scene.periodic, False)
    points = np.zeros((len(places), 3), np.float32)
    points[:, :2] = places - np.array([x_low + x_high, y_low + y_high]) / 2
    return box, points


def _moving_unit(name: str, discs: Discs) -> float:
    """The largest velocity component, in units of which fourth powers neither overflow nor vanish [length/time]."""
    largest = [(np.abs(part.velocity).max(initial=0.0), part.number) for part in parts(discs)]
    unit, count = float(max(each for each, _ in largest)), sum(count for _, count in largest)
    if unit == 0:
        raise InputError(f"{name} needs a disc that moves; got {count} discs, none moving. Give them velocities.")
    return unit


def _squares(part: Chunk, unit: float) -> Floats:
    """Squared speeds in units of a velocity, shape (K,)."""
    return ((part.velocity / unit) ** 2).sum(axis=1)


def _common(state: State, reference: State, name: str) -> NDArray[np.int64]:
    """Indices of discs in two states of the same discs, without those absent in both."""
    for each in (state, reference):
        count_of(each)  # which refuses what is no state
    if len(state.present) != len(reference.present):
        raise InputError(
            f"{name} needs two states of the same discs; got {len(state.present)} and {len(reference.present)} discs. "
            "Compare states between which no disc was added."
        )
    common = np.flatnonzero(state.present | reference.present)
    _demand_discs(name, len(common), 1)
    return common


def _difference(state: State, reference: State, discs: NDArray[np.int64], scene: Scene | None) -> Floats:
    """Differences of the positions of some discs in two states, to the nearest images along periodic axes."""
    if scene is not None:
        state, reference = placed(state, scene), placed(reference, scene)
    a, b = (finite("position", each.position)[discs] for each in (state, reference))
    return a - b if scene is None else scene._to_nearest_image(a - b, reference.box)


def _demand_one_box(before: State, after: State, discs: NDArray[np.int64]) -> None:
    """Refuse displacements of discs that have crossed borders of a box that has become another one."""
    if before.image is None or after.image is None or before.box is None or after.box is None:
        return
    crossed = ((before.image[discs] != 0) | (after.image[discs] != 0)).any(axis=0)
    if (crossed & (np.abs(np.divide(sides_of(after.box), sides_of(before.box)) - 1) > SAME_BOX)).any():
        raise InputError(
            "mean_squared_displacement across borders needs states of one box; got boxes of "
            f"{_in_words(before.box)} and {_in_words(after.box)}. In a box that changes, displacements are not "
            "defined; take states before or after the change."
        )


def _demand_discs(name: str, count: int, fewest: int) -> None:
    if count < fewest:
        raise InputError(f"{name} needs at least {fewest} disc{'s' * (fewest > 1)}; got {count}. Add discs.")
