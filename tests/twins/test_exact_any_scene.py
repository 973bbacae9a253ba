"""Random small scenes with all that the exact solver knows, against its slow twin, event by event.

Every feature is in every kernel, with values that do nothing where the scene lacks it: two compilations for all scenes.
"""

import math

import numpy as np
import pytest
from support.event_twin import Twin
from support.event_twin_fixtures import gap
from support.exact import Run
from support.selection import long_but

from mpsim.kernels.events import records

CLOSE = 1e-7
"""Events that are closer in time than this end a comparison: which comes first, rounding decides."""

EVENTS = 12
NO_EDGE = 9


def anywhere(seed, falls):
    """Arguments of `Run` and `Twin`: up to four discs, two capsules, a moving wall, an absorbing edge."""
    rng = np.random.default_rng([seed, falls])
    size = rng.uniform(3.0, 6.0, 2)
    radius = rng.uniform(0.1, 0.6, rng.integers(1, 5))
    periodic = [bool(rng.random() < 0.3), bool(rng.random() < 0.3)]
    capsules = []
    for _ in range(rng.integers(1, 3)):
        a = rng.uniform(0.0, 1.0, 2) * size
        b = a if rng.random() < 0.4 else np.clip(a + rng.normal(size=2), 0.0, size)
        capsules.append((*a, *b, rng.choice([0.0, 0.1, 0.5]) + 0.05 * (a == b).all()))
    wall, low, high = moving_wall(rng, size, periodic)
    edges = [edge for edge in range(4) if not periodic[edge // 2] and edge != wall[0]]
    absorbing = (int(rng.choice(edges)),) if edges and rng.random() < 0.3 else (NO_EDGE,)
    position = placed(rng, radius, low, high, size, periodic, capsules)
    if position is None:
        return None
    count = len(radius)
    return dict(
        position=position, velocity=rng.normal(size=(count, 2)), width=size[0], height=size[1], radius=radius,
        periodic=tuple(periodic), mass=rng.uniform(0.5, 3.0, count), spin=rng.normal(size=count),
        gravity=tuple(rng.normal(size=2)) if falls else None, capsules=capsules, moving_wall=wall, absorbing=absorbing,
        restitution=float(rng.choice([1.0, 0.9])), wall_restitution=float(rng.choice([1.0, 0.8])), contact_time=1e-13,
        friction=(float(rng.choice([0.0, 0.3])), 0.5), wall_friction=(float(rng.choice([0.0, 0.4])), 0.0),
    )  # fmt: skip


def moving_wall(rng, size, periodic):
    """(edge, start, stop, speed), and the corners of the box; where none moves, the left one, or one far away."""
    low, high = np.zeros(2), size.copy()
    walled = [edge for edge in range(4) if not periodic[edge // 2]]
    if not walled or rng.random() < 0.4:
        left = -1e6 if periodic[0] else 0.0
        return (0, left, left, 1.0), low, high
    edge = int(rng.choice(walled))
    axis, upper = edge // 2, edge % 2
    start, stop = (size[axis], 0.8 * size[axis]) if upper else (0.0, 0.2 * size[axis])
    return (edge, start, stop, float(rng.choice([0.1, 1.0, 5.0])) * (-1 if upper else 1)), low, high


def placed(rng, radius, low, high, size, periodic, capsules):
    """Places without overlap, or None where there is no room."""
    found = []
    for r in radius:
        margin = np.where(periodic, 0.0, r)
        for _ in range(200):
            place = rng.uniform(low + margin, high - margin)
            away = [place - other for other in found]
            away = [each - size * np.round(each / size) * periodic for each in away]
            clear = all(math.hypot(*each) > r + q for each, q in zip(away, radius, strict=False))
            shifts = [np.array([a, b]) * size * periodic for a in (-1, 0, 1) for b in (-1, 0, 1)]
            if clear and all(gap(place - shift, capsule, r) > 0.0 for shift in shifts for capsule in capsules):
                found.append(place)
                break
        else:
            return None
    return np.array(found)


def compare(options, other=None):
    """Play both, the twin with other options if there are: events of each kind, and the worst difference."""
    run = Run(image=True, **options)
    twin = Twin(**{**(other or options), "gravity": options["gravity"] or (0.0, 0.0)}, images=1)
    seen, worst = {}, 0.0
    event = twin.next_event()
    for k in range(1, EVENTS + 1):
        if not CLOSE < event[0] < 3.0:  # longer flights may pass more images than the twin looks at
            break
        seen[event[1]] = seen.get(event[1], 0) + 1
        twin.step(event)
        event = twin.next_event()
        wait = min(event[0], 1.0)
        if wait < CLOSE:
            break
        twin.fly(0.5 * wait)
        assert run.advance(twin.time) == (records.REACHED, -1)
        assert run.count("pairs") + run.count("walls") == k, f"{k} events of the twin, {seen}"
        x, v = run.state()
        away = x - np.array(twin.x)
        away -= run.box[:2] * np.round(away / run.box[:2]) * options["periodic"]
        turned = run.spin()
        worst = max(worst, *(float(np.abs(each).max()) for each in (away, v - twin.v, turned - twin.spin)))
        twin.x, twin.v, twin.spin = x.tolist(), v.tolist(), turned.tolist()
        event = twin.next_event()
    return seen, worst


def check(seeds, falls):
    total, played, worst = {}, 0, 0.0
    for seed in seeds:
        options = anywhere(seed, falls)
        if options is not None:
            seen, difference = compare(options)
            assert difference < 1e-9, f"seed {seed}: {difference}, {options}"
            played, worst = played + 1, max(worst, difference)
            total = {kind: total.get(kind, 0) + seen.get(kind, 0) for kind in {*total, *seen}}
    assert played > 0.7 * len(seeds)
    assert min(total.get(kind, 0) for kind in ("pair", "wall", "capsule", "moving wall")) > 0.2 * len(seeds), total
    return total, worst


@pytest.mark.slow
@pytest.mark.parametrize("falls", long_but([False, True], True))
def test_random_scenes_follow_the_slow_twin(falls):
    print(check(range(60), falls))


@pytest.mark.long
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("falls", [False, True])
def test_a_thousand_random_scenes_follow_the_slow_twin(falls):
    print(check(range(60, 560), falls))


@pytest.mark.slow
def test_a_law_that_is_nearly_right_is_noticed():
    """The controls: obstacles thicker by 1e-7, a wall that stops 1e-7 earlier, a restitution less by 1e-7."""
    for name, other in (
        ("capsules", lambda found: [(*each[:4], each[4] + 1e-7) for each in found]),
        ("moving_wall", lambda found: (*found[:2], found[2] - 1e-7 * np.sign(found[3]), found[3])),
        ("wall_restitution", lambda found: found - 1e-7),
    ):
        missed = 0
        for seed in range(25):
            options = anywhere(seed, True)
            if options is not None:
                try:
                    missed += compare(options, {**options, name: other(options[name])})[1] > 1e-9
                except AssertionError:
                    missed += 1
        assert missed > 3, name
