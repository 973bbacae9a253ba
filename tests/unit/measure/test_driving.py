"""Largest accelerations, losses, and whether a scene conserves energy."""

import numpy as np
import pytest

import mpsim
from mpsim.measure import driving


def scene(**features):
    """Two discs at rest."""
    given = {"width": 8, "height": 8, "position": [[2, 2], [5, 5]], "velocity": np.zeros((2, 2)), "radius": 0.5}
    return mpsim.Scene(**given | features)


def test_accelerations_are_bounded_by_the_sum_of_gravity_and_the_largest_of_a_disc():
    both = scene(gravity=(3, 4), acceleration=[[0, 1], [-12, 5]])
    assert driving.gravity_strength(both) == 5
    assert driving.acceleration_bound(both) == 5 + 13
    assert driving.strongest_field(both) == 13
    none = mpsim.Scene(
        width=8, height=8, position=np.zeros((0, 2)), velocity=np.zeros((0, 2)), radius=0.5,
        acceleration=np.zeros((0, 2)), gravity=(0, -2),
    )  # fmt: skip
    assert driving.acceleration_bound(none) == driving.strongest_field(none) == 2
    assert driving.acceleration_bound(scene()) == driving.gravity_strength(scene()) == 0


def test_losses_at_walls_count_only_where_there_are_walls():
    assert driving.has_losses(scene(restitution=0.9))
    assert driving.has_losses(scene(wall_restitution=0.9))
    assert driving.has_losses(scene(wall_restitution=0.9, boundary=("periodic", "walls")))
    assert not driving.has_losses(scene(wall_restitution=0.9, boundary="periodic"))
    assert not driving.has_losses(scene())


@pytest.mark.parametrize(
    "feature",
    [
        {"gravity": (0, -1)}, {"acceleration": [[0, 1], [0, 0]]}, {"restitution": 0.9},
        {"piston": mpsim.Piston("left", 1.0, 1.0)}, {"absorbing": "top"},
        {"emitters": mpsim.Emitter((4, 7), (0, -1), interval=1.0)},
    ],
    ids=lambda feature: next(iter(feature)),
)  # fmt: skip
def test_whatever_gives_or_takes_energy_is_noticed(feature):
    assert not driving.conserves_energy(scene(**feature))


def test_fields_of_zero_are_fields_that_change_no_energy():
    still = scene(gravity=(0, 0))
    assert driving.has_body_force(still)
    assert driving.conserves_energy(still)
    assert not driving.has_body_force(scene())
