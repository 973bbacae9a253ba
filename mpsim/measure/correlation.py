"""Pairs of discs, and the pair-correlation function."""

# pyright: reportPrivateUsage=false
# Names of Scene that begin with an underscore are for all of mpsim.

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mpsim.core import checks
from mpsim.core.state import Box, State, states_in
from mpsim.errors import InputError
from mpsim.features import FEATURES
from mpsim.measure.moments import checked_positions, placed
from mpsim.measure.statistics import Measure
from mpsim.scene.scene import Scene

# --- Pairs of discs closer than a distance, in boxes with walls and periodic ones

CANDIDATES = 2**21
"""Pairs tested together: limits the memory of a pair search to about 100 MB, whatever the number of discs."""

Pairs = tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]
"""Indices i, indices j, and distances [length], each of shape (pairs,)."""

Lengths = tuple[float | None, float | None]
"""Lengths of x and y, None for an axis that is not periodic [length]."""


def lengths_of(scene: Scene, box: Box | None = None) -> Lengths:
    """Lengths of the periodic axes of a scene, or those of the box of a state of it."""
    sides = (scene.width, scene.height) if box is None else (box[1] - box[0], box[3] - box[2])
    width, height = (length if wraps else None for length, wraps in zip(sides, scene.periodic, strict=True))
    return width, height


def to_nearest_image(difference: NDArray[np.float64], lengths: Lengths) -> NDArray[np.float64]:
    """Differences of positions, shape (..., 2), to the nearest image along each periodic axis.

    >>> to_nearest_image(np.array([[0.9, 0.9], [-0.6, 0.2]]), (1.0, None)).round(12).tolist()
    [[-0.1, 0.9], [0.4, 0.2]]
    """
    size = np.array([np.inf if length is None else length for length in lengths])
    turns = np.round(difference / size)
    return difference - np.where(np.isinf(size), 0.0, turns * np.where(np.isinf(size), 0.0, size))


def close_pairs(position: NDArray[np.float64], reach: float, lengths: Lengths = (None, None)) -> Iterator[Pairs]:
    """Pairs of discs closer than `reach`, each once, in chunks: indices i, indices j, distances.

    Args:
        position: shape (N, 2), along a periodic axis from 0 to its length [length].
        reach: at most half of each periodic axis [length].
        lengths: of the periodic axes.

    >>> place = np.array([[0.1, 0.5], [0.9, 0.5], [0.5, 0.5]])
    >>> [(i.tolist(), j.tolist(), d.round(12).tolist()) for i, j, d in close_pairs(place, 0.3, (1.0, None))]
    [([1], [0], [0.2])]
    """
    if lengths == (None, None):
        yield from _open_pairs(position, reach)
        return
    # Images beyond the upper end of each periodic axis. A pair of two images along one axis was found without them.
    places, owner, image = position, np.arange(len(position)), np.zeros((len(position), 2), np.bool_)
    for axis, length in enumerate(lengths):
        if length is not None:
            low = np.flatnonzero(places[:, axis] < reach)
            shifted, marked = places[low].copy(), image[low].copy()
            shifted[:, axis] += length
            marked[:, axis] = True
            places, owner = np.concatenate([places, shifted]), np.concatenate([owner, owner[low]])
            image = np.concatenate([image, marked])
    for i, j, distance in _open_pairs(places, reach):
        new = ~(image[i] & image[j]).any(axis=1)
        yield owner[i[new]], owner[j[new]], distance[new]


