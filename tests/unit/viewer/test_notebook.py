"""`mpsim.live` without a browser: a front end that hears and says what a notebook's would."""

import asyncio
import sys
import threading
import time

import numpy as np
import pytest
from support.notebook import FrontEnd
from support.scenes import gas

import mpsim
from mpsim.viewer import notebook
from mpsim.viewer.broadcast import Shown
from mpsim.viewer.client import Client

GRID = mpsim.Settings(method="grid")
SCENE = gas(100, 0.3)


@pytest.fixture
def front():
    with mpsim.live(SCENE, GRID, name="a gas") as live:
        found = FrontEnd(live)
        found.live = live
        yield found


def seen(front, name="a"):
    page = front.open(name)
    page.until(lambda p: p.opened == 1)
    page.say("visible", value=True)
    return page


def test_an_output_shows_the_run_and_controls_it_without_a_change_of_bits(front):
    page = seen(front)
    page.until(lambda p: p.frame > 5)
    assert page.last["scene"]["name"] == "a gas"
    page.say("pause")
    page.until(lambda p: p.phase == "paused")
    sim = front.live._session._sim
    page.until(lambda p: p.frame == sim.frame)
    assert np.abs(page.picture.position - sim.state.position).max() <= 0.501 * SCENE.width / 65535
    with mpsim.Simulation(SCENE, GRID) as alone:
        alone.run(frames=sim.frame)
        assert alone.digest() == sim.digest()
        alone.run(frames=1)
        assert alone.digest() != sim.digest(), "negative control"
    page.say("step", frames=2)
    page.until(lambda p: p.frame == alone.frame + 1)


def test_an_output_that_is_cleared_or_scrolled_away_lets_the_run_rest(front):
    page = seen(front)
    page.until(lambda p: p.frame > 3)
    for rest, again in (
        (lambda: page.say("visible", value=False), lambda: page.say("visible", value=True)),
        (lambda: front.say({"page": "a", "close": True}), lambda: seen(front, "again")),
    ):
        rest()
        time.sleep(0.2)
        frame = front.live._session._sim.frame
        time.sleep(0.2)
        assert front.live._session._sim.frame == frame
        again()
        front.pages[list(front.pages)[-1]].until(lambda p, frame=frame: p.frame > frame)


def test_files_are_kept_in_a_notebook_as_on_a_page(front):
    page = seen(front)
    page.until(lambda p: p.frame > 3)
    begins = {"session.zip": b"PK", "scene.zip": b"PK", "program.py": b'"""', "film.gif": b"GIF8"}
    for name, begin in begins.items():
        page.keep(name)
        page.until(lambda p, name=name: name in p.kept)
        assert page.kept[name][1].startswith(begin), page.kept[name]
    assert page.kept["session.zip"][0] == "application/zip"
    page.until(lambda p: p.pings > 0 or p.frame > 20)
    for name in ("", "../session.zip", "/etc/passwd", "x" * 3000):
        page.keep(name)
        page.until(lambda p, name=name: name[:40] in {each[:40] for each in p.kept})
    assert page.kept["/etc/passwd"] == "There is no '/etc/passwd' to keep."
    before = page.frame
    page.until(lambda p: p.frame > before)
    assert page.closed is None


def test_a_kept_file_counts_as_a_message_so_that_nothing_seems_lost(monkeypatch):
    monkeypatch.setattr(notebook, "PING_SECONDS", 0.2)
    with mpsim.live(SCENE, GRID, playing=False) as live:
        page = seen(FrontEnd(live))
        page.keep("program.py")
        page.until(lambda p: p.kept)
        pings = page.pings
        page.until(lambda p: p.pings > pings + 2)
        before = page.received
        page.until(lambda p: p.pings > pings + 4)
        assert page.received == before, "negative control below: what is lost is sent again"
        page.loses = lambda content: "kept" in content
        page.keep("scene.zip")
        page.until(lambda p: p.received > before + 1)


