"""The time line in a real browser: by pointer and by keys, and what a recording does not show."""

import pytest
from support.browser import browser, until
from support.scenes import gas
from support.trajectories import written
from support.viewing import viewed

import mpsim

pytestmark = pytest.mark.slow


@pytest.fixture
def page(tmp_path, capsys):
    path = tmp_path / "run.xyz"
    written(path, gas(100, 0.3), frames=100, every=5)
    with viewed(mpsim.Trajectory(path), playing=False) as view, browser() as opened:
        found = opened.new_page(viewport={"width": 390, "height": 800})
        found.complaints = []
        found.on("pageerror", lambda error: found.complaints.append(str(error)))
        found.goto(view.address)
        until(lambda: shown(found) == 0)
        yield found


def shown(page) -> int:
    return int(page.get_attribute("#stage", "data-frame") or -1)


def test_the_time_line_is_moved_by_pointer_and_keys(page):
    assert page.inner_text("#timeline-text") == "1 of 21"
    box = page.locator("#timeline").bounding_box()
    page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    until(lambda: shown(page) == 50)
    assert page.inner_text("#timeline-text") == "11 of 21"
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.mouse.down()
    page.mouse.move(box["x"] + box["width"] + 20, box["y"] + 5, steps=20)
    page.mouse.up()
    until(lambda: shown(page) == 100)
    page.focus("#stage")
    for key, frame in ((",", 95), ("Home", 0), (".", 5), ("End", 100), ("r", 0)):
        page.keyboard.press(key)
        until(lambda frame=frame: shown(page) == frame)
    page.click("#step")
    until(lambda: shown(page) == 5)
    page.click("#back")
    until(lambda: shown(page) == 0 and page.is_disabled("#back"))
    page.keyboard.press("l")
    until(lambda: shown(page) == 100 and page.get_attribute("#follow", "aria-pressed") == "true")
    box = page.locator("#stage").bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    for key in ("p", "s", "g", "x", "f", "f", "]"):  # keys of runs, which a recording has not, and of one disc
        page.keyboard.press(key)
    until(lambda: page.inner_text("#speed-text") == "1×, 60 recorded frames a second")  # noqa: RUF001
    assert page.get_attribute("#follow", "aria-pressed") == "true", "it follows the file still"
    assert page.get_attribute("#stage", "data-tool") == "hand"
    page.keyboard.press("[")
    until(lambda: page.inner_text("#speed-text").startswith("1/2"))
    assert page.inner_text("#speed-text") == "1/2×, 30 recorded frames a second"  # noqa: RUF001
    page.keyboard.press("[")
    page.keyboard.press("[")
    until(lambda: page.inner_text("#speed-text") == "1/10×, 6 recorded frames a second")  # noqa: RUF001
    page.click("#play")  # at the end: again from the start
    until(lambda: page.inner_text("#phase") == "playing" and shown(page) < 60)
    page.keyboard.press("m")
    until(lambda: page.inner_text("#phase") == "paused" and shown(page) == 100)
    hidden = ("#tools", "#parameters", "#keep-session", "#nanoseconds")
    assert [name for name in hidden if page.is_visible(name)] == []
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    page.click("#keep summary")
    with page.expect_download() as film:
        page.click("#keep-film")
    assert film.value.suggested_filename == "run_xyz-100.gif"
    assert page.complaints == []
