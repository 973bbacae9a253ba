"""Extreme scenes, searched and shrunk: nothing is lost, nothing grows, and what comes out wrong was told."""

import math
import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.compare import assert_inside_and_finite

import mpsim

pytestmark = [pytest.mark.compiled, pytest.mark.slow]

PARTS = st.sampled_from([1e-6, 1e-3, 0.03, 0.3, 0.7, 1.5, 10.0, 100.0])
"""Way of the fastest disc in a step, in radii."""

SIXTEENTHS = st.integers(0, 16)
POWERS = st.sampled_from([-12, -6, -3, 0, 3, 6, 12])


@st.composite
def scenes(draw):
    """Up to a dozen discs, in any units, in boxes up to 10,000 times as long as high, all in one place perhaps."""
    unit, pace = 10.0 ** draw(POWERS), 10.0 ** draw(POWERS)
    width, height = unit * draw(st.sampled_from([1.0, 1.1, 4.0, 1e4])), unit * draw(st.sampled_from([1.0, 1.3, 5.0]))
    places = draw(st.lists(st.tuples(SIXTEENTHS, SIXTEENTHS), max_size=12))
    count = len(places)
    radius = 0.5 * unit
    free = np.array([width, height]) - 2 * radius
    squeezed = draw(st.sampled_from([1.0, 1.0, 1e-3, 0.0]))
    position = radius + np.reshape(places, (count, 2)) / 16 * free * squeezed
    speed = st.sampled_from([0.0, 1.0, -1.0, 0.3, -0.7, 1e-15])
    velocity = np.reshape(draw(st.lists(st.tuples(speed, speed), min_size=count, max_size=count)), (count, 2))
    dt = draw(PARTS) * radius / (pace * unit)
    box = {"width": width, "height": height, "radius": radius}
    return mpsim.Scene(position=position, velocity=velocity * pace * unit, **box), dt


@st.composite
def runs(draw):
    scene, dt = draw(scenes())
    how = {
        "precision": draw(st.sampled_from(["float64", "float32"])),
        "law": draw(st.sampled_from(["elastic", "reflect"])),
        "contact": draw(st.sampled_from(["impact", "push"])),
        "on_fast": draw(st.sampled_from(["warn", "warn", "substep"])),
        "dt": dt,
    }
    return scene, how


def ran(scene, frames, **how):
    """Final state, the kinds of warnings, and the number of contacts; None where it is refused with a remedy."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        try:
            with mpsim.Simulation(scene, mpsim.Settings(**how)) as sim:
                report = sim.run(frames=frames)
                return sim.state, {each.category for each in told}, report.collisions
        except mpsim.InputError:
            return None


def energy(velocity, scene):
    unit = float(np.abs(scene.velocity).max(initial=0.0)) or 1.0
    return float(((velocity.astype(float) / unit) ** 2).sum())


@given(runs(), st.sampled_from(["naive", "grid"]))
def test_nothing_is_lost_and_no_energy_comes_from_nowhere(run, method):
    scene, how = run
    found = ran(scene, 40, method=method, **how)
    if found is None:
        return
    state, _, contacts = found
    assert len(state.position) == scene.count
    assert_inside_and_finite(state, scene, f"{method}, {how}")
    # A contact rounds a velocity, and with on_fast="substep" there were 123,213 of them in 40 frames.
    rounding = (1e-12 if how["precision"] == "float64" else 1e-4) + contacts * np.finfo(float).eps
    before, after = energy(scene.velocity, scene), energy(state.velocity, scene)
    assert after <= before * (1 + rounding) + 1e-30, f"{method}, {how}: energy {before} became {after}"


@given(
    part=PARTS,
    off=st.floats(0, 0.5),
    speeds=st.tuples(st.floats(0.01, 1), st.just(1.0)),
    unit=POWERS,
    precision=st.sampled_from(["float64", "float32"]),
    on_fast=st.sampled_from(["warn", "substep"]),
    side=st.sampled_from([20.0, 1e3, 1e5, 1e7]),
)
def test_two_discs_part_as_they_should_or_it_was_told(part, off, speeds, unit, precision, on_fast, side):
    """`off`: distance of their ways, in diameters. Nothing to do with the exact solver: worked by hand."""
    scale = 10.0**unit
    gap, middle = 1.7, side / 2
    places = np.array([[middle - 0.5 - gap / 2, middle], [middle + 0.5 + gap / 2, middle + off]]) * scale
    velocity = np.array([[speeds[0], 0], [-speeds[1], 0]]) * scale
    scene = mpsim.Scene(width=side * scale, height=side * scale, position=places, velocity=velocity, radius=0.5 * scale)
    dt = part * 0.5
    time = 1.5 * (gap + 1) / sum(speeds)
    frames = min(math.ceil(time / dt), 4000)
    found = ran(scene, frames, method="grid", dt=dt, precision=precision, on_fast=on_fast)
    if found is None:
        return
    state, told, _ = found
    expected = _by_hand(off, gap, speeds, frames * dt, places / scale)
    if (expected < 0.5).any() or (expected > side - 0.5).any():  # they have met a wall
        return
    # Each frame rounds a place by at most half the spacing of coordinates, in the middle of the box side * eps / 2 at
    # most, and perhaps to the same side each time.
    rounding = 1e-6 + frames * np.finfo(float).eps * side / 4 if precision == "float64" else 0.05 + 1e-3 * frames
    if np.abs(state.position / scale - expected).max() > rounding:
        assert told, f"silent: {state.position / scale} for {expected}, {frames} frames of {dt}"


def _by_hand(off, gap, speeds, time, places):
    """Places after a time, in diameters."""
    closing = sum(speeds)
    touch = (gap + 1 - math.sqrt(1 - off * off)) / closing
    velocity = np.array([[speeds[0], 0.0], [-speeds[1], 0.0]])
    if time <= touch:
        return places + velocity * time
    met = places + velocity * touch
    normal = met[1] - met[0]
    exchanged = (velocity[1] - velocity[0]) @ normal * normal
    after = velocity + np.array([exchanged, -exchanged])
    return met + after * (time - touch)
