"""Each function of mpsim.measure, and each measure of a run, against a few lines of NumPy that share nothing with it.

States are made, not simulated, with any features that a measure knows: sizes, masses, fields, periodic axes, float32,
discs that have left.
"""

from collections import Counter
from itertools import combinations

import numpy as np
import pytest
from support.anything import any_gas, typical_time
from support.scenes import scene_of, simulate

import mpsim
from mpsim import measure
from mpsim.engine.feature_arrays import typical_momentum
from mpsim.measure import registry

pytestmark = [pytest.mark.plain, pytest.mark.filterwarnings("ignore::UserWarning")]


def drawn(seed):
    """A scene and two states of it, the second with every disc elsewhere; and who is present."""
    rng = np.random.default_rng([seed, 8])
    count = int(rng.choice([1, 2, 7, 40]))
    size = rng.uniform(4, 12, 2)
    boundary = [str(rng.choice(["walls", "periodic"])) for _ in "xy"]
    radius = rng.choice([0.2, 0.5, 0.9], count) if rng.random() < 0.5 else 0.4
    features = {"mass": rng.uniform(0.1, 9, count)} if rng.random() < 0.5 else {}
    fields = np.array([word == "walls" for word in boundary])
    if rng.random() < 0.5:
        features["gravity"] = rng.normal(size=2) * fields
    if rng.random() < 0.5:
        features["acceleration"] = rng.normal(size=(count, 2)) * fields
    precision = str(rng.choice(["float32", "float64"]))
    margin = np.multiply.outer(np.broadcast_to(radius, count), fields)
    places = [margin + rng.random((count, 2)) * (size - 2 * margin) for _ in range(2)]
    velocity = rng.normal(size=(2, count, 2)) * 10.0 ** rng.integers(-3, 4)
    scene = scene_of(places[0], velocity[0], size[0], size[1], radius=radius, boundary=boundary, **features)
    here = rng.random(count) < 0.7 if rng.random() < 0.5 else np.ones(count, bool)
    here[0] = True
    wraps = not fields.all()
    images = [rng.integers(-3, 4, (count, 2)) * ~fields for _ in range(2)]
    states = [
        mpsim.State(
            p.astype(precision), v.astype(precision), present=here, box=scene.box, image=image if wraps else None
        )
        for p, v, image in zip(places, velocity, images, strict=True)
    ]
    return scene, states, here


def nearest(scene, difference):
    """The shortest of a difference and its images, by trying all of them."""
    shifts = [
        [0, -length, length] if wraps else [0] for length, wraps in zip(scene.box[1::2], scene.periodic, strict=True)
    ]
    tried = np.array([np.add(difference, (x, y)) for x in shifts[0] for y in shifts[1]])
    return tried[(tried**2).sum(axis=-1).argmin(axis=0), np.arange(len(difference))]


def check_sums(seed):
    """Energies, momentum, temperature and speeds."""
    scene, (state, _), here = drawn(seed)
    v, p, m = state.velocity[here].astype(float), state.position[here].astype(float), scene.masses[here]
    squares = v[:, 0] ** 2 + v[:, 1] ** 2
    same(measure.kinetic_energy(state, scene), (m * squares).sum() / 2)
    same(measure.momentum(state, scene), [m @ v[:, 0], m @ v[:, 1]], scale=m @ np.sqrt(squares))
    same(measure.temperature(state, scene), (m * squares).mean() / 2)
    if len(m) > 1:
        drift = np.array([m @ v[:, 0], m @ v[:, 1]]) / m.sum()
        heat = (m * ((v - drift) ** 2).sum(axis=1)).sum() / 2 / (len(m) - 1)
        same(measure.temperature(state, scene, remove_drift=True), heat, scale=(m * squares).sum())
    g = np.zeros((len(m), 2)) if scene.gravity is None else np.tile(scene.gravity, (len(m), 1))
    g = g if scene.acceleration is None else g + scene.acceleration[here]
    same(
        measure.potential_energy(state, scene), -(m * (g * p).sum(axis=1)).sum(), scale=np.abs(m[:, None] * g * p).sum()
    )
    same(measure.speed_kurtosis(state), np.mean(squares**2) / np.mean(squares) ** 2)


def check_pairs(seed):
    """Overlaps, over all pairs one by one."""
    scene, (state, _), here = drawn(seed)
    p, discs = state.position.astype(float), np.flatnonzero(here)
    pairs = list(combinations(discs.tolist(), 2))
    i, j = np.array(pairs, int).reshape(-1, 2).T
    depth = scene.radii[i] + scene.radii[j] - np.hypot(*nearest(scene, p[i] - p[j]).T)
    rounding = 8 * np.finfo(state.position.dtype).eps * max(scene.width, scene.height)
    if (np.abs(depth - rounding) > 1e-12).all():
        deep = depth[depth > rounding]
        found = measure.overlap(state, scene)
        assert found.pairs == len(deep), f"{found.pairs} pairs instead of {len(deep)}"
        same([found.largest, found.mean], [deep.max(initial=0), deep.mean() if len(deep) else 0])
        assert found.worst == (pairs[int(depth.argmax())] if len(deep) else None)


