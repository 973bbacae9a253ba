"""Hands and keep in a real browser: pointer and keys do what they say, and what is kept has the bits of the run."""

import contextlib
import io
import json
import subprocess
import sys
import time
import zipfile

import numpy as np
import pytest
from PIL import Image
from support.hands import WHITE, Table, until
from support.scenes import gas
from support.selection import long_but
from support.viewing import viewed

import mpsim

pytestmark = pytest.mark.slow

GRID = mpsim.Settings(method="grid")
SCENE = mpsim.Scene(
    width=20, height=12, position=[[4, 6], [10, 6], [16, 6], [10, 2]], velocity=np.zeros((4, 2)), radius=0.5
)


@pytest.fixture(scope="module")
def compiled():
    """Machine code of what pages change here: no page waits for it."""
    with mpsim.Simulation(SCENE, GRID) as sim:
        for change in ({"gravity": (0.0, -1.0)}, {"gravity": (0.0, 0.0), "restitution": 0.9}, {"gravity": (0.0, -1.0)}):
            sim.run(frames=1)
            sim.change(**change)
        sim.run(frames=1)
    with mpsim.Simulation(SCENE, GRID) as sim:
        sim.add_wall([(0, 0), (1, 0)])
    with mpsim.Simulation(SCENE, GRID) as sim:
        for number in (0, 1):
            sim.remove(number)
            sim.run(frames=1)
            sim.change(gravity=(0.0, -1.0))


@pytest.fixture
def table(opened, compiled, capsys):
    with contextlib.ExitStack() as stack:

        def begin(scene=SCENE, settings=GRID, query="", size=(1280, 800), context=None, **options):
            view = stack.enter_context(viewed(scene, settings, **{"playing": False, **options}))
            made = Table(opened, view, query, size, **(context or {}))
            stack.callback(made.context.close)
            return made

        yield begin


def test_a_disc_is_dragged_to_where_the_pointer_lets_it_go(table):
    t = table()
    t.drag((4.2, 6.1), (8.2, 9.1))
    until(lambda: t.holding() is None and np.allclose(t.disc(0), (8, 9), atol=0.03))
    assert t.sim.state.velocity[0].tolist() == [0, 0], "it rests: the pointer did"
    assert set(t.what()) == {"set"}
    assert np.allclose(t.disc(1), (10, 6)), "the others are where they were"
    until(lambda: t.seen(8, 9) != WHITE)  # it is drawn there
    until(lambda: t.seen(4, 6) == WHITE)
    assert t.complaints == []


def test_a_drag_of_the_background_moves_the_view_and_no_disc(table):
    t = table()
    before = t.sim.digest()
    t.drag((6, 9), (8, 10))
    until(lambda: json.loads(t.page.evaluate("JSON.stringify(document.querySelector('#stage').dataset.drawn)")) != "1")
    assert (t.sim.digest(), t.what()) == (before, [])


def test_a_disc_is_thrown_with_the_velocity_of_the_pointer(table):
    t = table()
    t.gesture(*((4 + 0.2 * k, 6 + 0.1 * k) for k in range(9)))
    until(lambda: bool(t.sim.state.velocity[0].any()))
    expected = np.array([0.2, 0.1]) / 0.02 / (60 * 0.01)  # length a time of the simulation: 60 frames of 0.01 a second
    assert t.sim.state.velocity[0] == pytest.approx(expected, rel=0.02)
    assert t.complaints == []


def test_a_pointer_that_rests_before_it_lets_go_throws_nothing(table):
    t = table()
    t.gesture(*((4 + 0.2 * k, 6 + 0.1 * k) for k in range(9)), rest=0.1)
    until(lambda: t.holding() is None and np.allclose(t.disc(0), (5.6, 6.8), atol=0.03))
    assert t.sim.state.velocity[0].tolist() == [0, 0]
    t.gesture((10, 6), (10, 8), (10, 8.1), (10, 8.2), apart=0.05)
    until(lambda: bool(t.sim.state.velocity[1].any()))
    assert t.sim.state.velocity[1] == pytest.approx((0, 2.0 / 0.6), rel=0.02), "of the last tenth of a second alone"


def test_a_busy_page_throws_a_disc_with_the_velocity_of_the_pointer(table):
    t = table()
    t.page.evaluate(BUSY)
    t.gesture(*((4 + 0.2 * k, 6 + 0.1 * k) for k in range(5)))
    until(lambda: bool(t.sim.state.velocity[0].any()))
    assert t.sim.state.velocity[0] == pytest.approx((0.2 / 0.02 / 0.6, 0.1 / 0.02 / 0.6), rel=0.02)


