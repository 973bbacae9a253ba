"""Obstacles, by numbers that can be checked by hand."""

import numpy as np
import pytest
from support.arrays import control_of, discs_of, parameters_of
from support.internals import machine_code, parameters

import mpsim
from mpsim.features.obstacles import OBSTACLES
from mpsim.kernels.features import capsules as capsule_kernels
from mpsim.kernels.features.capsules import Capsules, resolve_capsules
from mpsim.kernels.features.hooks import features_of

resolve_capsule = machine_code(capsule_kernels.resolve_capsule)
FLOOR = (0.0, 0.0, 10.0, 0.0, 0.0)
PEG = (0.0, 0.0, 0.0, 0.0, 0.5)


def after_capsule(place, velocity, capsule=FLOOR, impact=True, pull=(0.0, 0.0), restitution=1.0):
    """Place and velocity of a disc of radius 1/2 after its contact with a capsule, if any."""
    discs = discs_of(np.float64, [place[0]], [place[1]], [velocity[0]], [velocity[1]])
    capsules = Capsules(np.array([capsule]), np.arange(2, dtype=np.int32), *[None] * 4)
    met = resolve_capsule(discs, 0, 0, capsules, 0.5, *pull, features_of({}), parameters(restitution), impact)
    return met, (discs.x[0], discs.y[0]), (discs.vx[0], discs.vy[0])


@pytest.mark.parametrize(
    ("place", "velocity", "capsule", "restitution", "then", "now"),
    [
        ((5, 0.3), (1, -2), FLOOR, 1.0, (5, 0.7), (1, 2)),
        ((5, 0.3), (1, -2), FLOOR, 0.5, (5, 0.6), (1, 1)),
        ((5, -0.3), (1, 2), FLOOR, 1.0, (5, -0.7), (1, -2)),
        ((5, 0.6), (1, -2), (0, 0, 10, 0, 0.25), 1.0, (5, 0.9), (1, 2)),
        ((0.8, 0), (-2, 0), PEG, 1.0, (1.2, 0), (2, 0)),
        ((10.4, 0), (-1, 0), FLOOR, 1.0, (10.6, 0), (1, 0)),
        ((0.48, 0.64), (-3, -4), PEG, 1.0, (0.72, 0.96), (3, 4)),
    ],
    ids=["side", "lossy side", "side from below", "thick side", "peg", "end", "peg aslant"],
)
def test_an_impact_on_an_obstacle_happens_where_they_touched(place, velocity, capsule, restitution, then, now):
    met, found, speed = after_capsule(place, velocity, capsule, restitution=restitution)
    assert met
    assert found == pytest.approx(then, abs=1e-15)
    assert speed == pytest.approx(now, abs=1e-15)


def test_a_glancing_impact_on_a_peg_turns_the_velocity_about_the_normal_at_touch():
    """It came along y = 0.6 and touched at (-0.8, 0.6), 0.1 ago at speed 2: the normal is (-0.8, 0.6)."""
    _, place, velocity = after_capsule((-0.6, 0.6), (2, 0), PEG)
    along = 2 * -0.8
    expected = np.array([2.0, 0.0]) - 2 * along * np.array([-0.8, 0.6])
    assert velocity == pytest.approx(expected, rel=1e-14)
    assert place == pytest.approx(np.array([-0.8, 0.6]) + 0.1 * expected, rel=1e-14)


@pytest.mark.parametrize("impact", [True, False])
def test_a_disc_that_does_not_approach_is_only_put_out_of_an_obstacle(impact):
    assert after_capsule((5, 0.25), (1, 2), impact=impact) == (True, (5, 0.5), (1, 2))
    assert after_capsule((5, 0.5), (1, -2), impact=impact) == (False, (5, 0.5), (1, -2)), "touching is not overlapping"


def test_a_push_puts_a_disc_at_the_surface_and_turns_it_round_there():
    assert after_capsule((5, 0.25), (1, -2), impact=False) == (True, (5, 0.5), (1, 2))


@pytest.mark.parametrize(
    ("place", "capsule", "then"),
    [((5, 0), FLOOR, (5, 0.5)), ((0, 5), (0, 0, 0, 10, 0), (-0.5, 5)), ((0, 0), PEG, (0, 1))],
    ids=["level", "upright", "peg"],
)
def test_a_disc_with_its_centre_on_an_obstacle_is_put_across_it(place, capsule, then):
    assert after_capsule(place, (0, 0), capsule) == (True, then, (0, 0))


@pytest.mark.parametrize("capsule", [FLOOR, (5.0, -0.5, 5.0, -0.5, 0.5)], ids=["floor", "peg"])
def test_a_disc_at_rest_on_an_obstacle_stays_there(capsule):
    """A step of 1/4 under gravity 2 has led it from (5, 1/2) at rest to depth 1/16 and speed 1/2."""
    met, place, velocity = after_capsule((5, 0.5 - 1 / 16), (0, -0.5), capsule, pull=(0, -2.0))
    assert met
    assert place == pytest.approx((5, 0.5), abs=1e-15)
    assert velocity == pytest.approx((0, 0), abs=1e-15)


def test_an_obstacle_never_puts_a_disc_beyond_a_periodic_border():
    """A disc deep in a thick peg at x = 1 is put 5.5 from its centre: 4.5 beyond the border."""
    peg = mpsim.FixedDisc((1, 10), 5.0)
    scene = mpsim.Scene(
        width=20, height=20, position=[[0.5, 10]], velocity=[[0, 0]], radius=0.5, boundary="periodic", obstacles=peg
    )
    arrays = {
        name: np.zeros(shape, dtype) for name, (dtype, shape) in OBSTACLES.shapes(scene, 1, np.dtype(float)).items()
    }
    OBSTACLES.fill(scene, arrays, 0.0)
    wrap = np.array([20.0])
    features = features_of(arrays | {"wrap_x": wrap, "wrap_y": wrap, "image": np.zeros((2, 1), np.int64)})
    discs = discs_of(np.float64, [0.5], [10.0])
    resolve_capsules(discs, 0, 1, features, parameters_of(np.float64, 20, 20), control_of(1))
    assert (discs.x[0], discs.y[0]) == (15.5, 10)
    assert features.image.tolist() == [[-1], [0]]
