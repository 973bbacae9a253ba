"""Any scene in other units: lengths, times and masses times powers of two give the same bits, scaled.

So nowhere may an absolute number stand for a length, a time or a mass.
"""

import dataclasses

import numpy as np
import pytest
from support.anything import any_gas, anything, typical_time
from support.compare import assert_same_bits
from support.scenes import simulate
from support.transforms import Units, features_of, is_weighed

import mpsim
from mpsim.measure import registry

FRAMES = 10

pytestmark = [pytest.mark.plain, pytest.mark.filterwarnings("ignore::UserWarning")]


MOST_POWER = {"float32": 6, "float64": 60}  # of two, up to which units are changed: squares of squares must fit


def without_vanishing(scene):
    """Speeds and spins whose squares would leave the range of float32 in some units are none."""
    large = lambda speeds: None if speeds is None else np.where(np.abs(speeds) < 1e-20, 0.0, speeds)  # noqa: E731
    return mpsim.Scene(**features_of(scene) | {"velocity": large(scene.velocity), "spin": large(scene.spin)})


def outcome(scene, frames, **settings):
    """State, contacts and measures of a run."""
    names = [name for name in registry.NAMES if registry.refusal(name, scene) is None]
    with simulate(scene, **settings) as sim:
        report = sim.run(frames=frames, measures=names)
        return sim.state, report.collisions, dict(report.measures), sim.absorbed.tolist()


def check(scene, frames, units, note, **settings):
    """Fail unless both systems of units give the same bits. Returns contacts."""
    if not is_weighed(scene) or not scene.count:  # discs without masses, which have mass 1 in any units
        units = dataclasses.replace(units, mass=1.0)
    state, contacts, measures, absorbed = outcome(scene, frames, **settings)
    settings["dt"] *= units.time
    other = outcome(units.scene(scene), frames, **settings)
    note = f"{note}, {units}, {scene!r}, {settings}"
    real = state.position.dtype.type
    expected = {"position": state.position * real(units.length), "velocity": state.velocity * real(units.speed)}
    if state.spin is not None:
        expected["spin"] = state.spin * real(1 / units.time)
    if getattr(state, "box", None) is not None:
        expected["box"] = tuple(edge * units.length for edge in state.box)
    others = {field.name: getattr(state, field.name) for field in dataclasses.fields(state)}
    assert_same_bits(other[0], mpsim.State(**others | expected), note)
    assert other[1] == contacts, f"{note}: {other[1]} contacts instead of {contacts}"
    assert other[3] == absorbed, f"{note}: others are absorbed"
    for name, measure in measures.items():
        for part in ("value", "error"):
            got, want = getattr(other[2][name], part), getattr(measure, part) * units.measure(name)
            assert got == want or np.isnan([got, want]).all(), f"{note}: {part} of {name} is {got!r}, expected {want!r}"
    return contacts


def check_stepped(seed):
    """Any scene by naive or grid."""
    scene, settings = anything(seed)
    units = Units.drawn(np.random.default_rng([seed, 1]), MOST_POWER[settings["precision"]])
    return check(without_vanishing(scene), FRAMES, units, f"scene {seed}", **settings)


def check_exact(seed):
    """Any gas by event."""
    scene = any_gas(seed)
    units = Units.drawn(np.random.default_rng([seed, 2]), MOST_POWER["float64"])
    return check(scene, FRAMES, units, f"gas {seed}", method="event", dt=typical_time(scene) / 4)


def check_placed(seed):
    """A random start is the same in other units."""
    rng = np.random.default_rng([seed, 3])
    units, packing = Units.drawn(rng, 60), rng.choice([0.05, 0.3, 0.5, 0.7])
    boundary = [str(rng.choice(["walls", "periodic"])) for _ in "xy"]
    radius = rng.choice([0.5, 0.3, 0.2], 20) if rng.random() < 0.5 else 0.5
    start, scaled = (
        mpsim.Scene.random(
            count=20, packing=packing, radius=np.multiply(radius, length), temperature=1.0, seed=seed, boundary=boundary
        )
        for length in (1.0, units.length)
    )
    assert (start.position * units.length == scaled.position).all(), f"start {seed}, {units}: {start!r}, {scaled!r}"


def test_units_change_no_bit_of_any_scene():
    assert sum(map(check_stepped, range(4))) > 8
    assert sum(map(check_exact, range(2))) > 8


def test_units_change_no_random_start():
    for seed in range(4):
        check_placed(seed)
