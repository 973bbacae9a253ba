"""Order in space: pair correlations, the structure factor, bond-orientational order, and states for freud."""

# pyright: reportPrivateUsage=false
# Names of Scene that begin with an underscore are for all of mpsim.

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpsim.core import checks
from mpsim.core.state import Box, State, states_in
from mpsim.errors import InputError, NotMeasurableError
from mpsim.measure.moments import (
    Lengths,
    checked_positions,
    close_pairs,
    demand_scene,
    lengths_of,
    placed,
    to_nearest_image,
)
from mpsim.measure.statistics import Measure
from mpsim.scene.scene import Scene

Floats = NDArray[np.float64]

# --- The pair-correlation function, and its value at contact

CONTACT_RANGE = 0.4
"""The contact value is extrapolated from distances up to this many diameters beyond contact. A shorter range
adds noise; a longer one adds bias (0.8 % from 0.3 to 0.5 at packing 0.6, nothing to be seen at packing 0.5)."""

NEWTON_STEPS = 50
"""Largest number of steps of the fit of the contact value: it converges in about five, or gives NaN."""


@dataclass(frozen=True)
class PairCorrelation:
    """Pair-correlation function, away from the walls.

    Attributes:
        r: shape (bins,), middle of each shell, from one diameter to r_max [length].
        value: shape (bins,), g(r): density at that distance from a disc, over the mean density [1].
        error: shape (bins,), its standard error from the number of pairs counted [1]. Between walls the density has an
            error too, at most 1/sqrt(references), which all shells share and which is not included.
        contact: g at one diameter, extrapolated; its error comes from the counts [1].
        density: number density of the region of the reference discs [1/length^2].
        references: number of reference discs, over all states.
    """

    r: Floats
    value: Floats
    error: Floats
    contact: Measure
    density: float
    references: int


def pair_correlation(states: State | Sequence[State], scene: Scene, bins: int, r_max: float) -> PairCorrelation:
    """Pair-correlation function g(r) from contact to r_max, of one state or averaged over several of the same scene.

    Along a periodic axis nearest images count. Between walls a disc is a reference only if its centre is at least
    radius + r_max from every wall: no shell then needs a correction, and the density is that of the same inner region,
    g = pairs / (states x inner area x density^2 x shell area). In dense gases choose r_max of at least about 4
    diameters: closer to the walls, layers of discs still affect the density.

    The contact value comes from exp(quadratic in r), fitted to the counts as Poisson numbers up to CONTACT_RANGE
    diameters beyond contact. Pairs closer than a diameter are not counted: see `overlap`. The density must be uniform:
    scenes with gravity, acceleration, emitters or obstacles are refused, and states with absorbed discs or a moving
    wall. After a wall has come to rest, the box is that of the state (`State.box`).

    Args:
        states: of equal discs in the scene's box; independent ones lower the noise.
        scene: gives box and radius, the same for all discs.
        bins: number of shells of equal width, >= 1; the contact value needs at least 4 within CONTACT_RANGE, and is NaN
            otherwise.
        r_max: [length], > one diameter, at most half of a periodic axis, and so small that an inner region remains.

    Raises:
        InputError: naming the argument and its rule; if no disc is a reference; if density is not uniform.

    Source: minus sampling, Ripley, J. R. Stat. Soc. B 39, 172 (1977), sect. 6; Allen & Tildesley, Computer Simulation
    of Liquids (2017), sect. 8.2.

    >>> scene = Scene.random(count=2000, packing=0.3, radius=0.5, seed=1)
    >>> found = pair_correlation(State(scene.position, scene.velocity), scene, bins=40, r_max=3.0)
    >>> bool(abs(found.value[-10:].mean() - 1) < 0.05)
    True
    """
    states = [placed(state, scene) for state in states_in(states)]
    bins = checks.whole("bins", bins, 1, 1_000_000, "About 100 shells are usual.")
    r_max = checks.positive("r_max", r_max, "[length]")
    radius = _one_radius(states, scene)
    walls = np.array(_box_of(states, scene))
    diameter, size, periodic = 2 * radius, walls[1::2] - walls[::2], np.array(scene.periodic)
    margin = np.where(periodic, 0.0, radius + r_max)
    low, inner = walls[::2] + margin, size - 2 * margin
    most = float(np.where(periodic, size / 2, size / 2 - radius).min())
    if not diameter < r_max <= most or (inner <= 0).any():
        raise InputError(
            f"r_max must lie above one diameter, {diameter:g}, and below {most:g} (beyond that no disc is far enough "
            f"from the walls, or a disc meets its own images); got {r_max!r}. Use another r_max, or a larger box."
        )
    edges = np.linspace(diameter, r_max, bins + 1)
    counts, variances, references = np.zeros(bins), np.zeros(bins), 0
    for state in states:
        position = checked_positions(state.position)
        inside = np.all((position >= low) & (position <= low + inner), axis=1, keepdims=True)[:, 0]
        references += int(inside.sum())
        for i, j, distance in close_pairs(position, r_max, lengths_of(scene, state.box)):
            seen = inside[i].astype(float) + inside[j]  # number of reference discs in each pair
            counts += np.histogram(distance, edges, weights=seen)[0]
            variances += np.histogram(distance, edges, weights=seen**2)[0]
    if references == 0:
        raise InputError(
            f"pair_correlation needs discs at least radius + r_max = {radius + r_max:g} from the walls; got none "
            f"in {len(states)} states. Use a smaller r_max."
        )
    density = references / (len(states) * float(inner.prod()))
    expected = references * density * math.pi * np.diff(edges**2)
    g, error, r = counts / expected, np.sqrt(variances) / expected, (edges[:-1] + edges[1:]) / 2
    doubled = float(variances.sum() / max(counts.sum(), 1))
    contact = _contact(r / diameter - 1, counts, expected, doubled)
    return PairCorrelation(r, g, error, contact, density, references)


