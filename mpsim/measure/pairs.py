"""Pairs of discs closer than a distance, in boxes with walls and periodic ones."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from mpsim.core.state import Box
from mpsim.scene.scene import Scene

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
        chunk = lengths[start:stop]
        i = np.repeat(np.arange(start, stop) // 2, chunk)
        j = np.arange(len(i)) + np.repeat(first[start:stop] - (ends[start:stop] - chunk - done), chunk)
        distance = np.hypot(x[i] - x[j], y[i] - y[j])
        near = distance < reach
        yield order[i[near]], order[j[near]], distance[near]
        start = stop