def test_a_disc_held_in_a_run_follows_and_is_thrown(table):
    t = table(playing=True)
    mouse = t.page.mouse
    mouse.move(*t.pixel(4, 6))
    mouse.down()
    until(lambda: t.holding() is not None)
    frame = t.sim.frame
    mouse.move(*t.pixel(7, 8), steps=10)
    until(lambda: t.sim.frame > frame + 20 and np.allclose(t.disc(0), (7, 8), atol=0.05))
    mouse.up()
    until(lambda: t.holding() is None)
    t.gesture(*((7 + 0.1 * k, 8) for k in range(5)))
    until(lambda: t.holding() is None and t.disc(0)[0] > 8)
    assert t.text("phase") == "playing"
    assert t.complaints == []


def test_a_disc_is_let_go_when_its_page_is_closed(table):
    t = table(playing=True)
    t.page.mouse.move(*t.pixel(4, 6))
    t.page.mouse.down()
    first = until(t.holding)
    until(lambda: t.holding().until > first.until + 0.5)  # the page says again that it holds it
    other = t.context.new_page()
    other.goto(t.view.address)
    t.page.close()
    until(lambda: t.holding() is None)


def test_what_is_refused_is_said_and_the_run_goes_on(table):
    scene = mpsim.Scene(
        width=20, height=12, position=[[4, 6], [10, 6]], velocity=np.zeros((2, 2)), radius=0.5,
        obstacles=mpsim.FixedDisc((15, 6), 1.0),
    )  # fmt: skip
    t = table(scene, playing=True)
    t.drag((4, 6), (15, 6.2), steps=1)
    until(lambda: "obstacles" in t.text("hand-note"))
    assert t.text("phase") == "playing"
    frame = t.sim.frame
    until(lambda: t.sim.frame > frame + 10)
    t.page.click("#tool-add")
    t.page.mouse.click(*t.pixel(15, 6))
    until(lambda: t.sim.count == 2)
    assert t.view._session.error is None


def test_discs_are_added_by_click_and_brush_and_removed(table):
    t = table()
    t.page.click("#tool-add")
    t.page.mouse.click(*t.pixel(5, 10))
    until(lambda: t.sim.count == 5)
    assert np.allclose(t.disc(4), (5, 10), atol=0.05)
    until(lambda: t.text("discs") == "5")
    t.page.click("#tool-brush")
    t.page.mouse.move(*t.pixel(2, 3))
    t.page.mouse.down()
    for k, x in enumerate((2, 2.4, 3.5, 5.0, 6.5)):
        t.page.mouse.move(*t.pixel(x, 3))
        until(lambda k=k: t.sim.count == 6 + (0, 0, 1, 2, 4)[k])  # at 2.4 there is no room beside the first
    t.page.mouse.up()
    places = t.sim.state.position[5:]
    assert np.allclose(places[:, 1], 3, atol=0.05)
    assert np.diff(np.sort(places[:, 0])).min() > 1.0, "no two overlap"
    t.page.click("#tool-remove")
    t.page.mouse.click(*t.pixel(10, 6))
    until(lambda: not t.sim.state.present[1])
    assert t.sim.state.present.sum() == t.sim.count - 1
    count = t.sim.count
    t.page.click("#undo")
    until(lambda: bool(t.sim.state.present.all()))
    t.page.click("#undo")
    until(lambda: t.sim.count == 5)
    assert count > 5, "a stroke of the brush is taken back as one"
    t.page.click("#undo")
    until(lambda: t.sim.count == 4 and t.page.is_disabled("#undo"))
    assert t.what() == []
    assert t.complaints == []


BUSY = """addEventListener("pointermove", () => {
    const end = performance.now() + 150;
    while (performance.now() < end);
}, true)"""


def test_a_fast_stroke_on_a_busy_page_leaves_no_gaps(table):
    t = table()
    t.page.evaluate(BUSY)
    t.page.click("#tool-brush")
    t.gesture((1, 3.5), (19, 3.5), (19, 11), apart=0.0)
    until(lambda: t.sim.count > 4 + 20)
    drawn = t.sim.state.position[4:]
    row, column = drawn[drawn[:, 1] < 3.6], drawn[drawn[:, 1] > 3.6]
    gaps = np.diff(np.sort(row[:, 0])), np.diff(np.sort(column[:, 1]))
    for each in gaps:
        assert 1.0 <= each.min() <= each.max() < 1.1, "one beside the other"
    assert row[:, 0].max() > 18
    assert column[:, 1].max() > 10
    assert len(t.view._session._hands.undo) == 1, "one stroke"
    t.page.click("#tool-remove")
    t.gesture((1, 3.5), (19, 3.5), (19, 11), apart=0.0)
    until(lambda: not t.sim.state.present[4:].any())
    assert t.sim.state.present[:4].all(), "no other one is gone"
    assert len(t.view._session._hands.undo) == 2
    t.page.click("#undo")
    until(lambda: bool(t.sim.state.present.all()))
    assert t.complaints == []


