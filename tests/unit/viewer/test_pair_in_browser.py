"""Two stages, passes and moments on the page in a real browser, and its numbers beside the library's."""

import base64
import io
import time

import numpy as np
import pytest
from PIL import Image
from support.browser import until
from support.scenes import gas
from support.viewing import viewed

import mpsim
from mpsim import measure
from mpsim.viewer import tuning

pytestmark = pytest.mark.slow

SCENE = gas(300, 0.4)
GRID = mpsim.Settings(method="grid", contact="push", dt=0.01)


@pytest.fixture
def shown(opened, capsys):
    """A paused page with the exact solver beside the first stage, and the session behind it."""
    with viewed(SCENE, GRID, beside=mpsim.Settings(method="event"), playing=False) as view:
        page, complaints = opened.new_page(viewport={"width": 1280, "height": 800}), []
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.goto(view.address)
        until(lambda: page.inner_text("#phase") == "paused")
        yield page, view._session
        page.close()
        assert not complaints


def value(page, name):
    return float(page.get_attribute(f"#trade-{name}", "data-value") or "nan")


def frame(page):
    return int(page.get_attribute("#stage", "data-frame") or -1)


def drawn(page, canvas):
    url = page.evaluate(f"document.getElementById('{canvas}').toDataURL()")
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(url.partition(",")[2]))).convert("RGBA"))


def step(page, frames):
    for _ in range(frames):
        before = frame(page)
        page.click("#step")
        until(lambda before=before: frame(page) == before + 1)


def test_the_numbers_are_those_of_both_states(shown):
    page, session = shown
    step(page, 3)
    other = session._trade.pair.sim
    until(lambda: other.frame == 3)
    expected = measure.trajectory_error(session._sim.state, other.state, SCENE).rms
    until(lambda: value(page, "distance") == pytest.approx(expected, rel=1e-12))
    assert page.inner_text("#first-name") == "grid push dt=0.01"
    assert page.inner_text("#second-name") == "event, exact"
    assert page.evaluate("document.querySelector('#beside-choice').selectedOptions[0].text") == "event"
    assert not page.is_visible("#parted")
    first, second = drawn(page, "discs-canvas"), drawn(page, "second-discs")
    assert first.shape == second.shape
    assert (first[..., 3] > 0).mean() == pytest.approx((second[..., 3] > 0).mean(), rel=0.02)
    assert 0 < (np.abs(first.astype(int) - second).max(axis=2) > 60).mean() < 0.05, "nearly the same, and not the same"


def test_they_part_and_the_page_says_so(shown):
    page, session = shown
    page.keyboard.press("m")
    page.click("#play")
    until(lambda: page.is_visible("#parted"))
    page.click("#play")
    parted = session._trade.pair.comparison.parted
    assert parted > 0
    assert "The stages parted for good" in page.inner_text("#parted")
    assert page.inner_text("#trade-distance") == "parted"
    assert page.inner_text("#trade-missed").endswith("%"), "averages only"
    page.select_option("#beside-choice", "null", force=True)
    until(lambda: not page.is_visible("#second"))
    assert frame(page) == 0 or until(lambda: frame(page) == 0)
    assert not page.is_visible("#trade")


def test_passes_by_button_and_key(shown):
    page, session = shown
    step(page, 2)
    page.click("#pass")
    until(lambda: page.get_attribute("#stage", "data-pass") == "even 1/2")
    until(lambda: "no two brackets share a column" in page.inner_text("#pass-note"))
    assert session._sim.frame == 2
    until(lambda: drawn(page, "hand-canvas").any())  # the brackets
    page.keyboard.press("p")
    until(lambda: page.get_attribute("#stage", "data-pass") == "odd 2/2")
    until(lambda: frame(page) == 3)
    page.keyboard.press(".")
    until(lambda: page.get_attribute("#stage", "data-pass") == "")
    until(lambda: not drawn(page, "hand-canvas")[..., 3].any())


def test_where_there_are_no_passes_the_page_offers_a_restart_with_them(opened, capsys):
    few = gas(20, 0.3)  # `auto` takes the method naive
    with viewed(few, playing=False) as view:
        page, other = (opened.new_page(viewport={"width": 390, "height": 844}) for _ in range(2))
        for each in (page, other):
            each.goto(view.address)
            until(lambda each=each: each.inner_text("#phase") == "paused" and frame(each) == 0)
        step(page, 2)
        page.keyboard.press("p")
        until(lambda: page.is_visible("#asked-yes"))
        assert page.inner_text("#asked-text") == (
            "The method naive tests all pairs of discs at once, so a frame has no passes. The method grid has passes. "
            "A restart changes all pages of this view."
        )
        assert not page.is_visible("#pass-note")
        assert not other.is_visible("#asked"), "only the page that asked for a pass is asked"
        page.click("#asked-no")
        assert not page.is_visible("#asked")
        assert view._session._sim.frame == 2, "and nothing has changed"
        page.keyboard.press("p")
        until(lambda: page.is_visible("#asked-yes"))
        page.keyboard.press("Enter")  # the button has the focus
        for each in (page, other):
            until(lambda each=each: each.get_attribute("#stage", "data-pass") == "even 1/2")
            until(lambda each=each: "no two brackets share a column" in each.inner_text("#pass-note"))
            assert not each.is_visible("#asked")
        assert "method grid" in page.inner_text("#about")
        page.close()
        other.close()


