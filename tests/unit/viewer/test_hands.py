"""What is done by hand: each action is what was asked for, refused ones change nothing, all are taken back."""

import json
import math
import tempfile

import numpy as np
import pytest
from support.scenes import gas, simulate, zoo
from support.selection import long_but

import mpsim
from mpsim.viewer import hands as hands_module
from mpsim.viewer import undo as undo_module
from mpsim.viewer.hands import HOLD_SECONDS, Hands
from mpsim.viewer.wire import Action, read_action

SCENE = gas(50, 0.2)
CONTACTS = {"grid": {"method": "grid"}, "event": {"method": "event"}, "naive": {"method": "naive"}}


class Table:
    """A simulation under somebody's hands."""

    def __init__(self, scene, owned=True, **settings):
        self.sim = simulate(scene, **settings)
        self.hands = Hands(owned)
        self.hands.begin(self.sim)

    def do(self, name, /, now=0.0, **values):
        self.sim = self.hands.do(self.sim, Action(name, values), now)
        return self.hands.note

    @property
    def told(self):
        return self.hands.told(self.sim)

    def values(self):
        return {each["name"]: each["value"] for each in self.told["parameters"]}

    def close(self):
        self.sim.close()
        self.hands.close()


@pytest.fixture
def table():
    made = []

    def begin(scene=SCENE, owned=True, **settings):
        made.append(Table(scene, owned, **{"method": "grid", **settings}))
        return made[-1]

    yield begin
    for each in made:
        each.close()


def free_place(sim, radius=0.5):
    """A place for a disc, clear of all others."""
    scene, state = sim.scene, sim.state
    rng = np.random.default_rng(1)
    while True:
        place = radius + rng.random(2) * (np.array([scene.width, scene.height]) - 2 * radius)
        if np.hypot(*(state.position - place).T).min() > 2 * radius + 0.05:
            return place


def draw_wall(t):
    """A wall right before one of the discs, the first that has room for it; what is said in the end."""
    for place, velocity in zip(t.sim.state.position, t.sim.state.velocity, strict=True):
        ahead = velocity / np.hypot(*velocity)
        ends = place + 0.63 * ahead + np.outer([0.51, -0.51], (-ahead[1], ahead[0]))
        note = t.do("wall", **dict(zip(("ax", "ay", "bx", "by"), ends.ravel().tolist(), strict=True)))
        if note is None:
            break
    return note


@pytest.mark.parametrize("method", CONTACTS)
def test_a_disc_is_held_where_the_pointer_is_and_thrown(table, method):
    t = table(**CONTACTS[method])
    t.sim.run(frames=5)
    x, y = free_place(t.sim)
    assert t.do("hold", id=7, x=x, y=y) is None
    assert t.sim.state.position[7].tolist() == [x, y]
    assert t.sim.state.velocity[7].tolist() == [0, 0]
    assert t.told["held"] == [7]
    x, y = free_place(t.sim)
    t.do("hold", id=7, x=x, y=y)
    assert t.do("release", id=7, vx=1.0, vy=-2.0) is None
    assert t.sim.state.velocity[7].tolist() == [1.0, -2.0]
    assert t.told["held"] == []
    with mpsim.Simulation.replay(t.sim.journal) as again:
        assert again.digest() == t.sim.digest()


def test_a_held_disc_stays_while_others_strike_it(table):
    scene = mpsim.Scene(width=9, height=4, position=[[2, 2], [7, 2]], velocity=[[3, 0], [0, 0]], radius=0.5)
    t = table(scene)
    t.do("hold", id=1, x=5.0, y=2.0)
    for _ in range(100):
        t.hands.hold_still(t.sim, now=1.0)
        t.sim.run(frames=1)
    t.hands.hold_still(t.sim, now=1.0)
    assert t.sim.state.position[1].tolist() == [5.0, 2.0]
    assert t.sim.state.velocity[0, 0] <= 0, "the other one has struck it"
    with mpsim.Simulation(scene, mpsim.Settings(method="grid")) as alone:
        alone.set([1], position=(5.0, 2.0), velocity=(0, 0))
        alone.run(frames=100)
        assert alone.state.position[1, 0] > 5.1, "negative control: it moves when nobody holds it"