def test_a_stroke_goes_round_what_is_in_its_way_and_says_nothing(table):
    place = [[2 * k + 1.5, 6] for k in range(8)]
    scene = mpsim.Scene(
        width=20, height=12, position=place, velocity=np.zeros((8, 2)), radius=0.5,
        obstacles=mpsim.FixedDisc((18.5, 6), 0.4),
    )  # fmt: skip
    t = table(scene)
    t.page.click("#tool-brush")
    t.gesture((1.5, 6), (19.4, 6.05), apart=0.0)
    until(lambda: t.sim.count >= 8 + 1)
    time.sleep(0.3)
    new = t.sim.state.position[8:]
    apart = np.hypot(*(new[:, None] - t.sim.state.position[None]).T)
    assert np.sort(apart, axis=0)[1].min() >= 1.0, "on no disc"
    assert np.hypot(*(new - [18.5, 6]).T).min() >= 0.9, "nor on the obstacle"
    assert t.text("hand-note") == ""
    assert t.complaints == []


def test_a_wall_is_drawn_by_pointer_and_keys_refused_on_a_disc_and_taken_back(table):
    t = table()
    t.page.click("#tool-wall")
    t.drag((7, 12.1), (7, 4))
    until(lambda: len(t.sim.scene.obstacles) == 1)
    (wall,) = t.sim.scene.obstacles
    assert np.allclose(wall.points, [(7, 12), (7, 4)], atol=0.05)
    assert wall.points[0][1] == 12, "an end beside the edge is on it"
    until(lambda: t.page.evaluate("import('./common.js').then(({state}) => state.scene.capsules.length)") == 1)
    until(lambda: t.seen(7, 8) == [0x3A, 0x3F, 0x45])  # it is drawn there
    for end, said in (
        ((16, 7), "a wall must be clear of all discs; got disc 1"),
        ((9.2, 6), "as long as a disc is wide"),
    ):
        t.drag((9, 6), end)
        until(lambda said=said: said in t.text("hand-note"))
    t.keys("k", "ArrowUp", "ArrowUp", "ArrowUp", "ArrowUp", "ArrowUp", "Enter", *["ArrowRight"] * 9)
    assert len(t.sim.scene.obstacles) == 1, "nothing before the second end"
    t.keys("Enter")
    until(lambda: len(t.sim.scene.obstacles) == 2)
    (ax, ay), (bx, by) = t.sim.scene.obstacles[1].points
    assert ay == by > 6.5
    assert (ax, bx > ax + 1) == (10, True)
    t.keys("Enter", "ArrowRight", "Escape")
    assert t.what() == ["add_wall", "add_wall"], "Escape forgets a wall that has one end"
    t.keys("z", "z")
    until(lambda: t.sim.scene.obstacles == () and t.page.is_disabled("#undo"))
    until(lambda: t.page.evaluate("import('./common.js').then(({state}) => state.scene.capsules.length)") == 0)
    assert t.complaints == []


def test_a_wall_is_cut_where_it_leaves_the_box(table):
    t = table()
    t.page.click("#tool-wall")
    t.drag((-0.3, 3), (-0.3, 8))
    until(lambda: t.text("hand-note") == "A wall must be in the box. Draw it there.")
    t.drag((3, 9), (6, 15))
    until(lambda: len(t.sim.scene.obstacles) == 1)
    (wall,) = t.sim.scene.obstacles
    assert np.allclose(wall.points, [(3, 9), (4.5, 12)], atol=0.05), "along the line that was drawn"
    assert wall.points[1][1] == 12
    assert t.complaints == []


