"""Mirrored, turned and renumbered scenes: the exact solver says the same, and the stepped ones on average.

A rounding grows with each collision. So two runs of `event` may differ by no more than a start nudged by 1e-11 would
make them differ, which is a hundred thousand roundings. Contacts of stepped methods come in another order in a mirror,
so their ensembles are compared. Scenes run as plain Python in a process of their own. One execution: a scene and its
three images. Executions: 44 by default, 3,160 with --long.
"""

import warnings

import numpy as np
import pytest
from support.gases import any_gas, typical_time
from support.processes import assert_clean, run_script
from support.scenes import simulate
from support.transforms import features_of, mirrored, renumbered, turned

import mpsim

NUDGE = 1e-11


def images(scene, rng):
    """Each image of the scene by name, and what brings its positions (displacements) and velocities back."""
    order = rng.permutation(scene.count)
    back = np.argsort(order)
    return {
        "mirrored": (mirrored(scene), lambda p: p * [-1, 1] + [scene.width, 0], lambda v: v * [-1, 1]),
        "turned": (turned(scene), lambda p: p[:, ::-1] * [1, -1] + [0, scene.height], lambda v: v[:, ::-1] * [1, -1]),
        "renumbered": (renumbered(scene, order), lambda p: p[back], lambda v: v[back]),
    }


def run(scene, frames, **settings):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        with simulate(scene, **settings) as sim:
            collisions = sim.run(frames=frames).collisions
            return sim.state.position, sim.state.velocity, collisions


def moved(scene, one, other):
    """From one set of places to another, by the shorter way round."""
    size = np.array([scene.width, scene.height])
    return other - one - np.where(scene.periodic, size * np.round((other - one) / size), 0)


def apart(scene, one, other):
    """Largest difference of positions, in radii, and of velocities, in units of the largest."""
    offset = moved(scene, one[0], other[0])
    speed = np.abs(one[1]).max() or 1.0
    return max(np.abs(offset).max() / scene.smallest_radius, np.abs(one[1] - other[1]).max() / speed)


def check_exact(seed, picture=images):
    """A gas and its images by event. Returns whether it was sharp: the rounding had not grown much."""
    scene, rng = any_gas(seed), np.random.default_rng([seed, 6])
    settings = {"method": "event", "dt": typical_time(scene) / 4}
    low, high = scene.limits(scene.radius)
    places = np.clip(scene.position + NUDGE * rng.choice([-1, 1], (scene.count, 2)), low, high)
    nudged = mpsim.Scene(**features_of(scene) | {"position": places})
    reference, other = run(scene, 4, **settings), run(nudged, 4, **settings)
    bound = 10 * max(apart(scene, reference, other), NUDGE)
    for name, (image, place, turn) in picture(scene, rng).items():
        found = run(image, 4, **settings)
        note = f"gas {seed} {name}, {scene!r}"
        distance = apart(scene, reference, (place(found[0]), turn(found[1])))
        assert distance <= bound, f"{note}: differs by {distance:.3g}, a nudge makes {bound / 10:.3g}"
        if bound < 1e-4:
            assert found[2] == reference[2], f"{note}: {found[2]} collisions instead of {reference[2]}"
    return bound < 1e-4


def differences(seeds, picture=images):
    """For each image, how much collisions, energy and the displacement of all discs differ by grid, shape (N, 3)."""
    found = {}
    for seed in seeds:
        scene, rng = any_gas(seed), np.random.default_rng([seed, 7])
        if scene.count < 6:
            continue
        speed = float(np.abs(scene.velocity).max())
        settings = {"method": "grid", "contact": "impact", "dt": 0.2 * scene.smallest_radius / speed}
        position, velocity, collisions = run(scene, 12, **settings)
        drift = moved(scene, scene.position, position)
        for name, (image, place, _) in picture(scene, rng).items():
            p, v, contacts = run(image, 12, **settings)
            energy = [float((w**2).sum()) for w in (velocity, v)]
            more = (moved(scene, position, place(p)) * drift).sum() / (drift**2).sum()
            numbers = [(contacts - collisions) / max(collisions, 1), energy[1] / energy[0] - 1, more]
            found.setdefault(name, []).append(numbers)
    return {name: np.array(rows) for name, rows in found.items()}


def check_averages(seeds, picture=images):
    """The means of the differences are 0 within 4.5 standard errors."""
    for name, rows in differences(seeds, picture).items():
        error = rows.std(axis=0, ddof=1) / np.sqrt(len(rows))
        off = np.abs(rows.mean(axis=0)) / np.maximum(error, 1e-9)
        assert (off < 4.5).all(), (
            f"{name}: collisions, energy and displacement are off by {off.round(1)} standard errors"
        )


def check_many(exact, stepped):
    """What runs as plain Python. Prints how many were sharp."""
    warnings.simplefilter("ignore")
    check_averages(range(*stepped))
    print(sum(map(check_exact, range(*exact))))


def plain(exact, stepped, bound):
    text = f"from adversary.test_symmetry import check_many; check_many({exact}, {stepped})"
    outcome = run_script(text, env={"NUMBA_DISABLE_JIT": "1"}, bound=bound)
    assert_clean(outcome)
    return int(outcome.out)


def test_images_of_scenes_do_the_same():
    assert plain((0, 30), (0, 18), bound=120) >= 20


@pytest.mark.long
@pytest.mark.timeout(1600)
def test_images_of_thousands_of_scenes_do_the_same():
    assert plain((1000, 4000), (1000, 1200), bound=1500) >= 2000


def wrong_mirror(scene, rng):
    """Places are mirrored, velocities are not."""
    features = features_of(mirrored(scene)) | {"velocity": scene.velocity}
    return {"mirrored": (mpsim.Scene(**features), *images(scene, rng)["mirrored"][1:])}


def check_that_a_wrong_mirror_is_seen():
    warnings.simplefilter("ignore")
    with pytest.raises(AssertionError, match="differs by"):
        check_exact(5, wrong_mirror)
    with pytest.raises(AssertionError, match="standard errors"):
        check_averages(range(12), wrong_mirror)


def test_a_wrong_mirror_is_seen():
    """The control."""
    text = "from adversary.test_symmetry import *; check_that_a_wrong_mirror_is_seen()"
    assert_clean(run_script(text, env={"NUMBA_DISABLE_JIT": "1"}, bound=60))
