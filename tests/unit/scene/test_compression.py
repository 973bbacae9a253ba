"""Compression to a packing: the same discs, no overlap, exactly the packing that was asked, the same bits."""

import math

import numpy as np
import pytest
from support.refusals import assert_says
from support.scenes import lattice

import mpsim
from mpsim.kernels.events.features import expansion

SIZES = np.repeat([0.5, 0.7], 32)
MIXTURE = {"count": 64, "packing": 0.5, "radius": SIZES, "mass": SIZES**2, "seed": 2}


def equal_discs(count=100, packing=0.5, seed=1, **others):
    return mpsim.Scene.random(count=count, packing=packing, radius=0.5, seed=seed, **others)


def overlap(scene):
    return mpsim.measure.overlap(mpsim.State(scene.position, scene.velocity), scene)


def energy(scene):
    return float((scene.masses * (scene.velocity**2).sum(axis=1)).sum() / 2)


@pytest.mark.slow
@pytest.mark.parametrize("boundary", ["walls", "periodic", ("periodic", "walls")])
def test_the_same_discs_are_denser_and_do_not_overlap(boundary):
    scene = equal_discs(width=12.0, height=9.0, packing=None, boundary=boundary)
    dense = scene.compressed(0.78, rate=0.1)
    assert dense.packing == pytest.approx(0.78, rel=1e-14)
    assert dense.width / dense.height == pytest.approx(12 / 9, rel=1e-14)
    assert overlap(dense).pairs == 0
    assert dense.overlaps_at_start() == ""
    assert (dense.radius, dense.boundary, dense.count) == (scene.radius, scene.boundary, scene.count)
    assert energy(dense) == pytest.approx(energy(scene), rel=1e-12)
    squeezed = mpsim.Scene(
        width=dense.width, height=dense.height, boundary=boundary, radius=0.5, velocity=scene.velocity,
        position=np.clip(scene.position * dense.width / scene.width, 0.5, np.array([dense.width, dense.height]) - 0.5),
    )  # fmt: skip
    assert overlap(squeezed).pairs > 10, "negative control: without collisions they overlap"


@pytest.mark.slow
def test_a_mixture_keeps_its_radii_masses_and_features():
    scene = mpsim.Scene.random(**MIXTURE, boundary="periodic", gravity=(0, -1), restitution=0.9, duration=7.0)
    dense = scene.compressed(0.8, rate=0.1)
    assert (dense.radius == SIZES).all()
    assert (dense.mass == scene.mass).all()
    assert (dense.gravity.tolist(), dense.restitution, dense.duration) == ([0, -1], 0.9, 7.0)
    assert overlap(dense).pairs == 0
    momentum = (dense.masses[:, None] * dense.velocity).sum(axis=0)
    assert np.abs(momentum).max() < 1e-12, "collisions conserve it"
    with pytest.raises(ValueError, match="read-only"):
        dense.position[0] = 0


def test_it_starts_a_run_of_the_exact_solver():
    dense = equal_discs().compressed(0.8, rate=0.1)
    with mpsim.Simulation(dense, mpsim.Settings(method="event", dt=0.1)) as sim:
        report = sim.run(frames=2)
    assert report.collisions > 100


def test_it_gives_the_same_bits_again():
    scene = equal_discs()
    once, again = scene.compressed(0.7, rate=0.1), equal_discs().compressed(0.7, rate=0.1)
    assert once.digest() == again.digest()
    assert once.digest() != equal_discs(seed=2).compressed(0.7, rate=0.1).digest()
    assert once.digest() != scene.compressed(0.7, rate=0.2).digest()


def test_its_bits_are_pinned():
    """On any machine: the start is made by integer arithmetic."""
    assert lattice(8, 8).compressed(0.75, rate=0.1).digest() == "170700835ea965549bf2f7ef33fbfcfc"


@pytest.mark.parametrize("power", [-300, 300])
def test_other_units_give_the_same_digits(power):
    """A power of two changes no digit, as far as areas fit float64."""
    unit = 2.0**power
    scene, dense = lattice(4, 4), lattice(4, 4).compressed(0.7, rate=0.1)
    other = mpsim.Scene(
        width=scene.width * unit, height=scene.height * unit, radius=scene.radius * unit,
        position=scene.position * unit, velocity=scene.velocity / unit,
    ).compressed(0.7, rate=0.1)  # fmt: skip
    assert (other.position == dense.position * unit).all()
    assert (other.velocity == dense.velocity / unit).all()


def test_another_seed_compresses_another_start():
    dense = equal_discs(49).compressed(0.7, rate=0.2)
    other = dense.redrawn(3)
    assert other.packing == pytest.approx(0.7, rel=1e-14)
    assert not (other.position == dense.position).any()
    assert other.digest() == dense.redrawn(3).digest()
    with pytest.raises(mpsim.InputError, match="another start needs a scene that was drawn at random"):
        lattice(4, 4).compressed(0.75, rate=0.2).redrawn(3)