def check_displacements(seed):
    """How far discs have moved, and how far two states are apart."""
    scene, (before, after), here = drawn(seed)
    size = np.array([scene.width, scene.height])
    at = [s.position.astype(float) + (0 if s.image is None else s.image * size) for s in (before, after)]
    same(measure.mean_squared_displacement(before, after, scene), np.mean(((at[1] - at[0])[here] ** 2).sum(axis=1)))
    off = nearest(scene, after.position.astype(float) - before.position.astype(float))
    off = np.where(here, np.hypot(*off.T), 0)
    bare = [mpsim.State(s.position, s.velocity, present=here) for s in (before, after)]  # the nearest images count
    same(measure.mean_squared_displacement(*bare, scene), (off[here] ** 2).mean())
    found = measure.trajectory_error(after, before, scene)
    same([found.rms, found.largest], [np.sqrt((off[here] ** 2).mean()), off.max()])
    assert found.disc == off.argmax()


# --- measures of runs


def drawn_run(seed):
    """A gas of smooth discs, whose changes of velocity say who met whom, and settings.

    Exact; or stepped with `push`, where it is plain at which depth discs meet.
    """
    scene, rng = any_gas(seed, friction=False, wrap=0.6), np.random.default_rng([seed, 9])
    stepped = {"method": "naive", "contact": "push", "law": str(rng.choice(["elastic", "reflect"]))}
    return scene, {
        "dt": typical_time(scene) / max(20 * scene.count, 100),
        **(stepped if rng.random() < 0.5 else {"method": "event"}),
    }


def check_run(seed):
    """Every measure that a gas allows, from the changes of velocity between short frames. Returns which were seen."""
    (scene, settings), frames = drawn_run(seed), 250
    names = [name for name in registry.NAMES if registry.refusal(name, scene) is None]
    states = [mpsim.State(scene.position, scene.velocity)]
    with simulate(scene, **settings) as sim:
        for _ in range(frames):
            sim.run(frames=1)
            states.append(sim.state)
    with simulate(scene, **settings) as sim:
        found = sim.run(frames=frames, measures=names).measures
    happened = events(scene, states, settings["dt"])
    depths = depths_met(scene, states, settings)
    if happened is None or depths is None:
        return []  # more than one event in a frame: it cannot be said what happened
    time = frames * settings["dt"]
    expected = states_say(scene, states, time) | events_say(scene, states, time, *happened)
    expected |= {"overlap": np.mean(depths or [0.0]), "largest_overlap": max(depths, default=0.0)}
    units = natural_units(scene, states, time) | pressure_unit(scene, time, settings["dt"], len(happened[1]))
    for name in names:
        try:
            same(found[name].value, expected[name], rel=1e-9, scale=units.get(name))
        except AssertionError as error:
            raise AssertionError(f"{name}, gas {seed}, {scene!r}, {settings}: {error}") from error
    return names


def events(scene, states, dt):
    """Momenta given to pairs, [(i, j, to i, to j)], and by walls, [(x, y)]; None where a frame may have had several."""
    fall = 0 if scene.gravity is None else scene.gravity * dt
    kicks = scene.masses[:, None] * (np.diff([state.velocity for state in states], axis=0) - fall)
    kicks[np.abs(kicks) < 1e-9 * np.abs(scene.masses[:, None] * states[0].velocity).max()] = 0
    pairs, walls = [], []
    for kick in kicks:
        struck = np.flatnonzero(kick.any(axis=1))
        if len(struck) == 1:
            walls.append(kick[struck[0]])
        elif len(struck) == 2:
            i, j = struck
            parallel = abs(np.linalg.det(kick[struck])) < 1e-6 * np.prod(np.linalg.norm(kick[struck], axis=1))
            if not parallel or not kick[struck].all():  # two at walls, or one of a pair
                return None
            pairs.append((i, j, kick[i], kick[j]))
        elif len(struck):
            return None
    return pairs, walls


def depths_met(scene, states, settings):
    """Depths at which pairs overlap when all have flown freely for a frame; None where one of them is at a wall."""
    depths, i, j = [], *np.triu_indices(scene.count, 1)
    if settings["method"] == "event":
        return depths
    dt, (low, high) = settings["dt"], scene.limits(scene.radius)
    for state in states[:-1]:
        flown = state.position + (state.velocity + (0 if scene.gravity is None else scene.gravity * dt)) * dt
        inside = np.where(scene.periodic, flown, np.clip(flown, low, high))
        depth = scene.radii[i] + scene.radii[j] - np.hypot(*nearest(scene, inside[i] - inside[j]).T)
        met = np.flatnonzero(depth > 0)
        moved = (inside != flown).any(axis=1)
        if len(met) > 1 or moved[[*i[met], *j[met]]].any():
            return None
        depths += depth[met].tolist()
    return depths


