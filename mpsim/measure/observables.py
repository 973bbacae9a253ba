"""What one state shows: energies, momentum, overlaps, speeds, structure; and how far apart two states are.

All is computed in float64, whatever the precision of the state. Discs have mass 1, so energies are in
[length^2/time^2] and momenta in [length/time]. Positions are those in the box: nothing here unwraps periodic images.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mpsim import checks
from mpsim.errors import InputError
from mpsim.measure.statistics import Measure
from mpsim.scene import Scene
from mpsim.state import State

ROUNDINGS = 8
"""Discs closer than a diameter by up to this many units in the last place of the box's size count as touching: that
much two coordinates lose by rounding. Less would report discs pushed exactly apart, more would hide real overlaps."""

CONTACT_RANGE = 0.4
"""The contact value is extrapolated from distances up to this many diameters beyond contact. A shorter range
adds noise; a longer one adds bias (0.8 % from 0.3 to 0.5 at packing 0.6, nothing to be seen at packing 0.5)."""

NEWTON_STEPS = 50
"""Steps of the fit of the contact value, which converges in some five; one that does not gives NaN."""

CANDIDATES = 2**21
"""Pairs looked at together: bounds the memory of a pair search, some 100 MB, whatever the number of discs."""


@dataclass(frozen=True)
class Overlap:
    """Overlapping pairs of discs.

    Attributes:
        pairs: number of pairs closer than a diameter.
        largest: depth of the deepest pair, diameter minus distance [length]; 0 without pairs.
        mean: mean depth of the overlapping pairs [length]; 0 without pairs.
        worst: the deepest pair, (i, j) with i < j; None without pairs.
    """

    pairs: int
    largest: float
    mean: float
    worst: tuple[int, int] | None


@dataclass(frozen=True)
class SpeedDistribution:
    """Distribution of speeds, with the Maxwell distribution of the same mean square beside it.

    Attributes:
        edges: shape (bins + 1,), of the bins [length/time].
        density: shape (bins,), of the speeds: fraction in a bin over its width [time/length].
        maxwell: shape (bins,), the same of the Maxwell distribution, its mean over each bin [time/length].
        distance: largest difference of the two cumulative distributions (Kolmogorov-Smirnov), from 0 to 1, taken from
            the speeds themselves, not from the bins. For N >= 50 speeds in equilibrium 1.08/sqrt(N) is exceeded by
            chance once in 20 times, 1.28/sqrt(N) once in 100 (the test of Lilliefors, J. Am. Stat. Assoc. 64, 387,
            1969; both numbers simulated anew, to 0.01).
    """

    edges: NDArray[np.float64]
    density: NDArray[np.float64]
    maxwell: NDArray[np.float64]
    distance: float


@dataclass(frozen=True)
class PairCorrelation:
    """Pair-correlation function of a closed box, away from the walls.

    Attributes:
        r: shape (bins,), middle of each shell, from one diameter to r_max [length].
        g: shape (bins,), density at that distance from a disc, over the density [1].
        error: shape (bins,), its standard error from the number of pairs counted, a fraction 1/sqrt(pairs) [1].
        contact: g at one diameter, extrapolated; its error is that of the counts [1].
        density: number density where the reference discs are [1/length^2].
        references: reference discs counted, over all states.
    """

    r: NDArray[np.float64]
    g: NDArray[np.float64]
    error: NDArray[np.float64]
    contact: Measure
    density: float
    references: int


@dataclass(frozen=True)
class TrajectoryError:
    """Distance of each disc from where it should be.

    Attributes:
        rms: root of the mean square [length].
        largest: [length].
        disc: the disc that is farthest off.
    """

    rms: float
    largest: float
    disc: int


def kinetic_energy(state: State, scene: Scene) -> float:
    """Kinetic energy, sum of v^2 / 2 over the discs [length^2/time^2], >= 0. `scene`: that of the state.

    Raises:
        InputError: if the state is not finite.

    >>> scene = Scene(width=9, height=9, position=[[1, 1], [5, 5]], velocity=[[3, 4], [0, 1]], radius=0.5)
    >>> kinetic_energy(State(scene.position, scene.velocity), scene)
    13.0
    """
    return 0.5 * float((_velocity(state) ** 2).sum())


def potential_energy(state: State, scene: Scene) -> float:
    """Energy in gravity and in each disc's own acceleration, - sum of (g + a_i).r_i from the box's origin.

    Each of these fields is uniform and constant, so kinetic plus potential energy is conserved by exact motion [D].

    Returns:
        [length^2/time^2]; 0.0 for a scene with neither.

    Raises:
        InputError: if the state is not finite, or holds more or fewer discs than the scene's acceleration has rows:
            the acceleration of a disc added later is not in the scene.

    >>> scene = Scene(width=4, height=3, position=[[1, 2]], velocity=[[0, 0]], radius=0.5, gravity=(0, -10))
    >>> potential_energy(State(scene.position, scene.velocity), scene)
    20.0
    """
    position, energy = _position(state), 0.0
    if scene.gravity is not None:
        energy -= float((position @ scene.gravity).sum())
    if scene.acceleration is not None:
        if len(scene.acceleration) != len(position):
            raise InputError(
                f"potential_energy needs one row of the scene's acceleration per disc; got {len(scene.acceleration)} "
                f"rows and {len(position)} discs. Make a scene that holds all discs and their accelerations."
            )
        energy -= float((position * scene.acceleration).sum())
    return energy


def momentum(state: State, scene: Scene) -> NDArray[np.float64]:
    """Total momentum, sum of v, shape (2,) [length/time]. `scene`: that of the state.

    Raises:
        InputError: if the state is not finite.

    >>> scene = Scene(width=9, height=9, position=[[1, 1], [5, 5]], velocity=[[3, 4], [0, 1]], radius=0.5)
    >>> momentum(State(scene.position, scene.velocity), scene).tolist()
    [3.0, 5.0]
    """
    return _velocity(state).sum(axis=0)


def temperature(state: State, scene: Scene, *, remove_drift: bool = False) -> float:
    """Temperature kT: mean square of one velocity component [length^2/time^2], >= 0.

    Args:
        state, scene: the state and its scene.
        remove_drift: measure velocities from that of the centre of mass and divide by N - 1 instead of N. Right where
            the total momentum is conserved (periodic boxes, kT = E/(N - 1) at rest), or where the gas flows; wrong in
            a box with walls, whose kT is E/N.

    Raises:
        InputError: if there is no disc (two are needed with `remove_drift`), or the state is not finite.

    >>> scene = Scene(width=9, height=9, position=[[1, 1], [5, 5]], velocity=[[3, 0], [1, 0]], radius=0.5)
    >>> state = State(scene.position, scene.velocity)
    >>> temperature(state, scene), temperature(state, scene, remove_drift=True)
    (2.5, 1.0)
    """
    velocity = _velocity(state)
    _demand_discs("temperature", len(velocity), 2 if remove_drift else 1)
    if remove_drift:
        return float(((velocity - velocity.mean(axis=0)) ** 2).sum()) / (2 * (len(velocity) - 1))
    return float((velocity**2).mean())


def overlap(state: State, scene: Scene) -> Overlap:
    """Number of overlapping pairs, their largest and mean depth. O(N) by cells of one diameter.

    Pairs closer than rounding of the state's own precision (ROUNDINGS) count as touching, not as overlapping.

    Raises:
        InputError: if the state is not finite.

    >>> scene = Scene(width=9, height=9, position=[[1, 1], [1.75, 1], [5, 5]], velocity=np.zeros((3, 2)), radius=0.5)
    >>> overlap(State(scene.position, scene.velocity), scene)
    Overlap(pairs=1, largest=0.25, mean=0.25, worst=(0, 1))
    """
    rounding = ROUNDINGS * float(np.finfo(state.position.dtype).eps) * max(scene.width, scene.height)
    diameter = 2 * scene.radius
    pairs, total, largest, worst = 0, 0.0, 0.0, None
    for i, j, distance in _close_pairs(_position(state), diameter - rounding):
        if len(distance):
            deepest = int(distance.argmin())
            pairs += len(distance)
            total += float((diameter - distance).sum())
            if worst is None or diameter - distance[deepest] > largest:
                largest = float(diameter - distance[deepest])
                worst = (int(min(i[deepest], j[deepest])), int(max(i[deepest], j[deepest])))
    return Overlap(pairs, largest, total / pairs if pairs else 0.0, worst)


def speed_kurtosis(state: State) -> float:
    """Fourth moment of the speeds over the square of the second, <v^4>/<v^2>^2 [1], >= 1.

    1 for equal speeds, 2 for a Maxwell distribution in two dimensions; `reference.speed_kurtosis` gives the value of a
    box of N discs, and kurtosis/2 - 1 is the excess a_2 that relaxes to (almost) 0.

    Raises:
        InputError: if no disc moves, or the state is not finite.

    >>> speed_kurtosis(State(np.zeros((2, 2)), np.array([[1.0, 0.0], [0.0, 3.0]])))
    1.64
    """
    squares, _ = _moving_squares("speed_kurtosis", state)
    return float((squares**2).mean() / squares.mean() ** 2)


def speed_distribution(state: State, bins: int | ArrayLike = 50) -> SpeedDistribution:
    """Speeds against the Maxwell distribution of the same mean square: density (v/kT) exp(-v^2/(2 kT)) in 2-D.

    Args:
        state: the state; its drift, if any, is part of the speeds.
        bins: number of bins of equal width from 0 to the largest speed, or their edges, shape (bins + 1,), rising,
            >= 0 [length/time].

    Raises:
        InputError: if no disc moves, the state is not finite or the edges do not rise.

    Source: Maxwell's distribution, whose squares of speeds in 2-D are exponential: P(< v) = 1 - exp(-v^2/(2 kT)).

    >>> state = State(np.zeros((2, 2)), np.array([[1.0, 0.0], [0.0, 3.0]]))
    >>> found = speed_distribution(state, bins=3)
    >>> found.density.tolist(), round(found.distance, 6)
    ([0.0, 0.5, 0.5], 0.334701)
    """
    squares, unit = _moving_squares("speed_distribution", state)
    squares.sort()
    mean_square, speed = float(squares.mean()), unit * np.sqrt(squares)
    edges = _edges(bins, float(speed[-1]))
    below = -np.expm1(-((edges / unit) ** 2) / mean_square)
    count = len(speed)
    counted, _ = np.histogram(speed, edges)
    cumulative = -np.expm1(-squares / mean_square)
    ranks = np.arange(count) / count
    distance = float(max((cumulative - ranks).max(), (ranks + 1 / count - cumulative).max()))
    width = np.diff(edges)
    return SpeedDistribution(edges, counted / (count * width), np.diff(below) / width, distance)


def mean_squared_displacement(before: State, after: State) -> float:
    """Mean over the discs of |r(after) - r(before)|^2 [length^2], >= 0, for the same discs in the same order.

    Raises:
        InputError: if the states hold no disc or different numbers of them, or are not finite.

    >>> mean_squared_displacement(State(np.zeros((2, 2)), np.zeros((2, 2))), State(np.ones((2, 2)), np.zeros((2, 2))))
    2.0
    """
    return float((_displacements("mean_squared_displacement", before, after) ** 2).sum(axis=1).mean())


def trajectory_error(state: State, reference: State) -> TrajectoryError:
    """Distance of each disc from its place in a reference state of the same time, say the exact solver's.

    It means something only while the motion is predictable: see `predictability.require_predictable`.

    Raises:
        InputError: if the states hold no disc or different numbers of them, or are not finite.

    >>> trajectory_error(State(np.array([[3.0, 4.0], [0, 0]]), np.zeros((2, 2))), State(*np.zeros((2, 2, 2))))
    TrajectoryError(rms=3.5355339059327378, largest=5.0, disc=0)
    """
    distance = np.hypot(*_displacements("trajectory_error", state, reference).T)
    worst = int(distance.argmax())
    return TrajectoryError(math.sqrt(float((distance**2).mean())), float(distance[worst]), worst)


def pair_correlation(states: State | Sequence[State], scene: Scene, bins: int, r_max: float) -> PairCorrelation:
    """Pair-correlation function g(r) from contact to r_max, of one state or of several of the same scene together.

    Walls: a disc counts as a reference only if its centre is at least radius + r_max from every wall, so that every
    shell around it lies where centres may be. No shell needs correcting, the layers of discs at the walls bias nothing
    but the shells that reach them, and the density is that of the same inner region:
    g = pairs / (states x inner area x density^2 x shell area). The price: only the inner discs are references.
    In dense gases choose r_max of some 4 diameters or more: nearer to the walls their layers still show in the density.

    The contact value is exp(quadratic in r) fitted to the counts, as Poisson numbers, up to CONTACT_RANGE diameters
    beyond contact, taken at one diameter. Pairs closer than a diameter are not counted: see `overlap`.

    Args:
        states: of equal discs in the scene's box; independent ones lower the noise.
        scene: gives box and radius.
        bins: shells of equal width, >= 1; at least 4 must lie within CONTACT_RANGE for a contact value, else NaN.
        r_max: [length], > one diameter, and so small that some inner region remains.

    Raises:
        InputError: naming the argument and its rule; if no disc is a reference.

    Source: minus sampling, Ripley, J. R. Stat. Soc. B 39, 172 (1977), sect. 6; Allen & Tildesley, Computer Simulation
    of Liquids (2017), sect. 8.2.

    >>> scene = Scene.random(count=2000, packing=0.3, radius=0.5, seed=1)
    >>> found = pair_correlation(State(scene.position, scene.velocity), scene, bins=40, r_max=3.0)
    >>> bool(abs(found.g[-10:].mean() - 1) < 0.05)
    True
    """
    states = [states] if isinstance(states, State) else list(states)
    bins = checks.whole("bins", bins, 1, 1_000_000, "Some 100 shells are usual.")
    r_max = checks.positive("r_max", r_max, "[length]")
    diameter = 2 * scene.radius
    inner = np.array([scene.width, scene.height]) - 2 * (scene.radius + r_max)
    if r_max <= diameter or (inner <= 0).any():
        most = min(scene.width, scene.height) / 2 - scene.radius
        raise InputError(
            f"r_max must lie above one diameter, {diameter:g}, and below {most:g} (beyond that no disc is so far from "
            f"the walls); got {r_max!r}. Use another r_max, or a larger box."
        )
    edges = np.linspace(diameter, r_max, bins + 1)
    counts, variances, references = np.zeros(bins), np.zeros(bins), 0
    for state in states:
        position = _position(state)
        low = scene.radius + r_max
        inside = np.all((position >= low) & (position <= low + inner), axis=1, keepdims=True)[:, 0]
        references += int(inside.sum())
        for i, j, distance in _close_pairs(position, r_max):
            seen = inside[i].astype(float) + inside[j]  # by how many reference discs
            counts += np.histogram(distance, edges, weights=seen)[0]
            variances += np.histogram(distance, edges, weights=seen**2)[0]
    if references == 0:
        raise InputError(
            f"pair_correlation needs discs at least radius + r_max = {scene.radius + r_max:g} from the walls; got none "
            f"in {len(states)} states. Use a smaller r_max."
        )
    density = references / (len(states) * float(inner.prod()))
    expected = references * density * math.pi * np.diff(edges**2)
    g, error, r = counts / expected, np.sqrt(variances) / expected, (edges[:-1] + edges[1:]) / 2
    doubled = float(variances.sum() / max(counts.sum(), 1))
    contact = _contact(r / diameter - 1, counts, expected, doubled)
    return PairCorrelation(r, g, error, contact, density, references)


def _contact(
    gap: NDArray[np.float64], counts: NDArray[np.float64], expected: NDArray[np.float64], doubled: float
) -> Measure:
    """g at gap 0 [diameters] from counts near contact: Poisson regression on (1, gap, gap^2), Newton's method.

    Unlike a line through log(counts) it stays unbiased where counts are few. `doubled`: variance of a count over the
    count, above 1 because a pair of two inner discs is counted from both ends.
    """
    near = gap < CONTACT_RANGE
    gap, counts, expected = gap[near], counts[near], expected[near]
    pairs = int(counts.sum())
    if (counts > 0).sum() < 4:
        return Measure(math.nan, math.nan, pairs, settled=False)
    design = np.vander(gap, 3, increasing=True)
    powers = np.array([math.log(pairs / expected.sum()), 0.0, 0.0])
    inverse = np.eye(3)
    for _ in range(NEWTON_STEPS):
        mean = expected * np.exp(np.clip(design @ powers, -50, 50))
        inverse = np.linalg.pinv(design.T @ (mean[:, None] * design))
        step = inverse @ (design.T @ (counts - mean))
        powers = powers + step
        if np.abs(step).max() < 1e-10:
            value = math.exp(powers[0])
            return Measure(value, value * math.sqrt(doubled * inverse[0, 0]), pairs)
    return Measure(math.nan, math.nan, pairs, settled=False)


def _close_pairs(
    position: NDArray[np.float64], reach: float
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]]:
    """Pairs of discs closer than `reach`, each once, in chunks: indices i, indices j, distances.

    Discs are sorted by cell of side `reach`, cells numbered along y, then x, with an empty cell above each column. The
    partners of a disc are then two runs of the sorted discs: the rest of its own cell with the cell above, and three
    cells of the next column.
    """
    count = len(position)
    if count < 2 or reach <= 0:
        return
    low = position.min(axis=0)
    cell = ((position - low) / (reach * (1 + 1e-9))).astype(np.int64)
    rows = int(cell[:, 1].max()) + 2
    key = (cell[:, 0] + 1) * rows + cell[:, 1]
    order = np.argsort(key, kind="stable")
    key, x, y = key[order], position[order, 0], position[order, 1]
    first = np.stack([np.arange(1, count + 1), np.searchsorted(key, key + rows - 1, "left")], axis=1).ravel()
    last = np.stack(
        [np.searchsorted(key, key + 1, "right"), np.searchsorted(key, key + rows + 1, "right")], axis=1
    ).ravel()
    lengths = np.maximum(last - first, 0)
    ends = np.cumsum(lengths)
    start = 0
    while start < len(ends):
        done = int(ends[start] - lengths[start])
        stop = max(int(np.searchsorted(ends, done + CANDIDATES, "right")), start + 1)
        part = lengths[start:stop]
        i = np.repeat(np.arange(start, stop) // 2, part)
        j = np.arange(len(i)) + np.repeat(first[start:stop] - (ends[start:stop] - part - done), part)
        distance = np.hypot(x[i] - x[j], y[i] - y[j])
        near = distance < reach
        yield order[i[near]], order[j[near]], distance[near]
        start = stop


def _edges(bins: int | ArrayLike, largest: float) -> NDArray[np.float64]:
    if isinstance(bins, (int, np.integer)):
        number = checks.whole("bins", bins, 1, 1_000_000, "Some 50 bins are usual.")
        return np.linspace(0, largest, number + 1)
    edges = checks.finite_array("bins", bins, (None,), "(bins + 1,)")
    if len(edges) < 2 or edges[0] < 0 or (np.diff(edges) <= 0).any():
        raise InputError(f"bins must be at least two rising edges >= 0; got {edges.tolist()}. Sort them.")
    return edges


def _position(state: State) -> NDArray[np.float64]:
    return checks.finite_array("state.position", state.position, (None, 2), "(N, 2)")


def _velocity(state: State) -> NDArray[np.float64]:
    return checks.finite_array("state.velocity", state.velocity, (None, 2), "(N, 2)")


def _moving_squares(name: str, state: State) -> tuple[NDArray[np.float64], float]:
    """Squares of the speeds in units of the largest velocity component squared, and that component.

    In these units neither the squares nor their squares leave the range of float64, however fast or slow the discs.
    """
    velocity = _velocity(state)
    unit = float(np.abs(velocity).max(initial=0.0))
    if unit == 0:
        raise InputError(
            f"{name} needs a disc that moves; got {len(velocity)} discs, none moving. Give them velocities."
        )
    return ((velocity / unit) ** 2).sum(axis=1), unit


def _displacements(name: str, state: State, reference: State) -> NDArray[np.float64]:
    a, b = _position(state), _position(reference)
    if len(a) != len(b):
        raise InputError(
            f"{name} needs two states of the same discs; got {len(a)} and {len(b)} discs. "
            "Compare states between which no disc was added."
        )
    _demand_discs(name, len(a), 1)
    return a - b


def _demand_discs(name: str, count: int, fewest: int) -> None:
    if count < fewest:
        raise InputError(f"{name} needs at least {fewest} disc{'s' * (fewest > 1)}; got {count}. Add discs.")
