"""Stepped runs at a small step against the exact solver, from the same starts: collisions, energy, pressure.

The two follow one trajectory until rounding has grown, and are independent after it. So runs are long, some hundred
collisions per disc (a few where losses cool the gas), and gases count by the collisions that they have: the noise left
is a third of a percent.
"""

import itertools
import warnings

import numpy as np
import pytest
from support.gases import any_gas, typical_time
from support.scenes import simulate

pytestmark = [pytest.mark.compiled, pytest.mark.long]

MEASURES = ["pressure", "contact_rate"]


LENGTHS = {False: 150, True: 3}
"""Of a run, in times that a disc takes from one to the next: gases with losses cool, and cluster."""


def answers(scene, until, **settings):
    """Pressure, collision rate and kinetic energy at the end; and collisions."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        with simulate(scene, **settings) as sim:
            names = MEASURES[all(scene.periodic) :]  # where there is a wall
            report = sim.run(until=until, measures=names)
            values = [report.measures[name].value if name in names else 0.0 for name in MEASURES]
            energy = (scene.masses * (sim.state.velocity**2).sum(axis=1)).sum()
            return np.array([*values, energy]), report.collisions


def loses_energy(scene):
    """By restitution or friction. Under gravity such discs come to rest, in countless bounces."""
    return scene.restitution < 1 or scene.dissipates


def gases(seeds, lossy=False, **kinds):
    """Those with collisions to compare, with losses or without; with `kinds` none with radii or masses either."""
    for scene in (any_gas(seed, **kinds) for seed in seeds):
        own = kinds and (scene.mass is not None or np.ndim(scene.radius))
        if scene.count >= 6 and not own and loses_energy(scene) == lossy:
            yield scene


def differences(scenes, step):
    """Stepped less exact over their mean, gas by gas, shape (N, 3), and collisions of each, shape (N,).

    Steps are in radii of a disc of thermal speed.
    """
    rows, weights = [], []
    for scene in scenes:
        until = LENGTHS[loses_energy(scene)] * typical_time(scene)
        speed = float(np.sqrt((scene.velocity**2).sum(axis=1).mean()))
        exact, collisions = answers(scene, until, method="event", dt=until / 256)
        dt = until / np.ceil(until / (step * scene.smallest_radius / speed))
        stepped, contacts = answers(scene, until, method="grid", contact="impact", dt=dt)
        rows.append((stepped - exact) / np.maximum((stepped + exact) / 2, 1e-300))
        weights.append(collisions + contacts)
    return np.array(rows), np.array(weights)


def check(rows, weights, most=0.015):
    """The mean differences are at most 1.5 %, or `most` (one for all or one each), with noise of a third of that."""
    most = np.broadcast_to(most, 3)
    shares = weights[:, None] / weights.sum()
    mean = (shares * rows).sum(axis=0)
    error = np.sqrt((shares**2 * (rows - mean) ** 2).sum(axis=0))
    note = f"by {mean.round(4)} with errors {error.round(4)}"
    assert (np.abs(mean) < most).all(), f"pressure, collisions and energy differ {note}"
    assert (error < most / 3).all(), f"too noisy to show anything: pressure, collisions and energy {note}"


def of_few_kinds(scenes, most=10):
    """Those with the first few combinations of features: each is compiled anew, by both methods."""
    kinds = set()
    for scene in scenes:
        own = scene.gravity, scene.acceleration, scene.mass, scene.radius if np.ndim(scene.radius) else None
        kind = (*(each is not None for each in own), scene.periodic)
        if kind in kinds or len(kinds) < most:
            kinds.add(kind)
            yield scene


@pytest.mark.timeout(1800)
@pytest.mark.parametrize(("lossy", "number", "most"), [(False, 600, (0.015, 0.015, 0.02)), (True, 250, 0.05)])
def test_small_steps_agree_with_the_exact_solver_with_any_features(lossy, number, most):
    """Under gravity the kinetic energy at an instant scatters more; gases that cool and cluster do in all."""
    scenes = itertools.islice(of_few_kinds(gases(range(1000, 20000), lossy)), number)
    check(*differences(scenes, 0.02), most)


def test_steps_five_times_as_long_do_not():
    """The control: steps of a tenth of a radius miss 3 % of the collisions, which the comparison notices."""
    with pytest.raises(AssertionError, match="energy differ by"):
        check(*differences(gases(range(120), gravity=False, losses=False, wrap=0), 0.1))
