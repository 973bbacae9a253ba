"""Every kind of obstacle goes through every door, seventy at once; one that a door does not know is refused by name."""

import dataclasses
import re

import numpy as np
import pytest
from support.twins import Twin

import mpsim
from mpsim.features.obstacles import OBSTACLES, Obstacle
from mpsim.viewer import export

pytestmark = [pytest.mark.plain, pytest.mark.filterwarnings("ignore")]


@dataclasses.dataclass(frozen=True, repr=False)
class Probe(Obstacle):
    """A kind that only its feature knows."""

    position: tuple
    radius: float

    def __post_init__(self):
        super().__post_init__()
        object.__setattr__(self, "position", tuple(self.position))

    def capsules(self):
        return [(*self.position, *self.position, self.radius)]


HERE = [(2.0 * (k % 10) + 0.5, 2.0 * (k // 10) + 0.5) for k in range(70)]
EXAMPLES = {
    mpsim.FixedDisc: [mpsim.FixedDisc(place, 0.25) for place in HERE],
    mpsim.Polyline: [mpsim.Polyline([(x, y), (x + 0.5, y + 0.25)], 0.25 * (x > 9)) for x, y in HERE],
    mpsim.Circle: [*(mpsim.Circle(place, 0.25) for place in HERE), mpsim.Circle((10, 7), 10.5, inside=True)],
}
HOW = {"method": "grid", "dt": 1 / 32, "workers": 1}


def scene_of(obstacles):
    return mpsim.Scene(width=20, height=15, radius=0.25, position=[[1.5, 1.5], [7.5, 3.25]],
                       velocity=[[-1.5, -1.25], [0.25, 1]], obstacles=obstacles)  # fmt: skip


def run_resumed_and_kept(scene, folder, **settings):
    """The last state, which a checkpoint and a replayed session have, too."""
    with mpsim.Simulation(scene, mpsim.Settings(**settings)) as sim:
        sim.run(frames=20)
        with mpsim.Simulation.resume(sim.save(folder / "run.mpsim")) as resumed:
            assert (resumed.scene.obstacles, resumed.digest()) == (scene.obstacles, sim.digest())
        sim.journal.save(folder / "session.toml")
        with mpsim.Simulation.replay(folder / "session.toml") as again:
            assert again.digest() == sim.digest()
        return sim.state


def test_every_kind_goes_through_every_door(tmp_path):
    assert {*EXAMPLES} == {*OBSTACLES.kinds}, "a kind of obstacle without an example here"
    for kind, obstacles in EXAMPLES.items():
        scene = scene_of(obstacles)
        scene.save(tmp_path / f"{kind.__name__}.toml")
        again = mpsim.Scene.load(tmp_path / f"{kind.__name__}.toml")
        assert again.obstacles == scene.obstacles
        assert {type(each) for each in again.obstacles} == {kind}
        assert mpsim.draw(scene).axes
        twin = Twin(scene, method="grid", contact="impact", dt=1 / 32)
        twin.run(20)
        for method in ("grid", "event"):
            last = run_resumed_and_kept(again, tmp_path, **HOW | {"method": method})
            assert (last.velocity != scene.velocity).any(), "nothing has met an obstacle"
            assert np.abs(twin.state.position - last.position).max() < 0.1


def test_a_kind_that_only_its_feature_knows_is_kept_or_refused_by_name(tmp_path, monkeypatch):
    with monkeypatch.context() as declared:
        declared.setattr(OBSTACLES, "kinds", (*OBSTACLES.kinds, Probe))  # as a new kind would be
        declared.setattr(mpsim, "Probe", Probe, raising=False)
        scene = scene_of([Probe(place, 0.25) for place in HERE])
        scene.save(tmp_path / "probes.toml")
        assert mpsim.Scene.load(tmp_path / "probes.toml").obstacles == scene.obstacles
        assert mpsim.draw(scene).axes
        last = run_resumed_and_kept(scene, tmp_path, **HOW)
        checkpoint, session = tmp_path / "run.mpsim", tmp_path / "session.toml"
        with mpsim.Simulation(scene_of([]), mpsim.Settings(**HOW)) as sim:
            sim.change(obstacles=EXAMPLES[mpsim.FixedDisc][1:])
            sim.remove_wall(sim.add_wall(Probe(HERE[0], 0.25)))
            sim.add_wall(mpsim.FixedDisc(HERE[0], 0.25))
            sim.run(frames=20)
            assert sim.digest() == last.digest()
            sim.save(checkpoint), sim.journal.save(session)
            program = export.program(sim, "").content.decode()
        exec(program, {})
        for again in (mpsim.Simulation.resume(checkpoint), mpsim.Simulation.replay(session)):
            with again:
                assert [type(each).__name__ for each in again.scene.obstacles[-2:]] == ["Removed", "FixedDisc"]
                assert [type(each.values.get("wall")) for each in again.journal][1] is Probe
    for again, text in (
        (
            lambda: mpsim.Scene.load(tmp_path / "probes.toml"),
            "kind must be FixedDisc or Polyline or Circle; got 'Probe'",
        ),
        (lambda: mpsim.Simulation.resume(checkpoint), "it has a 'Probe'"),
        (lambda: mpsim.Simulation.replay(session), "it has a 'Probe'"),
        (lambda: exec(program, {}), "module 'mpsim' has no attribute 'Probe'"),
    ):
        with pytest.raises((mpsim.InputError, mpsim.errors.CheckpointError, AttributeError), match=text):
            again()
    with mpsim.Simulation(scene_of([]), mpsim.Settings(**HOW)) as sim:
        for wall in (Probe(HERE[0], 0.25), *scene.obstacles[:1]):
            with pytest.raises(mpsim.InputError, match=r"obstacles\[0\] must be an mpsim\.FixedDisc or .*; got Probe"):
                sim.add_wall(wall)

    class Peg(mpsim.FixedDisc):
        pass

    with pytest.raises(mpsim.InputError, match=r"obstacles of a scene file must each be a FixedDisc or .*; got a Peg"):
        scene_of([Peg(HERE[0], 0.25)]).save(tmp_path / "peg.toml")
    with pytest.raises(AssertionError, match="the twin does not know a Probe"):
        Twin(scene, method="grid")


MOTIONS = [
    mpsim.Translation((0, 0.125), stop=0.25), mpsim.Translation((0.125, 0), stop=0.25, start=1 / 3),
    mpsim.Oscillation((0.125, 0), period=1 / 3, phase=0.1), mpsim.Rotation((10, 7), rate=0.3, stop=0.1),
    mpsim.Path(times=[0, 1, 2], displacements=[(0, 0), (0.1, 0), (0, 0)]),
]  # fmt: skip


def test_motions_and_belts_are_in_scene_files(tmp_path):
    lines = EXAMPLES[mpsim.Polyline][20:22]
    moving = [dataclasses.replace(each, motion=motion) for motion in MOTIONS for each in lines]
    alike = [dataclasses.replace(each, motion=MOTIONS[0], surface_velocity=0.5) for each in EXAMPLES[mpsim.FixedDisc]]
    scene = mpsim.Scene(width=20, height=15, radius=0.25, position=[], velocity=[], obstacles=[*moving, *alike],
                        wall_friction=0.5)  # fmt: skip
    scene.save(tmp_path / "scene.toml")
    again = mpsim.Scene.load(tmp_path / "scene.toml")
    assert (again.obstacles, again.digest()) == (scene.obstacles, scene.digest())
    text = (tmp_path / "scene.toml").read_text()
    assert text.count("[[obstacles]]") == len(moving) + 1, "those with one motion are one table of arrays"
    (tmp_path / "scene.toml").write_text(text.replace("amplitude", "amplitud"))
    with pytest.raises(mpsim.errors.SceneFileError, match=re.escape("motion.amplitud must be a key of a scene file")):
        mpsim.Scene.load(tmp_path / "scene.toml")


def test_what_is_no_obstacle_is_refused_by_the_kinds_that_are():
    with pytest.raises(mpsim.InputError, match=re.escape("obstacles[0] must be an mpsim.FixedDisc or mpsim.Polyline")):
        mpsim.Scene(width=2, height=2, radius=0.5, position=[[1, 1]], velocity=[[0, 0]], obstacles=[None])


@pytest.mark.parametrize(
    ("table", "words"),
    [
        (
            "position = [1, 1]\nradius = 0.5\nspacing = 1.0",
            "spacing goes with places, but these have positions. Leave it out.",
        ),
        (
            "points = [[1, 1], [2, 2]]\nradius = 0.5",
            "this one is unknown, with the value 0.5. Keys there: points, thickness",
        ),
    ],
)
def test_a_key_of_another_kind_of_obstacle_is_not_answered_with_itself(tmp_path, table, words):
    path = tmp_path / "scene.toml"
    path.write_text(f"schema = 1\nwidth = 9\nheight = 9\n\n[[obstacles]]\n{table}\n")
    with pytest.raises(mpsim.InputError, match=re.escape(words)):
        mpsim.Scene.load(path)


# --- images across periodic borders

LONG = {
    "a line across the box": [mpsim.Polyline([(10, 0), (10, 20)])],
    "an oblique line": [mpsim.Polyline([(2, 1), (18, 19)], thickness=0.4)],
    "a line along both borders": [mpsim.Polyline([(0, 0), (0, 20), (20, 20)], thickness=0.3)],
    "a thick disc in the corner": [mpsim.FixedDisc((19.5, 0.5), 6.0)],
    "a line of more than half": [mpsim.Polyline([(3, 4), (3, 19.5)], thickness=1.0), mpsim.FixedDisc((0.0, 10.0), 2.0)],
}
BOUNDARIES = [("walls", "periodic"), ("periodic", "walls"), "periodic"]


def is_clear(scene):
    """Whether no disc is in another, in an obstacle, or in an image of one."""
    return scene.overlaps_at_start() == "" and scene._deepest(scene.position, scene.radii - 1e-12) is None


@pytest.mark.parametrize(("name", "boundary"), list(zip(LONG, [*BOUNDARIES, *BOUNDARIES[1:]], strict=True)), ids=str)
@pytest.mark.parametrize("count", [60, 190])  # one after the other at random, and from a lattice
def test_random_discs_keep_clear_of_all_images(name, boundary, count):
    count = count // 2 if "thick" in name else count
    box = {"width": 20, "height": 20, "boundary": boundary, "obstacles": LONG[name]}
    assert is_clear(mpsim.Scene.random(count=count, radius=0.5, seed=1, **box))


@pytest.mark.parametrize("boundary", BOUNDARIES, ids=str)
def test_discs_of_a_region_keep_clear_of_images_and_of_each_other(boundary, tmp_path):
    """A region that reaches to a border: what is beyond it counts, and the other side of the region itself."""
    group = '[[discs]]\nplaces = "random"\ncount = 60\nradius = 0.5\nregion = {}\nseed = {}\n'
    wraps = [each == "periodic" for each in ([boundary] * 2 if isinstance(boundary, str) else boundary)]
    region = [0.5 * (not wrap) for wrap in wraps] + [20 - 0.5 * (not wrap) for wrap in wraps]
    words = f'"{boundary}"' if isinstance(boundary, str) else str(list(boundary)).replace("'", '"')
    text = f"schema = 1\nwidth = 20.0\nheight = 20.0\nboundary = {words}\n"
    text += "".join(group.format(region, seed) for seed in (1, 2))
    text += "[[obstacles]]\nposition = [10.0, 0.0]\nradius = 2.0\n[[obstacles]]\nposition = [0, 10]\nradius = 2.0\n"
    (tmp_path / "a.toml").write_text(text)
    assert is_clear(mpsim.Scene.load(tmp_path / "a.toml"))


@pytest.mark.parametrize("boundary", ["periodic", ("walls", "periodic")], ids=str)
def test_a_disc_that_is_added_in_an_image_is_refused(boundary):
    scene = mpsim.Scene(width=20, height=20, position=[[5, 5]], velocity=[[0, 0]], radius=0.5, boundary=boundary,
                        obstacles=[mpsim.Polyline([(10, 2), (10, 20)])])  # fmt: skip
    with mpsim.Simulation(scene, mpsim.Settings(method="naive")) as sim:
        for place in ((10.2, 0.3), (10.2, 19.0), (9.8, 10.0)):
            with pytest.raises(mpsim.InputError, match="must be one radius from every obstacle"):
                sim.add(place, (0, 0))
        sim.add((10.2, 1.0), (0, 0))
    with pytest.raises(mpsim.InputError, match="one radius from every obstacle"):
        mpsim.Scene(width=20, height=20, position=[[5, 5]], velocity=[[0, 0]], radius=0.5, boundary=boundary,
                    obstacles=scene.obstacles, emitters=[mpsim.Emitter((10.2, 0.3), (0, 1), interval=1.0)])  # fmt: skip


# --- parts of the box for discs

TRIANGLE = [(4, 2), (10, 3), (6, 8), (4, 2)]


def in_triangle(position):
    corners = np.array(TRIANGLE)
    along, r = corners[1:] - corners[:-1], position[:, None] - corners[:-1]
    return (along[:, 0] * r[..., 1] - along[:, 1] * r[..., 0] > 0).all(axis=1)


@pytest.mark.parametrize("count", [30, 130])  # one after the other at random, and by overlap removal
@pytest.mark.parametrize("boundary", ["walls", "periodic"])
def test_random_discs_are_outside_a_filled_polygon_or_inside_a_shape(count, boundary):
    box = {"width": 12, "height": 10, "radius": 0.25, "seed": 1, "boundary": boundary}
    filled, hollow = (mpsim.Polyline(TRIANGLE, 0.2, filled=filled) for filled in (True, False))
    outside = mpsim.Scene.random(count=count, obstacles=filled, **box)
    assert not in_triangle(outside.position).any()
    assert count == 30 or in_triangle(mpsim.Scene.random(count=count, obstacles=hollow, **box).position).any()
    inside = mpsim.Scene.random(count=count // 4, inside=hollow, obstacles=hollow, **box)
    assert in_triangle(inside.position).all()
    assert in_triangle(inside.redrawn(1).position).all()
    circle = mpsim.Scene.random(count=count // 2, inside=mpsim.Circle((8, 5), 2.8), **box)
    assert np.hypot(*(circle.position - (8, 5)).T).max() <= 2.55
    ring = mpsim.Scene.random(count=count // 2, obstacles=mpsim.Circle((7, 5), 4, inside=True), **box)
    assert np.hypot(*(ring.position - (7, 5)).T).max() <= 3.75
    region = mpsim.Scene.random(count=count // 5, inside=(1, 1, 4, 5), **box)
    assert ((region.position >= 1) & (region.position <= (4, 5))).all()
    assert [each.overlaps_at_start() for each in (outside, inside, circle, ring, region)] == [""] * 5


@pytest.mark.parametrize("features", [{}, {"inside": mpsim.Circle((8, 5), 4)}, {"boundary": ("walls", "periodic")}])
def test_placed_discs_are_between_pistons_as_they_start(features):
    walls = [mpsim.Piston("left", 0.5, 6, start=5), mpsim.Piston("right", motion=mpsim.Oscillation((1, 0), 2), start=9)]
    box, inside = {"width": 12, "height": 10, "piston": walls, **features}, features.get("inside")
    made = [mpsim.Scene.random(count=20, radius=[0.2, 0.4] * 10, **box)]
    box.pop("inside", None)
    groups = [{"places": "random", "count": 12, "radius": 0.2, **({} if inside is None else {"region": inside})}]
    groups += [{"places": "square", "count": 12, "radius": 0.4, "spacing": 0.8}] * (inside is None)
    made.append(mpsim.Scene.groups(groups[::-1], **box))
    for scene in made:
        x, radius = scene.position[:, 0], scene.radius
        assert ((x >= 5 + radius) & (x <= 9 - radius)).all()
        assert scene.overlaps_at_start() == ""


def test_no_disc_starts_or_is_added_in_a_filled_polygon_also_after_it_has_moved():
    box = {"width": 12, "height": 10, "radius": 0.25, "velocity": [(0, 0)]}
    filled = mpsim.Polyline(TRIANGLE, filled=True, motion=mpsim.Translation((0.5, 0), stop=1))
    with pytest.raises(mpsim.InputError, match=re.escape("position[0] must lie outside obstacles[0], a Polyline")):
        mpsim.Scene(position=[(6, 4)], obstacles=filled, **box)
    with mpsim.Simulation(mpsim.Scene(position=[(1, 9)], obstacles=filled, **box), mpsim.Settings(dt=1 / 8)) as sim:
        for frames, place in ((0, (4.8, 3)), (24, (10, 3.7))):
            sim.run(frames=frames)
            with pytest.raises(mpsim.InputError, match="must be one radius from every obstacle"):
                sim.add(place, (0, 0))
        sim.add((4.8, 3), (0, 0))
    with pytest.raises(mpsim.InputError, match="filled must end with the first one"):
        mpsim.Polyline(TRIANGLE[:3], filled=True)
    with pytest.raises(mpsim.InputError, match=re.escape("inside must be numbers of shape (4,)")):
        mpsim.Scene.random(count=1, width=9, height=9, radius=0.1, inside=mpsim.Polyline(TRIANGLE[:3]))
    rule = "the shape around discs must reach into the box of 9 x 9; got Circle(centre=(20.0, 4.0), radius=1.0)."
    with pytest.raises(mpsim.InputError, match=re.escape(rule)):
        mpsim.Scene.random(count=1, width=9, height=9, radius=0.1, inside=mpsim.Circle((20, 4), 1))


def test_groups_are_those_of_a_scene_file(tmp_path):
    text = """schema = 1\nwidth = 9\nheight = 6\ngravity = [0, -1]
[[obstacles]]\ncentre = [6, 3]\nradius = 0.3
[[discs]]\nposition = [[2, 3]]\nradius = 1.5\nmass = 20
[[discs]]\nplaces = "random"\ncount = 20\nradius = 0.2\nregion = [4, 1, 8, 5]\ntemperature = 1.0\nseed = 3\n"""
    (tmp_path / "groups.toml").write_text(text)
    groups = [
        {"position": np.array([[2, 3]]), "radius": 1.5, "mass": 20},
        {"places": "random", "count": 20, "radius": 0.2, "region": (4, 1, 8, 5), "temperature": 1.0, "seed": 3},
    ]
    made = mpsim.Scene.groups(groups, width=9, height=6, gravity=(0, -1), obstacles=mpsim.Circle((6, 3), 0.3))
    file = mpsim.Scene.load(tmp_path / "groups.toml")
    assert made.digest() == file.digest()
    assert made.redrawn(1).digest() == file.redrawn(1).digest() != made.digest()
    groups[1]["region"] = mpsim.Circle((6, 3), 2)
    assert np.hypot(*(mpsim.Scene.groups(groups, width=9, height=6).position[1:] - (6, 3)).T).max() <= 1.8
    groups[0]["radios"], groups[1]["count"] = 1, -1
    with pytest.raises(mpsim.errors.SceneFileError, match=r"discs\[0\].radios.*\n.*discs\[1\].count must be a whole"):
        mpsim.Scene.groups(groups, width=9, height=6)
    one = {"position": [(2, 3)], "radius": 0.5}
    assert mpsim.Scene.groups(one, width=9, height=6).count == 1, "a single one without a list"
    with pytest.raises(mpsim.InputError, match=r"groups must be a list of dictionaries, .*; got \[1\]\. Write"):
        mpsim.Scene.groups([1], width=9, height=6)
    for wrong in (5, [5]):
        with pytest.raises(mpsim.InputError, match=r"obstacles\[0\] must be an mpsim\.FixedDisc or .*; got int"):
            mpsim.Scene.groups([one], width=9, height=6, obstacles=wrong)
