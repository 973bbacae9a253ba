"""Colours that stand for something else than the speed: where it comes from, and a scale that leaves none out."""

import numpy as np
import pytest
from support.scenes import gas

import mpsim
from mpsim.engine.simulation import read_in_place
from mpsim.viewer.colouring import LOW, MIDDLE, Colouring, own_colours
from mpsim.viewer.colours import ABSORBED, FASTEST, KNEE

GRID = mpsim.Settings(method="grid")
SCENE = gas(300, 0.4)


def colours(colouring, sim):
    return read_in_place(sim, lambda discs: colouring.bytes_of(sim, discs))


def test_own_values_are_on_a_scale_by_percentiles_and_none_is_saturated():
    values = np.random.default_rng(1).normal(size=300)
    values[:2] = -1e6, 1e6
    colouring = Colouring(values)
    with mpsim.Simulation(SCENE, GRID) as sim:
        found = colours(colouring, sim)
        order = np.argsort(values)
        assert (np.diff(found[order].astype(int)) >= 0).all()
        assert (found[order[0]], found[order[-1]]) == (0, FASTEST)
        usual = (found >= LOW) & (found <= KNEE)
        assert usual.mean() > 0.96, "two values of a million darken no others"
        assert np.ptp(found[usual].astype(int)) > 150
        assert (found == FASTEST).sum() == (found == 0).sum() == 1
        corners = colouring.told(sim)["values"]
        assert corners == np.percentile(values, (0, 2, 98, 100)).tolist()
        values[:] = 7.0  # by the program, in place
        assert (colours(colouring, sim) == MIDDLE).all()
        values[3:] = np.nan
        values[:3] = 1.0, 2.0, 3.0
        assert colours(colouring, sim)[:4].tolist() == [0, 127, FASTEST, MIDDLE]


def test_columns_and_workers_are_those_of_the_simulation():
    colouring = Colouring()
    with mpsim.Simulation(SCENE, GRID) as sim:
        sim.run(frames=3)
        assert colours(colouring, sim) is None, "the speeds'"
        assert colouring.told(sim)["choices"] == ["speed", "worker", "column", "collision"]
        colouring.choose("column", sim)
        assert (colours(colouring, sim) == (sim.columns().of_disc % 2) * FASTEST).all()
        assert colouring.told(sim)["classes"] == 2
        colouring.choose("worker", sim)
        assert (colours(colouring, sim) == 0).all()
        with pytest.raises(mpsim.InputError, match="by of colour must be one of"):
            colouring.choose("own", sim)


def test_the_exact_solver_has_no_columns():
    with mpsim.Simulation(SCENE, mpsim.Settings(method="event")) as sim:
        assert Colouring().choices(sim) == ["speed", "collision"]


def test_times_since_the_last_collision_are_those_of_the_log():
    scene = gas(300, 0.4)
    colouring, other = Colouring(), mpsim.Collisions()
    with mpsim.Simulation(scene, GRID) as sim:
        colouring.choose("collision", sim)
        colours(colouring, sim)  # from here on
        begun = sim.time
        for frames in (5, 16, 9):
            sim.run(frames=frames, observe=[*colouring.observers(8), other])
            colouring.end_run(sim)
        last = np.full(300, begun)
        for row in other.table:
            for disc in [row["i"], row["j"]] if row["kind"] == 0 else [row["i"]]:
                last[disc] = max(last[disc], row["time"])
        since = sim.time - last
        assert read_in_place(sim, colouring._values).tolist() == since.tolist()
        assert 0 < (last > begun).sum() < 300, "some have met, some not"
        found = colours(colouring, sim)
        assert found[np.argmax(since)] == FASTEST
        colouring.begin()  # discs were changed by hand
        assert (read_in_place(sim, colouring._values) == 0).all()


def test_discs_that_have_left_are_not_drawn():
    colouring = Colouring(np.arange(300.0))
    with mpsim.Simulation(SCENE, GRID) as sim:
        left = np.arange(300) == 7
        found = read_in_place(sim, lambda discs: colouring.bytes_of(sim, discs._replace(absent=left)))
    assert (found == ABSORBED).tolist() == left.tolist()


@pytest.mark.parametrize("colour", [[1.0, 2.0], "red", np.zeros((3, 1)), ["a", "b", "c"], 5])
def test_what_is_no_array_of_numbers_is_refused(colour):
    with pytest.raises(mpsim.InputError, match="colour must be an array of 3 numbers, one for each disc; got"):
        own_colours(colour, 3)
    given = np.zeros(3)
    assert own_colours(given, 3) is given
