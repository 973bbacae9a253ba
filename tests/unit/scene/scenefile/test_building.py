"""From a scene file to a scene: it says the same as Python."""

import numpy as np
import pytest
from support.compare import overlapping_pairs
from support.scenefiles import HEAD

import mpsim
from mpsim.scene.scenefile import schema

ONE = "[[discs]]\nposition = [[2.0, 3.0]]\nradius = 0.5\n"


def test_a_file_says_the_same_as_python(load, tmp_path):
    np.save(tmp_path / "mass.npy", np.array([1.0, 2.5]))
    (tmp_path / "speeds.csv").write_text("vx, vy\n1, 0\n\n-0.5, 1e-3\n")
    file = load("""
        schema = 1
        width = 20
        height = 10.0
        boundary = ["periodic", "walls"]
        gravity = [0, -1]
        restitution = 0.9
        wall_restitution = 0.8
        absorbing = ["bottom"]
        duration = 12.5
        obstacles = [{ position = [5, 5], radius = 1 }, { points = [[1, 1], [2, 1], [2, 3]], thickness = 0.1 }]
        [about]
        title = "A test"
        look_for = "Nothing."
        [settings]
        dt = 0.5
        passes = 2
        [[discs]]
        position = [[1, 2], [9, 3]]
        velocity = "speeds.csv"
        radius = [0.5, 0.25]
        mass = "mass.npy"
        acceleration = [1, 0]
        [[emitters]]
        position = [10, 5]
        velocity = [1, 1]
        every = 7
        limit = 3
        radius = 0.2
        mass = 2
        [piston]
        wall = "top"
        speed = -1
        stop = 6
    """)
    same = mpsim.Scene(
        width=20,
        height=10,
        boundary=("periodic", "walls"),
        gravity=(0, -1),
        restitution=0.9,
        wall_restitution=0.8,
        absorbing="bottom",
        position=[[1, 2], [9, 3]],
        velocity=[[1, 0], [-0.5, 1e-3]],
        radius=[0.5, 0.25],
        mass=[1, 2.5],
        acceleration=[[1, 0], [1, 0]],
        obstacles=[mpsim.FixedDisc((5, 5), 1), mpsim.Polyline([(1, 1), (2, 1), (2, 3)], 0.1)],
        emitters=mpsim.Emitter((10, 5), (1, 1), every=7, limit=3, radius=0.2, mass=2),
        piston=mpsim.Piston("top", -1, 6),
    )
    assert file.scene.digest() == same.digest()
    assert file.scene.duration == 12.5
    assert file.settings == mpsim.Settings(dt=0.5, passes=2)
    assert (file.name, file.title, file.text, file.look_for) == ("scene", "A test", "", "Nothing.")
    assert [path.name for path in file.read] == ["scene.toml", "mass.npy", "speeds.csv"]


def test_random_places_are_those_of_python(load):
    text = 'schema = 1\n{}[[discs]]\nplaces = "random"\ncount = 50\nradius = 0.5\ntemperature = 2.0\nseed = 3\n'
    same = mpsim.Scene.random(count=50, packing=0.3, radius=0.5, temperature=2.0, seed=3)
    assert load(text.format("packing = 0.3\n")).scene.digest() == same.digest()
    same = mpsim.Scene.random(count=50, width=10, height=20, radius=0.5, temperature=2.0, seed=3)
    assert load(text.format("width = 10\nheight = 20\n")).scene.digest() == same.digest()


def test_random_places_in_a_periodic_box_among_obstacles_are_those_of_python(load):
    radii = [0.5] * 20 + [0.25] * 30
    text = f"""
        {HEAD}
        boundary = ["periodic", "walls"]
        obstacles = [{{ position = [5, 4], radius = 1.0 }}]
        [[discs]]
        places = "random"
        count = 50
        radius = {radii}
        mass = 2.0
        temperature = 1.5
        seed = 9
    """
    same = mpsim.Scene.random(
        count=50,
        width=10,
        height=8,
        radius=radii,
        mass=2.0,
        temperature=1.5,
        seed=9,
        boundary=("periodic", "walls"),
        obstacles=mpsim.FixedDisc((5, 4), 1.0),
    )
    assert load(text).scene.digest() == same.digest()


def test_random_places_in_a_region_lie_in_it(load):
    group = '[[discs]]\nplaces = "random"\ncount = 12\nradius = {}\nregion = [2, 3, 5, 6]\n'
    for radius in (0.25, [0.125, 0.25] * 6):
        for others in ("", ONE):
            scene = load(HEAD + group.format(radius) + others.replace("2.0, 3.0", "9.0, 7.0")).scene
            places = scene.position[:12]
            assert (places >= [2, 3]).all()
            assert (places <= [5, 6]).all()


