"""A compressed gas in equilibrium, and where compressed discs jam, against published values."""

import math

import pytest
from support.scenes import simulate

import mpsim
from mpsim.measure import Measure, reference

pytestmark = pytest.mark.compiled

COUNT = 100


@pytest.mark.long
def test_a_compressed_gas_has_the_pressure_of_the_equation_of_state():
    packing = 0.6
    scene = mpsim.Scene.random(count=COUNT, packing=0.3, radius=0.5, boundary="periodic", seed=4)
    scene = scene.compressed(packing, rate=0.1)
    with simulate(scene, method="event", dt=1.0) as sim:
        sim.run(until=20.0)
        pressure = sim.run(until=520.0, measures="pressure").measures["pressure"]
    # kT = E/(N - 1): a velocity component that the zero momentum takes away has no share of the energy.
    ratio, area = (COUNT - 1) / COUNT, scene.width * scene.height
    z = 1 + (pressure.value * area / COUNT - 1) * ratio
    found = Measure(z, pressure.error * area / COUNT * ratio, pressure.samples)
    expected = reference.compressibility(packing) + reference.finite_size(packing, COUNT)
    assert found.error < 0.003 * expected
    assert abs(found.deviation(expected)) < 4, f"Z = {found}, expected {expected}"
    wrong = reference.compressibility(0.98 * packing)
    assert abs(found.deviation(wrong)) > 4, f"two per cent less dense, {wrong}, must fail; got {found}"


def jammed_at(scene, packing, rate=0.1):
    """The packing at which a scene jams on its way to another one."""
    with pytest.raises(mpsim.InputError, match="jammed") as caught:
        scene.compressed(packing, rate=rate)
    return float(str(caught.value).split("a packing of ")[1].split(". ")[0])


@pytest.mark.parametrize(
    ("count", "distance"),
    [
        pytest.param(5, math.sqrt(2) / 2, marks=pytest.mark.slow),
        pytest.param(3, math.sqrt(6) - math.sqrt(2), marks=pytest.mark.long),
        pytest.param(9, 0.5, marks=pytest.mark.long),
    ],
)
def test_few_discs_jam_in_the_densest_packing_in_a_square(count, distance):
    """distance: the largest least distance of so many points in a unit square (of nine: Schaer, Canad. Math. Bull. 8,
    273, 1965). Some starts jam before, none after.
    """
    densest = count * math.pi * (distance / (2 * (1 + distance))) ** 2
    starts = [mpsim.Scene.random(count=count, packing=0.2, radius=0.5, seed=seed) for seed in range(4)]
    found = max(jammed_at(scene, densest + 0.02) for scene in starts)
    assert densest - 3e-6 < found < densest, f"{found}, expected {densest}"
