"""The exact solver against a slow twin, collision by collision, and what is logged against what measures count."""

import numpy as np
import pytest
from support.event_twin import EDGES, Twin, rows_of
from support.scenes import scene_of, simulate
from support.transforms import features_of

import mpsim

pytestmark = [
    pytest.mark.plain,
    pytest.mark.filterwarnings("ignore::mpsim.errors.GuardWarning"),
    pytest.mark.filterwarnings("ignore::mpsim.FastWarning"),
]

CLOSE = 1e-7  # events that are closer in time than this end a comparison: which comes first, rounding decides


def numbers(scene, event):
    """Kind, and number, of what disc i meets in an event of the twin."""
    _, kind, _, j, _ = event
    if kind == "pair":
        return 0, j
    if kind != "capsule":
        return 1, EDGES.index(scene.piston.wall) if kind == "moving wall" else 2 * j[0] + j[1]
    for index, each in enumerate(scene.obstacles):
        for own in rows_of(each):
            shift = (np.array(j[:4]) - np.array(own[:4])) / ([scene.width, scene.height] * 2)
            if np.allclose(shift, np.round(shift)) and np.isclose(j[4], own[4]):
                return 2, index
    raise AssertionError(j)


def collisions_of_twin(twin, scene, most):
    """The first collisions: (time, kind, j, i, impulse on i, place of i). The twin stops half way to the next event."""
    found, event = [], twin.next_event()
    while len(found) < most and CLOSE < event[0] < 2.0:  # longer flights may pass more images than the twin looks at
        t, _, i, _, _ = event
        before = np.array(twin.v[i]) + t * np.array(twin.gravity)
        twin.step(event)
        if i not in twin.gone:
            impulse = twin.mass[i] * (np.array(twin.v[i]) - before)
            found.append((twin.time, *numbers(scene, event), i, impulse, np.array(twin.x[i])))
        event = twin.next_event()
    twin.fly(0.5 * min(event[0], 1.0))
    return found, event[0]


def compare(scene, twin, most, contact_time, tolerance):
    """Play both, and fail unless all collisions and the end are the same to rounding: collisions of each kind."""
    expected, wait = collisions_of_twin(twin, scene, most)
    if wait <= CLOSE:
        return None
    seen, size = mpsim.Collisions(), np.array([scene.width, scene.height])
    with simulate(scene, method="event", dt=twin.time / 8, contact_time=contact_time or 1e-12) as sim:
        sim.run(frames=8, observe=seen)
        state = sim.state
    table, worst = seen.table, 0.0
    assert len(table) == len(expected)
    for row, (time, kind, j, i, impulse, there) in zip(table, expected, strict=True):
        assert (row["kind"], row["i"], row["j"]) == (kind, i, j), (row, time)
        along = row["impulse"] / np.hypot(*row["impulse"])
        far = np.abs(row["place"] - (there - scene.radii[i] * along))
        far = np.where(scene.periodic, np.minimum(far % size, -far % size), far)  # on a border, either side
        total = row["impulse"] + row["tangential_impulse"]
        worst = max(worst, abs(row["time"] - time), np.abs(total - impulse).max(), far.max())
    here = state.present
    assert set(np.flatnonzero(~here)) == twin.gone
    away = (state.position - np.array(twin.x))[here]
    away -= size * np.round(away / size) * scene.periodic
    turned = np.zeros(1) if state.spin is None else state.spin[here] - np.array(twin.spin)[here]
    moved = state.velocity[here] - np.array(twin.v)[here]
    worst = max(worst, *(np.abs(each).max(initial=0.0) for each in (away, turned, moved)))
    assert worst < tolerance, f"differs by {worst}"
    return [row[1] for row in expected]


