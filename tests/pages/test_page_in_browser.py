"""The page in a real browser: what is drawn, buttons, keys, pointer, fingers, what is kept, and the layout."""

# ruff: noqa: RUF001 - signs that the page shows

import base64
import contextlib
import io
import re
import shlex
import time
import zipfile

import numpy as np
import pytest
from PIL import Image
from support.browser import browser, until
from support.scenes import gas
from support.selection import long_but
from support.trajectories import written
from support.visitor import Visitor, kept, viewed

import mpsim
from mpsim import measure

pytestmark = [pytest.mark.plain, pytest.mark.slow]

GRID = mpsim.Settings(method="grid")
SCENE = gas(40, 0.3)
FOUR = mpsim.Scene(
    width=20, height=12, position=[[4, 6], [10, 6], [16, 6], [10, 2]], velocity=np.zeros((4, 2)), radius=0.5
)


@pytest.fixture(scope="module")
def opened():
    with browser() as found:
        yield found


@pytest.fixture
def table(opened):
    with contextlib.ExitStack() as stack:

        def begin(scene=FOUR, settings=GRID, query="", size=(1280, 800), context=None, **options):
            view = stack.enter_context(viewed(scene, settings, **{"playing": False, **options}))
            made = Table(opened, view, query, size, **(context or {}))
            stack.callback(made.close)
            return made

        yield begin


def brightness(picture):
    return picture[..., :3].astype(float) @ (0.2126, 0.7152, 0.0722)


# --- what is drawn


@pytest.mark.parametrize(("query", "by"), long_but([("", "ByWebGL"), ("?canvas=2d", "ByCanvas")], ("", "ByWebGL")))
def test_discs_are_drawn_where_they_are_as_large_as_they_are_and_faster_is_brighter(table, query, by):
    t = table(SCENE, query=query)
    assert t.page.get_attribute("#stage", "data-drawn-by") == by
    picture = t.canvas()
    height, width = picture.shape[:2]
    scale = 0.96 * min(width / SCENE.width, height / SCENE.height)
    x = width / 2 + (SCENE.position[:, 0] - SCENE.width / 2) * scale
    y = height / 2 - (SCENE.position[:, 1] - SCENE.height / 2) * scale
    centres = picture[y.astype(int), x.astype(int)]
    assert (centres[:, 3] == 255).all(), "each disc is there"
    assert (picture[:, :, 3] > 127).sum() / scale**2 == pytest.approx(40 * np.pi * 0.25, rel=0.03), "and nothing else"
    ranks = [np.argsort(np.argsort(each)) for each in (np.hypot(*SCENE.velocity.T), brightness(centres))]
    assert np.corrcoef(*ranks)[0, 1] > 0.95
    fetched = t.page.evaluate("performance.getEntriesByType('resource').map((each) => each.name)")
    assert fetched
    assert all(name.startswith(t.view.address) for name in fetched), "nothing is fetched from elsewhere"
    assert t.complaints == []


# --- buttons, keys, numbers


def test_buttons_and_keys_do_what_they_say_and_numbers_are_those_of_the_library(table):
    t = table(SCENE)
    assert t.text("frames_per_second") == "–", "before anything has run"
    t.page.click("#play")
    until(lambda: t.frame > 5 and t.text("play") == "Pause")
    t.keys("Space")
    until(lambda: t.text("phase") == "paused" and t.frame == kept(t.view.address).frame)
    frame = t.frame
    t.page.click("#step")
    until(lambda: t.frame == frame + 1)
    t.keys(".")
    until(lambda: t.frame == frame + 2)
    with mpsim.Simulation(SCENE, GRID) as alone:
        report = alone.run(frames=frame + 2)
        assert kept(t.view.address).digest == alone.digest(), "the page has changed no bit"
        state = alone.state
        until(lambda: t.text("collisions") == f"{report.collisions:,}")
        assert (t.text("frame"), t.text("discs")) == (f"{alone.frame:,}", "40")
        assert float(t.text("time")) == pytest.approx(alone.time, rel=1e-3)
    assert t.text("collisions-note") == "since the start, between discs"
    temperature = measure.temperature(state, SCENE)
    until(lambda: float(t.page.get_attribute("#temperature", "data-value") or -1) == temperature)
    t.keys("]")
    until(lambda: t.text("speed-text") == "2×, 120 frames a second")
    t.keys("[", "[")
    until(lambda: t.text("speed-text") == "1/2×, 30 frames a second")
    t.keys("m")
    until(lambda: t.text("speed-text") == "as fast as possible")
    t.keys("r")
    until(lambda: t.frame == 0)
    t.page.focus("#step")
    t.keys("Space")  # the button's own
    until(lambda: t.frame == 1)
    assert t.text("phase") == "paused"
    t.page.focus("#speed")
    t.keys("Home")
    until(lambda: t.text("speed-text") == "1/100×, 0.6 frames a second")
    assert t.complaints == []


