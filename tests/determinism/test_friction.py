"""The bits of rough discs: on any number of workers, in pieces, after a resume, after a death."""

import os
import signal

import numpy as np
import pytest
from support.compare import assert_same_bits
from support.scenes import gas, simulate, state_after

import mpsim

ROUGH = {"friction": 0.4, "wall_friction": 0.3, "tangential_restitution": 0.5, "restitution": 0.9}
SETTINGS = {"dt": 0.02, "contact": "impact"}
FRAMES = 40

pytestmark = pytest.mark.timeout(300)


def scene():
    return gas(1500, 0.6, seed=2, **ROUGH, spin=1.0)


@pytest.fixture(scope="module")
def expected():
    """By `grid`, in one piece."""
    return state_after(scene(), FRAMES, method="grid", **SETTINGS)


@pytest.mark.parametrize("workers", [1, 2, 3])
def test_any_number_of_workers_has_the_bits_of_grid(workers, expected):
    with simulate(scene(), method="parallel", workers=workers, **SETTINGS) as sim:
        assert sim.run(frames=FRAMES).collisions > 1000
        assert_same_bits(sim.state, expected, f"{workers} workers")
        assert np.unique(sim.state.spin).size > 1000, "contacts have changed the spins"


@pytest.mark.long
@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("contact", ["push", "impact"])
def test_precisions_and_contacts_have_the_same_bits_on_workers(precision, contact):
    settings = {"dt": 0.02, "contact": contact, "precision": precision}
    grid = state_after(scene(), FRAMES, method="grid", **settings)
    assert grid.spin.dtype == precision
    assert_same_bits(state_after(scene(), FRAMES, method="parallel", workers=3, **settings), grid, str(settings))


def test_pieces_and_a_resume_have_the_same_bits(expected, tmp_path):
    with simulate(scene(), method="grid", **SETTINGS) as sim:
        for frames in (1, 7, 12):
            sim.run(frames=frames)
        path = sim.save(tmp_path / "run")
    with mpsim.Simulation.resume(path, workers=2) as sim:
        sim.run(frames=FRAMES - 20)
        assert_same_bits(sim.state, expected, "resumed")


def test_a_healed_run_has_the_same_bits(expected):
    with simulate(scene(), method="parallel", workers=2, on_worker_death="restart", **SETTINGS) as sim:
        sim.run(frames=FRAMES // 2)
        os.kill(sim.pids[0], signal.SIGKILL)
        sim.run(frames=FRAMES - FRAMES // 2)
        assert_same_bits(sim.state, expected, "healed")


def test_the_exact_solver_has_the_same_bits_in_pieces_and_after_a_resume(tmp_path):
    small = gas(100, 0.4, seed=2, **ROUGH, spin=1.0)
    whole = state_after(small, 40, method="event", dt=0.05)
    with simulate(small, method="event", dt=0.05) as sim:
        sim.run(frames=13)
        path = sim.save(tmp_path / "run")
    with mpsim.Simulation.resume(path) as sim:
        sim.run(frames=27)
        assert_same_bits(sim.state, whole, "resumed")


def test_spins_are_in_the_digest(expected):
    """The control: another spin is another digest."""
    other = mpsim.State(expected.position, expected.velocity, spin=np.nextafter(expected.spin, 9), box=expected.box)
    again = mpsim.State(expected.position, expected.velocity, spin=expected.spin.copy(), box=expected.box)
    assert other.digest() != again.digest() == expected.digest()
