"""The page in a real browser: buttons and keys, what is drawn, and numbers beside the library's."""

# ruff: noqa: RUF001 - signs that the page shows

import base64
import contextlib
import io
import pathlib
import re
import time

import numpy as np
import pytest
from PIL import Image
from support.browser import until
from support.scenes import gas
from support.selection import long_but
from support.viewing import viewed

import mpsim
from mpsim import measure
from mpsim.viewer.compiling import LISTENERS

pytestmark = pytest.mark.slow

GRID = mpsim.Settings(method="grid")
SCENE = gas(100, 0.3)


class Page:
    """A page of a view in the browser, and what it complains of."""

    def __init__(self, opened, view, size=(1280, 800), query=""):
        self.view, self.complaints = view, []
        self.page = opened.new_page(viewport={"width": size[0], "height": size[1]})
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("console", self._note)
        self.page.goto(view.address + query)

    def _note(self, message):
        if message.type == "error":
            self.complaints.append(message.text)

    @property
    def sim(self):
        return self.view._session._sim

    def text(self, name: str) -> str:
        return self.page.inner_text(f"#{name}")

    @property
    def frame(self) -> int:
        return int(self.page.get_attribute("#stage", "data-frame") or -1)

    def settle(self) -> int:
        """Wait until the paused page shows the frame and the gauges of the simulation; returns that frame."""
        until(lambda: self.text("phase") == "paused" and self.frame == self.sim.frame)
        expected = measure.temperature(self.sim.state, self.sim.scene)
        until(lambda: float(self.page.get_attribute("#temperature", "data-value") or -1) == expected)
        return self.frame

    def rests(self) -> bool:
        """Whether no frame is run for some time."""
        before = self.sim.frame
        time.sleep(0.4)
        return self.sim.frame == before

    def stage(self) -> np.ndarray:
        """The discs as they are drawn, without what lies below them: shape (height, width, 4)."""
        url = self.page.evaluate("document.getElementById('discs-canvas').toDataURL()")
        return np.asarray(Image.open(io.BytesIO(base64.b64decode(url.partition(",")[2]))).convert("RGBA"))


@pytest.fixture
def shown(opened, capsys):
    with contextlib.ExitStack() as stack:

        def show(scene=SCENE, settings=GRID, size=(1280, 800), query="", **options):
            page = Page(opened, stack.enter_context(viewed(scene, settings, **options)), size, query)
            stack.callback(page.page.close)
            return page

        yield show


@pytest.mark.parametrize(("query", "by"), [("", "ByWebGL"), ("?canvas=2d", "ByCanvas")])
def test_discs_are_drawn_where_they_are(shown, query, by):
    page = shown(query=query, playing=False)
    page.settle()
    assert page.page.get_attribute("#stage", "data-drawn-by") == by
    picture = page.stage()
    height, width = picture.shape[:2]
    scale = 0.96 * min(width / SCENE.width, height / SCENE.height)
    x = width / 2 + (SCENE.position[:, 0] - SCENE.width / 2) * scale
    y = height / 2 - (SCENE.position[:, 1] - SCENE.height / 2) * scale
    centres = picture[y.astype(int), x.astype(int)]
    assert (centres[:, 3] == 255).all(), "each disc is there"
    area = (picture[:, :, 3] > 127).sum() / scale**2
    assert area == pytest.approx(100 * np.pi * 0.25, rel=0.03), "at true radius, and nothing else"
    order = np.argsort(np.hypot(*SCENE.velocity.T))
    brightness = centres[:, :3].astype(float) @ (0.2126, 0.7152, 0.0722)
    assert np.corrcoef(np.argsort(order), np.argsort(np.argsort(brightness)))[0, 1] > 0.95, "faster is brighter"
    assert page.complaints == []