def test_a_flood_of_files_ends_its_page(front):
    page, polite = seen(front), seen(front, "polite")
    for _ in range(2000):
        page.keep("program.py")
    page.until(lambda p: p.closed)
    assert page.closed["reason"] == "at most 200 messages a second are read; got more. Send fewer."
    frame = polite.frame
    polite.until(lambda p: p.frame > frame)


def test_what_is_no_message_of_a_page_is_passed_over_and_a_broken_rule_ends_one_page(front):
    polite, rude = seen(front), seen(front, "rude")
    for noise in (None, 7, "text", [], {}, {"page": 1, "open": True}, {"page": "x" * 65, "open": True},
                  {"page": "who", "text": '{"do": "pause"}'}, {"page": "who", "close": True},
                  {"page": "a", "text": 5}, {"page": "a", "text": b"x"}):  # fmt: skip
        front.say(noise)
    front.say({"page": "rude", "text": "garbage"})
    rude.until(lambda p: p.closed)
    assert rude.closed["code"] == 1008
    assert rude.closed["reason"].startswith("a message must be JSON; got 'garbage'")
    before, polite_frame = rude.pictures, polite.frame
    polite.until(lambda p: p.frame > polite_frame + 5)
    assert rude.pictures == before
    assert polite.closed is None


def test_a_flood_ends_its_page(front):
    page = seen(front)
    for _ in range(2000):
        page.say("pause")
    page.until(lambda p: p.closed)
    assert page.closed["reason"] == "at most 200 messages a second are read; got more. Send fewer."


def test_at_most_eight_outputs_at_a_time(front):
    for number in range(8):
        seen(front, str(number))
    page = front.open("one more")
    page.until(lambda p: p.closed)
    assert page.closed == {"code": 1013, "reason": "at most 8 pages at a time: close another one"}
    assert page.opened == 0


def test_a_name_that_is_open_already_ends_its_page(front):
    page = seen(front)
    front.say({"page": "a", "open": True})
    page.until(lambda p: p.closed)
    assert page.closed == {"code": 1008, "reason": "a page opens once; 'a' was open"}


def comes_to_rest(live, within=20.0) -> bool:
    """Whether the simulation stops within so many seconds."""
    end = time.monotonic() + within
    while time.monotonic() < end:
        frame = live._session._sim.frame
        time.sleep(0.3)
        if live._session._sim.frame == frame:
            return True
    return False


def test_a_browser_that_dies_lets_the_run_rest_and_gives_its_place(monkeypatch):
    monkeypatch.setattr(notebook, "PING_SECONDS", 0.4)
    with mpsim.live(SCENE, GRID) as live:
        front = FrontEnd(live)
        dying = [seen(front, str(number)) for number in range(8)]
        dying[0].until(lambda p: p.pings > 2)
        assert not comes_to_rest(live, 1), "negative control: pages that answer are watched"
        for page in dying:
            page.dead = True
        assert comes_to_rest(live)
        pings = [page.pings for page in dying]
        time.sleep(1)
        assert [page.pings for page in dying] == pings, "a dead page is sent nothing"
        page, frame = seen(front, "another"), live._session._sim.frame
        page.until(lambda p: p.frame > frame)
        dying[0].until(lambda p: p.closed)
        assert dying[0].closed == {"code": 1013, "reason": "it did not answer, and another page needed its place"}
        assert all(each.closed is None for each in dying[1:])


def test_a_hidden_page_that_answers_keeps_its_place(monkeypatch):
    monkeypatch.setattr(notebook, "PING_SECONDS", 0.1)
    with mpsim.live(SCENE, GRID) as live:
        front = FrontEnd(live)
        for number in range(8):
            seen(front, str(number)).say("visible", value=False)
        front.pages["7"].until(lambda p: p.pings > 5)
        page = front.open("one more")
        page.until(lambda p: p.closed)
        assert page.closed["reason"] == "at most 8 pages at a time: close another one"