def states_say(scene, states, time):
    """Measures that follow from states: means over all but the first, as so few are all sampled."""
    m, g = scene.masses, np.zeros(2) if scene.gravity is None else scene.gravity
    squares = np.array([(state.velocity**2).sum(axis=1) for state in states])
    kinetic = (m * squares).sum(axis=1) / 2
    total = [kinetic[k] - (m * (states[k].position @ g)).sum() for k in (0, -1)]
    seen = squares[1:]
    return {
        "kinetic_energy": kinetic[1:].mean(),
        "temperature": kinetic[1:].mean() / scene.count,
        "speed_kurtosis": np.mean((seen**2).mean(axis=1) / seen.mean(axis=1) ** 2),
        "energy_drift": (total[1] - total[0]) / kinetic[[0, -1]].max() / time,
    }


def events_say(scene, states, time, pairs, walls):
    """Measures that follow from collisions, with s the distance at which discs touch and n the direction of a kick.

    The two kicks of a collision are equal, but for those of `reflect`, whose mean counts.
    """
    m, size = scene.masses, np.array([scene.width, scene.height])
    free = size - np.where(scene.periodic, 0, 2 * scene.largest_radius)
    given = np.zeros((2, 2))  # s |dp| n n / time
    for i, j, kick, other in pairs:
        mean = (np.hypot(*kick) + np.hypot(*other)) / 2
        given += (scene.radii[i] + scene.radii[j]) * mean * np.outer(kick, kick) / (kick @ kick) / time
    momenta = m[:, None] * np.array([state.velocity for state in states])
    drift = momenta.sum(axis=1, keepdims=True) / m.sum() * scene.periodic
    flow = np.einsum("tia,tib->tab", momenta - m[:, None] * drift, momenta / m[:, None] - drift)
    tensor = flow[1:].mean(axis=0) + given
    rate = 2 * len(pairs) / scene.count / time
    unbalanced = np.hypot(*sum((to_i + to_j for _, _, to_i, to_j in pairs), np.zeros(2)))
    virial = (np.trace(flow[-1]) + np.trace(given)) / (free @ size[::-1])
    edge = 2 * (size[::-1] * ~np.array(scene.periodic)).sum()
    return {
        "collision_rate": rate,
        "contact_rate": rate,
        "momentum_drift": unbalanced / np.linalg.norm(momenta[[0, -1]], axis=2).sum(axis=1).max() / time,
        "pressure": np.abs(walls).sum() / time / edge if edge else virial,
        "pressure_virial": virial,
        "pressure_xx": tensor[0, 0] / free[0] / size[1],
        "pressure_yy": tensor[1, 1] / free[1] / size[0],
        "pressure_xy": tensor[0, 1] / size.prod(),
    }


def natural_units(scene, states, time):
    """What rounding is measured by, where a measure may be 0."""
    energy = (scene.masses[:, None] * states[0].velocity ** 2).sum()
    return {
        "overlap": scene.largest_radius,
        "largest_overlap": scene.largest_radius,
        "energy_drift": 1 / time,
        "momentum_drift": 1000 / time,  # impulses are summed in steps of 2^-32
        "pressure_xy": energy / scene.width / scene.height,
    }


def pressure_unit(scene, time, dt, hits):
    """The pressure if each hit on a wall gave it a typical momentum: impulses are summed in steps of 2^-32 of that."""
    edge = 2 * (np.array([scene.height, scene.width]) * ~np.array(scene.periodic)).sum()
    return {"pressure": hits * typical_momentum(scene, dt) / time / edge} if edge else {}


def same(got, expected, rel=1e-12, scale=None):
    """Fail unless numbers agree to rounding, of the expected ones or of a scale."""
    expected = np.asarray(expected)
    slack = rel * np.maximum(np.abs(expected), np.abs(expected) if scale is None else scale)
    assert (np.abs(np.asarray(got) - expected) <= slack).all(), f"{got!r} instead of {expected!r}"


CHECKS = {check.__name__: check for check in (check_sums, check_pairs, check_displacements)}


@pytest.mark.parametrize("seeds", [range(10), pytest.param(range(15, 1515), marks=pytest.mark.long)])
@pytest.mark.parametrize("name", CHECKS)
def test_functions_of_a_state(name, seeds):
    for seed in seeds:
        try:
            CHECKS[name](seed)
        except Exception as error:
            raise AssertionError(f"{name}, state {seed}: {error}") from error


@pytest.mark.timeout(900)
@pytest.mark.parametrize("seeds", [(1, 5), pytest.param(range(100, 500), marks=pytest.mark.long)])
def test_measures_of_runs(seeds):
    """Seen are those of runs with one event in a frame at most."""
    seen = Counter(name for seed in seeds for name in check_run(seed))
    assert len(seen) > 5, f"too few runs had one event in a frame at most: {seen}"