def test_small_discs_are_drawn_at_true_radius(shown):
    radius = np.linspace(0.2, 0.7, 100)
    place = np.stack(np.divmod(np.arange(100), 10), axis=1) * 10.03 + 4.9
    scene = mpsim.Scene(width=100, height=100, position=place, velocity=radius[:, None] * [1, 0], radius=radius)
    page = shown(scene, playing=False)
    until(lambda: page.frame == 0 and page.text("phase") == "paused")
    picture = page.stage()
    height, width = picture.shape[:2]
    scale = 0.96 * height / 100
    x = (width / 2 + (place[:, 0] - 50) * scale).astype(int)
    y = (height / 2 - (place[:, 1] - 50) * scale).astype(int)
    found = np.array([picture[b - 8 : b + 9, a - 8 : a + 9, 3].sum() / 255 for a, b in zip(x, y, strict=True)])
    assert found == pytest.approx(np.pi * (radius * scale) ** 2, rel=0.15)
    assert picture[..., 3].sum() / 255 == pytest.approx(found.sum()), "and nothing elsewhere"
    brightness = picture[y, x, :3].astype(float) @ (0.2126, 0.7152, 0.0722)
    assert (np.diff(brightness) >= 0).all(), "faster is brighter"
    middles = "[median(state.radii), median([3]), median([]), median([2, 1, 5])]"
    middles = f"import('./common.js').then(({{median, state}}) => {middles})"
    assert page.page.evaluate(middles) == [float(np.float32(radius[50])), 3, 0, 2]
    assert page.complaints == []


def test_buttons_do_what_they_say_and_numbers_are_those_of_the_library(shown):
    page = shown()
    until(lambda: page.frame > 5)
    assert page.text("play") == "Pause"
    page.page.click("#play")
    frame = page.settle()
    assert page.text("play") == "Play"
    page.page.click("#step")
    until(lambda: page.frame == frame + 1)
    assert page.settle() == page.sim.frame
    state = page.sim.state
    with mpsim.Simulation(SCENE, GRID) as alone:
        report = alone.run(frames=page.sim.frame)
        assert alone.digest() == page.sim.digest(), "the page has changed no bit"
        alone_time = alone.time
    assert page.text("frame") == f"{page.sim.frame:,}"
    assert float(page.text("time")) == pytest.approx(alone_time, rel=1e-3)
    assert page.text("discs") == "100"
    until(lambda: page.text("collisions") == f"{report.collisions:,}")
    assert page.text("collisions-note") == "since the start, between discs"
    assert float(page.text("temperature")) == pytest.approx(measure.temperature(state, SCENE), rel=1e-3)
    drift = float(page.page.get_attribute("#energy_drift", "data-value") or 0)
    assert abs(drift) < 1e-12
    page.page.click("#reset")
    until(lambda: page.sim is not None and page.frame == 0)
    assert page.complaints == []


def test_keys_do_what_buttons_do(shown):
    page = shown(playing=False)
    page.settle()
    page.page.keyboard.press(".")
    until(lambda: page.frame == 1)
    page.page.keyboard.press("]")
    until(lambda: page.text("speed-text") == "2×, 120 frames a second")
    page.page.keyboard.press("[")
    page.page.keyboard.press("[")
    until(lambda: page.text("speed-text") == "1/2×, 30 frames a second")
    page.page.keyboard.press("m")
    until(lambda: page.text("speed-text") == "as fast as possible")
    page.page.keyboard.press("Space")
    until(lambda: page.frame > 200)
    page.page.keyboard.press("Space")
    page.settle()
    page.page.keyboard.press("r")
    until(lambda: page.frame == 0)
    page.page.focus("#step")
    page.page.keyboard.press("Space")  # the button's own
    until(lambda: page.frame == 1)
    time.sleep(0.2)
    assert (page.frame, page.text("phase")) == (1, "paused")
    page.page.focus("#speed")
    page.page.keyboard.press("Home")
    until(lambda: page.text("speed-text") == "1/100×, 0.6 frames a second")
    assert page.complaints == []


def test_the_wheel_zooms_on_the_stage_and_scrolls_elsewhere(shown):
    page = shown(size=(390, 700), playing=False)
    page.settle()
    before = page.stage()
    page.page.mouse.move(195, 300)
    page.page.mouse.wheel(0, -300)
    until(lambda: (page.stage()[:, :, 3] > 127).sum() != (before[:, :, 3] > 127).sum())
    assert page.page.evaluate("scrollY") == 0
    page.page.keyboard.press("0")
    until(lambda: np.array_equal(page.stage(), before))
    page.page.mouse.down()
    page.page.mouse.move(240, 320, steps=3)
    page.page.mouse.up()
    until(lambda: not (page.stage() == before).all())
    page.page.mouse.move(195, 690)
    page.page.mouse.wheel(0, 300)
    until(lambda: page.page.evaluate("scrollY") > 100)