def _open_pairs(position: NDArray[np.float64], reach: float) -> Iterator[Pairs]:
    """`close_pairs` without periodic axes.

    Discs are sorted by cells of side `reach`, numbered along y, then x, with an empty cell above each column. The
    candidates of a disc are then two ranges of the sorted discs: the rest of its own cell with the cell above, and
    three cells of the next column.
    """
    count = len(position)
    if count < 2 or reach <= 0:
        return
    low = position.min(axis=0)
    # Cells are wider than needed where their numbers would overflow.
    side = max(reach * (1 + 1e-9), float((position.max(axis=0) - low).max()) / 2**30)
    cell = ((position - low) / side).astype(np.int64)
    rows = int(cell[:, 1].max()) + 2
    key: NDArray[np.int64] = (cell[:, 0] + 1) * rows + cell[:, 1]
    order = np.argsort(key, kind="stable")
    key, x, y = key[order], position[order, 0], position[order, 1]
    above: NDArray[np.intp] = np.searchsorted(key, key + 1, "right")
    right: NDArray[np.intp] = np.searchsorted(key, key + rows + 1, "right")
    first = np.stack([np.arange(1, count + 1), np.searchsorted(key, key + rows - 1, "left")], axis=1).ravel()
    last: NDArray[np.intp] = np.stack([above, right], axis=1).ravel()
    lengths = np.maximum(last - first, 0)
    ends = np.cumsum(lengths)
    start = 0
    while start < len(ends):
        done = int(ends[start] - lengths[start])
        stop = max(int(np.searchsorted(ends, done + CANDIDATES, "right")), start + 1)
        chunk = lengths[start:stop]
        i = np.repeat(np.arange(start, stop) // 2, chunk)
        j = np.arange(len(i)) + np.repeat(first[start:stop] - (ends[start:stop] - chunk - done), chunk)
        distance = np.hypot(x[i] - x[j], y[i] - y[j])
        near = distance < reach
        yield order[i[near]], order[j[near]], distance[near]
        start = stop


# --- The pair-correlation function of states, and its value at contact

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
        error: shape (bins,), its standard error, a relative error of 1/sqrt(pairs) from the number of pairs counted
            [1]. Between walls the density has an error too, at most 1/sqrt(references), which all shells share and
            which is not included.
        contact: g at one diameter, extrapolated; its error comes from the counts [1].
        density: number density of the region of the reference discs [1/length^2].
        references: number of reference discs, over all states.
    """

    r: NDArray[np.float64]
    value: NDArray[np.float64]
    error: NDArray[np.float64]
    contact: Measure
    density: float
    references: int


def pair_correlation(states: State | Sequence[State], scene: Scene, bins: int, r_max: float) -> PairCorrelation:
    """Pair-correlation function g(r) from contact to r_max, of one state or averaged over several of the same scene.

    A periodic axis needs no margin: nearest images count. Between walls a disc is a reference only if its centre is at
    least radius + r_max from every wall, so that centres may lie anywhere in the shells around it. Then no shell needs
    a correction, the layers of discs at the walls bias only the shells that reach them, and the density is that of the
    same inner region: g = pairs / (states x inner area x density^2 x shell area). The price is that only the inner
    discs are references. In dense gases choose r_max of at least about 4 diameters: closer to the walls, the layers
    still affect the density.

    The contact value comes from exp(quadratic in r), fitted to the counts as Poisson numbers up to CONTACT_RANGE
    diameters beyond contact. Pairs closer than a diameter are not counted: see `overlap`.

    The density must be uniform, or g would reflect its variation in space. Scenes with gravity, acceleration, emitters
    or capsules are therefore refused, as are states with absorbed discs or a moving wall. After a wall has come to
    rest, the box is that of the state (`State.box`).

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
    radius = _one_radius(scene)
    _demand_uniform(states, scene)
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


def _one_radius(scene: Scene) -> float:
    """The common radius of all discs, in a box without capsules."""
    if not isinstance(scene.radius, float):
        raise InputError(
            f"pair_correlation needs discs of one radius; got radii from {scene.smallest_radius:g} to "
            f"{scene.largest_radius:g}. Give it a scene and states of the discs of one size."
        )
    for feature in FEATURES:
        if feature.excludes and feature.is_in(scene):
            raise InputError(
                f"pair_correlation needs a box without {feature.argument}, which keep discs out of part of each shell; "
                f"got {len(feature.of(scene))}. Leave them out, or measure a scene without them."
            )
    return scene.radius


def _demand_uniform(states: Sequence[State], scene: Scene) -> None:
    """Refuse, by name, what makes the density vary in space or time."""
    reasons = {
        "gravity": scene.gravity is not None and bool(scene.gravity.any()),
        "acceleration": scene.acceleration is not None and bool(scene.acceleration.any()),
        "emitters": bool(scene.emitters),
    }
    for what, present in reasons.items():
        if present:
            raise InputError(
                f"pair_correlation needs a uniform density; this scene has {what}, which makes the density "
                "non-uniform. Make a scene of these discs without it, and measure there once it has settled."
            )
    gone = sum(int((~state.present).sum()) for state in states)
    if gone:
        raise InputError(
            "pair_correlation needs a uniform density; got states from which discs have left through an absorbing edge "
            f"({gone} absent in {len(states)} states), which thins them out near it. Make a scene without absorbing "
            "edges from scene.starting_from(state), and measure there once it has settled."
        )


def _box_of(states: Sequence[State], scene: Scene) -> Box:
    """The walls in all states: those of the scene, except for one that has moved and come to rest."""
    wall = scene._moving_wall
    if wall is None:
        return scene.box
    places = {None if state.box is None else state.box[wall.edge] for state in states}
    if places != {wall.stop}:
        raise InputError(
            f"pair_correlation needs a box at rest; got a {wall.name} on its way to {wall.stop:g}, at "
            f"{', '.join(sorted(str(place) for place in places))}. Take states after it has arrived, from a simulation."
        )
    edges = list(scene.box)
    edges[wall.edge] = wall.stop
    return edges[0], edges[1], edges[2], edges[3]


def _contact(
    gap: NDArray[np.float64], counts: NDArray[np.float64], expected: NDArray[np.float64], doubled: float
) -> Measure:
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