COUNT, SIDE = 9, 5.0
CORNERS = np.array([[0.8 + 1.6 * (k % 3), 0.8 + 1.6 * (k // 3)] for k in range(COUNT)]) + 0.1
VELOCITY = np.random.default_rng(3).normal(size=(COUNT, 2))
ROUGH = {"friction": 0.3, "wall_friction": 0.4, "tangential_restitution": 0.5, "spin": np.linspace(-1, 1, COUNT)}
LOSSY = {"mass": np.linspace(0.5, 3.0, COUNT), "radius": np.linspace(0.25, 0.5, COUNT), "restitution": 0.9,
         "wall_restitution": 0.8}  # fmt: skip
OBSTACLES = [
    mpsim.Polyline([(0.0, 0.0), (0.2, 1.6), (0.2, 3.2)]), mpsim.FixedDisc((1.6, 1.6), 0.2),
    mpsim.Polyline([(3.3, 3.3), (3.4, 3.1)], 0.1),
]  # fmt: skip
SCENES = {
    "walls": ({}, 0.0),
    "periodic": ({"boundary": "periodic"}, 0.0),
    "gravity": ({"gravity": (0.25, -0.5)}, 0.0),
    "masses, radii and losses": (LOSSY, 0.3),
    "obstacles": ({"obstacles": OBSTACLES, "boundary": ("walls", "periodic")}, 0.0),
    "obstacles under gravity": ({"obstacles": OBSTACLES, "gravity": (0.3, -1.0)}, 0.0),
    "piston": ({"piston": mpsim.Piston("left", speed=0.25, stop=0.4, start=0.0)}, 0.0),
    "piston under gravity": ({"piston": mpsim.Piston("bottom", 0.05, 0.3), "gravity": (0.3, -1.0), **ROUGH}, 0.0),
    "absorbing": ({"absorbing": ["right"], "gravity": (0.1, -1.0)}, 0.0),
    "rough": (ROUGH, 0.0),
    "rough with everything": ({**LOSSY, **ROUGH, "gravity": (0.2, -0.7), "boundary": ("periodic", "walls")}, 1e-3),
    "sticking obstacles": ({**LOSSY, **ROUGH, "friction": 1e9, "obstacles": OBSTACLES[1:]}, 1e-3),
}


@pytest.mark.parametrize("name", SCENES)
def test_every_collision_is_that_of_the_slow_twin(name):
    features, contact_time = SCENES[name]
    scene = mpsim.Scene(width=SIDE, height=SIDE, position=CORNERS, velocity=VELOCITY, **{"radius": 0.4, **features})
    twin = Twin(scene, contact_time)
    kinds = compare(scene, twin, 16 if name == "absorbing" else 40, contact_time, 1e-7)
    assert set(kinds) >= {"periodic": {0}, "obstacles": {0, 1, 2}}.get(name, {0, 1}), "the scene shows too little"
    assert twin.guards > 0 or contact_time < 0.01, "the contact time shows nothing"


@pytest.mark.parametrize("size", [2.2, 3.1])
def test_small_periodic_boxes_see_every_image(size):
    """Of some two diameters: a disc meets others from both sides, and itself nowhere."""
    at = np.array([[0.25, 0.25], [0.75, 0.25], [0.25, 0.75], [0.75, 0.75]]) * size
    scene = mpsim.Scene(width=size, height=size, position=at, velocity=VELOCITY[:4], radius=0.5, boundary="periodic")
    assert len(compare(scene, Twin(scene, 0.0, images=5), 30, 0.0, 1e-7)) > 10


# --- random scenes


def anywhere(seed, falls):
    """Up to four discs, two obstacles, a piston, an absorbing edge, all laws; or None where there is no room."""
    rng = np.random.default_rng([seed, falls])
    size = rng.uniform(3.0, 6.0, 2)
    radius = rng.uniform(0.1, 0.6, rng.integers(1, 5))
    periodic = [bool(rng.random() < 0.3), bool(rng.random() < 0.3)]
    obstacles = []
    for _ in range(rng.integers(1, 3)):
        a = rng.uniform(0.0, 1.0, 2) * size
        b = np.clip(a + rng.normal(size=2), 0.0, size)
        thin = rng.choice([0.05, 0.1, 0.5])
        obstacles.append(mpsim.FixedDisc(a, thin) if rng.random() < 0.4 else mpsim.Polyline([a, b], thin))
    walled = [edge for edge in range(4) if not periodic[edge // 2]]
    piston = None
    if walled and rng.random() < 0.6:
        edge = int(rng.choice(walled))
        speed, stop = float(rng.choice([0.1, 1.0, 5.0])), 0.2 * size[edge // 2]
        piston = mpsim.Piston(EDGES[edge], *((-speed, 4 * stop) if edge % 2 else (speed, stop)))
        walled.remove(edge)
    absorbing = [EDGES[int(rng.choice(walled))]] if walled and rng.random() < 0.3 else []
    count = len(radius)
    try:
        scene = mpsim.Scene.random(
            count=count, seed=seed, width=size[0], height=size[1], radius=radius, obstacles=obstacles, piston=piston,
            boundary=["periodic" if each else "walls" for each in periodic], mass=rng.uniform(0.5, 3.0, count),
            spin=rng.normal(size=count), gravity=tuple(rng.normal(size=2)) if falls else None, absorbing=absorbing,
            restitution=float(rng.choice([1.0, 0.9])), wall_restitution=float(rng.choice([1.0, 0.8])),
            friction=float(rng.choice([0.1, 0.3])), wall_friction=float(rng.choice([0.1, 0.4])),
            tangential_restitution=float(rng.choice([0.0, 0.5])),
        )  # fmt: skip
    except mpsim.InputError:
        return None
    return mpsim.Scene(**features_of(scene) | {"velocity": rng.normal(size=(count, 2))})


@pytest.mark.timeout(1800)
@pytest.mark.parametrize("seeds", [range(10), pytest.param(range(60, 85), marks=pytest.mark.long)])
@pytest.mark.parametrize("falls", [False, True])
def test_random_scenes_follow_the_slow_twin(falls, seeds):
    played, kinds = 0, []
    for seed in seeds:
        scene = anywhere(seed, falls)
        if scene is not None:
            found = compare(scene, Twin(scene, 1e-13), 12, 1e-13, 1e-6)
            played, kinds = played + (found is not None), kinds + (found or [])
    assert played > 0.5 * len(seeds)
    assert min(kinds.count(kind) for kind in (0, 1, 2)) > 0.2 * len(seeds), kinds


# --- what is logged, and what is measured


@pytest.mark.parametrize(("method", "contact"), [("event", "impact"), ("grid", "impact"), ("naive", "push")])
def test_collisions_add_up_to_what_is_measured(method, contact):
    """Frame by frame: the collision rate, the pressures on walls and the virial follow from the logged rows."""
    scene = mpsim.Scene.random(count=24, packing=0.3, radius=0.5, seed=4)
    seen, found, dt = mpsim.Collisions(), [], 0.05
    with simulate(scene, method=method, contact=contact, dt=dt) as sim:
        for _ in range(40):
            report = sim.run(frames=1, observe=seen, measures=["collision_rate", "pressure"])
            found.append(
                [report.collisions, report.measures["collision_rate"].value, report.measures["pressure"].value]
            )
    found, table = np.array(found), seen.table
    discs, walls = table[table["kind"] == 0], table[table["kind"] == 1]
    counts = np.bincount(discs["frame"], minlength=41)[1:]
    assert counts.tolist() == found[:, 0].tolist()
    assert counts.sum() > 20
    assert 2 * counts / scene.count / dt == pytest.approx(found[:, 1])
    pushed = np.bincount(walls["frame"], np.abs(walls["impulse"]).sum(axis=1), minlength=41)[1:]
    assert pushed / dt / (2 * (scene.width + scene.height)) == pytest.approx(found[:, 2], rel=1e-7, abs=1e-7)


@pytest.mark.parametrize(
    ("contact", "time", "method", "precision"),
    [("impact", 1.0, "grid", "float64"), ("impact", 1.0, "naive", "float32"), ("push", 1.2, "grid", "float32")],
)
def test_a_lone_contact_of_stepped_methods_is_logged_at_its_time(contact, time, method, precision):
    """Two discs meet between two steps: `impact` goes back to the instant, `push` knows the end of the step."""
    scene = scene_of([[3.0, 2.0], [6.0, 2.0]], [[1.0, 0.0], [-1.0, 0.0]], 10.0, 4.0)
    seen = mpsim.Collisions()
    how = {"contact": contact, "substeps": 2, "precision": precision, "dt": 0.8, "on_fast": "warn"}
    with simulate(scene, method=method, **how) as sim:
        sim.run(frames=8, observe=seen)
    first, second, third = seen.table[:3]
    assert (first["frame"], first["kind"], first["i"], first["j"]) == (2, 0, 0, 1)
    assert first["time"] == pytest.approx(time, abs=1e-6)
    assert first["impulse"].tolist() == pytest.approx([-2.0, 0.0])
    assert first["place"].tolist() == pytest.approx([4.5, 2.0], abs=1e-6)
    assert {(second["kind"], second["j"]), (third["kind"], third["j"])} == {(1, 0), (1, 1)}
    if contact == "impact":
        times = {row["j"]: row["time"] for row in (second, third)}
        assert times == pytest.approx({0: 4.5, 1: 5.5}, abs=1e-5)  # 3.5 and 4.5 further, at speed 1
    assert {second["place"][0], third["place"][0]} == {0.0, 10.0}