def test_a_kernel_that_runs_a_long_cell_drops_no_page(monkeypatch):
    monkeypatch.setattr(notebook, "PING_SECONDS", 0.4)
    with mpsim.live(SCENE, GRID) as live:
        front = FrontEnd(live)
        page = seen(front)
        page.until(lambda p: p.frame > 3)
        front.busy = []
        assert comes_to_rest(live)
        page.say("speed", value=0.5)  # somebody moves a slider meanwhile
        assert page.closed is None
        frame = page.frame
        front.end_cell()
        page.until(lambda p: p.frame > frame + 3 and p.last["status"]["speed"] == 0.5)
        assert (page.opened, page.closed) == (1, None)


def dropping(page, what):
    """Have the notebook's server drop the next messages of a kind, one at least."""
    dropped = []

    def loses(content):
        if what in content:
            dropped.append(content)
        return what in content

    page.loses = loses
    page.until(lambda p: dropped)
    page.loses = lambda content: False


def test_a_picture_that_a_notebook_s_server_drops_is_sent_again(monkeypatch):
    monkeypatch.setattr(notebook, "PING_SECONDS", 1e9)
    with mpsim.live(SCENE, GRID) as live:
        page = seen(FrontEnd(live))
        page.until(lambda p: p.frame > 3)
        dropping(page, "bytes")
        pictures, frame = page.pictures, live._session._sim.frame
        time.sleep(0.7)
        assert live._session._sim.frame > frame
        assert page.pictures == pictures, "negative control: it waits until it is asked"
        live._pages.from_outside(live._pages._ask_for_life)
        page.until(lambda p: p.pictures > pictures + 3 and p.frame > frame)
        assert page.closed is None


def test_a_message_that_a_notebook_s_server_drops_is_sent_again(monkeypatch):
    monkeypatch.setattr(notebook, "PING_SECONDS", 1e9)
    with mpsim.live(SCENE, GRID) as live:
        page = seen(FrontEnd(live))
        page.until(lambda p: p.frame > 3)
        page.loses = lambda content: "text" in content
        page.say("pause")
        end = time.monotonic() + 60
        while live._session._playing and time.monotonic() < end:
            time.sleep(0.01)
        time.sleep(0.3)
        page.loses = lambda content: False
        time.sleep(0.5)
        assert page.phase == "playing", "negative control: nobody has asked"
        live._pages.from_outside(live._pages._ask_for_life)
        page.until(lambda p: p.phase == "paused" and p.frame == live._session._sim.frame)
        pictures = page.pictures
        for _ in range(2):
            live._pages.from_outside(live._pages._ask_for_life)
        time.sleep(0.3)
        assert page.pictures == pictures, "nothing was lost, and nothing is sent again"


class Sink:
    """A connection that keeps what is sent."""

    def __init__(self):
        self.sent = []

    async def send(self, message):
        self.sent.append(message)


def test_a_picture_that_came_although_others_were_lost_may_be_acknowledged_again():
    """The page answers pictures late, as after a long cell, and the same ones are sent again meanwhile."""
    sink = Sink()
    client = Client(sink)

    async def lose():
        sending = asyncio.ensure_future(client.send_all())
        client.note(visible=True)
        for serial in (1, 2):
            client.show(Shown(serial, b"picture %d" % serial, b"radii", np.zeros((0, 5))))
            await asyncio.sleep(0)
        await asyncio.sleep(0.01)
        client.send_again({"status": "again"})
        await asyncio.sleep(0.01)
        client.send_again({"status": "again"})
        await asyncio.sleep(0.01)
        for serial in (1, 1, 2, 2):
            client.acknowledge(serial)
        with pytest.raises(mpsim.InputError, match="serial of an ack must be that of the last picture; got 3"):
            client.acknowledge(3)
        sending.cancel()

    asyncio.run(lose())
    assert sink.sent == [b"radii", b"picture 1", *["again", b"radii", b"picture 2"] * 2]