@pytest.mark.long
def test_discs_have_the_colours_of_a_program_and_one_is_labelled_followed_and_has_a_trail(table):
    t = table(SCENE, colour=np.arange(40.0))
    until(lambda: t.text("legend-name") == "own values")
    until(lambda: np.ptp(t.canvas()[..., 1]) > 0)
    t.page.mouse.move(*t.pixel(*SCENE.position[7]))
    until(lambda: t.text("disc-label").startswith("disc 7: "))
    t.page.focus("#stage")
    t.page.mouse.move(*t.pixel(*(SCENE.position[7] + 0.05)))
    t.keys("f")
    until(lambda: t.page.get_attribute("#stage", "data-followed") == "7")
    t.page.click("#play")
    until(lambda: t.frame > 30)
    t.page.click("#play")
    until(lambda: t.text("phase") == "paused" and t.frame == kept(t.view.address).frame)
    box = t.page.locator("#discs-canvas").bounding_box()
    until(lambda: t.canvas()[round(box["height"] / 2), round(box["width"] / 2)][3] == 255)  # in the middle
    assert t.canvas("hand-canvas").any(), "its trail"
    t.keys("f")
    until(lambda: t.page.get_attribute("#stage", "data-followed") == "")
    assert t.complaints == []


# --- hands


def test_discs_are_dragged_thrown_added_and_removed(table):
    t = table()
    t.drag((6, 9), (8, 10))  # the background
    assert t.what() == []
    t.keys("0")
    t.drag((4.2, 6.1), (8.2, 9.1))
    until(lambda: t.holding() == [] and np.allclose(t.disc(0), (8, 9), atol=0.03))
    assert set(t.what()) == {"set"}
    until(lambda: t.seen(8, 9) != WHITE)  # it is drawn there
    until(lambda: t.seen(4, 6) == WHITE)
    t.settle()
    t.gesture(*((10 + 0.2 * k, 6 + 0.1 * k) for k in range(9)), rest=0.1)
    until(lambda: t.holding() == [] and np.allclose(t.disc(1), (11.6, 6.8), atol=0.03))
    t.page.click("#tool-add")
    t.click(5, 10)
    until(lambda: len(t.picture.colour) == 5 and np.allclose(t.disc(4), (5, 10), atol=0.05))
    until(lambda: t.text("discs") == "5")
    t.settle()
    t.gesture((1, 3.5), (9, 3.5), (9, 1), apart=0.0)
    until(lambda: len(t.picture.colour) > 5 + 7)
    time.sleep(0.2)
    drawn = t.picture.position[5:]
    row = np.sort(drawn[drawn[:, 1] > 3.4][:, 0])
    assert 0.999 <= np.diff(row).min() <= np.diff(row).max() < 1.1, "one beside the other, without gaps"
    t.page.click("#tool-remove")
    t.settle()
    t.click(16, 6)
    until(lambda: not t.present[2])
    t.page.click("#undo")
    until(lambda: bool(t.present.all()))
    t.page.click("#undo")
    until(lambda: len(t.picture.colour) == 5)  # a stroke is taken back as one
    for _ in range(3):
        t.page.click("#undo")
    until(lambda: len(t.picture.colour) == 4 and t.page.is_disabled("#undo"))
    assert t.what() == []
    t.keys("h")
    t.settle()
    t.gesture(*((4 + 0.2 * k, 6 + 0.1 * k) for k in range(9)))
    until(t.what)
    expected = np.array([0.2, 0.1]) / 0.02 / (60 * 0.01)  # length a time of the simulation: 60 frames of 0.01 a second
    t.keys(".")
    until(lambda: t.frame == 1)
    before = t.disc(0)
    t.keys(".", ".", ".")
    until(lambda: t.picture.frame == 4)
    assert (t.disc(0) - before) / 0.03 == pytest.approx(expected, rel=0.05), "thrown as the pointer moved"
    assert t.complaints == []


