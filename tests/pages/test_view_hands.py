"""What is done by hand on a page: it is done as asked or refused with a note, kept in the session, and taken back."""

import math

import numpy as np
import pytest
from support.scenes import gas, scene_of, zoo
from support.selection import long_but
from support.visitor import Visitor, digest_alone, kept, paused, replayed

import mpsim

pytestmark = pytest.mark.plain

SCENE = gas(20, 0.2)
GRID = mpsim.Settings(method="grid", contact="push", dt=0.01)
PLAIN = mpsim.Settings(method="grid")


def free_place(page, *others, radius=0.5):
    """A place for a disc, clear of all discs and of some other places."""
    taken, rng = np.vstack([page.picture.position, *others]), np.random.default_rng(1)
    while True:
        place = radius + rng.random(2) * (np.array(page.picture.extent) - 2 * radius)
        if np.hypot(*(taken - place).T).min() > 2 * radius + 0.1:
            return place.tolist()


def state_of(page):
    with replayed(page.view.address) as sim:
        return sim.state


# --- discs


@pytest.mark.parametrize("method", ["grid", "event"])
def test_a_disc_is_held_where_the_pointer_is_and_thrown(method):
    with paused(SCENE, mpsim.Settings(method=method)) as page:
        page.step_to(5)
        for _ in range(2):
            x, y = free_place(page)
            told = page.do("hold", id=7, x=x, y=y)
            assert (told["note"], told["held"]) == (None, [7])
            page.hear_until(lambda v, x=x: abs(v.picture.position[7, 0] - x) < 1e-3)
        state = state_of(page)
        assert (state.position[7].tolist(), state.velocity[7].tolist()) == ([x, y], [0, 0])
        told = page.do("release", id=7, vx=1.0, vy=-2.0)
        assert (told["note"], told["held"], told["undo"]) == (None, [], 1)
        assert state_of(page).velocity[7].tolist() == [1.0, -2.0]


def test_a_held_disc_stays_while_others_strike_it():
    scene = mpsim.Scene(width=9, height=4, position=[[2, 2], [7, 2]], velocity=[[3, 0], [0, 0]], radius=0.5)
    with paused(scene, PLAIN) as page:
        page.do("hold", id=1, x=5.0, y=2.0)
        for frame in range(20, 101, 20):
            page.say("hold", id=1, x=5.0, y=2.0)
            page.step_to(frame)
        page.do("hold", id=1, x=5.0, y=2.0)
        state = state_of(page)
        assert state.position[1].tolist() == [5.0, 2.0]
        assert state.velocity[0, 0] <= 0, "the other one has struck it"
    with mpsim.Simulation(scene, PLAIN) as alone:
        alone.set([1], position=(5.0, 2.0), velocity=(0, 0))
        alone.run(frames=100)
        assert alone.state.position[1, 0] > 5.1, "the control: it moves when nobody holds it"


def test_a_disc_is_let_go_when_its_page_falls_silent():
    with paused(SCENE, PLAIN) as page:
        x, y = free_place(page)
        with Visitor(page.view.address) as other:
            other.say("hold", id=3, x=x, y=y)
            page.hear_until(lambda v: v.last.get("hands", {}).get("held") == [3])
        page.say("speed", value=0.1)
        page.say("play")
        page.hear_until(lambda v: v.last["hands"]["held"] == [])


def test_a_throw_is_at_most_one_radius_a_step_where_there_are_steps():
    with paused(SCENE, mpsim.Settings(method="grid", dt=0.1)) as page:
        x, y = free_place(page)
        page.do("hold", id=3, x=x, y=y)
        assert "thrown at speed 5, one radius a step" in page.do("release", id=3, vx=300.0, vy=400.0)["note"]
        assert state_of(page).velocity[3] == pytest.approx([3.0, 4.0])
    with paused(SCENE, mpsim.Settings(method="event")) as page:
        page.do("hold", id=3, x=x, y=y)
        assert "one side of the box a frame" in page.do("release", id=3, vx=3e9, vy=4e9)["note"]
        side = min(SCENE.width, SCENE.height) / 0.01
        assert state_of(page).velocity[3] == pytest.approx([0.6 * side, 0.8 * side])
        assert page.do("release", id=3, vx=1.0, vy=1.0)["note"] is None, "nobody holds it"