def test_gravity_is_dragged_on_the_dial_and_pressed_by_keys(table):
    t = table()
    t.show("parameters")
    box = t.box("dial")
    middle = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    high = next(each["high"] for each in t.view._session._hands.told(t.sim)["parameters"] if each["name"] == "gravity")
    t.page.mouse.move(*middle)
    t.page.mouse.down()
    for k in range(1, 6):
        t.page.mouse.move(middle[0], middle[1] + k * box["height"] / 20)
    t.page.mouse.up()
    until(lambda: t.sim.scene.gravity == pytest.approx((0, -high / 2), rel=0.005, abs=0.005 * high))  # the last place
    until(lambda: t.page.evaluate("JSON.parse(dial.dataset.value)") == t.sim.scene.gravity.tolist())
    pulled = t.sim.scene.gravity.copy()
    t.page.focus("#dial")
    t.keys("ArrowRight")
    until(lambda: t.sim.scene.gravity[0] == pytest.approx(high / 10))
    t.keys("Delete")
    until(lambda: t.sim.scene.gravity is None or not t.sim.scene.gravity.any())
    t.page.click("#undo")
    until(lambda: t.sim.scene.gravity is not None and t.sim.scene.gravity[0] == pytest.approx(high / 10))
    t.page.click("#undo")
    until(lambda: np.array_equal(t.sim.scene.gravity, pulled))
    t.page.click("#undo")
    until(lambda: t.sim.scene.gravity is None)
    assert t.what() == [], "all of one drag is taken back at once"
    assert t.complaints == []


def test_a_slider_changes_its_parameter_by_pointer_and_keys(table):
    t = table()
    t.show("parameters")
    box = t.box("change-restitution")
    y = box["y"] + box["height"] / 2
    t.page.mouse.move(box["x"] + box["width"] - 6, y)
    t.page.mouse.down()
    t.page.mouse.move(box["x"] + box["width"] / 2, y, steps=8)
    t.page.mouse.up()
    until(lambda: t.sim.scene.restitution == pytest.approx(0.5, abs=0.05))
    until(lambda: float(t.page.get_attribute("#change-restitution", "data-value")) == t.sim.scene.restitution)
    t.page.focus("#change-passes")
    t.keys("ArrowRight")
    until(lambda: t.sim.settings.passes == 2)
    t.page.select_option("#change-contact", "push")
    until(lambda: t.sim.settings.contact == "push")
    t.page.focus("#change-dt")
    t.keys("Home")
    until(lambda: t.sim.settings.dt == pytest.approx(0.001))
    for _ in range(3):
        t.page.click("#undo")
    until(lambda: (t.sim.settings.dt, t.sim.settings.contact, t.sim.settings.passes) == (0.01, "impact", 1))
    t.page.click("#undo")
    until(lambda: t.sim.scene.restitution == 1.0)
    until(lambda: t.page.input_value("#change-restitution") == "1000")
    assert t.complaints == []


def test_keys_do_what_the_pointer_does(table):
    t = table()
    t.keys("k")
    until(lambda: t.page.evaluate("document.activeElement.id") == "stage")
    for _ in range(4):
        t.keys("ArrowUp")
    t.keys("Enter")  # the nearest disc
    until(lambda: t.holding() is not None)
    number = t.holding().disc
    assert number == 1, "from the middle of the box"
    until(lambda: f"Disc {number} is held." in t.text("hand-note"))
    for _ in range(5):
        t.keys("ArrowUp")
    t.keys("Enter")
    until(lambda: t.holding() is None)
    step = 0.02 * t.page.evaluate("Math.min(stage.clientWidth, stage.clientHeight)")
    assert t.disc(1)[0] == pytest.approx(10, abs=0.01)
    assert t.disc(1)[1] > 6.5
    assert step > 1
    t.settle()
    t.keys("Enter")
    until(lambda: t.holding() is not None)
    t.keys("Shift+ArrowRight")
    until(lambda: t.sim.state.velocity[1].tolist() == [1.0, 0.0])
    t.settle()
    t.keys("x", "ArrowUp", "ArrowUp", "ArrowUp", "ArrowUp", "Enter")
    until(lambda: t.text("hand-note") == "No disc is under the cross.")
    t.keys("a", "Enter")
    until(lambda: t.sim.count == 5)
    t.settle()
    t.keys("x", "Enter")
    until(lambda: not t.sim.state.present[4])
    t.keys("z")
    until(lambda: bool(t.sim.state.present.all()))
    t.keys("Control+z")
    until(lambda: t.sim.count == 4)
    t.keys("Escape")
    assert t.complaints == []


def session_of(t, folder):
    name, content = t.download("keep-session")
    assert name.endswith("-session.zip")
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        archive.extractall(folder)
    return folder / "session.toml"