def test_a_held_disc_follows_in_a_run_and_is_let_go_when_its_page_is_closed(table):
    t = table(playing=True)
    mouse = t.page.mouse
    mouse.move(*t.pixel(4, 6))
    mouse.down()
    until(t.holding)
    frame = t.frame
    mouse.move(*t.pixel(7, 8), steps=10)
    until(lambda: t.frame > frame + 20 and np.allclose(t.disc(0), (7, 8), atol=0.05))
    assert t.text("phase") == "playing"
    t.page.close()
    until(lambda: t.holding() == [])
    assert t.complaints == []


def test_walls_are_drawn_dragged_and_removed_by_pointer_and_keys(table):
    def walls():
        return t.last("obstacles")["capsules"]

    t = table()
    t.page.click("#tool-wall")
    t.drag((7, 12.1), (7, 4))
    until(lambda: len(walls()) == 1)
    assert np.allclose(walls()[0][:4], (7, 12, 7, 4), atol=0.05)
    until(lambda: t.seen(7, 8) == [0x3A, 0x3F, 0x45])  # it is drawn there
    t.drag((9, 9), (9.2, 9))
    until(lambda: "as long as a disc is w" in t.text("hand-note"))
    t.drag((3, 9), (6, 15))
    until(lambda: len(walls()) == 2)
    assert np.allclose(walls()[1][:4], (3, 9, 4.5, 12), atol=0.05), "along the line that was drawn"
    t.keys("k", *["ArrowUp"] * 5, "Enter", *["ArrowRight"] * 9)
    assert len(walls()) == 2, "nothing before the second end"
    t.keys("Enter")
    until(lambda: len(walls()) == 3)
    t.keys("Enter", "ArrowRight", "Escape")
    assert t.what() == ["add_wall"] * 3, "Escape forgets a wall that has one end"
    t.keys("z", "z")
    until(lambda: len(walls()) == 1)
    t.keys("h")
    t.drag((7, 8), (4, 6))  # the first one, across disc 0, which makes room
    until(lambda: t.last("obstacles")["numbers"] == [1])
    assert np.allclose(walls()[0][:4], (4, 10, 4, 2), atol=0.05)
    until(lambda: t.seen(4, 8) == [0x3A, 0x3F, 0x45] and t.seen(7, 8) == WHITE)
    until(lambda: np.hypot(*(t.disc(0) - (4, 6))) == pytest.approx(0.625, abs=0.02))
    t.drag((4, 8), (25, 8))
    until(lambda: t.last("obstacles")["numbers"] == [2])
    assert np.allclose(walls()[0][:4], (20, 10, 20, 2), atol=0.05), "it stays in the box"
    t.keys("x")
    t.click(19.9, 4)
    until(lambda: walls() == [])
    assert t.what() == ["add_wall", "remove_wall", "set", "add_wall", "remove_wall", "add_wall", "remove_wall"]
    t.keys("z")
    until(lambda: len(walls()) == 1)
    t.keys("z", "z", "z")
    until(lambda: walls() == [] and t.page.is_disabled("#undo"))
    assert t.complaints == []