@pytest.mark.parametrize("words", ["", "radii masses", "rough radii"])
def test_a_disc_is_added_at_rest_with_what_discs_of_the_scene_have(words):
    with paused(zoo(words, count=5, side=20.0, seed=2), PLAIN) as page:
        x, y = free_place(page)
        assert page.do("add", x=x, y=y, same=False)["note"] is None
        with replayed(page.view.address) as sim:
            assert (sim.count, sim.state.position[5].tolist(), sim.state.velocity[5].tolist()) == (6, [x, y], [0, 0])
            assert sim.radii[5] in sim.radii[:5]
            assert sim.masses[5] in sim.masses[:5]
        page.hear_until(lambda v: len(v.picture.colour) == 6)


def test_no_disc_is_added_in_an_obstacle_and_a_stroke_is_undone_at_once():
    peg = mpsim.FixedDisc((4.0, 6.0), 0.5)
    scene = scene_of([[0.1, 4]], width=8, height=8, boundary=("periodic", "walls"), obstacles=[peg])
    with paused(scene, PLAIN) as page:
        assert "obstacle" in page.do("add", x=4.0, y=6.0, same=False)["note"]
        for x in (2.0, 3.2):
            assert page.do("add", x=x, y=4.0, same=x > 2)["undo"] == 1
        assert state_of(page).position[1:].tolist() == [[2.0, 4.0], [3.2, 4.0]]
        page.do("undo")
        page.hear_until(lambda v: len(v.picture.colour) == 1)


def test_pages_may_hold_16_discs_at_a_time():
    with paused(gas(20, 0.02), PLAIN) as page:
        places: list = []
        for disc in range(17):
            places.append(free_place(page, *places))
            told = page.do("hold", id=disc, x=places[-1][0], y=places[-1][1])
        assert "pages may hold at most 16 discs at a time" in told["note"]
        assert told["held"] == list(range(16))
        x, y = free_place(page, *places)
        assert page.do("hold", id=3, x=x, y=y)["note"] is None, "it is held already"


REFUSED = [
    ("hold", {"id": 99, "x": 1.0, "y": 1.0}, "id must be the number of a disc, from 0 to 19; got 99"),
    ("hold", {"id": 3, "x": -4.0, "y": 1.0}, "one radius from the walls"),
    ("add", {"x": 1e99, "y": 1.0, "same": False}, "one radius from the walls"),
    ("wall", {"ax": 1.0, "ay": 0.0, "bx": 1.0, "by": 0.9}, "as long as a disc is wide, 1; got 0.9. Drag further."),
    ("wall", {"ax": 1.0, "ay": 0.0, "bx": 1.0, "by": -9.0}, "must lie in the box"),
    ("move_wall", {"id": 0, "dx": 1.0, "dy": 0.0}, "wall must be the number of an obstacle that is there"),
    ("remove_wall", {"id": 0, "same": False}, "wall must be the number of an obstacle that is there"),
    ("change", {"name": "dt", "value": -1.0, "same": False}, "dt must be from 0.001 to 0.1 here; got -1"),
    ("change", {"name": "gravity", "value": 3.0, "same": False}, "gravity must"),
    ("change", {"name": "gravity", "value": [1e99, 0.0], "same": False}, "gravity must be from "),
    ("change", {"name": "substeps", "value": 10**6, "same": False}, "substeps must be from 1 to 16 here"),
    ("change", {"name": "passes", "value": 2.5, "same": False}, "passes must be a whole number"),
    ("change", {"name": "contact", "value": 1.0, "same": False}, "must be a parameter that the page offers"),
    ("change", {"name": "workers", "value": 1024, "same": False}, "workers must be a parameter that the page offers"),
    ("change", {"name": "piston_speed", "value": 1.0, "same": False}, "must be a parameter that the page offers"),
    ("undo", {}, "undo needs a remembered change"),
]