@pytest.mark.parametrize("width", long_but([320, 390, 800, 1280, 1920], 320, 1280))
def test_nothing_is_wider_than_the_screen(shown, width):
    page = shown(size=(width, 800), playing=False)
    page.settle()
    assert page.page.evaluate("document.documentElement.scrollWidth") <= width
    if width > 800:
        assert page.page.evaluate("document.documentElement.scrollHeight") <= 800, "all is seen at once"
    for name in ("play", "step", "reset"):
        box = page.page.locator(f"#{name}").bounding_box()
        assert box["height"] >= 32, "large enough for a finger"
        assert box["x"] + box["width"] <= width


def test_before_anything_has_run_numbers_are_dashes(shown):
    page = shown(playing=False)
    page.settle()
    for name in ("collisions_per_second", "frames_per_second", "nanoseconds"):
        assert page.text(name) == "–"


def test_a_periodic_scene_shows_images_at_the_other_edge(shown):
    scene = mpsim.Scene(width=8, height=8, position=[[0.1, 4.0]], velocity=[[0, 0]], radius=1.0, boundary="periodic")
    page = shown(scene, playing=False)
    until(lambda: page.frame == 0 and page.text("phase") == "paused")
    picture = page.stage()
    height, width = picture.shape[:2]
    scale = 0.96 * height / 8
    row = picture[height // 2, :, 3] > 127
    right = int(width / 2 + 3.95 * scale)
    assert row[right - 5], "the image of the disc, at the other edge"
    assert not row[int(width / 2 + 4.05 * scale) :].any(), "and nothing beyond it"


def test_a_page_that_is_left_alone_stops_the_run_and_comes_back(shown):
    page = shown()
    until(lambda: page.frame > 5)
    page.page.goto("about:blank")
    until(page.rests)
    frame = page.sim.frame
    page.page.goto(page.view.address)
    until(lambda: page.frame > frame)


def test_it_says_what_is_compiled_while_it_is(shown):
    page = shown(playing=False)
    page.settle()
    assert not page.page.is_visible("#notice")
    LISTENERS.begin("compiling the loops for this scene, once; about 4 s")
    until(lambda: page.text("notice") == "Compiling the loops for this scene, once; about 4 s …")
    LISTENERS.end()
    until(lambda: not page.page.is_visible("#notice"))


def test_it_says_that_the_program_has_ended(shown):
    page = shown()
    until(lambda: page.frame > 5)
    page.view.close()
    until(lambda: "No connection to mpsim" in page.text("notice"))
    assert page.page.is_disabled("#play")


CONNECTED = """(where) => new Promise((end) => {
    const socket = new WebSocket(where);
    socket.onopen = () => end("open");
    socket.onerror = () => end("refused");
})"""


def test_another_site_cannot_read_or_connect(shown, opened):
    page = shown()
    until(lambda: page.frame > 5)
    other = opened.new_page()
    try:
        other.route("http://evil.example/", lambda route: route.fulfill(body="<p>evil</p>", content_type="text/html"))
        other.goto("http://evil.example/")
        fetched = "(where) => fetch(where).then(() => 'read', () => 'refused')"
        assert other.evaluate(fetched, page.view.address) == "refused"
        address = re.sub("^http", "ws", page.view.address) + "socket"
        assert other.evaluate(CONNECTED, address) == "refused"
        assert page.page.evaluate(CONNECTED, address) == "open", "negative control: its own page can"
    finally:
        other.close()


def test_nothing_is_fetched_from_elsewhere(shown, opened):
    page = shown()
    until(lambda: page.frame > 5)
    asked = page.page.evaluate("performance.getEntriesByType('resource').map((each) => each.name)")
    assert asked
    assert all(name.startswith(page.view.address) for name in asked)


DRAGGED = """([inside, from]) => {
    const data = new DataTransfer(), place = document.querySelector(inside).parentElement;
    place.scrollIntoView({ block: "center" });
    const { x, y } = place.querySelector(from).getBoundingClientRect();
    const where = { clientX: x + 5, clientY: y + 5, dataTransfer: data, bubbles: true };
    place.dispatchEvent(new DragEvent("dragstart", where));
    return Object.fromEntries(data.types.map((type) => [type, data.getData(type)]));
}"""


def dragged(page, gauge, begin):
    """What is dragged out of a gauge, by the element on which the drag begins: text by type."""
    return page.page.evaluate(DRAGGED, [gauge, begin])


def lines_of(found):
    return [line.split(",") for line in found["text/plain"].strip().split("\n")]


def test_gauges_are_saved_as_tables_and_pictures(shown):
    page = shown()
    until(lambda: page.text("temperature") != "–" and page.text("workers-note") not in ("", "not running"))
    page.page.click("#play")
    page.settle()
    until(lambda: lines_of(dragged(page, "#temperature", "dt"))[-1][0] == str(page.sim.frame))
    place = page.page.locator("#temperature").locator("xpath=..")
    for kind, begins in (("CSV", b"frame,time,temperature\n"), ("PNG", b"\x89PNG")):
        with page.page.expect_download() as waited:
            place.get_by_role("button", name=kind).click()
        content = pathlib.Path(waited.value.path()).read_bytes()
        assert content.startswith(begins)
        if kind == "CSV":
            frame, moment, value = map(float, content.decode().splitlines()[-1].split(","))
            assert (frame, moment) == (page.sim.frame, page.sim.time)
            assert value == measure.temperature(page.sim.state, SCENE)
    lines = lines_of(dragged(page, "#speeds", "figcaption"))
    assert lines[0] == ["from", "to", "density", "maxwell"]
    assert float(lines[-1][1]) == pytest.approx(np.hypot(*page.sim.state.velocity.T).max(), rel=1e-6)
    picture = dragged(page, "#speeds", "canvas")
    kind, name, link = picture["downloadurl"].split(":", 2)
    assert (kind, name) == ("image/png", f"mpsim-{page.sim.frame}-speeds.png")
    assert picture["text/uri-list"] == link
    assert base64.b64decode(link.removeprefix("data:image/png;base64,")).startswith(b"\x89PNG")
    assert page.complaints == []


def test_colours_are_chosen_and_the_legend_follows(shown):
    page = shown(colour=np.arange(100.0), playing=False)
    page.settle()
    until(lambda: page.page.input_value("#colour") == "own")
    offered = page.page.eval_on_selector_all("#colour option", "each => each.map((one) => one.value)")
    assert offered == ["speed", "worker", "column", "collision", "own"]
    until(lambda: np.ptp(page.stage()[..., 1]) > 0)
    before, legend = page.stage(), page.page.evaluate("document.getElementById('legend').toDataURL()")
    page.page.select_option("#colour", "column")
    until(lambda: page.page.evaluate("document.getElementById('legend').toDataURL()") != legend)
    until(lambda: not np.array_equal(page.stage(), before))
    page.page.select_option("#colour", "own")
    until(lambda: np.array_equal(page.stage(), before))
    assert page.complaints == []


def test_a_disc_is_labelled_followed_and_has_a_trail(shown):
    page = shown(playing=False)
    page.settle()
    box = page.page.locator("#discs-canvas").bounding_box()
    scale = 0.96 * min(box["width"] / SCENE.width, box["height"] / SCENE.height)

    def at(place):
        x = box["x"] + box["width"] / 2 + (place[0] - SCENE.width / 2) * scale
        return x, box["y"] + box["height"] / 2 - (place[1] - SCENE.height / 2) * scale

    page.page.mouse.move(*at(SCENE.position[7]))
    until(lambda: page.text("disc-label").startswith("disc 7: "))
    speed = float(page.text("disc-label").rpartition(" ")[2])
    assert speed == pytest.approx(np.hypot(*SCENE.velocity[7]), rel=0.02)
    page.page.keyboard.press("f")
    until(lambda: page.page.get_attribute("#stage", "data-followed") == "7")
    page.page.click("#play")
    until(lambda: page.sim.frame > 30)
    page.page.click("#play")
    page.settle()
    place = page.sim.state.position[7]

    def labelled():
        seen = page.page.inner_text("#disc-label").removeprefix("disc 7: ").partition(";")[0].split(", ")
        return np.abs(np.array(seen, float) - place).max() < 0.01

    until(labelled)
    until(lambda: page.stage()[round(box["height"] / 2), round(box["width"] / 2)][3] == 255)  # in the middle
    painted = page.page.evaluate("""() => {
        const canvas = document.getElementById("hand-canvas");
        return canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data.some((each) => each > 0);
    }""")
    assert painted, "its trail"
    page.page.keyboard.press("f")
    until(lambda: page.page.get_attribute("#stage", "data-followed") == "")
    assert page.complaints == []