def _one_radius(states: Sequence[State], scene: Scene) -> float:
    """The common radius of all discs, where nothing makes their density vary in space or time."""
    if not isinstance(scene.radius, float):
        raise InputError(
            f"pair_correlation needs discs of one radius; got radii from {scene.smallest_radius:g} to "
            f"{scene.largest_radius:g}. Give it a scene and states of the discs of one size."
        )
    for feature in scene._features:
        if feature.excludes:
            raise InputError(
                f"pair_correlation needs a box without {feature.argument}, which keep discs out of part of each shell; "
                f"got {len(feature.of(scene))}. Leave them out, or measure a scene without them."
            )
    reasons = {
        "gravity": scene.gravity is not None and bool(scene.gravity.any()),
        "acceleration": scene.acceleration is not None and bool(scene.acceleration.any()),
        "emitters": bool(scene.emitters),
    }
    for what in (what for what, present in reasons.items() if present):
        raise InputError(
            f"pair_correlation needs a uniform density; this scene has {what}, which makes the density non-uniform. "
            "Make a scene of these discs without it, and measure there once it has settled."
        )
    if gone := sum(int((~state.present).sum()) for state in states):
        raise InputError(
            "pair_correlation needs a uniform density; got states from which discs have left through an absorbing edge "
            f"({gone} absent in {len(states)} states), which thins them out near it. Make a scene without absorbing "
            "edges from scene.starting_from(state), and measure there once it has settled."
        )
    return scene.radius


def _box_of(states: Sequence[State], scene: Scene) -> Box:
    """The walls in all states: those of the scene, except for one that has moved and come to rest."""
    edges = list(scene.box)
    for wall in scene._moving_walls:
        edges[wall.edge] = end = float(wall.record.end)
        places = {None if state.box is None else state.box[wall.edge] for state in states}
        if math.isinf(wall.rests) or places != {end}:
            way = "that never rests" if math.isinf(wall.rests) else f"on its way to {end:g}"
            found = ", ".join(sorted(str(place) for place in places))
            raise InputError(
                f"pair_correlation needs a box at rest; got a {wall.name} {way}, at {found}. "
                "Take states after it has arrived, from a simulation."
            )
    return edges[0], edges[1], edges[2], edges[3]


