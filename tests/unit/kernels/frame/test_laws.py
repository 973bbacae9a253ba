"""What a contact does to two discs, by numbers that can be checked by hand."""

import numpy as np
import pytest
from support.arrays import control_of, discs_of, parameters_of
from support.internals import machine_code

from mpsim.kernels.features.hooks import BARE
from mpsim.kernels.frame import laws
from mpsim.kernels.layout import CONTACTS, ELASTIC, IMPACT, LAWS, REFLECT

REALS = [np.float32, np.float64]

push_contact, impact_contact, resolve_contact = map(
    machine_code, (laws.push_contact, laws.impact_contact, laws.resolve_contact)
)


def contact(discs, i, j, parameters, law):
    push_contact(discs, i, j, None, None, BARE, parameters, law)


def pair(real, law, offset, velocities, swapped=False, radius=3.0):
    """Positions relative to the first disc's start, and velocities, of two discs of radius 3 after their contact."""
    x, y = [50, 50 + offset[0]], [50, 50 + offset[1]]
    (vx, vy) = zip(*velocities, strict=True)
    discs = discs_of(real, x, y, vx, vy)
    i, j = (1, 0) if swapped else (0, 1)
    contact(discs, i, j, parameters_of(real, 100, 100, radius=radius), law)
    places = [(float(discs.x[k]) - 50, float(discs.y[k]) - 50) for k in range(2)]
    return places, [(float(discs.vx[k]), float(discs.vy[k])) for k in range(2)]


@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("swapped", [False, True])
def test_a_push_moves_each_disc_by_half_the_overlap(real, swapped):
    """Centres (0, 0) and (3, 4) are 5 apart, the diameter is 6: n = (0.6, 0.8), and each moves 0.5 along n."""
    places, _ = pair(real, ELASTIC, (3, 4), [(0, 0), (0, 0)], swapped)
    rel = 1e-5 if real is np.float32 else 1e-12
    assert places[0] == pytest.approx((-0.3, -0.4), rel=rel)
    assert places[1] == pytest.approx((3.3, 4.4), rel=rel)


@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("swapped", [False, True])
def test_elastic_exchanges_the_components_along_the_line_of_centres(real, swapped):
    """v1 = (5, 10) has 3 + 8 = 11 along n, v2 = (5, -5) has 3 - 4 = -1: they exchange 12, that is (7.2, 9.6)."""
    _, velocities = pair(real, ELASTIC, (3, 4), [(5, 10), (5, -5)], swapped)
    assert velocities[0] == pytest.approx((5 - 7.2, 10 - 9.6), rel=1e-5)
    assert velocities[1] == pytest.approx((5 + 7.2, -5 + 9.6), rel=1e-5)


@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("swapped", [False, True])
def test_reflect_mirrors_each_velocity(real, swapped):
    """v - 2 (v.n) n: (5, 10) loses 22 n = (13.2, 17.6), and (5, -5) gains 2 n = (1.2, 1.6)."""
    _, velocities = pair(real, REFLECT, (3, 4), [(5, 10), (5, -5)], swapped)
    assert velocities[0] == pytest.approx((5 - 13.2, 10 - 17.6), rel=1e-5)
    assert velocities[1] == pytest.approx((5 + 1.2, -5 + 1.6), rel=1e-5)


def test_elastic_leaves_discs_that_part_as_they_are():
    assert pair(np.float64, ELASTIC, (3, 4), [(-5, -10), (5, 5)])[1] == [(-5, -10), (5, 5)]


def test_elastic_leaves_discs_at_rest_to_each_other_as_they_are():
    assert pair(np.float64, ELASTIC, (3, 4), [(2, 1), (2, 1)])[1] == [(2, 1), (2, 1)]


@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("law", [ELASTIC, REFLECT])
def test_centres_at_one_point_are_separated_by_a_diameter_in_opposite_directions(law, real):
    places, velocities = np.array(pair(real, law, (0, 0), [(1, 2), (-1, 3)]))
    assert (places[0] == -places[1]).all()
    assert np.hypot(*places[1]) == pytest.approx(3, rel=1e-6)
    assert (places != 0).all(), "no axis of the box"
    assert (velocities**2).sum() == pytest.approx(15, rel=1e-6)


@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("offset", [(1e-30, 0), (0, 1e-38), (5e-324, 5e-324), (1e-7, -1e-7)])
@pytest.mark.parametrize("law", [ELASTIC, REFLECT])
def test_centres_almost_at_one_point_never_give_nan(law, offset, real):
    discs = discs_of(real, [0, offset[0]], [0, offset[1]], [1, -1], [2, 3])
    parameters = parameters_of(real, 100, 100)
    parameters.limit[:] = -50, 50, -50, 50
    contact(discs, 0, 1, parameters, law)
    values = np.array([field[:2] for field in discs[:4]], float)
    assert np.isfinite(values).all(), values
    assert np.hypot(*np.diff(values[:2], axis=1)) == pytest.approx(1, rel=1e-5), "they must be one diameter apart"
    assert (values[2:] ** 2).sum() == pytest.approx(15, rel=1e-5), "their energy must be kept"


def test_a_push_does_not_carry_a_disc_through_a_wall():
    discs = discs_of(np.float64, [0.5, 1.0], [3.0, 3.0])
    contact(discs, 0, 1, parameters_of(np.float64, 10, 6), ELASTIC)
    assert (discs.x[0], discs.x[1]) == (0.5, 1.25)


PULL = 8.0


def energy(discs, acceleration, mass):
    """Kinetic and potential energy of two discs."""
    place, velocity = (np.array([a[:2], b[:2]], float) for a, b in (discs[:2], discs[2:4]))
    return ((velocity**2 / 2 - acceleration * place) * mass).sum()