def test_a_disc_is_let_go_when_its_page_falls_silent(table):
    t = table()
    x, y = free_place(t.sim)
    t.do("hold", now=10.0, id=3, x=x, y=y)
    t.sim.run(frames=1)
    t.hands.hold_still(t.sim, now=10.0 + HOLD_SECONDS)
    assert t.told["held"] == [3]
    assert t.hands.hold_still(t.sim, now=10.1 + HOLD_SECONDS)
    assert t.told["held"] == []


def test_a_throw_is_at_most_one_radius_a_step_where_there_are_steps(table):
    t = table(dt=0.1)
    x, y = free_place(t.sim)
    t.do("hold", id=3, x=x, y=y)
    note = t.do("release", id=3, vx=300.0, vy=400.0)
    assert t.sim.state.velocity[3] == pytest.approx([3.0, 4.0])
    assert "thrown at speed 5, one radius a step" in note
    exact = table(method="event")
    exact.do("hold", id=3, x=x, y=y)
    assert exact.do("release", id=3, vx=3.0, vy=4.0) is None
    assert exact.sim.state.velocity[3].tolist() == [3.0, 4.0]
    exact.do("hold", id=3, x=x, y=y)
    assert "one side of the box a frame" in exact.do("release", id=3, vx=3e9, vy=4e9)
    scene = exact.sim.scene
    side = min(scene.width, scene.height) / exact.sim.settings.dt
    assert exact.sim.state.velocity[3] == pytest.approx([0.6 * side, 0.8 * side])


@pytest.mark.parametrize("name", long_but(["radii masses", "", "rough radii"], "radii masses", ""))
def test_a_disc_is_added_at_rest_with_what_discs_of_the_scene_have(table, name):
    t = table(zoo(name, count=5, side=20.0))
    x, y = free_place(t.sim)
    assert t.do("add", x=x, y=y, same=False) is None
    assert t.sim.count == 6
    assert t.sim.state.position[5].tolist() == [x, y]
    assert t.sim.state.velocity[5].tolist() == [0, 0]
    assert t.sim.radii[5] in t.sim.radii[:5]
    assert t.sim.masses[5] in t.sim.masses[:5]


def test_no_disc_is_added_on_another_one_nor_through_a_periodic_edge(table):
    scene = mpsim.Scene(width=8, height=8, position=[[0.1, 4]], velocity=[[0, 0]], radius=0.5, boundary="periodic")
    t = table(scene)
    for x in (0.1, 0.6, 7.9):
        assert f"a new disc needs a free place; got ({x}, 4), where disc 0 is" in t.do("add", x=x, y=4.0, same=False)
    assert t.sim.count == 1
    assert t.do("add", x=1.2, y=4.0, same=False) is None


@pytest.mark.slow
def test_a_stroke_adds_discs_where_there_is_room_and_no_others(table):
    """Of each kind: on a disc, through a periodic edge, on a new one, in an obstacle."""
    options = {"boundary": ("periodic", "walls"), "obstacles": [mpsim.FixedDisc((4.0, 6.0), 0.5)]}
    scene = mpsim.Scene(width=8, height=8, position=[[0.1, 4]], velocity=[[0, 0]], radius=0.5, **options)
    t = table(scene)
    places = [[0.5, 4.2], [7.7, 3.8], [2.0, 4.0], [2.5, 4.0], [3.2, 4.0], [4.2, 6.4], [6.0, 6.0]]
    assert t.do("stroke", places=places, same=False) is None
    assert t.sim.state.position[1:].tolist() == [[2.0, 4.0], [3.2, 4.0], [6.0, 6.0]]
    assert not t.sim.state.velocity.any()
    assert t.do("stroke", places=places, same=True) is None, "a stroke without room is not worth a note"
    assert (t.sim.count, t.told["undo"]) == (4, 1)
    assert t.do("stroke", places=[[2.0, 2.0]], same=True) is None
    assert (t.sim.count, t.told["undo"]) == (5, 1), "both are one stroke"
    t.do("undo")
    assert t.sim.count == 1