def _contact(gap: Floats, counts: Floats, expected: Floats, doubled: float) -> Measure:
    """g at gap 0 [diameters] from counts near contact: Poisson regression on (1, gap, gap^2) by Newton's method.

    Unlike a linear fit of log(counts) it is unbiased for low counts. `doubled`: variance of a count over the count,
    above 1 because a pair of two reference discs counts twice.
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


# --- The structure factor, bond-orientational order, and states for freud

NEIGHBOURS = 6
"""Nearest neighbours of a disc in bond-orientational order, as many as in a triangular lattice."""

MOST_VECTORS = 2_000_000
"""Wave vectors of a structure factor at most."""


EDGE = 1e-12
"""Relative distance beyond the edge of a shell of a wave vector that lies on it but for rounding."""


@dataclass(frozen=True)
class StructureFactor:
    """Static structure factor, averaged over shells of wave vectors.

    Attributes:
        k: shape (bins,), mean wave number of each shell, NaN for a shell without vectors [1/length].
        value: shape (bins,), S(k), NaN likewise [1].
        error: shape (bins,), standard error S / sqrt(vectors x states), for independent states: in a fluid |rho_k|^2 is
            exponentially distributed, independently for each vector [1].
        vectors: shape (bins,), number of wave vectors, with k and -k counted once.
    """

    k: Floats
    value: Floats
    error: Floats
    vectors: NDArray[np.int64]


@dataclass(frozen=True)
class HexaticOrder:
    """Bond-orientational order of the discs that are present.

    Attributes:
        disc: shape (K,), their numbers.
        psi: shape (K,), complex: psi_6, of modulus 1 in a triangular lattice, where its argument is six times the angle
            of the bonds [1].
        local: mean of |psi_6| [1].
        whole: |mean of psi_6|: 1 in a crystal, of order 1/sqrt(K) in a fluid [1].
    """

    disc: NDArray[np.int64]
    psi: NDArray[np.complex128]
    local: float
    whole: float


@dataclass(frozen=True)
class HexaticCorrelation:
    """Correlation of bond-orientational order.

    Attributes:
        r: shape (bins,), middle of each shell [length].
        value: shape (bins,), g_6(r), the real part of the mean of psi_6(i)* psi_6(j) over pairs at that distance, NaN
            without pairs [1].
        pairs: shape (bins,), number of pairs, over all states.
    """

    r: Floats
    value: Floats
    pairs: NDArray[np.int64]


def structure_factor(states: State | Sequence[State], scene: Scene, bins: int, k_max: float) -> StructureFactor:
    """Static structure factor S(k) = |sum over discs of exp(i k.r)|^2 / K in a periodic box, in shells from 0 to k_max.

    Wave vectors are those of the box, k = 2 pi (n_x/width, n_y/height), all of them except 0. A shell includes its
    upper edge.

    Args:
        states: of discs in the scene's box, absorbed ones left out; independent ones lower the noise.
        scene: gives the box, periodic in both axes.
        bins: number of shells of equal width, >= 1.
        k_max: > 0 [1/length]. The first peak of a dense fluid is near 2 pi / diameter.

    Raises:
        InputError: naming the argument and its rule; if the box has walls; for more than 2,000,000 wave vectors.

    Source: Hansen & McDonald, Theory of Simple Liquids (2013), eq. 4.1.3.

    >>> corner = np.array([[0.5, 0.5], [1.5, 0.5], [0.5, 1.5], [1.5, 1.5]])
    >>> scene = Scene(width=2, height=2, position=corner, velocity=0 * corner, radius=0.4, boundary="periodic")
    >>> found = structure_factor(State(scene.position, scene.velocity), scene, bins=2, k_max=6.4)
    >>> found.value.round(9).tolist(), found.vectors.tolist()  # in the second shell the Bragg peaks (2, 0) and (0, 2)
    ([0.0, 2.0], [2, 4])
    """
    states = states_in(states)
    demand_scene(scene, *states)
    k_max = checks.positive("k_max", k_max, "[1/length]")
    bins = checks.whole("bins", bins, 1, 1_000_000, "About 50 shells are usual.")
    if not all(scene.periodic):
        raise InputError(
            "structure_factor needs a box that is periodic in both axes, whose wave vectors it takes; this one has "
            "walls. Use Scene(..., boundary='periodic'), or pair_correlation."
        )
    steps = 2 * math.pi / np.array([scene.width, scene.height])
    edges = np.linspace(0, k_max, bins + 1) * (1 + EDGE)
    reach = edges[-1] / steps
    if not math.pi * reach.prod() / 2 <= MOST_VECTORS:
        raise InputError(
            f"k_max must be small enough for at most {MOST_VECTORS:,} wave vectors; got {k_max!r}, which gives "
            f"{math.pi * reach.prod() / 2:.3g}. Give a smaller one."
        )
    sums, lengths, vectors = np.zeros(bins), np.zeros(bins), np.zeros(bins, np.int64)
    for state in states:
        places = _present(placed(state, scene), "structure_factor", 1)
        up = np.arange(-int(reach[1]), int(reach[1]) + 1)
        along_y = np.exp(1j * steps[1] * up[:, None] * places[:, 1])
        for n in range(int(reach[0]) + 1):
            rows = up > 0 if n == 0 else np.ones(len(up), np.bool_)  # of k and -k one
            density = (along_y[rows] * np.exp(1j * steps[0] * n * places[:, 0])).sum(axis=1)
            k = np.hypot(steps[0] * n, steps[1] * up[rows])
            shell = np.minimum(np.searchsorted(edges, k, side="left") - 1, bins - 1)
            inside = k <= edges[-1]
            for total, values in ((sums, np.abs(density) ** 2 / len(places)), (lengths, k), (vectors, np.ones(len(k)))):
                np.add.at(total, shell[inside], values[inside].astype(total.dtype))
    with np.errstate(invalid="ignore", divide="ignore"):
        s = sums / vectors
        return StructureFactor(lengths / vectors, s, s / np.sqrt(vectors), vectors // len(states))


def hexatic_order(state: State, scene: Scene) -> HexaticOrder:
    """Bond-orientational order psi_6(i) = mean over the six nearest neighbours j of exp(6 i angle of r_j - r_i).

    Along a periodic axis nearest images count. Discs at a wall have neighbours on one side only.

    Args:
        state: with at least seven discs that are present.
        scene: that of the state.

    Raises:
        InputError: for fewer discs, a state that is not finite, or so small a periodic box that the six neighbours are
            not within half of it.

    Source: Halperin & Nelson, Phys. Rev. Lett. 41, 121 (1978); with six nearest neighbours, as in freud's Hexatic.

    >>> column, row = np.divmod(np.arange(48), 8)
    >>> place = np.stack([column + 0.5 * (row % 2), row * math.sqrt(0.75)], axis=1)
    >>> scene = Scene(width=6, height=8 * math.sqrt(0.75), position=place, velocity=0 * place, radius=0.45,
    ...               boundary="periodic")
    >>> found = hexatic_order(State(scene.position, scene.velocity), scene)
    >>> round(found.local, 9), round(found.whole, 9)
    (1.0, 1.0)
    """
    state = placed(state, scene)
    places, lengths = _present(state, "hexatic_order", NEIGHBOURS + 1), lengths_of(scene, state.box)
    i, j = _nearest(places, scene, lengths)
    x, y = to_nearest_image(places[j] - places[i], lengths).T
    bonds = np.exp(6j * np.arctan2(y, x))
    psi = bonds.reshape(len(places), NEIGHBOURS).sum(axis=1) / NEIGHBOURS
    return HexaticOrder(np.flatnonzero(state.present), psi, float(np.abs(psi).mean()), float(np.abs(psi.mean())))


def hexatic_correlation(states: State | Sequence[State], scene: Scene, bins: int, r_max: float) -> HexaticCorrelation:
    """Correlation function of bond-orientational order, g_6(r) = Re <psi_6(0)* psi_6(r)>.

    It stays above 0 in a crystal, falls as a power of r in the hexatic phase, and exponentially in a fluid.

    Args:
        states: of one scene; independent ones lower the noise.
        scene: that of the states.
        bins: number of shells of equal width from 0 to r_max, >= 1.
        r_max: [length], > 0, at most half of a periodic axis.

    Raises:
        InputError: naming the argument and its rule; as `hexatic_order`.

    Source: Bernard & Krauth, Phys. Rev. Lett. 107, 155704 (2011).

    >>> scene = Scene.random(count=500, packing=0.3, radius=0.5, seed=1, boundary="periodic")
    >>> found = hexatic_correlation(State(scene.position, scene.velocity), scene, bins=8, r_max=8.0)
    >>> bool(found.value[1] > 5 * abs(found.value[-1]))
    True
    """
    states = states_in(states)
    demand_scene(scene, *states)
    bins = checks.whole("bins", bins, 1, 1_000_000, "About 50 shells are usual.")
    r_max = checks.positive("r_max", r_max, "[length]")
    if r_max > (most := _half(lengths_of(scene))):
        raise InputError(
            f"r_max must be at most half of a periodic axis, {most:g}, as nearest images count; got {r_max!r}. Give a "
            "smaller one."
        )
    edges = np.linspace(0, r_max, bins + 1)
    sums, pairs = np.zeros(bins), np.zeros(bins, np.int64)
    for state in (placed(each, scene) for each in states):
        psi, places = hexatic_order(state, scene).psi, _present(state, "hexatic_correlation", NEIGHBOURS + 1)
        for i, j, distance in close_pairs(places, r_max, lengths_of(scene, state.box)):
            sums += np.histogram(distance, edges, weights=(psi[i].conj() * psi[j]).real)[0]
            pairs += np.histogram(distance, edges)[0]
    with np.errstate(invalid="ignore"):
        return HexaticCorrelation((edges[:-1] + edges[1:]) / 2, sums / pairs, pairs)


def to_freud(state: State, scene: Scene) -> tuple[Any, NDArray[np.float32]]:
    """The discs that are present, in freud's form: a two-dimensional box, and points, shape (K, 3) [length].

    Voronoi cells, clusters and everything else in freud can be computed from these:
    `freud.locality.Voronoi().compute(to_freud(...))`. Points are relative to the middle of the box, in float32, which
    is what freud computes in. If a piston has moved a wall, the box is that of the state.

    Args:
        state: at any moment.
        scene: that of the state; it says which axes are periodic.

    Raises:
        InputError: if the state is not finite.
        NotMeasurableError: if the package freud-analysis is not installed.

    >>> scene = Scene.random(count=50, packing=0.2, radius=0.5, seed=1, boundary="periodic")
    >>> box, points = to_freud(State(scene.position, scene.velocity), scene)
    >>> points.shape, box.is2D
    ((50, 3), True)
    """
    state = placed(state, scene)
    places = _present(state, "to_freud", 0)
    try:
        import freud  # noqa: PLC0415
    except ImportError as error:
        raise NotMeasurableError(
            f"to_freud needs the package freud-analysis, which cannot be imported ({error}). Install it by pip install "
            "freud-analysis."
        ) from None
    x_low, x_high, y_low, y_high = scene.box if state.box is None else state.box
    box = freud.box.Box(Lx=x_high - x_low, Ly=y_high - y_low, is2D=True)
    box.periodic = (*scene.periodic, False)
    points = np.zeros((len(places), 3), np.float32)
    points[:, :2] = places - np.array([x_low + x_high, y_low + y_high]) / 2
    return box, points


def _present(state: State, name: str, fewest: int) -> Floats:
    """Positions of the discs that are present, shape (K, 2)."""
    places = checked_positions(state.position)[state.present]
    if len(places) < fewest:
        raise InputError(f"{name} needs at least {fewest} discs; got {len(places)}. Use a larger scene.")
    return places


def _half(lengths: Lengths) -> float:
    """Half of the shorter periodic axis [length]; infinite without one."""
    return min((length / 2 for length in lengths if length is not None), default=math.inf)


def _nearest(places: Floats, scene: Scene, lengths: Lengths) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Each disc NEIGHBOURS times, in order, and its nearest neighbours, of equally near ones those of lower number."""
    count, half = len(places), _half(lengths)
    reach = min(math.sqrt(3 * NEIGHBOURS * scene.width * scene.height / (math.pi * count)), half)
    while True:
        found = list(close_pairs(places, reach, lengths))
        one, other, distance = (np.concatenate([each[part] for each in found] or [np.zeros(0)]) for part in range(3))
        i, j, r = np.append(one, other).astype(int), np.append(other, one).astype(int), np.tile(distance, 2)
        if (np.bincount(i, minlength=count) >= NEIGHBOURS).all():
            order = np.lexsort((j, r, i))
            first = np.searchsorted(i[order], np.arange(count))
            chosen = order[(first[:, None] + np.arange(NEIGHBOURS)).ravel()]
            return i[chosen], j[chosen]
        if reach >= min(half, scene.width + scene.height):
            raise InputError(
                f"hexatic_order needs {NEIGHBOURS} neighbours of each disc within half of each periodic axis, {half:g}"
                f"; got a disc with {int(np.bincount(i, minlength=count).min())}. Use a larger box."
            )
        reach = min(1.5 * reach, half, scene.width + scene.height)