def test_a_session_and_a_program_of_the_page_have_the_bits_of_the_run(table, tmp_path):
    t = table(gas(30, 0.1), playing=True, context={"permissions": ["clipboard-read", "clipboard-write"]})
    t.page.click("#tool-remove")
    until(lambda: t.sim.frame > 10)
    while t.sim.state.present.all():
        t.page.mouse.click(*t.pixel(*t.disc(0)))
        time.sleep(0.1)
    t.keys("h")
    until(lambda: t.sim.frame > 30)
    t.keys("Space")
    until(lambda: t.text("phase") == "paused")
    present = int(np.flatnonzero(t.sim.state.present)[0])
    x, y = t.disc(present)
    t.drag((x, y), (x + 0.05, y + 0.05))
    until(lambda: t.holding() is None)
    before = t.sim.frame
    t.keys(".", ".", ".")
    until(lambda: t.sim.frame == before + 3 and t.text("phase") == "paused")
    digest, frame = t.sim.digest(), t.sim.frame
    path = session_of(t, tmp_path)
    for workers in (1, 2, 3):
        with mpsim.Simulation.replay(path, method="parallel", workers=workers) as again:
            assert (again.digest(), again.frame) == (digest, frame)
    t.page.click("#keep-program")
    until(lambda: "The program is copied" in t.text("keep-note"))
    text = t.page.evaluate("navigator.clipboard.readText()")
    assert text == t.page.input_value("#kept-text")
    assert digest in text
    file = tmp_path / "program.py"
    file.write_text(text)
    command = [sys.executable, file]
    outcome = subprocess.run(command, check=False, capture_output=True, text=True, cwd=tmp_path, timeout=300)
    assert (outcome.returncode, outcome.stderr) == (0, "")
    assert f"frame {frame}" in outcome.stdout
    assert t.complaints == []


def test_picture_film_and_scene_are_downloaded(table, tmp_path):
    t = table(gas(30, 0.1), playing=True, name="a gas")
    until(lambda: t.sim.frame > 30)
    t.keys("Space")
    until(lambda: t.text("phase") == "paused")
    name, content = t.download("keep-picture")
    assert name == f"a_gas-{t.sim.frame}.png"
    picture = np.asarray(Image.open(io.BytesIO(content)).convert("RGB"), int)
    box = t.page.locator("#discs-canvas").bounding_box()
    for x, y in t.sim.state.position:
        px, py = t.pixel(x, y)
        assert picture[round(py - box["y"]), round(px - box["x"])].tolist() != [255, 255, 255], "each disc is there"
    name, content = t.download("keep-film")
    assert name.endswith(".gif")
    assert Image.open(io.BytesIO(content)).n_frames > 4
    name, content = t.download("keep-scene")
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        archive.extractall(tmp_path)
    assert np.array_equal(mpsim.Scene.load(tmp_path / "scene.toml").position, t.sim.state.position)
    assert t.complaints == []


def test_an_address_that_waits_starts_paused_with_the_view_it_holds(table, capsys):
    t = table(mpsim.Scene.load("gas"), playing=True, query="?wait&speed=2&zoom=2&x=3&y=4", name="gas")
    until(lambda: t.text("phase") == "paused")
    assert t.sim.frame == 0
    until(lambda: t.text("speed-text").startswith("2×"))  # noqa: RUF001 - a sign that the page shows
    t.show("keep")
    t.page.click("#keep-address")
    text = until(lambda: t.page.input_value("#kept-text"))
    assert text.startswith(t.view.address + "?scene=gas&method=grid&wait&")
    assert {"speed=2", "zoom=2", "x=3", "y=4"} <= set(text.partition("?")[2].split("&"))
    assert t.complaints == []


@pytest.mark.parametrize("width", long_but([320, 390, 1280, 1920], 320))
def test_nothing_is_wider_than_the_screen_with_all_panels_open(table, width):
    t = table(size=(width, 800))
    t.show("parameters")
    t.show("keep")
    assert t.page.evaluate("document.documentElement.scrollWidth") <= width
    if width > 800:
        assert t.page.evaluate("document.documentElement.scrollHeight") <= 800


def test_a_finger_throws_a_disc(table):
    t = table(context={"has_touch": True}, size=(390, 800))
    t.page.locator("#stage").scroll_into_view_if_needed()
    t.gesture(*((10 + 0.2 * k, 6) for k in range(6)), finger=True)
    until(lambda: t.holding() is None and t.sim.state.velocity[1, 0] > 0)
    assert t.sim.state.velocity[1, 0] == pytest.approx(0.2 / 0.02 / 0.6, rel=0.02)
    assert t.complaints == []