def test_what_is_refused_is_a_note_and_changes_nothing():
    with paused(SCENE, GRID) as page:
        for name, values, text in REFUSED:
            told = page.do(name, **values)
            assert text in (told["note"] or ""), (name, values)
            assert (told["undo"], told["held"]) == (0, []), (name, values)
        assert kept(page.view.address) == (0, digest_alone(SCENE, GRID, 0), [])
        page.say("hold", id=99, x=1.0, y=1.0)
        told = page.do("change", name="passes", value=2, same=False)
        assert "id must be" in told["note"], "it is told although another action followed at once"
        assert page.do("change", name="passes", value=3, same=False)["note"] is None
    with paused(SCENE, mpsim.Settings(method="event")) as page:
        x, y = SCENE.position[4].tolist()
        assert "discs that do not overlap" in page.do("hold", id=3, x=x, y=y)["note"]
        assert page.last["hands"]["held"] == []


# --- room among others


def test_what_finds_no_room_is_refused_and_nothing_has_moved():
    """A box full of discs, as they touch."""
    place = np.stack(np.divmod(np.arange(16), 4), axis=1) + 0.5
    scene = mpsim.Scene(width=4, height=4, position=place, velocity=np.zeros((16, 2)), radius=0.5)
    with paused(scene, PLAIN) as page:
        for name, values in (
            ("add", {"x": 2.0, "y": 2.0, "same": False}),
            ("wall", {"ax": 0.0, "ay": 1.8, "bx": 4.0, "by": 1.8}),
        ):
            told = page.do(name, **values)
            assert "there must be room for it" in told["note"]
            assert told["undo"] == 0
        assert kept(page.view.address) == (0, digest_alone(scene, PLAIN, 0), [])


def test_discs_that_made_room_are_put_back_if_what_they_made_it_for_is_refused():
    """By an emitter, which needs its own room."""
    scene = gas(20, 0.3, emitters=(mpsim.Emitter((1.0, 1.0), (0.0, 0.0), every=100),))
    with paused(scene, PLAIN) as page:
        before = kept(page.view.address)
        assert "emitter" in page.do("wall", ax=0.0, ay=1.0, bx=scene.width, by=1.0)["note"]
        assert kept(page.view.address) == before