def test_a_container_is_dragged_by_its_circle_and_removed(table):
    ring = mpsim.Circle((10, 6), 4, inside=True)
    disc = {"position": [[10, 6]], "velocity": [[0, 0]], "radius": 0.5}
    t = table(mpsim.Scene(width=20, height=12, **disc, obstacles=ring))
    t.drag((13.9, 6), (14.9, 6))
    until(lambda: t.last("obstacles")["numbers"] == [1])
    assert np.allclose(t.last("obstacles")["capsules"][0][:2], (11, 6), atol=0.05)
    t.keys("x")
    t.click(11, 2.1)
    until(lambda: t.last("obstacles")["capsules"] == [])
    assert t.complaints == []


def test_keys_do_what_the_pointer_does_and_fingers_too(table):
    t = table()
    t.keys("k")
    until(lambda: t.page.evaluate("document.activeElement.id") == "stage")
    t.keys(*["ArrowUp"] * 4, "Enter")  # the nearest disc
    until(lambda: t.holding() == [1])
    until(lambda: "Disc 1 is held." in t.text("hand-note"))
    t.keys(*["ArrowUp"] * 5, "Enter")
    until(lambda: t.holding() == [] and t.disc(1)[1] > 6.5)
    t.settle()
    t.keys("Enter")
    until(lambda: t.holding() == [1])
    t.keys("Shift+ArrowRight")  # thrown
    until(lambda: t.holding() == [])
    t.settle()
    t.keys("x", *["ArrowUp"] * 4, "Enter")
    until(lambda: t.text("hand-note") == "No disc and no wall is under the cross.")
    t.keys("a", "Enter")
    until(lambda: len(t.picture.colour) == 5)
    t.settle()
    t.keys("x", "Enter")
    until(lambda: not t.present[4])
    t.keys("z")
    until(lambda: bool(t.present.all()))
    t.keys("Control+z")
    until(lambda: len(t.picture.colour) == 4)
    assert t.complaints == []
    finger = table(context={"has_touch": True}, size=(390, 800))
    finger.page.locator("#stage").scroll_into_view_if_needed()
    finger.gesture(*((10 + 0.2 * k, 6) for k in range(6)), finger=True)
    until(lambda: finger.holding() == [] and finger.what() and finger.disc(1)[0] > 10.5)
    assert finger.complaints == []


# --- what is kept, and addresses


def test_what_is_kept_has_the_bits_of_the_run_and_the_discs_of_the_picture(table, tmp_path):
    t = table(gas(20, 0.1), name="a gas", context={"permissions": ["clipboard-read", "clipboard-write"]})
    t.keys(".", ".", ".")
    until(lambda: t.frame == 3)
    t.page.click("#tool-remove")
    t.click(*t.disc(0))
    until(lambda: not t.present[0])
    t.keys(".", ".")
    until(lambda: t.frame == 5 and t.picture.frame == 5)
    name, content = t.download("keep-session")
    assert name == "a_gas-5-session.zip"
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        archive.extractall(tmp_path)
    session = kept(t.view.address)
    with mpsim.Simulation.replay(tmp_path / "session.toml") as again:
        assert (again.digest(), again.frame) == (session.digest, 5)
    t.page.click("#keep-address")
    until(lambda: "The address is copied" in t.text("keep-note"))
    assert t.page.evaluate("navigator.clipboard.readText()") == t.page.input_value("#kept-text")
    name, content = t.download("keep-picture")
    assert name == "a_gas-5.png"
    picture = np.asarray(Image.open(io.BytesIO(content)).convert("RGB"), int)
    box = t.page.locator("#discs-canvas").bounding_box()
    for x, y in t.picture.position[t.present]:
        px, py = t.pixel(x, y)
        assert picture[round(py - box["y"]), round(px - box["x"])].tolist() != WHITE, "each disc is there"
    name, content = t.download("keep-film")
    assert (name[-4:], Image.open(io.BytesIO(content)).n_frames > 1) == (".gif", True)
    until(lambda: "send the file under Session" in (t.page.text_content("#keep-command-note") or ""))
    assert t.page.is_disabled("#keep-command"), "a scene of one's own has no command"
    assert t.complaints == []


