"""The first contact of a disc with an obstacle that moves, against a search in small steps of time."""

import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pytest

import mpsim
from mpsim import Circle, FixedDisc, Oscillation, Path, Polyline, Rotation, Translation
from mpsim.features.obstacles import OBSTACLES
from mpsim.kernels.events.features.bodies import time_to_body
from mpsim.kernels.features.bodies import Bodies

pytestmark = pytest.mark.plain

SIDE, RADIUS, WITHIN = 12.0, 0.5, 3.0
TIMES = np.linspace(0, WITHIN, 6001)


def motions(rng):
    """One of each kind, none leaving the middle of the box."""
    angle, speed = rng.uniform(0, 2 * math.pi), rng.uniform(0.1, 2)
    way = np.array([math.cos(angle), math.sin(angle)])
    yield Translation(tuple(speed * way), stop=rng.uniform(0.2, 2), start=rng.uniform(-1, 1))
    yield Oscillation(
        tuple(rng.uniform(0.05, 1) * way), rng.uniform(0.3, 3), rng.uniform(0, 6), start=rng.uniform(0, 1)
    )
    yield Rotation(6 + rng.uniform(-1, 1, 2), rng.choice([-1, 1]) * rng.uniform(0.1, 3), start=rng.uniform(-3, 1))
    yield Path(
        np.sort(rng.uniform(0, 3, 4)) + 0.1 * np.arange(4), rng.uniform(-1, 1, (4, 2)), start=rng.uniform(-1, 0.5)
    )


def displaced(motion, times):
    """Displacements of a motion at times, shape (T, 2), and angles; written from the definitions."""
    since = np.maximum(times - motion.start, 0)
    still = np.zeros((len(times), 2)), np.zeros(len(times))
    if isinstance(motion, Translation):
        velocity = np.array(motion.velocity)
        return np.minimum(since, motion.stop / np.hypot(*velocity))[:, None] * velocity, still[1]
    if isinstance(motion, Oscillation):
        return np.sin(2 * np.pi * since / motion.period + motion.phase)[:, None] * np.array(motion.amplitude), still[1]
    if isinstance(motion, Rotation):
        return still[0], motion.rate * since
    places = np.array(motion.displacements)
    return np.column_stack([np.interp(since, motion.times, places[:, axis]) for axis in range(2)]), still[1]


def gaps(motion, capsules, start, velocity, gravity, times):
    """Gap between the disc and the nearest capsule at times."""
    place = start + np.multiply.outer(times, velocity) + 0.5 * np.multiply.outer(times**2, gravity)
    shift, angle = displaced(motion, times)
    centre = np.array(motion.centre) if isinstance(motion, Rotation) else np.zeros(2)
    x, y = (place - shift - centre).T
    c, s = np.cos(angle), np.sin(angle)
    seen = np.column_stack([c * x + s * y, c * y - s * x]) + centre
    best = np.full(len(times), np.inf)
    for ax, ay, bx, by, thick in capsules:
        along = np.array([bx - ax, by - ay])
        part = np.clip((seen - (ax, ay)) @ along / max(along @ along, 1e-300), 0, 1)
        away = np.hypot(*(seen - (ax, ay) - part[:, None] * along).T)
        best = np.minimum(best, (away if thick >= 0 else -away) - thick - RADIUS)
    return best


@pytest.mark.timeout(3600)
@pytest.mark.parametrize(
    ("number", "seed", "least"), [(400, 1, 40), pytest.param(100_000, 2, 10_000, marks=pytest.mark.long)]
)
def test_no_contact_is_missed_and_none_is_invented(number, seed, least):
    rng, contacts = np.random.default_rng(seed), 0
    shapes = [Polyline([(5, 6), (7, 6)], 0.2), Polyline([(5, 5.5), (6, 6.5), (7, 5.5)]), FixedDisc((6, 6.2), 0.4)]
    shapes.append(Circle((6, 5.8), 4, inside=True))
    box = SimpleNamespace(width=SIDE, height=SIDE)
    while number > 0:
        for motion in motions(rng):
            shape = dataclasses.replace(shapes[rng.integers(len(shapes))], motion=motion)
            scene = mpsim.Scene(width=SIDE, height=SIDE, position=np.zeros((0, 2)), velocity=np.zeros((0, 2)),
                                radius=RADIUS, obstacles=shape)  # fmt: skip
            bodies = Bodies(**OBSTACLES.bodies(scene, margin=2 * RADIUS))
            for _ in range(5):
                start, gravity = rng.uniform(2, 10, 2), rng.choice([0, 1]) * rng.uniform(-2, 2, 2)
                velocity = rng.choice([0, 1], p=[0.1, 0.9]) * rng.normal(0, 2, 2)
                found = gaps(motion, shape.capsules(), start, velocity, gravity, TIMES)
                if found[0] < 0:
                    continue
                number -= 1
                t, k = 0.0, -1
                while k < 0 and t < WITHIN:  # as the solver looks again after LOOK
                    place, now = start + velocity * t + 0.5 * gravity * t * t, velocity + gravity * t
                    more, k = time_to_body(bodies.body[0], bodies, *place, *now, *gravity, RADIUS, t, WITHIN - t, box)
                    t += more
                assert found[t > TIMES].min(initial=1) > -1e-9, (motion, "a contact was missed")
                if k >= 0:
                    contacts += 1
                    gap = gaps(motion, shape.capsules(), start, velocity, gravity, np.array([t]))[0]
                    assert abs(gap) < 1e-11, (motion, "no contact is here")
                    later = np.linspace(t, t + 1e-5, 20)
                    assert gaps(motion, shape.capsules(), start, velocity, gravity, later).min() < 0, motion
    assert contacts > least


def test_a_search_in_larger_steps_would_miss_some():
    """The control: a search whose bound forgets what moves the body."""
    scene = mpsim.Scene(width=SIDE, height=SIDE, position=np.zeros((0, 2)), velocity=np.zeros((0, 2)), radius=RADIUS,
                        obstacles=Polyline([(5, 6), (7, 6)], motion=Rotation((6, 6), rate=2.0)))  # fmt: skip
    arrays = OBSTACLES.bodies(scene, margin=2 * RADIUS)
    box, still = SimpleNamespace(width=SIDE, height=SIDE), (6.0, 7.2, 0.0, 0.0, 0.0, 0.0, RADIUS, 0.0, WITHIN)
    t, k = time_to_body(arrays["body"][0], Bodies(**arrays), *still, box)
    assert k == 0
    assert gaps(scene.obstacles[0].motion, [(5, 6, 7, 6, 0)], np.array(still[:2]), np.zeros(2), np.zeros(2),
                np.array([t]))[0] == pytest.approx(0, abs=1e-12)  # fmt: skip
    arrays["body"]["kind"] = 0  # a translation that has come to rest
    arrays["body"]["stop"] = 0
    assert time_to_body(arrays["body"][0], Bodies(**arrays), *still, box)[1] == -1
