"""Logged collisions against the slow twin, one by one, and against what measures count."""

import numpy as np
import pytest
from support.event_twin import Twin
from support.internals import solver_of
from support.scenes import simulate
from support.selection import long_but

import mpsim

pytestmark = pytest.mark.slow

COUNT, SIDE = 9, 5.0
CORNERS = np.array([[0.8 + 1.6 * (k % 3), 0.8 + 1.6 * (k // 3)] for k in range(COUNT)])
VELOCITY = np.random.default_rng(3).normal(size=(COUNT, 2))
SCENES = {
    "walls": {},
    "periodic": {"boundary": "periodic"},
    "gravity": {"gravity": (0.25, -0.5)},
    "masses, radii and losses": {
        "mass": np.linspace(0.5, 3.0, COUNT), "radius": np.linspace(0.25, 0.5, COUNT), "restitution": 0.9,
        "wall_restitution": 0.8,
    },
    "obstacles": {
        "obstacles": [mpsim.Polyline([(0.0, 0.0), (0.2, 1.6), (0.2, 3.2)]), mpsim.FixedDisc((1.6, 1.6), 0.2)],
        "boundary": ("walls", "periodic"),
    },
    "piston": {"piston": mpsim.Piston("left", speed=0.25, stop=0.4, start=0.0)},
    "absorbing": {"absorbing": ["right"]},
}  # fmt: skip


def scene_of(name):
    position = CORNERS + 0.1
    return mpsim.Scene(width=SIDE, height=SIDE, position=position, velocity=VELOCITY, **{"radius": 0.4, **SCENES[name]})


def twin_of(scene):
    radius = np.broadcast_to(scene.radius, COUNT)
    moving, gravity = scene.moving_wall, (0.0, 0.0) if scene.gravity is None else scene.gravity
    return Twin(
        scene.position, scene.velocity, radius, SIDE, SIDE, mass=scene.mass, gravity=gravity,
        restitution=scene.restitution, wall_restitution=scene.wall_restitution, periodic=scene.periodic,
        capsules=scene.capsules, moving_wall=moving and (moving.edge, moving.start, moving.stop, moving.speed),
        absorbing=[("left", "right", "bottom", "top").index(edge) for edge in scene.absorbing],
    )  # fmt: skip


def owner(scene, capsule):
    """Index of the obstacle of which a capsule, shifted by periods perhaps, is a part."""
    for index, each in enumerate(scene.obstacles):
        for own in each.capsules():
            shift = (np.array(capsule[:4]) - own[:4]) / SIDE
            if np.allclose(shift, np.round(shift)) and np.isclose(capsule[4], own[4]):
                return index
    raise AssertionError(capsule)


def collisions_of_twin(scene, number):
    """The first collisions: (time, kind, i, j, impulse on i, place)."""
    twin, found = twin_of(scene), []
    while len(found) < number:
        event = twin.next_event()
        t, kind, i, j, _ = event
        before = np.array(twin.v[i]) + t * np.array(twin.gravity)
        twin.step(event)
        if i in twin.gone:
            continue
        impulse = twin.mass[i] * (np.array(twin.v[i]) - before)
        place = np.array(twin.x[i]) - twin.radius[i] * impulse / np.hypot(*impulse)
        place = np.where(scene.periodic, place % SIDE, place)
        if kind == "pair":
            other = 0, j
        elif kind == "capsule":
            other = 2, owner(scene, j)
        else:
            other = 1, scene.moving_wall.edge if kind == "moving wall" else 2 * j[0] + j[1]
        found.append((twin.time, other[0], i, other[1], impulse, place))
    return found


def collisions_of(scene, method="event", frames=120, dt=0.1, **settings):
    seen = mpsim.Collisions()
    with simulate(scene, method=method, dt=dt, **settings) as sim:
        sim.run(frames=frames, observe=seen)
    return seen.table


def worst_difference(table, expected):
    worst = 0.0
    for row, (time, kind, i, j, impulse, place) in zip(table, expected, strict=True):
        assert (row["kind"], row["i"], row["j"]) == (kind, i, j), (row, time)
        far = np.abs(row["place"] - place)
        far = np.minimum(far, np.abs(far - SIDE))  # on a periodic border, either side
        worst = max(worst, abs(row["time"] - time), np.abs(row["impulse"] - impulse).max(), far.max())
    return worst


@pytest.mark.parametrize("name", long_but(SCENES, "walls"))
def test_every_collision_is_that_of_the_slow_twin(name):
    scene, number = scene_of(name), 12 if name == "absorbing" else 50
    expected, table = collisions_of_twin(scene, number), collisions_of(scene)
    assert len(table) >= number
    assert worst_difference(table[:number], expected) < 1e-6
    kinds = set(table["kind"].tolist())
    assert kinds >= {"periodic": {0}, "obstacles": {0, 1, 2}}.get(name, {0, 1}), "the scene shows too little"


def test_the_twin_can_tell():
    scene = scene_of("walls")
    expected = collisions_of_twin(scene, 20)
    other = mpsim.Scene(width=SIDE, height=SIDE, position=scene.position, velocity=scene.velocity, radius=0.4001)
    with pytest.raises(AssertionError):
        assert worst_difference(collisions_of(other)[:20], expected) < 1e-6


def counted(sim, frames):
    """What measures count of each frame, and the collisions that are logged meanwhile."""
    solver, tallies, tables = solver_of(sim), [], []
    solver.tallied = True
    solver.log_collisions(True)
    while frames:
        tallies.append(solver.advance(frames, solver.choice.workers[0]).tally)
        tables.append(solver.take_collisions())
        frames -= len(tallies[-1])
    return np.concatenate(tallies), np.concatenate(tables)


@pytest.mark.parametrize("method", long_but(["event", "grid", "naive"], "event", "grid"))
@pytest.mark.parametrize("contact", ["impact", "push"])
@pytest.mark.parametrize("features", long_but(["none", "masses and gravity"], "none"))
def test_collisions_add_up_to_what_is_measured(method, contact, features):
    mass = np.where(np.arange(200) % 2, 1.0, 3.0)
    given = {} if features == "none" else {"mass": mass, "gravity": (0.0, -0.25)}
    scene = mpsim.Scene.random(count=200, packing=0.3, radius=0.5, seed=4, **given)
    with simulate(scene, method=method, contact=contact, dt=0.02) as sim:
        tally, table = counted(sim, 100)
    discs, walls = table[table["kind"] == 0], table[table["kind"] == 1]
    assert len(discs) == tally["collisions"].sum() > 200
    by_frame = np.bincount(discs["frame"], minlength=101)[1:]
    assert by_frame.tolist() == tally["collisions"].tolist()
    for edge in range(4):
        size = np.abs(walls["impulse"][walls["j"] == edge]).sum(axis=1)
        expected = np.bincount(walls["frame"][walls["j"] == edge], size, minlength=101)[1:]
        assert expected == pytest.approx(tally["wall"][:, edge], rel=1e-7, abs=1e-7)
        assert size.sum() > 0
    expected = np.bincount(discs["frame"], np.hypot(*discs["impulse"].T), minlength=101)[1:]
    assert expected == pytest.approx(tally["virial"], rel=1e-7, abs=1e-7)


@pytest.mark.parametrize("precision", long_but(["float64", "float32"], "float64"))
def test_a_lone_contact_of_stepped_methods_is_exact(precision):
    """Two discs meet between two steps: `impact` goes back to the instant, `push` knows the end of the step."""
    scene = mpsim.Scene(
        width=10.0, height=4.0, position=[[3.0, 2.0], [6.0, 2.0]], velocity=[[1.0, 0.0], [-1.0, 0.0]], radius=0.5
    )
    for contact, time in (("impact", 1.0), ("push", 1.2)):
        for method in ("grid", "naive"):
            seen = mpsim.Collisions()
            settings = {"contact": contact, "substeps": 2, "precision": precision, "dt": 0.8}
            with simulate(scene, method=method, on_fast="warn", **settings) as sim:
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


@pytest.mark.long
def test_stepped_collisions_come_to_those_of_the_exact_solver():
    scene = scene_of("obstacles")
    exact = collisions_of(scene, frames=20)
    stepped = collisions_of(scene, "grid", frames=20_000, dt=0.0001)
    number = 12
    for name in ("kind", "i", "j"):
        assert stepped[name][:number].tolist() == exact[name][:number].tolist()
    assert 2 in exact["kind"][:number]
    for name in ("time", "impulse", "place"):
        assert stepped[name][:number] == pytest.approx(exact[name][:number], abs=2e-2)