def test_an_address_says_how_a_page_begins_and_what_is_copied_asks_for_what_is_shown(table):
    t = table(mpsim.Scene.load("gas"), playing=True, query="?wait&speed=2&zoom=2&x=3&y=1", name="gas")
    until(lambda: t.text("phase") == "paused" and t.text("speed-text").startswith("2×"))
    frame = t.frame
    time.sleep(0.2)
    assert t.frame == frame
    t.show("keep")
    t.page.click("#keep-address")
    text = until(lambda: t.page.input_value("#kept-text"))
    assert text.startswith(t.view.address + "?scene=gas&")
    assert {"speed=2", "zoom=2", "x=3", "y=1", "wait"} <= set(text.partition("?")[2].split("&"))
    assert t.page.evaluate("import('./stage.js').then(({camera}) => [camera.zoom, camera.x, camera.y])") == [2, 3, 1]
    t.show("beside")
    t.page.select_option("#beside-choice", "event")
    until(lambda: "beside=event" in (t.last("link")["text"] or ""))
    until(lambda: t.page.is_enabled("#keep-command"))
    t.page.click("#keep-command")
    words = shlex.split(until(lambda: (found := t.page.input_value("#kept-text")).startswith("mpsim") and found))
    assert words[:2] == ["mpsim", "view"]
    assert words[2].startswith(f"?{t.last('link')['text']}&wait")
    assert t.complaints == []


@pytest.mark.long
def test_an_address_that_asks_for_another_run_is_explained_and_wrong_numbers_in_it_do_nothing(table):
    other = table(mpsim.Scene.load("cradle"), name="cradle", query="?wait&zoom=nan&speed=quick&x=1")
    assert other.complaints == []
    page = other.context.new_page()
    page.goto(other.view.address + "?wait&method=grid&scene=gas&%3Cimg%20src=x%20onerror=alert(1)%3E")
    until(lambda: "In a terminal: mpsim view '?wait&method=grid&scene=gas" in page.inner_text("#hand-note"))
    assert page.locator("#hand-note img").count() == 0


# --- two stages


def test_two_stages_and_other_random_numbers(table):
    settings = mpsim.Settings(method="grid", contact="push", dt=0.01)
    t = table(SCENE, settings, beside=mpsim.Settings(method="event"))

    def value(name):
        return float(t.page.get_attribute(f"#trade-{name}", "data-value") or "nan")

    t.keys(".", ".", ".")
    until(lambda: t.frame == 3)
    states = []
    for each in (settings, mpsim.Settings(method="event", dt=0.01)):
        with mpsim.Simulation(SCENE, each) as sim:
            sim.run(frames=3)
            states.append(sim.state)
    expected = measure.trajectory_error(*states, SCENE).rms
    until(lambda: value("distance") == pytest.approx(expected, rel=1e-9))
    assert (t.text("first-name"), t.text("second-name")) == ("grid push dt=0.01", "event, exact")
    first, second = t.canvas(), t.canvas("second-discs")
    assert (first[..., 3] > 0).mean() == pytest.approx((second[..., 3] > 0).mean(), rel=0.02)
    t.page.fill("#seed", "5")
    t.keys("Enter")
    until(lambda: t.frame == 0 and t.last("scene")["seed"] == 5)
    t.show("beside")
    t.page.select_option("#beside-choice", "", force=True)
    until(lambda: not t.page.is_visible("#second") and not t.page.is_visible("#trade"))
    assert t.complaints == []


# --- a recording