@pytest.mark.slow
@pytest.mark.parametrize("method", ["grid", "event"])
def test_a_stroke_has_discs_like_those_of_the_scene(table, method):
    t = table(zoo("radii masses", count=5, side=20.0), method=method)
    x, y = free_place(t.sim)
    t.do("stroke", places=[[x, y], [x, y]], same=False)
    assert t.sim.count == 6
    assert t.sim.radii[5] in t.sim.radii[:5]
    assert t.sim.masses[5] in t.sim.masses[:5]


def test_pages_can_add_so_many_discs_and_no_more(table, monkeypatch):
    monkeypatch.setattr(hands_module, "MOST_ADDED", 2)
    t = table(gas(3, 0.01))
    for _ in range(2):
        x, y = free_place(t.sim)
        assert t.do("add", x=x, y=y, same=True) is None
    assert "pages may add at most 2 discs" in t.do("add", x=x, y=y, same=True)
    assert "pages may add at most 2 discs" in t.do("stroke", places=[[x, y]], same=True)
    assert t.sim.count == 5
    t = table(mpsim.Scene(width=9, height=9, position=[[1, 1]], velocity=[[0, 0]], radius=0.5))
    t.do("stroke", places=[[3, 3], [3, 5], [3, 7], [5, 3]], same=False)
    assert t.sim.count == 3


def test_a_refusal_is_told_although_another_action_follows_at_once(table):
    """A page is sent the last of several messages, and the number of notes says that there is a new one."""
    t = table()
    notes = t.told["notes"]
    note = t.do("hold", id=99, x=1.0, y=1.0)
    assert t.do("release", id=99, vx=0.0, vy=0.0) is None
    assert (t.told["note"], t.told["notes"]) == (note, notes + 1)
    assert "id must be the number of a disc" in note


def test_pages_can_draw_so_many_walls_and_no_more(table, monkeypatch):
    monkeypatch.setattr(hands_module, "MOST_WALLS", 2)
    t = table()
    for _ in range(2):
        assert draw_wall(t) is None
    assert "pages may draw at most 2 walls" in draw_wall(t)
    assert [line.thickness for line in t.sim.scene.obstacles] == [0.25, 0.25]


REFUSED = [
    ("hold", {"id": 99, "x": 1.0, "y": 1.0}, "id must be the number of a disc, from 0 to 49; got 99"),
    ("hold", {"id": 3, "x": -4.0, "y": 1.0}, "one radius from the walls"),
    ("hold", {"id": 3, "x": 1e99, "y": 1.0}, "one radius from the walls"),
    ("add", {"x": 1e99, "y": 1.0, "same": False}, "one radius from the walls"),
    ("remove", {"id": 50, "same": False}, "got 50. There are 50 discs"),
    ("wall", {"ax": 1.0, "ay": 0.0, "bx": 1.0, "by": 0.9}, "as long as a disc is wide, 1; got 0.9. Drag further."),
    ("wall", {"ax": 1.0, "ay": 0.0, "bx": 1.0, "by": -9.0}, "must be in the box"),
    ("wall", {"ax": 0.0, "ay": 0.0, "bx": 14.0, "by": 14.0}, "a wall must be clear of all discs; got disc"),
    ("change", {"name": "dt", "value": -1.0, "same": False}, "dt must be from 0.001 to 0.1 here; got -1"),
    ("change", {"name": "dt", "value": [1.0, 2.0], "same": False}, "dt must be"),
    ("change", {"name": "gravity", "value": 3.0, "same": False}, "gravity must"),
    ("change", {"name": "restitution", "value": 7.0, "same": False}, "restitution must be from 0 to 1 here; got 7"),
    ("change", {"name": "piston_speed", "value": 1.0, "same": False}, "must be a parameter that the page offers"),
    ("change", {"name": "interval", "value": 1.0, "same": False}, "must be a parameter that the page offers"),
    ("change", {"name": "passes", "value": 2.5, "same": False}, "passes must be a whole number"),
    ("change", {"name": "contact", "value": 1.0, "same": False}, "contact must be one of"),
    ("undo", {}, "undo needs a remembered change"),
]


