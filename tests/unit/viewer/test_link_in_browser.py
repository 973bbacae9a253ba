"""An address with a scene in it, opened in a real browser: the question, the answers, and what is copied."""

import shlex

import pytest
from support.browser import until
from support.scenes import gas
from support.trajectories import written
from support.viewing import viewed

import mpsim
from mpsim.viewer import link

pytestmark = pytest.mark.slow

GRID = mpsim.Settings(method="grid")


@pytest.fixture
def shown(opened, capsys):
    """A paused view of the scene gas, and what opens pages of it."""
    with viewed(mpsim.Scene.load("gas"), GRID, name="gas", playing=False) as view:
        pages, complaints = [], []

        def page_at(query="", size=(1280, 800)):
            page = opened.new_page(viewport={"width": size[0], "height": size[1]})
            page.on("pageerror", lambda error: complaints.append(str(error)))
            page.goto(view.address + query)
            until(lambda: page.inner_text("#phase") in ("paused", "playing"))
            pages.append(page)
            return page

        yield page_at, view._session
        for page in pages:
            page.close()
        assert not complaints


def test_another_scene_is_asked_for_and_then_shown_on_all_pages(shown):
    page_at, session = shown
    other = page_at()
    page = page_at("?wait&method=grid&scene=dense&speed=0.5", size=(390, 844))
    until(lambda: page.is_visible("#asked-yes"))
    assert page.inner_text("#asked-text") == (
        "This address asks for dense, method=grid. gas, method=grid is running now. A restart changes all pages of "
        "this view."
    )
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    assert session._name == "gas", "nothing is changed before somebody says so"
    page.click("#asked-yes")
    for each in (page, other):
        until(lambda each=each: each.inner_text("#name") == "dense" and each.inner_text("#discs") == "2,000")
        assert not each.is_visible("#asked")
    until(lambda: page.inner_text("#speed-text").startswith("1/2"))
    assert page.inner_text("#phase") == "paused"
    assert session._sim.frame == 0
    page.reload()
    until(lambda: page.inner_text("#phase") == "paused")
    page.wait_for_timeout(500)
    assert not page.is_visible("#asked"), "it is what runs now"


def test_this_run_can_be_kept_and_is_not_asked_about_again(shown):
    page_at, session = shown
    page = page_at("?scene=dense&speed=100")
    until(lambda: page.is_visible("#asked-no"))
    speed = session._pace.speed
    page.click("#asked-no")
    assert not page.is_visible("#asked")
    page.reload()
    until(lambda: page.inner_text("#phase") == "paused")
    page.wait_for_timeout(500)
    assert not page.is_visible("#asked")
    assert (session._name, session._pace.speed) == ("gas", speed)


@pytest.mark.parametrize(
    ("query", "text"),
    [
        ("?scene=gas&count=1000000000", "a name in a link must be one of"),
        ("?scene=../../mine.toml", "scene of a link must be one of"),
        ("?dt=0.005", "a link must have a scene"),
        ("?wait&zoom=nan", "zoom must be a number from 0.5 to 64; got nan"),
        ("?speed=0", "speed must be a number from 0.01 to 1000; got 0"),
        ("?scene=%3Cimg%20src=x%20onerror=alert(1)%3E", "scene of a link must be one of"),
    ],
)
def test_a_wrong_address_is_explained_and_the_run_is_shown(shown, query, text):
    page_at, _ = shown
    page = page_at(query)
    until(lambda: page.is_visible("#asked"))
    assert page.inner_text("#asked-text").startswith("This address cannot be used: ")
    assert text in page.inner_text("#asked-text")
    assert page.locator("#asked img").count() == 0
    assert not page.is_visible("#asked-yes")
    page.click("#asked-no")
    assert not page.is_visible("#asked")
    assert page.inner_text("#name") == "gas"


def test_an_address_without_a_scene_chooses_speed_and_place(shown):
    page_at, session = shown
    page = page_at("?speed=0.5&zoom=2&x=3&y=4")
    until(lambda: page.evaluate("import('./stage.js').then(({camera}) => camera.zoom)") == 2)
    until(lambda: session._pace.speed == 0.5)
    assert page.evaluate("import('./stage.js').then(({camera}) => [camera.x, camera.y])") == [3, 4]
    assert not page.is_visible("#asked")


def test_what_is_copied_asks_for_what_is_shown(shown):
    page_at, session = shown
    page = page_at("?scene=gas&method=grid")
    page.click("#parameters summary")
    page.focus("#change-dt")
    page.keyboard.press("ArrowRight")
    until(lambda: session._sim.settings.dt > GRID.dt)
    page.evaluate("document.querySelectorAll('details').forEach((each) => { each.open = true; })")
    page.select_option("#beside-choice", '{"method":"event"}')
    until(lambda: session._trade.pair is not None)
    page.click("#parameters summary")
    page.evaluate("document.getElementById('dial').focus()")
    until(
        lambda: (
            "beside=event" in page.evaluate("document.getElementById('keep-command').disabled ? '' : 'beside=event'")
        )
    )
    page.click("#keep-command")
    words = shlex.split(until(lambda: page.input_value("#kept-text")))
    assert words[:2] == ["mpsim", "view"]
    asked = link.read(link.query_of(words[2]))
    assert (asked.scene, asked.settings, asked.beside.method) == ("gas", session._sim.settings, "event")
    assert "wait" in asked.seen
    page.click("#keep-address")
    text = until(lambda: (found := page.input_value("#kept-text")).startswith("http") and found)
    assert link.query_of(text) == words[2].removeprefix("?")


def test_a_scene_of_ones_own_has_no_command_and_says_what_to_send(opened, capsys):
    with viewed(gas(80, 0.2), GRID, name="mine", playing=False) as view:
        page = opened.new_page()
        page.goto(view.address)
        until(lambda: "send the file under Scene" in (page.text_content("#keep-command-note") or ""))
        assert page.is_disabled("#keep-command")
        page.close()


@pytest.mark.parametrize("kind", ["a recording", "a simulation that belongs to a program"])
def test_a_view_that_cannot_follow_an_address_names_the_command(opened, tmp_path, capsys, kind):
    scene = gas(80, 0.2)
    with mpsim.Simulation(scene, GRID) as sim:
        if kind == "a recording":
            written(tmp_path / "run.xyz", scene, frames=2, every=1)
        with viewed(mpsim.Trajectory(tmp_path / "run.xyz") if kind == "a recording" else sim, playing=False) as view:
            page = opened.new_page()
            page.goto(view.address + "?wait&scene=dense&method=grid")
            until(lambda: page.is_visible("#asked"))
            assert page.inner_text("#asked-text") == (
                f"This address asks for dense, method=grid. This view shows {kind}, and nothing else. In a terminal: "
                "mpsim view '?scene=dense&method=grid'"
            )
            assert not page.is_visible("#asked-yes")
            page.close()