@pytest.mark.long
def test_the_time_line_is_moved_by_pointer_and_keys(table, tmp_path):
    path = tmp_path / "run.xyz"
    written(path, gas(20, 0.2), frames=100, every=5, method="naive")
    t = table(mpsim.Trajectory(path), None, size=(390, 800))
    assert t.text("timeline-text") == "1 of 21"
    box = t.box("timeline")
    t.page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    until(lambda: t.frame == 50)
    t.page.focus("#stage")
    for key, frame in ((",", 45), ("Home", 0), (".", 5), ("End", 100), ("r", 0)):
        t.keys(key)
        until(lambda frame=frame: t.frame == frame)
    t.page.click("#step")
    until(lambda: t.frame == 5)
    t.page.click("#back")
    until(lambda: t.frame == 0 and t.page.is_disabled("#back"))
    t.keys("l")
    until(lambda: t.frame == 100 and t.page.get_attribute("#follow", "aria-pressed") == "true")
    t.keys("x", "f", "]")  # keys of runs, which a recording has not
    until(lambda: t.text("speed-text") == "1×, 60 recorded frames a second")
    assert t.page.get_attribute("#follow", "aria-pressed") == "true", "it follows the file still"
    t.page.click("#play")  # at the end: again from the start
    until(lambda: t.text("phase") == "playing" and t.frame < 60)
    t.keys("m")
    until(lambda: t.text("phase") == "paused" and t.frame == 100)
    hidden = ("#tools", "#parameters", "#keep-session", "#frames_per_second")
    assert [name for name in hidden if t.page.is_visible(name)] == []
    name, _ = t.download("keep-film")
    assert name == "run_xyz-100.gif"
    assert t.complaints == []


# --- other sites, and the end


CONNECTED = """(where) => new Promise((end) => {
    const socket = new WebSocket(where);
    socket.onopen = () => end("open");
    socket.onerror = () => end("refused");
})"""


def test_another_site_cannot_read_or_connect_and_the_end_is_told(table):
    t = table(SCENE, playing=True)
    until(lambda: t.frame > 5)
    other = t.context.new_page()
    other.route("http://evil.example/", lambda route: route.fulfill(body="<p>evil</p>", content_type="text/html"))
    other.goto("http://evil.example/")
    fetched = "(where) => fetch(where).then(() => 'read', () => 'refused')"
    address = re.sub("^http", "ws", t.view.address) + "socket"
    assert other.evaluate(fetched, t.view.address) == "refused"
    assert other.evaluate(CONNECTED, address) == "refused"
    assert t.page.evaluate(CONNECTED, address) == "open", "the control: its own page can"
    other.close()
    t.watch.say("visible", value=False)
    t.page.goto("about:blank")
    time.sleep(0.4)
    frame = kept(t.view.address).frame
    time.sleep(0.3)
    assert kept(t.view.address).frame == frame, "a page that is left alone stops the run"
    t.page.goto(t.view.address)
    until(lambda: t.frame > frame)
    t.view.close()
    until(lambda: "No connection to mpsim" in t.text("notice"))
    assert t.page.is_disabled("#play")


# --- a page under the hands of somebody: pointer, fingers, keys, and what is seen

WHITE = [255, 255, 255]  # the ground below the discs