CROWDED = {
    "gas": (gas(48, 0.4), "grid"), "dense": (gas(200, 0.7), "grid"), "dense, exact": (gas(200, 0.7), "event"),
    "dense, periodic": (gas(48, 0.7, boundary="periodic"), "grid"),
    "two sizes": (mpsim.Scene.random(count=40, packing=0.6, radius=[0.5, 0.25] * 20, seed=3), "grid"),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("words", CROWDED)
def test_there_is_room_for_a_disc_and_for_a_wall_anywhere_and_no_disc_is_moved_farther_than_needed(words):
    (scene, method), rng = CROWDED[words], np.random.default_rng(4)
    size, few = np.array([scene.width, scene.height]), words == "gas"
    with paused(scene, mpsim.Settings(method=method)) as page:
        for turn in range(20):
            x, y = 0.5 + rng.random(2) * (size - 1)
            bx, by = (np.array([x, y]) + rng.uniform(0.3, 0.7, 2) * size) % size
            told = page.do("wall", ax=x, ay=y, bx=bx, by=by) if turn % 2 else page.do("add", x=x, y=y, same=False)
            assert told["note"] is None
            with replayed(page.view.address) as sim:
                assert mpsim.measure.overlap(sim.state, sim.scene, radii=sim.radii).largest < 1e-12
                if turn % 2:
                    assert sim.scene.starting_from(sim.state).overlaps_at_start() == "", "nor with the wall"
                moved = sim.state.position[: scene.count] - scene.position
            moved -= np.round(moved / size) * size * np.array(scene.periodic)
            far = 2 * np.hypot(*moved.T)
            assert turn % 2 or (far.max() < (2 if few else 4) and (far > 0).sum() <= (8 if few else 100))
            page.do("undo")


def test_each_stage_makes_room_for_itself():
    scene = mpsim.Scene(width=9, height=9, position=[[2, 2], [6, 6]], velocity=[[1, 0], [0, 0]], radius=0.5)
    with paused(scene, PLAIN, beside=mpsim.Settings(method="event")) as page:
        page.do("hold", id=0, x=5.5, y=6.0)  # refused on the second stage, where disc 0 stays behind
        page.do("release", id=0, vx=0.0, vy=0.0)
        page.step_to(30)
        page.hear_until(lambda v: v.stages[1].frame == 30)
        x, y = page.stages[1].position[0].tolist()
        for name, values in (("add", {"x": x, "y": y, "same": False}), ("wall", {"ax": x, "ay": 0, "bx": x, "by": 9})):
            assert page.do(name, **values)["note"] is None
            page.step_to(page.frame + 1)
            assert page.last["pair"]["second"] == "event"
            assert len(page.stages[1].colour) == len(page.picture.colour) == 3


# --- walls


def test_a_drawn_wall_has_the_bits_of_one_that_a_program_adds_and_is_gone_after_undo_and_reset():
    scene = scene_of(np.add(SCENE.position, (4, 0)), SCENE.velocity, 14, SCENE.height)
    with mpsim.Simulation(scene, PLAIN) as alone:
        alone.run(frames=5)
        alone.add_wall(mpsim.Polyline([(2, 0), (2, 8)], thickness=0.25))
        alone.run(frames=60)
        expected = alone.digest()
    with paused(scene, PLAIN) as page:
        page.step_to(5)
        for way in ("undo", "reset"):
            assert page.last["obstacles"]["capsules"] == []
            assert page.do("wall", ax=2.0, ay=0.0, bx=2.0, by=8.0)["note"] is None
            page.hear_until(lambda v: v.last["obstacles"]["capsules"] == [[2.0, 0.0, 2.0, 8.0, 0.125]])
            page.step_to(65)
            if way == "undo":
                assert kept(page.view.address) == (65, expected, ["add_wall"])
            page.say(way)
            page.hear_until(lambda v: v.last["obstacles"]["capsules"] == [] and v.phase == "paused" and v.frame < 60)


def test_an_obstacle_that_moves_is_shown_where_it_is():
    bar = mpsim.Polyline([(3, 4), (5, 4)], motion=mpsim.Rotation((4, 4), rate=1.0))
    scene = mpsim.Scene(width=8, height=8, position=[[1, 1]], velocity=[[0, 0]], radius=0.5, obstacles=bar)
    with paused(scene, PLAIN) as page:
        page.step_to(30)
        shown = scene.capsules_at(30 * PLAIN.dt)
        page.hear_until(lambda v: np.abs(np.subtract(v.last["obstacles"]["capsules"], shown)).max() < 1e-6)
        assert np.abs(shown - scene.capsules_at(0.0)).max() > 0.1


def test_a_wall_is_moved_and_removed_like_a_disc():
    bar = mpsim.Polyline([(3, 4), (5, 4)], thickness=0.1, motion=mpsim.Translation((0, 1), stop=3))
    obstacles = [mpsim.FixedDisc((1, 7), 0.5), bar]
    scene = mpsim.Scene(width=8, height=9, position=[[1, 1]], velocity=[[0, 0]], radius=0.5, obstacles=obstacles)
    with paused(scene, PLAIN) as page:
        page.step_to(100)
        page.hear_until(lambda v: np.allclose(v.last["obstacles"]["capsules"][1], [3, 5, 5, 5, 0.05]))
        assert page.last["obstacles"]["numbers"] == [0, 1]
        assert page.do("move_wall", id=1, dx=-2.5, dy=-4.0)["note"] is None, "onto the disc, which makes room"
        page.hear_until(lambda v: np.allclose(v.last["obstacles"]["capsules"][1], [0.5, 1, 2.5, 1, 0.05]))
        assert page.last["obstacles"]["numbers"] == [0, 2]
        with replayed(page.view.address) as sim:
            assert np.hypot(*(sim.state.position[0] - (1, 1))) == pytest.approx(0.55, abs=1e-2)
        assert "must lie in the box" in page.do("move_wall", id=2, dx=-1.0, dy=0.0)["note"]
        assert page.do("move_wall", id=0, dx=1.0, dy=0.0)["note"] is None
        page.hear_until(lambda v: v.last["obstacles"]["capsules"][1] == [2, 7, 2, 7, 0.5])
        assert page.do("remove_wall", id=3, same=False)["note"] is None
        assert page.do("remove_wall", id=2, same=True)["undo"] == 3, "a stroke"
        page.hear_until(lambda v: v.last["obstacles"]["capsules"] == [])
        page.do("undo")
        page.do("undo")
        page.do("undo")
        page.hear_until(lambda v: v.last["obstacles"]["numbers"] == [0, 1])
        page.step_to(110)
        assert kept(page.view.address) == (110, digest_alone(scene, PLAIN, 110), [])


# --- parameters

BATH = gas(20, 0.4, boundary="periodic", thermostat=mpsim.Thermostat(temperature=1.0, rate=4.0, seed=5))
WALLS = gas(20, 0.4, thermal_walls=mpsim.ThermalWalls(left=2.0, right=2.0, bottom=2.0, top=2.0, seed=5))
ROUGH = gas(20, 0.4, friction=0.05, wall_friction=0.05)
USUAL = {"gravity", "restitution", "wall_restitution", "dt", "passes", "substeps"}
OFFERED = [
    ("bare", SCENE, GRID, USUAL, {"dt": (0.001, 0.1), "passes": (1, 4), "substeps": (1, 16)}),
    ("exact", SCENE, mpsim.Settings(method="event"), USUAL - {"passes", "substeps"}, {}),
    ("moved", zoo("piston emitters", count=5, side=20.0), PLAIN, USUAL | {"piston_speed", "interval", "every"},
     {"piston_speed": (-15, -0.15), "interval": (0.012, 1.2), "every": (1, 30)}),
    ("thermostat", BATH, PLAIN, USUAL | {"temperature"}, {"temperature": (0.1, 10)}),
    ("thermal walls", WALLS, PLAIN, USUAL | {"wall_temperature"}, {"wall_temperature": (0.2, 20)}),
    ("several temperatures", gas(20, 0.4, thermal_walls=mpsim.ThermalWalls(left=2.0, right=1.0)), PLAIN, USUAL, {}),
    ("friction", ROUGH, PLAIN, USUAL | {"friction", "wall_friction"}, {"friction": (0.005, 0.5)}),
    ("infinite friction", gas(20, 0.4, friction=math.inf, wall_friction=0.05), PLAIN, USUAL | {"wall_friction"}, {}),
]  # fmt: skip


@pytest.mark.filterwarnings("ignore::mpsim.FastWarning")
@pytest.mark.parametrize(
    ("scene", "settings", "names", "ends"), [each[1:] for each in OFFERED], ids=[each[0] for each in OFFERED]
)
def test_a_page_offers_the_parameters_of_the_scene_between_ends_that_follow_from_its_start(
    scene, settings, names, ends
):
    with paused(scene, settings) as page:
        page.hear_until(lambda v: "hands" in v.last)
        assert page.values.keys() == names
        sliders = {each["name"]: each for each in page.last["hands"]["parameters"] if "low" in each}
        for name, (low, high) in ends.items():
            assert (sliders[name]["low"], sliders[name]["high"]) == (pytest.approx(low), pytest.approx(high))
            assert low <= sliders[name]["value"] <= high
            for end in (sliders[name]["low"], sliders[name]["high"]):
                told = page.do("change", name=name, value=end, same=False)
                assert (told["note"], page.values[name]) == (None, end)
            for beyond in (high * 1e9, [low, high * 1e9]):
                told = page.do("change", name=name, value=beyond, same=False)
                assert name in (told["note"] or ""), "it would keep the simulation busy for hours"
                assert page.values[name] == sliders[name]["high"]
            told = page.do("change", name=name, value=high * 1e9, same=False)
            assert f"{name} must be from {low:.4g} to {high:.4g} here" in told["note"]
            assert "Simulation.change" in told["note"]


# --- undo


def draw_wall(page):
    """Right before the first disc that has room for it."""
    state = state_of(page)
    for place, velocity in zip(state.position[2:], state.velocity[2:], strict=True):  # one of the others is gone
        ahead = velocity / np.hypot(*velocity)
        ends = place + 0.63 * ahead + np.outer([0.51, -0.51], (-ahead[1], ahead[0]))
        if page.do("wall", **dict(zip(("ax", "ay", "bx", "by"), ends.ravel().tolist(), strict=True)))["note"] is None:
            return


def hold_and_throw(page):
    x, y = free_place(page)
    page.do("hold", id=7, x=x, y=y)
    page.step_to(page.frame + 4)
    page.do("release", id=7, vx=1.0, vy=0.5)


def add_two(page):
    first = free_place(page)
    for same, (x, y) in ((False, first), (True, free_place(page, first))):
        page.do("add", x=x, y=y, same=same)


def drag_gravity(page):
    for g in (0.25, 0.5):
        page.do("change", name="gravity", value=[0.0, -g], same=g > 0.3)
        page.step_to(page.frame + 3)


GESTURES = {
    "hold and throw": hold_and_throw,
    "add two": add_two,
    "remove": lambda page: page.do("remove", id=5, same=False),
    "gravity dragged": drag_gravity,
    "dt": lambda page: page.do("change", name="dt", value=0.005, same=False),
    "wall": draw_wall,
    "losses": lambda page: page.do("change", name="restitution", value=0.5, same=False),
}


@pytest.mark.parametrize("method", long_but(["grid", "event"], "grid"))
def test_after_undo_the_run_is_that_in_which_the_change_never_was(method):
    with paused(gas(20, 0.3), mpsim.Settings(method=method)) as page:
        page.step_to(5)
        page.do("remove", id=1, same=False)
        page.step_to(10)
        at_once = kept(page.view.address)
        page.step_to(25)
        later = kept(page.view.address)
        page.do("undo")
        page.hear_until(lambda v: v.frame == 5)
        page.do("remove", id=1, same=False)
        page.step_to(10)
        for name, gesture in GESTURES.items():
            gesture(page)
            page.step_to(max(page.frame, 10) + 15)
            assert page.last["hands"]["undo"] == 2, f"{name} is one gesture"
            assert kept(page.view.address).digest != later.digest, f"{name} matters"
            page.do("undo")
            page.hear_until(lambda v: v.frame == 10)
            assert kept(page.view.address) == at_once, name
        page.step_to(25)
        assert kept(page.view.address) == later == (25, later.digest, ["remove"])


def test_gestures_of_two_pages_at_a_time_are_one_entry_each_and_go_back_one_by_one():
    with paused(gas(20, 0.05), GRID) as page:
        start = kept(page.view.address).digest
        places = [np.array(free_place(page))]
        places.append(np.array(free_place(page, *places)))
        for k in range(4):  # each drags a disc
            for disc, place in ((3, places[0]), (7, places[1])):
                assert page.do("hold", id=disc, x=place[0] + 0.01 * k, y=float(place[1]))["note"] is None
            page.step_to(k + 1)
        assert (page.last["hands"]["undo"], page.last["hands"]["held"]) == (2, [3, 7])
        assert page.do("release", id=3, vx=1.0, vy=2.0)["held"] == [7]
        added: list = [*places]
        for k in range(3):  # one drags a slider, one adds discs along a stroke
            page.do("change", name="restitution", value=0.9 - k / 10, same=k > 0)
            added.append(free_place(page, *added))
            told = page.do("add", x=added[-1][0], y=added[-1][1], same=k > 0)
            assert told["note"] is None
        assert told["undo"] == 4
        told = page.do("undo")
        assert (told["undo"], told["held"]) == (3, [7]), "a gesture that began before goes on"
        page.hear_until(lambda v: len(v.picture.colour) == 20)
        page.do("hold", id=7, x=float(places[1][0]), y=float(places[1][1]))
        assert page.do("change", name="restitution", value=0.5, same=True)["undo"] == 3
        assert page.do("change", name="passes", value=2, same=True)["undo"] == 4, "another parameter is another gesture"
        for left in (3, 2, 1, 0):
            told = page.do("undo")
            assert told["undo"] == left
        assert told["held"] == []
        assert kept(page.view.address) == (0, start, [])


def test_the_last_16_gestures_can_be_undone():
    with paused(SCENE, PLAIN) as page:
        for number in range(18):
            told = page.do("remove", id=number, same=False)
        assert told["undo"] == 16
        for left in reversed(range(16)):
            assert page.do("undo")["undo"] == left
        page.hear_until(lambda v: (v.picture.colour == 255).sum() == 2)