def test_jammed_discs_are_reported_with_the_packing_that_can_be_had():
    scene = mpsim.Scene.random(**MIXTURE, boundary="periodic")
    with pytest.raises(mpsim.InputError) as caught:
        scene.compressed(0.9, rate=0.1)
    assert_says(
        caught, ["packing 0.9 was not reached", "at rate=0.1 the discs jammed at a packing of 0.8", "rate=0.01"]
    )
    reached = float(str(caught.value).split("a packing of ")[1].split(". ")[0])
    assert overlap(scene.compressed(reached, rate=0.1)).pairs == 0


# --- negative controls: what becomes of it without growth in one of the rules, in plain Python ----------------------


def few():
    return lattice(3, 3)


def test_in_plain_python_it_works(plain):
    assert few().compressed(0.7, rate=1.0).digest() == few().compressed(0.7, rate=1.0).digest()
    assert overlap(few().compressed(0.7, rate=1.0)).pairs == 0


def test_without_the_speed_of_growth_at_impacts_discs_stay_in_touch(plain):
    plain.setattr(expansion, "approach", lambda expansion, b, rx, ry, contact: b)
    with pytest.raises(mpsim.InputError, match="jammed"):
        few().compressed(0.7, rate=1.0)


def test_without_growth_in_the_predictions_discs_overlap(plain):
    grown = expansion.time_to_impact
    plain.setattr(expansion, "time_to_impact", lambda expansion, *others: grown(None, *others))
    assert overlap(few().compressed(0.7, rate=1.0)).pairs > 0


# --- bad input ------------------------------------------------------------------------------------------------------

PEG = mpsim.FixedDisc((2.0, 2.0), 0.1)
CASES = {
    "packing 0": (lambda: few().compressed(0), ["packing must be a finite number > 0", "got 0"]),
    "packing as text": (lambda: few().compressed("0.7"), ["packing must be a number > 0", "'0.7'"]),
    "packing in per cent": (lambda: few().compressed(82), ["packing must be a fraction of", "82 % is 0.82."]),
    "packing nan": (lambda: few().compressed(math.nan), ["packing must be a finite number > 0", "got nan"]),
    "packing below": (lambda: few().compressed(0.5), ["above that of the scene, 0.62", "got 0.5"]),
    "packing above all": (lambda: few().compressed(0.91), ["below 0.9069", "got 0.91"]),
    "packing above, of mixtures": (
        lambda: mpsim.Scene.random(**MIXTURE).compressed(0.95), ["below 0.909", "got 0.95"]
    ),
    "rate 0": (lambda: few().compressed(0.7, rate=0), ["rate must be a number from 1e-06 to 10", "got 0"]),
    "rate above": (lambda: few().compressed(0.7, rate=11), ["rate must be a number from", "got 11"]),
    "rate nan": (lambda: few().compressed(0.7, rate=math.nan), ["rate must be a number from", "got nan"]),
    "misspelt": (lambda: few().compressed(0.7, speed=1), ["argument of", "compressed", "'packing', 'rate'", "'speed'"]),
    "no disc": (
        lambda: mpsim.Scene(width=1, height=1, position=(), velocity=(), radius=0.1).compressed(0.5),
        ["compressed needs discs", "0 discs"],
    ),
    "at rest": (lambda: equal_discs(temperature=0).compressed(0.7), ["velocity must not be 0", "temperature"]),
    "too fast": (
        lambda: mpsim.Scene(width=5, height=5, position=[[2, 2]], velocity=[[1e200, 0]], radius=1).compressed(0.7),
        ["velocity", "below 1e+140", "1e+200"],
    ),
    "overlap": (
        lambda: mpsim.Scene(
            width=5, height=5, position=[[1, 1], [1.5, 1]], velocity=np.ones((2, 2)), radius=0.5
        ).compressed(0.6),
        ["do not overlap", "discs 0 and 1, by 0.5", "Move them apart"],
    ),
    "obstacles": (lambda: equal_discs(obstacles=PEG).compressed(0.7), ["cannot do a scene with obstacles"]),
    "absorbing": (lambda: equal_discs(absorbing="left").compressed(0.7), ["cannot do a scene with absorbing edges"]),
    "piston": (
        lambda: equal_discs(piston=mpsim.Piston("right", -1, 9)).compressed(0.7), ["cannot do a scene with a piston"]
    ),
    "emitters": (
        lambda: equal_discs(emitters=mpsim.Emitter((1, 1), (1, 0), interval=1)).compressed(0.7),
        ["cannot do a scene with emitters"],
    ),
    "a periodic box too small": (
        lambda: mpsim.Scene.random(count=4, packing=0.4, radius=0.5, boundary="periodic").compressed(0.85),
        ["packing must leave a box with room for its largest disc, 2 of them", "more discs"],
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_bad_input_is_refused(case):
    act, parts = CASES[case]
    with pytest.raises(mpsim.InputError) as caught:
        act()
    assert_says(caught, parts)
