"""Stepped runs at a small step against the exact solver, from the same starts: collisions, energy, pressure.

The two follow one trajectory until rounding has grown, and are independent after it, so that differences between them
are either small or noise. Each run lasts some collisions per disc. One execution: a gas by both.
Executions: 56 by default, 660 with --long.
"""

import warnings

import numpy as np
import pytest
from support.gases import any_gas, typical_time
from support.scenes import simulate

MEASURES = ["pressure", "collision_rate"]


def answers(scene, until, **settings):
    """Pressure, collision rate and kinetic energy at the end."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        with simulate(scene, **settings) as sim:
            names = MEASURES[all(scene.periodic) :]  # where there is a wall
            found = sim.run(until=until, measures=names).measures
            values = [found[name].value if name in names else 0.0 for name in MEASURES]
            return np.array([*values, (scene.masses * (sim.state.velocity**2).sum(axis=1)).sum()])


def differences(seeds, step, **kinds):
    """Stepped less exact over their mean, gas by gas, shape (N, 3); steps in radii of a disc of thermal speed."""
    rows = []
    for seed in seeds:
        scene = any_gas(seed, **kinds)
        if scene.count < 6 or (kinds and (scene.mass is not None or np.ndim(scene.radius))):
            continue
        until = 3 * typical_time(scene)
        speed = float(np.sqrt((scene.velocity**2).sum(axis=1).mean()))
        exact = answers(scene, until, method="event", dt=until / 256)
        dt = until / np.ceil(until / (step * scene.smallest_radius / speed))
        stepped = answers(scene, until, method="grid", contact="impact", dt=dt)
        rows.append((stepped - exact) / np.maximum((stepped + exact) / 2, 1e-300))
    return np.array(rows)


def check(rows, most):
    """The mean differences are at most so large, and their noise."""
    error = rows.std(axis=0, ddof=1) / np.sqrt(len(rows))
    mean = rows.mean(axis=0)
    note = f"pressure, collisions and energy differ by {mean.round(4)} with errors {error.round(4)}"
    assert (np.abs(mean) < most + 4 * error).all(), note
    assert (error < 0.1).all(), f"too noisy to show anything: {note}"


PLAIN = {"gravity": False, "losses": False, "wrap": False}
"""Kernels that are compiled anyway."""


def test_small_steps_agree_with_the_exact_solver():
    check(differences(range(120), 0.004, **PLAIN), 0.005)


@pytest.mark.long
@pytest.mark.timeout(1200)
def test_small_steps_agree_with_the_exact_solver_with_any_features():
    check(differences(range(1000, 2000), 0.004), 0.005)


def test_large_steps_do_not():
    """The control: the comparison notices the collisions that a large step misses."""
    with pytest.raises(AssertionError, match="differ by"):
        check(differences(range(120), 2.0, **PLAIN), 0.005)