def test_a_connection_that_fails_lets_the_run_rest_and_one_that_works_again_is_used(monkeypatch):
    monkeypatch.setattr(notebook, "PING_SECONDS", 0.2)
    with mpsim.live(SCENE, GRID) as live:
        page = seen(front := FrontEnd(live))
        page.until(lambda p: p.frame > 5)
        working, sim = live.widget.send, live._session._sim

        def fail(content, buffers=None):
            raise RuntimeError("the kernel is ending")

        live.widget.send = fail
        time.sleep(0.6)
        frame = sim.frame
        time.sleep(0.4)
        assert sim.frame == frame
        live.widget.send = working
        front.say({"page": "a", "pong": True, "lost": True})  # as the page does that has heard nothing for long
        page.until(lambda p: p.frame > frame + 5)


def test_closing_ends_its_threads_and_says_so():
    threads = threading.active_count()
    live = mpsim.live(SCENE, GRID)
    front = FrontEnd(live)
    page = seen(front)
    page.until(lambda p: p.frame > 3)
    live.close()
    assert page.closed == {"code": 1008, "reason": "the view was closed"}
    live.close()
    front.say({"page": "a", "text": '{"do": "play"}'})  # nobody listens
    assert threading.active_count() <= threads


def test_a_simulation_of_ones_own_is_shown_and_stays_open():
    with mpsim.Simulation(SCENE, GRID) as sim:
        sim.run(frames=5)
        with mpsim.live(sim, playing=False) as live:
            page = seen(FrontEnd(live))
            page.until(lambda p: p.frame == 5)
            assert not page.last["scene"]["can_reset"]
            sim.run(frames=7)
            page.until(lambda p: p.frame == 12)
        sim.run(frames=1)


def test_notebooks_get_a_widget(front):
    bundle = front.live._repr_mimebundle_()
    bundle = bundle[0] if isinstance(bundle, tuple) else bundle
    assert "application/vnd.jupyter.widget-view+json" in bundle
    assert front.live._display_() is front.live.widget
    assert repr(front.live) == "<Live: 'a gas'>"
    assert len(front.live.widget._esm) < 150_000


@pytest.mark.parametrize("missing", ["anywidget", "traitlets"])
def test_without_the_package_it_names_the_extra(monkeypatch, missing):
    monkeypatch.setitem(sys.modules, missing, None)
    notebook._widget_class.cache_clear()
    threads = threading.active_count()
    with pytest.raises(
        mpsim.errors.OutputError, match=rf"needs the package {missing}, .* `pip install 'mpsim\[notebook\]'`"
    ):
        mpsim.live(SCENE)
    assert threading.active_count() == threads


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"source": "gas"}, r"a view shows an mpsim.Scene, an mpsim.Simulation or an mpsim.Trajectory; got str. Use "),
        ({"settings": {"dt": 1}}, r"settings must be mpsim.Settings; got dict."),
        ({"height": 100}, r"height must be a whole number from 200 to 4000; got 100. 640 suits most screens."),
        ({"playing": 1}, r"playing must be True or False; got 1"),
        ({"settings": mpsim.Settings(method="mpi")}, r"a view runs in one process"),
    ],
)
def test_what_is_wrong_is_named(arguments, text):
    with pytest.raises(mpsim.InputError, match=text):
        mpsim.live(**{"source": SCENE, **arguments})


def test_a_second_stage_and_own_colours_are_shown_as_on_a_page_of_its_own():
    with mpsim.live(SCENE, GRID, colour=np.arange(100.0), beside=mpsim.Settings(method="event"), playing=False) as live:
        page = seen(FrontEnd(live))
        page.until(lambda p: "pair" in p.last and "colours" in p.last)
        assert (page.last["pair"]["second"], page.last["colours"]["by"]) == ("event", "own")


def test_what_is_no_second_stage_is_refused_in_a_notebook():
    with pytest.raises(mpsim.InputError, match=r"beside must be mpsim\.Settings; got str"):
        mpsim.live(SCENE, beside="event")  # pyright: ignore[reportArgumentType]
    with mpsim.Simulation(SCENE, GRID) as sim, pytest.raises(mpsim.InputError, match="beside needs a scene"):
        mpsim.live(sim, beside=GRID)
