"""Mirrored, turned and renumbered scenes: the exact solver says the same, and the stepped ones on average.

A rounding grows with each collision. So two runs of `event` may differ by no more than a start nudged by 1e-11 would
make them differ, which is a hundred thousand roundings. Contacts of stepped methods come in another order in a mirror,
so their ensembles are compared.
"""

import warnings

import numpy as np
import pytest
from support.gases import any_room, typical_time
from support.scenes import simulate
from support.transforms import features_of, mirror, renumbered, turn

import mpsim

NUDGE = 1e-11

pytestmark = [
    pytest.mark.plain,
    pytest.mark.filterwarnings("ignore::UserWarning"),
]


def images(scene, rng):
    """Each image of the scene by name, and what brings its positions and its velocities back."""
    order = rng.permutation(scene.count)
    first = lambda rows: np.concatenate([rows[np.argsort(order)], rows[scene.count :]])  # noqa: E731
    found = {"renumbered": (renumbered(scene, order), first, first)}
    for name, image in (("mirrored", mirror(scene)), ("turned", turn(scene))):
        found[name] = (image.scene(scene), image.point_back, image.vector_back)
    return found


def run(scene, frames, **settings):
    """Positions and velocities of all discs, 0 for those that have left, and collisions."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        with simulate(scene, **settings) as sim:
            collisions = sim.run(frames=frames).collisions
            state = sim.state
            return state.position, state.velocity * state.present[:, None], collisions


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
    """A room and its images by event. Returns whether it was sharp: the rounding had not grown much."""
    scene, rng = any_room(seed, stepped=False), np.random.default_rng([seed, 6])
    settings = {"method": "event", "dt": typical_time(scene) / 4}
    low, high = scene.limits(scene.radius)
    places = np.clip(scene.position + NUDGE * rng.choice([-1, 1], (scene.count, 2)), low, high)
    nudged = mpsim.Scene(**features_of(scene) | {"position": places})
    reference, other = run(scene, 4, **settings), run(nudged, 4, **settings)
    bound = 10 * max(apart(scene, reference, other), NUDGE)
    for name, (image, place, heading) in picture(scene, rng).items():
        found = run(image, 4, **settings)
        note = f"room {seed} {name}, {scene!r}"
        assert len(found[0]) == len(reference[0]), f"{note}: {len(found[0])} discs instead of {len(reference[0])}"
        distance = apart(scene, reference, (place(found[0]), heading(found[1])))
        assert distance <= bound, f"{note}: differs by {distance:.3g}, a nudge makes {bound / 10:.3g}"
        if bound < 1e-4:
            assert found[2] == reference[2], f"{note}: {found[2]} collisions instead of {reference[2]}"
    return bound < 1e-4


def fastest(scene):
    """Largest speed of a disc at the start, one that enters, and the piston."""
    emitted = [np.hypot(*emitter.velocity) for emitter in scene.emitters]
    pushed = [2 * abs(scene.piston.speed)] if scene.piston is not None else []
    return float(max([np.abs(scene.velocity).max(), *emitted, *pushed]))


def differences(seeds, picture=images):
    """For each image, how much collisions, energy and the displacement of all discs differ by grid, shape (N, 3)."""
    found = {}
    for seed in seeds:
        scene, rng = any_room(seed, stepped=True), np.random.default_rng([seed, 7])
        if scene.count < 5:
            continue
        settings = {"method": "grid", "contact": "impact", "dt": 0.2 * scene.smallest_radius / fastest(scene)}
        position, velocity, collisions = run(scene, 12, **settings)
        here = slice(scene.count)  # those that have entered have no displacement
        drift = moved(scene, scene.position, position[here])
        for name, (image, place, _) in picture(scene, rng).items():
            p, v, contacts = run(image, 12, **settings)
            energy = [float((w**2).sum()) for w in (velocity, v)]
            more = (moved(scene, position[here], place(p)[here]) * drift).sum() / (drift**2).sum()
            numbers = [(contacts - collisions) / max(collisions, 1), energy[1] / energy[0] - 1, more]
            found.setdefault(name, []).append(numbers)
    return {name: np.array(rows) for name, rows in found.items()}


def check_averages(seeds, most, picture=images):
    """The means of the differences are 0 within 4.5 standard errors, which are at most so large."""
    for name, rows in differences(seeds, picture).items():
        error = rows.std(axis=0, ddof=1) / np.sqrt(len(rows))
        mean = rows.mean(axis=0)
        note = f"{name}: collisions, energy and displacement differ by {mean.round(4)} with errors {error.round(4)}"
        assert (np.abs(mean) < 4.5 * np.maximum(error, 1e-9)).all(), note
        assert (error < most).all(), f"too noisy to show anything: {note}"


def test_images_of_scenes_do_the_same_by_the_exact_solver():
    assert sum(map(check_exact, range(4))) >= 2


def test_images_of_scenes_do_the_same_on_average_by_grid():
    check_averages(range(9), 0.15)
