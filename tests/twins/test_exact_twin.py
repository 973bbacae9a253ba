"""The exact solver against a slow twin, and against itself with other cells and calendars."""

import numpy as np
import pytest
from support.event_twin import Twin
from support.exact import CONFIGURATIONS, Run, bits, follow, gas
from support.selection import long_but


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    long_but(CONFIGURATIONS, "plain", "rough obstacles with everything"),
)
def test_follows_the_slow_twin_event_by_event(name):
    options = dict(CONFIGURATIONS[name])
    position, velocity, radius, length = gas(9, 0.35, seed=5, spread=options.pop("spread", 0.0))
    if options.pop("mass", False):
        options["mass"] = np.random.default_rng(1).uniform(0.5, 3.0, 9)
    if options.pop("spin", False):
        options["spin"] = np.random.default_rng(2).normal(size=9)
    run = Run(position, velocity, length, length, radius, **options)
    twin = Twin(position, velocity, np.broadcast_to(radius, 9), length, length, **options)
    worst = follow(run, twin, 60 if twin.capsules else 300)
    print(name, worst, twin.time, twin.guards)
    assert worst < 1e-12


@pytest.mark.slow
def test_the_twin_can_tell():
    position, velocity, radius, length = gas(9, 0.35, seed=5)
    run = Run(position, velocity, length, length, radius)
    twin = Twin(position, velocity, [radius] * 9, length, length, restitution=0.999)
    with pytest.raises(AssertionError):
        assert follow(run, twin, 20) < 1e-6


@pytest.mark.long
def test_the_twin_can_tell_another_law_of_friction():
    options = dict(CONFIGURATIONS["rough with everything"], mass=np.ones(9), spin=np.ones(9))
    position, velocity, radius, length = gas(9, 0.35, seed=5, spread=options.pop("spread"))
    run = Run(position, velocity, length, length, radius, **options)
    twin = Twin(position, velocity, radius, length, length, **options | {"wall_friction": (0.4, 1e-6)})
    with pytest.raises(AssertionError):
        assert follow(run, twin, 20) < 1e-9


@pytest.mark.slow
def test_cells_and_calendar_do_not_change_the_motion():
    position, velocity, radius, length = gas(36, 0.3, seed=12)
    reference = Run(position, velocity, length, length, radius)
    reference.advance(3.0)
    for cells, steps in [((1, 1), None), ((2, 5), None), (None, 64), (None, 1 << 14)]:
        run = Run(position, velocity, length, length, radius, cells=cells, steps=steps)
        run.advance(3.0)
        assert run.count("pairs") == reference.count("pairs")
        assert np.abs(run.state()[0] - reference.state()[0]).max() < 1e-9


@pytest.mark.parametrize("cells", [(1, 1), (2, 2), (3, 3), (2, 3)])
def test_small_periodic_boxes_see_every_image(cells):
    position, velocity, radius, length = gas(4, 0.3, seed=13)
    run = Run(position, velocity, length, length, radius, periodic=(True, True), cells=cells)
    twin = Twin(position, velocity, [radius] * 4, length, length, periodic=(True, True), images=5)
    assert follow(run, twin, 120) < 1e-12


@pytest.mark.long
def test_winding_unwraps_a_flight():
    run = Run([[2.0, 7.0]], [[-3.1, 1.7]], 10.0, 8.0, periodic=(True, True), image=True)
    run.advance(100.0)
    unwrapped = run.state()[0] + run.features.image * np.array([10.0, 8.0])
    assert np.abs(unwrapped - [2.0 - 310.0, 7.0 + 170.0]).max() < 1e-10


@pytest.mark.long
def test_masses_and_radii_that_are_all_equal_give_the_bits_of_none():
    position, velocity, radius, length = gas(49, 0.4, seed=14)
    plain = Run(position, velocity, length, length, radius)
    given = Run(position, velocity, length, length, np.full(49, radius), mass=np.ones(49))
    plain.advance(5.0)
    given.advance(5.0)
    assert bits(plain) == bits(given)
