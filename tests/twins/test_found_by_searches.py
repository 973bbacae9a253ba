"""What searches have found, each case reduced to a few discs."""

import warnings

import numpy as np
import pytest
from support.scenes import box_of, simulate
from support.transforms import Units

import mpsim

pytestmark = [
    pytest.mark.plain,
    pytest.mark.filterwarnings("ignore::mpsim.FastWarning"),
    pytest.mark.filterwarnings("ignore::UserWarning"),
]


def measured(scene, name, frames=120, **settings):
    with simulate(scene, **{"method": "naive", "contact": "impact", "dt": 0.05, **settings}) as sim:
        return sim.run(frames=frames, measures=[name]).measures[name].value


SMALL = Units(length=2.0**-20, mass=2.0**-40)
"""Of grains a millionth of a unit large, in metres and kilograms say."""

AT_REST = {
    "falls": box_of(position=[[3, 3], [7, 2]], velocity=np.zeros((2, 2)), gravity=(0, -1), mass=[2, 1]),
    "own accelerations": box_of(position=[[3, 3]], velocity=np.zeros((1, 2)), acceleration=[[1, -2]], mass=2),
    "emitter alone": box_of(
        position=np.zeros((0, 2)),
        velocity=np.zeros((0, 2)),
        emitters=mpsim.Emitter((5, 5), (2, 1), interval=1.0, limit=9, mass=2),
    ),
}


@pytest.mark.parametrize(
    ("name", "precision"), [("falls", "float32"), ("own accelerations", "float64"), ("emitter alone", "float32")]
)
def test_impulses_are_counted_where_nothing_moves_at_the_start(name, precision):
    """Impulses were counted in steps of 2^-32 of the scene's units where nothing moved at the start: 0 here."""
    scene = AT_REST[name]
    pressure = measured(scene, "pressure", precision=precision)
    assert pressure > 0.005
    assert measured(SMALL.scene(scene), "pressure", precision=precision) == pressure * SMALL.measure("pressure")


def test_the_contact_time_is_short_where_nothing_moves_at_the_start():
    """It was 1e-6 of the units of time where nothing moved at the start: an age for a disc that an emitter launches."""
    start = box_of(
        position=[[4, 5], [5.5, 5]],
        velocity=np.zeros((2, 2)),
        restitution=0.5,
        emitters=mpsim.Emitter((1, 5), (1, 0), interval=1.0, limit=1),
    )
    fast, energies = Units(time=2.0**-30), []
    for scene, factor in ((start, 1.0), (fast.scene(start), fast.time)):
        with warnings.catch_warnings(), simulate(scene, method="event", dt=factor) as sim:
            warnings.simplefilter("error", mpsim.errors.GuardWarning)
            sim.run(frames=8)
            energies.append((sim.state.velocity**2).sum() * factor**2)
    assert energies[0] < 0.5, "the collisions lose energy"
    assert energies[1] == energies[0]


def test_a_kurtosis_of_discs_that_come_to_rest_ends_no_run():
    """It raised InputError in the middle of the run in which the last disc stopped."""
    scene = box_of(position=[[3, 5], [7, 5]], velocity=[[1, 0], [-1, 0]], restitution=0.0)
    with simulate(scene, method="naive", contact="impact", dt=0.05) as sim:
        report = sim.run(frames=100, measures=["speed_kurtosis", "kinetic_energy"])
        assert sim.frame == 100
    assert np.isnan(report.measures["speed_kurtosis"].value)
    assert report.measures["kinetic_energy"].value > 0


@pytest.mark.parametrize(("name", "height"), [("pressure_virial", 1), ("pressure_xx", 4)])
def test_a_virial_where_the_disc_fills_the_box_is_refused(name, height):
    """It divided by the area in which centres can be, 0, and the report of the whole run was lost."""
    scene = mpsim.Scene(width=1, height=height, position=[[0.5, 0.5]], velocity=[[0, 0]], radius=0.5)
    with simulate(scene, method="naive", dt=0.01) as sim, pytest.raises(mpsim.InputError, match="no room to move"):
        sim.run(frames=1, measures=[name])
