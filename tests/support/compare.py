"""Comparisons whose failure names the first thing that differs."""

from dataclasses import fields

import numpy as np

import mpsim


def assert_same_bits(got: mpsim.State, expected: mpsim.State, note: str) -> None:
    """Fail, naming the first differing disc and its values, unless both states have the same bits."""
    for field in ("position", "velocity"):
        left, right = getattr(got, field), getattr(expected, field)
        assert left.dtype == right.dtype, f"{note}: {field} has {left.dtype}, expected {right.dtype}"
        assert left.shape == right.shape, f"{note}: {field} has shape {left.shape}, expected {right.shape}"
        words = f"u{left.dtype.itemsize}"
        if len(differ := np.flatnonzero((left.view(words) != right.view(words)).any(axis=1))):
            first = differ[0]
            raise AssertionError(
                f"{note}: {len(differ)} of {len(left)} discs differ in {field}; the first is disc {first}: "
                f"{left[first].tolist()} instead of {right[first].tolist()}"
            )
    others = {column.name for column in fields(mpsim.State)} - {"position", "velocity", "box"}  # not all know the box
    for field in sorted(others):
        left, right = getattr(got, field), getattr(expected, field)
        assert np.array_equal(left, right), f"{note}: {field} is {left}, expected {right}"


def values(report: mpsim.Report) -> dict[str, str]:
    """The measures of a report, with their errors, as texts: in these NaN equals NaN."""
    return {name: repr(each) for name, each in report.measures.items()}


def assert_inside_and_finite(state: mpsim.State, scene: mpsim.Scene, note: str) -> None:
    """Fail unless every disc is finite and, in the precision of the run, wholly inside the box."""
    real = state.position.dtype.type
    low = real(scene.radius)
    high = np.array([scene.width - scene.radius, scene.height - scene.radius]).astype(real)
    finite = np.isfinite(state.position).all() and np.isfinite(state.velocity).all()
    assert finite, f"{note}: a disc is not finite"
    outside = np.flatnonzero(((state.position < low) | (state.position > high)).any(axis=1))
    assert not len(outside), f"{note}: disc {outside[0]} is outside, at {state.position[outside[0]].tolist()}"


def overlapping_pairs(position: np.ndarray, diameter: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Index arrays i < j of all pairs closer than one diameter, and their distances: by sorting along x."""
    order = np.argsort(position[:, 0], kind="stable")
    x, y = position[order].T
    firsts, seconds, distances = [], [], []
    for offset in range(1, len(x)):
        dx = x[offset:] - x[:-offset]
        if not (dx < diameter).any():
            break
        distance = np.hypot(dx, y[offset:] - y[:-offset])
        hits = np.flatnonzero(distance < diameter)
        firsts.append(order[hits])
        seconds.append(order[hits + offset])
        distances.append(distance[hits])
    if not firsts:
        return np.empty(0, int), np.empty(0, int), np.empty(0)
    i, j = np.concatenate(firsts), np.concatenate(seconds)
    return np.minimum(i, j), np.maximum(i, j), np.concatenate(distances)
