"""The kernel of a thermostat in plain Python: which discs, when, and how fast."""

from types import SimpleNamespace

import numpy as np
import pytest

from mpsim.kernels.features import thermostat

COUNT = 2000


def after(steps, *, probability=1.0, substeps=1, mass=None, exits=None, ids=None, first_frame=0):
    """Velocities of discs in the order of their numbers after `heat`, which were 0."""
    numbers = np.arange(COUNT) if ids is None else ids
    discs = SimpleNamespace(id=numbers, vx=np.zeros(COUNT), vy=np.zeros(COUNT))
    record = SimpleNamespace(probability=probability, temperature=2.0, seed=3, first_frame=first_frame)
    control = SimpleNamespace(steps=steps, substeps=substeps)
    thermostat.heat(record, discs, 0, COUNT, SimpleNamespace(mass=mass, exits=exits), control)
    found = np.zeros((COUNT, 2))
    found[numbers] = np.stack([discs.vx, discs.vy], axis=1)
    return found


def test_each_mass_has_the_energy_of_the_temperature():
    mass = np.where(np.arange(COUNT) % 2, 1.0, 9.0)
    energy = mass[:, None] * after(5, mass=mass) ** 2
    for kind in (1.0, 9.0):
        assert energy[mass == kind].mean() == pytest.approx(2.0, abs=4 * 2.0 * np.sqrt(2 / COUNT))


def test_so_many_discs_have_new_velocities_as_the_probability_says():
    changed = (after(5, probability=0.3) != 0).all(axis=1).sum()
    assert changed == pytest.approx(0.3 * COUNT, abs=4 * np.sqrt(0.21 * COUNT))


def test_the_order_in_memory_does_not_matter_and_the_frame_does():
    expected = after(5)
    assert (after(5, ids=np.random.default_rng(0).permutation(COUNT)) == expected).all()
    assert (after(2, first_frame=3) == expected).all()
    assert (after(15, substeps=3) == expected).all()
    assert (after(6) != expected).all()


@pytest.mark.parametrize(("steps", "substeps"), [(0, 1), (1, 2), (2, 3)])
def test_before_the_first_frame_and_inside_frames_nothing_changes(steps, substeps):
    assert (after(steps, substeps=substeps) == 0).all()


def test_absorbed_discs_stay_at_rest():
    exits = np.zeros((3, COUNT))
    exits[0, ::2] = 1
    found = after(5, exits=exits)
    assert (found[::2] == 0).all()
    assert (found[1::2] != 0).all()