def test_back_to_a_moment_and_other_seeds(shown):
    page, session = shown
    assert page.is_disabled("#return")
    step(page, 1)
    page.click("#snapshot")
    until(lambda: page.is_enabled("#return"))
    step(page, 2)
    page.keyboard.press("g")
    until(lambda: frame(page) == 1)
    until(lambda: session._trade.pair.sim.frame == 1)
    page.fill("#seed", "5")
    page.keyboard.press("Enter")
    until(lambda: session.scene is not SCENE and frame(page) == 0)
    assert (session._sim.state.position == SCENE.redrawn(5).position).all()


def test_what_is_typed_into_a_field_stays_there(shown):
    page, _session = shown
    step(page, 1)
    page.click("#beside summary")
    for name, text in (("tune-budget", "1.0e-2"), ("seed", "10")):
        page.focus(f"#{name}")
        page.keyboard.press("Control+a")
        page.keyboard.type(text)
        assert page.input_value(f"#{name}") == text
    assert page.evaluate("import('./stage.js').then(({camera}) => [camera.zoom, camera.free])") == [1, False]
    page.keyboard.press("Control+a")
    page.keyboard.type("0")  # no other seed
    page.focus("#colour")
    for key in ("r", "[", "Space", "Escape"):
        page.keyboard.press(key)
    page.focus("#stage")
    page.keyboard.press(".")
    until(lambda: frame(page) == 2)  # neither reset nor played
    assert (page.inner_text("#phase"), page.inner_text("#speed-text")) == ("paused", "1×, 60 frames a second")  # noqa: RUF001


@pytest.mark.parametrize("text", ["1e-300", "1e300", "2", "-1", "0", ""])
def test_a_budget_that_is_none_searches_for_nothing_and_ends_no_connection(shown, text):
    page, session = shown
    step(page, 1)
    page.click("#beside summary")
    page.fill("#tune-budget", text)
    page.click("#tune")
    step(page, 1)
    assert page.inner_text("#phase") == "paused"
    assert page.is_hidden("#tune-text")
    assert not session._tuning.running
    assert not page.evaluate("document.getElementById('tune-form').checkValidity()"), "the browser says what is wrong"


def test_a_budget_has_the_unit_and_the_range_of_its_measure(shown):
    page, _session = shown
    page.click("#beside summary")
    assert page.inner_text("#tune-unit") == "of the exact value"
    page.fill("#tune-budget", "2")
    valid = "document.getElementById('tune-form').checkValidity()"
    assert not page.evaluate(valid)
    page.select_option("#tune-measure", "overlap")
    assert page.inner_text("#tune-unit") == "diameters"
    assert page.evaluate(valid)


def test_a_finger_has_room_for_the_buttons_of_the_gauges(opened, capsys):
    with viewed(SCENE, GRID, playing=False) as view:
        context = opened.new_context(viewport={"width": 390, "height": 844}, has_touch=True, is_mobile=True)
        page = context.new_page()
        page.goto(view.address)
        until(lambda: page.locator(".save button").count() > 0)
        smallest = (
            "Math.min(...[...document.querySelectorAll('.save button, #colour')].map((each) => each.offsetHeight))"
        )
        until(lambda: page.evaluate(smallest) >= 24)
        assert page.evaluate("document.documentElement.scrollWidth") <= 390
        context.close()


def test_a_search_can_be_stopped_whatever_the_field_says(shown, monkeypatch):
    page, session = shown

    def search(scene, budgets, seconds, progress):
        while True:
            progress(1, 2, "halfway")
            time.sleep(0.01)

    monkeypatch.setattr(tuning, "tune", search)
    step(page, 1)
    page.click("#beside summary")
    page.click("#tune")
    until(lambda: page.inner_text("#tune") == "Stop")
    page.fill("#tune-budget", "-1")
    page.click("#tune")
    until(lambda: page.inner_text("#tune") == "Tune")
    assert not session._tuning.running


def test_at_390_pixels_nothing_is_cut(opened, capsys):
    with viewed(SCENE, GRID, beside=mpsim.Settings(method="event"), playing=False) as view:
        page = opened.new_page(viewport={"width": 390, "height": 844})
        page.goto(view.address)
        until(lambda: page.is_visible("#second"))
        assert page.evaluate("document.documentElement.scrollWidth") <= 390
        page.close()