class Table:
    """A page of a view. Attributes: page (of Playwright), watch (another page, without a browser), complaints."""

    def __init__(self, opened, view, query="", size=(1280, 800), **options):
        self.view, self.complaints = view, []
        self.watch = Visitor(view.address)
        self.context = opened.new_context(viewport={"width": size[0], "height": size[1]}, **options)
        self.page = self.context.new_page()
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("console", lambda each: each.type == "error" and self.complaints.append(each.text))
        self.page.goto(view.address + query)
        until(lambda: self.text("phase") in ("paused", "playing") and self.page.get_attribute("#stage", "data-frame"))
        self.watch.say("visible", value=True)
        until(lambda: self.picture is not None and "scene" in self.watch.last)

    def close(self):
        self.context.close()
        self.watch.__exit__(None, None, None)

    # --- what the view says of itself

    def last(self, kind):
        """The last message of a kind to another page."""
        self.watch.hear_for(0.02)
        return self.watch.last.get(kind, {})

    @property
    def picture(self):
        self.watch.hear_for(0.02)
        return self.watch.picture

    @property
    def present(self):
        return self.picture.colour != 255

    def disc(self, number):
        return self.picture.position[number]

    def holding(self):
        return self.last("hands")["held"]

    def values(self):
        self.watch.hear_for(0.02)
        return self.watch.values

    def what(self):
        return kept(self.view.address).changes

    # --- what is seen

    def text(self, name):
        return self.page.inner_text(f"#{name}")

    @property
    def frame(self):
        return int(self.page.get_attribute("#stage", "data-frame") or -1)

    def canvas(self, name="discs-canvas"):
        """What is drawn there, without what lies below it: shape (height, width, 4)."""
        url = self.page.evaluate(f"document.getElementById('{name}').toDataURL()")
        return np.asarray(Image.open(io.BytesIO(base64.b64decode(url.partition(",")[2]))).convert("RGBA"))

    def seen(self, x, y):
        """Colour of the screen at a place of the box."""
        picture = np.asarray(Image.open(io.BytesIO(self.page.screenshot())).convert("RGB"), int)
        x, y = self.pixel(x, y)
        return picture[int(y), int(x)].tolist()

    def pixel(self, x, y):
        """Where a place of the box is on the screen."""
        box, scene = self.page.locator("#discs-canvas").bounding_box(), self.watch.last["scene"]
        scale = 0.96 * min(box["width"] / scene["width"], box["height"] / scene["height"])
        middle = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        return middle[0] + (x - scene["width"] / 2) * scale, middle[1] - (y - scene["height"] / 2) * scale

    def box(self, name):
        """Where something is on the screen, after scrolling to it."""
        found = self.page.locator(f"#{name}")
        found.scroll_into_view_if_needed()
        return found.bounding_box()

    def show(self, panel):
        if self.page.get_attribute(f"#{panel}", "open") is None:
            self.page.click(f"#{panel} summary")

    # --- what is done

    def keys(self, *keys):
        for key in keys:
            self.page.keyboard.press(key)

    def click(self, x, y):
        self.page.mouse.click(*self.pixel(x, y))

    def drag(self, start, end, steps=6, pause=0.15):
        """Press at a place, go to another one, stay there for some time, and let go."""
        mouse = self.page.mouse
        mouse.move(*self.pixel(*start))
        mouse.down()
        mouse.move(*self.pixel(*end), steps=steps)
        time.sleep(pause)
        mouse.up()

    def gesture(self, *places, apart=0.02, rest=0.01, finger=False):
        """Press at the first of some places, go to the others, and let go. The times of the events [s] are those given,
        however busy the machine is: between two places, and from the last one to letting go."""
        session, begun, last = self.context.new_cdp_session(self.page), time.time(), len(places) - 1
        names = ("touchStart", "touchMove", "touchEnd") if finger else ("mousePressed", "mouseMoved", "mouseReleased")
        for k, kind in enumerate([names[0], *[names[1]] * last, names[2]]):
            x, y = self.pixel(*places[min(k, last)])
            event = {"type": kind, "timestamp": begun + apart * min(k, last) + rest * (k > last)}
            if finger:
                points = [] if k > last else [{"x": x, "y": y}]
                session.send("Input.dispatchTouchEvent", {**event, "touchPoints": points})
            else:
                button = {"button": "left", "buttons": 1, "clickCount": 1}
                session.send("Input.dispatchMouseEvent", {**event, **button, "x": x, "y": y})
        session.detach()

    def settle(self):
        """Wait until the page shows the discs where they are: it acts on the discs that are seen."""
        places = "import('./common.js').then(({state}) => [...state.picture.places])"

        def settled():
            found = np.reshape(self.page.evaluate(places), (-1, 2)) / 65535 * np.array(self.picture.extent)
            return len(found) == len(self.watch.picture.colour) and np.allclose(
                found[self.present], self.watch.picture.position[self.present], atol=0.01
            )

        until(settled)

    def download(self, button):
        self.show("keep")
        with self.page.expect_download() as waiting:
            self.page.click(f"#{button}")
        with open(waiting.value.path(), "rb") as file:
            return waiting.value.suggested_filename, file.read()
