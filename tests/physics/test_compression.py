"""A compressed gas in equilibrium, and where compressed discs jam, against published values."""

import numpy as np
import pytest
from support.scenes import simulate

import mpsim
from mpsim.measure import Measure, reference

COUNT = 100


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


def test_discs_of_two_sizes_jam_at_the_published_packing():
    """Half of them 1.4 times as large: at some 0.842 (O'Hern et al., Phys. Rev. E 68, 011306, 2003)."""
    radius = np.repeat([0.5, 0.7], 500)
    scene = mpsim.Scene.random(count=1000, packing=0.4, radius=radius, boundary="periodic", seed=1)
    jammed = {}
    for rate in (1.0, 0.1):
        with pytest.raises(mpsim.InputError, match="jammed") as caught:
            scene.compressed(0.9, rate=rate)
        jammed[rate] = float(str(caught.value).split("a packing of ")[1].split(". ")[0])
    assert jammed[0.1] == pytest.approx(0.842, abs=0.01)
    assert jammed[1.0] < 0.83, "negative control: too fast"