def test_groups_at_random_places_keep_clear_of_each_other_and_of_obstacles(load):
    scene = load(
        HEAD
        + """
        obstacles = [{ position = [5, 4], radius = 1.5 }, { points = [[1, 1], [3, 1]], thickness = 0.2 }]
        [[discs]]
        position = [[2.0, 5.0]]
        radius = 1.0
        [[discs]]
        places = "random"
        count = 60
        radius = 0.25
        temperature = 1.0
        """
    ).scene
    from mpsim.features.capsules import distance  # noqa: PLC0415

    assert scene.count == 61
    assert not len(overlapping_pairs(scene.position[1:], 0.5)[0])
    assert np.hypot(*(scene.position[1:] - scene.position[0]).T).min() >= 1.25
    assert distance(scene.position[:, None], scene.capsules)[1:].min() >= 0.25
    assert scene.velocity[0].tolist() == [0, 0]


@pytest.mark.parametrize(("kind", "count"), [("square", 12), ("hexagonal", 30)])
def test_a_lattice_fills_the_box(load, kind, count):
    scene = load(HEAD + f'[[discs]]\nplaces = "{kind}"\ncount = {count}\nradius = 0.4\n').scene
    gaps = np.hypot(*np.moveaxis(scene.position[:, None] - scene.position, 2, 0))[~np.eye(count, dtype=bool)]
    nearest = float(gaps.min())
    assert nearest >= 0.8
    assert scene.count == count
    with_spacing = load(HEAD + f'[[discs]]\nplaces = "{kind}"\nspacing = {nearest!r}\nradius = 0.4\n').scene
    assert with_spacing.count >= count
    assert (with_spacing.position.min(axis=0) == 0.4).all()


def test_a_lattice_of_pegs(load):
    pegs = 'obstacles = [{ places = "square", spacing = 2.0, region = [1, 1, 5, 3], radius = 0.5 }]\n'
    scene = load(HEAD + pegs + ONE.replace("2.0, 3.0", "8.0, 3.0")).scene
    assert [peg.position for peg in scene.obstacles] == [(x, y) for y in (1, 3) for x in (1, 3, 5)]


def test_thermal_velocities_have_the_temperature_and_no_momentum_whatever_the_masses(load):
    masses = ", ".join(str(1 + index % 3) for index in range(30))
    scene = load(
        HEAD + f'[[discs]]\nplaces = "square"\ncount = 30\nradius = 0.1\nmass = [{masses}]\ntemperature = 1.5\n'
    ).scene
    assert (scene.masses[:, None] * scene.velocity**2).mean() == pytest.approx(1.5, rel=1e-12)
    assert np.abs((scene.masses[:, None] * scene.velocity).sum(axis=0)).max() < 1e-12


def test_groups_are_joined(load):
    groups = [ONE, ONE.replace("2.0, 3.0", "6.0, 3.0")]
    scene = load(HEAD + groups[0] + groups[1]).scene
    assert (scene.count, scene.radius, scene.mass, scene.acceleration) == (2, 0.5, None, None)
    scene = load(HEAD + groups[0] + groups[1] + "mass = 2\nacceleration = [1, 2]\n").scene
    assert (scene.masses.tolist(), scene.acceleration.tolist()) == ([1, 2], [[0, 0], [1, 2]])
    scene = load(HEAD + groups[0] + groups[1].replace("0.5", "0.25")).scene
    assert scene.radii.tolist() == [0.5, 0.25]


def test_a_scene_may_begin_without_discs(load):
    assert load(HEAD).scene.count == 0
    emitter = "[[emitters]]\nposition = [5, 5]\nvelocity = [1, 0]\ninterval = 0.5\n"
    assert load(HEAD + "[[discs]]\nposition = []\nradius = 0.5\n" + emitter).scene.largest_radius == 0.5
    assert load(HEAD + emitter + "radius = 0.25\nmass = 1\n").scene.largest_radius == 0.25


def test_the_settings_of_a_file_are_those_of_python():
    assert schema.keys_of(schema.SettingsTable) == list(mpsim.Settings.__dataclass_fields__)


def test_parts_that_do_not_fit_the_box_are_told_at_once(problems):
    found = problems(
        HEAD
        + """
        boundary = ["periodic", "walls"]
        absorbing = ["left"]
        obstacles = [{ position = [1, 1], radius = 0.1 }, { position = [11, 1], radius = 0.1 }]
        [[discs]]
        position = [[1.0, 3.0]]
        radius = 0.5
        [[discs]]
        position = [[4.0, 3.0], [9.9, 9.0]]
        radius = 0.5
        [[emitters]]
        position = [3, 0]
        velocity = [0, 0]
        interval = 1
        [piston]
        wall = "top"
        speed = -1
        stop = 9
        """
    )
    assert [text.split(" must ")[0] for text in found] == [
        "discs[1].position[1]",
        "obstacles[1]",
        "emitters[0]: the position of emitters[0]",
        "absorbing",
        "piston.stop",
    ]
