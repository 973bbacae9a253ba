"""Discs that lose energy: cooling by Haff's law, collapse, and heaps; each with its control."""

import math

import numpy as np
import pytest
from support.scenes import gas, simulate

import mpsim
from mpsim import FixedDisc, Polyline, Scene
from mpsim.measure import independent_average

pytestmark = [pytest.mark.plain, pytest.mark.filterwarnings("ignore::mpsim.FastWarning")]

PACKING = 0.1  # small and dilute gases: vortices and clusters, which Haff's law leaves out, need room to grow


def cooled(restitution, starts, count=50, law_of=None, rate=None, until=16.0, **settings):
    """Temperature over that of Haff's law for the restitution `law_of`, after so many collisions per disc, or in time
    where a rate is given.

    A collision takes (1 - e^2) (v_12.n)^2 / 4, on average kT, from the energy N kT (Haff, J. Fluid Mech. 134, 1983).
    """
    ratios, loss = [], (1 - (law_of or restitution) ** 2) / 2
    for seed in range(starts):
        with simulate(gas(count, PACKING, seed=seed, restitution=restitution), **settings) as sim:
            if rate:
                sim.run(until=until)
                expected = (1 + loss * rate * sim.time / 2) ** -2
            else:
                collisions, frames = 0.0, 1 if settings["method"] == "event" else 20
                while collisions < until:
                    collisions += 2 * sim.run(frames=frames).collisions / count
                expected = math.exp(-loss * collisions)
            ratios.append((sim.state.velocity**2).mean() / expected)
    return independent_average(ratios)


@pytest.mark.parametrize(
    "settings", [{"method": "event", "dt": 2.0}, {"method": "naive", "contact": "impact", "dt": 0.1}], ids=str
)
def test_a_granular_gas_cools_by_haffs_law(settings):
    """The law takes velocities as Maxwellian and as uncorrelated. The controls: other losses, and none."""
    found = cooled(0.9, 4, 16, until=6.0, **settings)
    assert found.error < 0.1
    assert abs(found.value - 1) < 0.04 + 3 * found.error, f"T over Haff's law {found}"
    assert cooled(0.95, 2, 16, law_of=0.9, until=6.0, **settings).value > 1.2
    none = cooled(1.0, 2, 16, law_of=0.9, until=2.0, **settings)
    assert none.value == pytest.approx(math.exp((1 - 0.9**2) * 2 / 2), rel=0.1)


def test_inelastic_collapse_ends_with_the_guard():
    """Above e = 7 - 4 sqrt 3 there is no collapse of three discs, and the guard has nothing to do: the control."""
    reports = {}
    for e in (0.05, 0.2):
        scene = Scene(width=40, height=1, position=[[10.0, 0.5], [11.5, 0.5], [13.2, 0.5]],
                      velocity=[[1.0, 0.0], [0.0, 0.0], [-1.0, 0.0]], radius=0.5, restitution=e)  # fmt: skip
        with simulate(scene, method="event", dt=3.0, contact_time=1e-6) as sim:
            if e == 0.05:
                with pytest.warns(mpsim.errors.GuardWarning):
                    reports[e] = sim.run(frames=1)
            else:
                reports[e] = sim.run(frames=1)
    assert reports[0.05].guarded > 0
    assert reports[0.05].collisions < 1000
    assert reports[0.2].guarded == 0
    assert reports[0.2].collisions >= 2


def heap(restitution, count, until):
    """Kinetic energy per disc, how far discs moved over the last quarter, and how many sank through a bent line."""
    rng, (layer, place) = np.random.default_rng(0), np.divmod(np.arange(count), wide := 5 if count == 6 else 10)
    position = np.stack([1 + 1.1 * place + 0.04 * (layer % 2), 3 + 1.1 * layer], axis=1)
    position, middle = position + rng.uniform(-0.04, 0.04, (count, 2)), 1 + wide / 2
    line = Polyline([(0, 1 + middle / 5), (middle, 1), (2 * middle, 1 + middle / 5)])
    scene = Scene(
        width=2 * middle, height=16, position=position, velocity=0 * position, radius=0.5, gravity=(0, -1.0),
        restitution=restitution, wall_restitution=restitution, obstacles=[line, FixedDisc((middle, 2.4), 0.3)],
    )  # fmt: skip
    with simulate(scene, method="naive", dt=0.03 if count == 6 else 0.01, contact="impact", passes=4) as sim:
        sim.run(until=until * 3 / 4)
        before, energies = sim.state.position, []
        for _ in range(10):
            sim.run(until=sim.time + until / 40)
            energies.append((sim.state.velocity**2).sum() / 2 / count)
        after = sim.state.position
    below = after[:, 1] < 1 + np.abs(after[:, 0] - middle) / 5
    return np.mean(energies), np.abs(after - before).max(), below.sum()


@pytest.mark.parametrize(("count", "until"), [(6, 14.0), pytest.param(60, 200.0, marks=pytest.mark.long)])
def test_an_inelastic_heap_comes_to_rest_and_stays(count, until):
    """What is left is the fall of a frame in each layer, some (6 g dt)^2 / 2 per disc: of second order, no heat."""
    energy, moved, sunk = heap(0.5, count, until)
    assert energy < (8 * (0.03 if count == 6 else 0.01)) ** 2, f"{energy} per disc is left"
    assert moved < 0.5, f"a disc has moved by {moved} in the last quarter"
    assert sunk == 0, f"{sunk} discs have sunk through the line"
    hot, _, _ = heap(1.0, count, until / 4)
    assert hot > 0.1, "an elastic one must stay hot"