@pytest.mark.parametrize(("name", "values", "text"), REFUSED)
def test_what_is_refused_is_a_note_and_changes_nothing(table, name, values, text):
    t = table()
    before = t.sim.digest()
    assert text in t.do(name, **values)
    assert (t.sim.digest(), len(t.sim.journal), t.told["undo"], t.told["held"]) == (before, 0, 0, [])
    notes = t.told["notes"]
    assert t.do("change", name="passes", value=2, same=False) is None
    assert t.told["notes"] == notes, "pages show a note once, by its number"


def test_a_place_on_another_disc_is_refused_by_the_exact_solver(table):
    t = table(method="event")
    x, y = t.sim.state.position[4]
    assert "discs that do not overlap" in t.do("hold", id=3, x=float(x), y=float(y))
    assert t.told["held"] == []
    assert len(t.sim.journal) == 0


ACTIONS = {
    "hold and throw": lambda t: (
        t.do("hold", id=7, x=free_place(t.sim)[0], y=free_place(t.sim)[1]), t.sim.run(frames=4),
        t.hands.hold_still(t.sim, 0.0), t.do("release", id=7, vx=1.0, vy=0.5),
    ),
    "add two": lambda t: [
        t.do("add", x=free_place(t.sim)[0], y=free_place(t.sim)[1], same=same) for same in (False, True)
    ],
    "remove": lambda t: t.do("remove", id=5, same=False),
    "gravity dragged": lambda t: [
        (t.do("change", name="gravity", value=[0.0, -g], same=g > 0.3), t.sim.run(frames=3)) for g in (0.25, 0.5)
    ],
    "dt": lambda t: t.do("change", name="dt", value=0.005, same=False),
    "wall": draw_wall,
    "losses": lambda t: t.do("change", name="restitution", value=0.5, same=False),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("method", ["grid", "event", "parallel"])
@pytest.mark.parametrize("action", ACTIONS)
def test_after_undo_the_run_is_that_in_which_the_change_never_was(table, action, method):
    settings = {"method": method} | ({"workers": 2} if method == "parallel" else {})
    with simulate(SCENE, **settings) as never:
        never.run(frames=20)
        never.kick(1, (0.5, 0.0))
        never.run(frames=10)
        at_once = never.digest()
        never.run(frames=15)
        later = never.digest()
    t = table(**settings)
    t.sim.run(frames=20)
    t.sim.kick(1, (0.5, 0.0))
    t.sim.run(frames=10)
    ACTIONS[action](t)
    t.sim.run(frames=15)
    assert t.sim.digest() != later, "negative control: the action matters"
    assert t.told["undo"] == 1
    assert t.do("undo") is None
    assert (t.sim.digest(), t.sim.frame, t.told["undo"]) == (at_once, 30, 0)
    t.sim.run(frames=15)
    assert t.sim.digest() == later
    assert [change.what for change in t.sim.journal] == ["kick"]
    with mpsim.Simulation.replay(t.sim.journal, workers=1) as again:
        assert again.digest() == later


def test_undo_goes_back_one_gesture_at_a_time(table):
    t = table()
    digests = []
    for number in range(4):
        digests.append(t.sim.digest())
        t.do("remove", id=number, same=False)
        t.sim.run(frames=2)
    assert t.told["undo"] == 4
    for number in reversed(range(4)):
        t.do("undo")
        assert (t.sim.digest(), t.sim.frame) == (digests[number], 2 * number)


def test_gestures_of_two_pages_at_a_time_are_one_entry_each(table):
    t = table(gas(50, 0.05))
    start = t.sim.digest()
    for k in range(6):  # each drags a disc
        for disc in (3, 7):
            x, y = free_place(t.sim) if not k else t.sim.state.position[disc] + [0.01, 0.0]
            assert t.do("hold", id=disc, x=float(x), y=float(y)) is None
        t.hands.hold_still(t.sim, 0.0)
        t.sim.run(frames=1)
    assert (t.told["undo"], t.told["held"]) == (2, [3, 7])
    t.do("release", id=3, vx=1.0, vy=2.0)
    assert t.sim.state.velocity[3].tolist() == [1.0, 2.0]
    assert t.told["held"] == [7]
    for k in range(4):  # one drags a slider, one adds discs along a stroke
        t.do("change", name="restitution", value=0.9 - k / 10, same=k > 0)
        x, y = free_place(t.sim)
        assert t.do("add", x=x, y=y, same=k > 0) is None
    assert t.told["undo"] == 4
    t.do("undo")
    assert (t.sim.count, t.told["undo"], t.told["held"]) == (50, 3, [7]), "a gesture that began before goes on"
    x, y = free_place(t.sim)
    t.do("hold", id=7, x=x, y=y)
    t.do("change", name="restitution", value=0.5, same=True)
    assert t.told["undo"] == 3
    for _ in range(3):
        t.do("undo")
    assert (t.sim.digest(), t.told["held"]) == (start, [])


def test_pages_can_hold_so_many_discs_and_no_more(table, monkeypatch):
    monkeypatch.setattr(hands_module, "MOST_HELD", 1)
    t = table()
    x, y = free_place(t.sim)
    t.do("hold", id=3, x=x, y=y)
    assert "pages may hold at most 1 discs at a time" in t.do("hold", id=4, x=x, y=y)
    assert (t.told["undo"], t.told["held"]) == (1, [3])
    assert t.do("hold", id=3, x=x, y=y) is None


def test_a_refused_change_costs_no_entry(table, monkeypatch):
    monkeypatch.setattr(undo_module, "MOST_POINTS", 2)
    t = table()
    for number in range(2):
        t.do("remove", id=number, same=False)
    t.do("remove", id=99, same=False)
    assert t.told["undo"] == 2


def test_of_another_parameter_same_does_not_go_on(table):
    t = table()
    t.do("change", name="dt", value=0.005, same=False)
    t.do("change", name="passes", value=2, same=True)
    assert t.told["undo"] == 2


def test_a_simulation_of_a_program_is_changed_but_not_replaced(table):
    t = table(owned=False)
    t.do("remove", id=5, same=False)
    assert not t.sim.state.present[5]
    assert t.told["undo"] is None
    assert "belongs to a program" in t.do("undo")
    assert not t.sim.state.present[5]


def test_the_sliders_are_those_of_the_scene(table):
    t = table(zoo("piston emitters", count=5, side=20.0))
    assert {"gravity", "restitution", "piston_speed", "interval", "every", "dt", "passes"} <= set(t.values())
    for each in t.told["parameters"]:
        if "low" in each:
            assert each["low"] <= each["value"] <= each["high"]
            for end in (each["low"], each["high"]):
                assert t.do("change", name=each["name"], value=end, same=False) is None, each
                assert t.values()[each["name"]] == end
    assert set(table(method="event").values()) == {"gravity", "restitution", "wall_restitution", "dt"}
    assert table(method="parallel", workers=1).values()["workers"] == 1


MOVED = zoo("piston emitters", count=5, side=20.0)
BATH = gas(60, 0.4, seed=2, boundary="periodic", thermostat=mpsim.Thermostat(temperature=1.0, rate=4.0, seed=5))
WALLS = gas(60, 0.4, seed=2, thermal_walls=mpsim.ThermalWalls(left=2.0, right=2.0, bottom=2.0, top=2.0, seed=5))
ROUGH = gas(60, 0.4, seed=2, friction=0.05, wall_friction=0.05)
BEYOND = [
    (SCENE, "dt", 1e100, "dt must be from 0.001 to 0.1 here; got 1e+100"),
    (SCENE, "dt", 1e-9, "dt must be from 0.001 to 0.1 here"),
    (SCENE, "substeps", 1_000_000, "substeps must be from 1 to 16 here"),
    (SCENE, "passes", 1000, "passes must be from 1 to 4 here"),
    (SCENE, "gravity", [1e99, 0.0], "gravity must be at most "),
    (SCENE, "workers", 1024, "workers must be a parameter that the page offers"),
    (MOVED, "piston_speed", -1e99, "piston_speed must be from -15 to -0.15 here"),
    (MOVED, "interval", 1e-99, "interval must be from 0.012 to 1.2 here"),
    (MOVED, "interval", [1e-99, 1.0], "interval must be from 0.012 to 1.2 here"),
    (MOVED, "every", 10**9, "every must be from 1 to 30 here"),
    (BATH, "temperature", 1e99, "temperature must be from 0.1 to 10 here"),
    (BATH, "wall_temperature", 1.0, "wall_temperature must be a parameter that the page offers"),
    (WALLS, "wall_temperature", 1e99, "wall_temperature must be from 0.2 to 20 here"),
    (ROUGH, "friction", 1e99, "friction must be from 0.005 to 0.5 here"),
    (ROUGH, "friction", 0.0, "friction must be from 0.005 to 0.5 here"),
    (SCENE, "wall_friction", 0.1, "wall_friction must be a parameter that the page offers"),
]


@pytest.mark.parametrize(("scene", "name", "value", "text"), BEYOND)
def test_what_no_slider_offers_is_refused(table, scene, name, value, text):
    """Through the schema, as a message of a page: one of these could keep the simulation busy for hours."""
    t = table(scene)
    action = read_action(json.dumps({"do": "change", "name": name, "value": value, "same": False}))
    before = t.sim.settings, t.sim.scene
    note = t.do(action.name, **action.values)
    assert text in note
    assert "Simulation.change" in note
    assert (t.sim.settings, t.sim.scene, len(t.sim.journal), t.told["undo"]) == (*before, 0, 0)


def test_the_ends_of_sliders_follow_from_the_start_of_a_simulation(table):
    """Not from where it is when the page goes back to a moment: else each return would move them on."""
    t = table()
    assert t.do("change", name="dt", value=0.1, same=False) is None
    t.hands.begin(t.sim)
    assert "dt must be from 0.001 to 0.1 here" in t.do("change", name="dt", value=1.0, same=False)
    assert "dt must be from 0.002 to 0.2 here" in table(dt=0.02).do("change", name="dt", value=1.0, same=False)


OF_SOME_SCENES = {"temperature", "wall_temperature", "friction", "wall_friction"}


@pytest.mark.parametrize(
    ("scene", "names", "value"),
    [
        (BATH, {"temperature"}, 4.0),
        (WALLS, {"wall_temperature"}, 4.0),
        (ROUGH, {"friction", "wall_friction"}, 0.25),
        (ROUGH.changed(friction=math.inf), {"wall_friction"}, 0.25),
    ],
    ids=["thermostat", "thermal walls", "friction", "infinite friction"],
)
def test_parameters_of_some_scenes_have_sliders_there(table, scene, names, value):
    t = table(scene)
    assert OF_SOME_SCENES & t.values().keys() == names
    for name in names:
        assert t.do("change", name=name, value=value, same=False) is None
        assert (t.values()[name], t.sim.journal.changes[-1].values) == (value, {name: value})
    assert not OF_SOME_SCENES & table().values().keys(), "negative control"


def test_walls_of_several_temperatures_have_no_slider(table):
    """One would make them alike."""
    t = table(WALLS)
    t.sim.change(wall_temperature=[1.0, 2.0, 2.0, 2.0])
    assert "wall_temperature" not in t.values()


def test_checkpoints_of_undo_are_gone_in_the_end(table, tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))  # where no other view has a folder
    t = table()
    for number in range(20):
        t.do("remove", id=number, same=False)
    assert t.told["undo"] == 16
    (folder,) = tmp_path.glob("mpsim-view-*")
    assert len(list(folder.iterdir())) == 16
    t.close()
    assert not folder.exists()
