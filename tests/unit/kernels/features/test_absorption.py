"""Edges that absorb discs, by numbers that can be checked by hand."""

import numpy as np
import pytest
from support.arrays import control_of, discs_of
from support.internals import parameters

from mpsim.kernels import layout, records
from mpsim.kernels.features.absorption import absorb
from mpsim.kernels.features.hooks import BARE
from mpsim.kernels.frame.flight import fly
from mpsim.kernels.frame.motion import tally_walls


def exits_after(edges, velocity, gravity=None, contact=layout.PUSH):
    """What is noted of a disc of radius 1/2, 1/4 from the left and the bottom wall, in a step of 1/4."""
    discs = discs_of(np.float64, [0.75], [0.75], [velocity[0]], [velocity[1]])
    control, exits = control_of(1), np.zeros((3, 1))
    control.absorbing[edges], control.contact = 1, contact
    features = BARE._replace(exits=exits, gravity=None if gravity is None else np.array(gravity, float))
    absorb(discs, 0, 1, exits, features, parameters(dt=0.25), control)
    return exits[:, 0].tolist()


def test_an_edge_absorbs_what_the_step_would_bring_beyond_it():
    left, bottom = [layout.LEFT], [layout.BOTTOM]
    assert exits_after(left, (-1.5, 0)) == [1, 0.75, 0.75]
    assert exits_after(left, (-1.0, 0)) == [0, 0, 0], "to touch the edge is not to leave"
    assert exits_after(bottom, (-1.5, 0)) == [0, 0, 0]
    assert exits_after(left + bottom, (0, -1.5)) == [1, 0.75, 0.75]


@pytest.mark.parametrize(("contact", "least"), [(layout.PUSH, 4), (layout.IMPACT, 8)])
def test_an_edge_absorbs_what_gravity_brings_to_it(contact, least):
    """1/4 in a time 1/4 from rest: v += g dt, y += v dt needs g = 4, a parabola 8."""
    bottom = [layout.BOTTOM]
    assert exits_after(bottom, (0, 0), (0, -least), contact)[0] == 0
    assert exits_after(bottom, (0, 0), (0, -least * 1.001), contact)[0] == 1


@pytest.mark.parametrize("absorbed", [0, 1])
def test_an_edge_takes_no_impulse_from_a_disc_that_it_has_absorbed(absorbed):
    """A disc of mass 1 that would bounce off the floor at speed 2 in this step, falling or not."""
    values, tally = parameters(dt=0.25), np.zeros(1, records.TALLY)
    features = BARE._replace(exits=np.array([[absorbed], [5], [0.75]], float), gravity=np.array([0.0, 0.0]))
    discs = discs_of(np.float64, [5.0], [0.75], [0.0], [-2.0])
    tally_walls(discs, 0, 1, features, values, tally, 0)
    fly(discs, 0, 1, True, features, values, np.zeros(1, records.CONTROL)[0], tally, 0)
    assert tally[0].wall[layout.BOTTOM] / values.tally_scale == (0 if absorbed else 8)