def lifted(contact, offset, parting, mass=None, exchange=1.0):
    """A disc on the floor and another 0.625 above it, to the right: height of both, energies before and after."""
    velocities = [[0.0, parting * length / 0.625] for length in offset]
    discs = discs_of(np.float64, [5.0, 5.0 + offset[0]], [0.5, 0.5 + offset[1]], *velocities)
    features = BARE._replace(gravity=np.array([0.0, -PULL]), mass=mass)
    parameters, control = parameters_of(np.float64, 10, 10), control_of(2)
    parameters.half_one_plus_e, control.contact = exchange, IMPACT
    weights = np.ones(2) if mass is None else mass
    before = energy(discs, np.array([[0.0], [-PULL]]), weights)
    if contact == "push":
        push_contact(discs, 0, 1, None, None, features, parameters, ELASTIC)
    else:
        impact_contact(discs, 0, 1, None, None, features, parameters, control, None, 0)
    return discs.y[:2].copy(), before, energy(discs, np.array([[0.0], [-PULL]]), weights)


@pytest.mark.slow
@pytest.mark.parametrize("mass", [None, np.array([1.0, 3.0]), np.array([4.0, 1.0])])
def test_a_lift_against_gravity_is_paid_for_by_the_speed_of_parting(mass):
    """3/8 are missing along (0.6, 0.8). The floor does not yield, so the upper disc's half is a lift."""
    height, before, after = lifted("impact", (0.375, 0.5), 5.0, mass)
    pushed, _, control = lifted("push", (0.375, 0.5), 5.0, mass)
    assert height.tolist() == pushed.tolist()
    assert height[0] == 0.5
    assert height[1] > 1.05
    assert after == pytest.approx(before, rel=1e-13)
    assert control > before + 0.5, "a push that nobody pays must show"


def test_who_cannot_pay_for_a_lift_is_lifted_as_far_as_he_can():
    """A parting speed of 0.8 has the energy 0.8^2/4 = 0.16 of relative motion: a lift of 0.16/8 = 0.02."""
    height, before, after = lifted("impact", (0.0, 0.625), 0.8)
    assert height == pytest.approx([0.5, 1.145], rel=1e-13)
    assert after == pytest.approx(before, rel=1e-13)


def test_in_a_heap_that_loses_energy_a_lift_may_cost_more_than_there_is():
    height, before, after = lifted("impact", (0.375, 0.5), 0.0, exchange=0.75)
    assert height.tolist() == lifted("push", (0.375, 0.5), 0.0)[0].tolist()
    assert after > before


@pytest.mark.slow
@pytest.mark.parametrize("mass", [None, np.array([1.0, 3.0])])
def test_an_impact_of_discs_that_are_pulled_differently_keeps_the_energy(mass):
    pulls = np.array([[3.0, -1.0], [-7.0, 2.0]])
    discs = discs_of(np.float64, [5.0, 5.5], [5.0, 5.5], [1.0, -9.0], [-2.0, 1.0])
    parameters, control = parameters_of(np.float64, 10, 10, dt=0.1), control_of(2)
    control.contact = IMPACT
    weights = np.ones(2) if mass is None else mass
    before = energy(discs, pulls, weights)
    impact_contact(discs, 0, 1, None, None, BARE._replace(acceleration=pulls, mass=mass), parameters, control, None, 0)
    assert energy(discs, pulls, weights) == pytest.approx(before, rel=1e-13)
    alike = discs_of(np.float64, [5.0, 5.5], [5.0, 5.5], [1.0, -9.0], [-2.0, 1.0])
    impact_contact(alike, 0, 1, None, None, BARE._replace(mass=mass), parameters, control, None, 0)
    assert abs(energy(alike, pulls, weights) - before) > 0.1, "without the account it must show"


def velocities_after(law, kind):
    """Of two discs that approach aslant and overlap, after their contact; before: (1, 0.5) and (-2, -0.25)."""
    discs, control = discs_of(np.float64, [5.0, 5.5], [5.0, 5.75], [1.0, -2.0], [0.5, -0.25]), control_of(2)
    control.law, control.contact = law, kind
    resolve_contact(discs, 0, 1, None, None, BARE, parameters_of(np.float64, 10, 10, dt=0.5), control, None, 0)
    return *discs.vx[:2].tolist(), *discs.vy[:2].tolist()


def test_every_law_and_every_contact_of_the_tables_does_something_of_its_own():
    """What stood in a table and not in the kernels would do what another does: the last of the kernels' choices."""
    numbers, kinds = [law.number for law in LAWS.values()], [*CONTACTS.values()]
    found = [velocities_after(law, kind) for law in numbers for kind in kinds]
    assert (1.0, -2.0, 0.5, -0.25) not in found
    assert len(set(found)) == len(LAWS) * len(CONTACTS)
    missing = [velocities_after(max(numbers) + 1, kind) for kind in kinds]
    assert len({*found, *missing}) == len(found), "the control: one that is missing is seen"


@pytest.mark.parametrize("word", LAWS)
def test_the_facts_of_a_law_are_true_of_what_it_does(word):
    """Energy of both discs, and of each, before and after: what the engine asks of the table, asked of the kernel."""
    law, before = LAWS[word], ((1.0, -2.0), (0.5, -0.25))
    vx_i, vx_j, vy_i, vy_j = velocities_after(law.number, IMPACT)
    energies = np.array([vx_i**2 + vy_i**2, vx_j**2 + vy_j**2])
    expected = (np.array(before) ** 2).sum(axis=0)
    assert energies.sum() == pytest.approx(expected.sum(), rel=1e-14)
    assert (abs(energies - expected).min() > 0.01) == law.exchanges_energy
