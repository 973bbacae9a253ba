"""`mpsim.live` without a browser: a front end that hears and says what that of a notebook would."""

import json
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from support.processes import run_script
from support.scenes import gas
from support.visitor import Picture, Visitor, digest_alone, read, read_session

import mpsim

pytestmark = pytest.mark.plain

GRID = mpsim.Settings(method="grid")
SCENE = gas(20, 0.2)


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


def session_of(page):
    """Frame and digest of the run, as the kept session says."""
    page.kept.clear()
    page.keep("session.zip")
    page.until(lambda p: "session.zip" in p.kept)
    session = read_session(page.kept["session.zip"][1])
    return session.frame, session.digest


def test_an_output_shows_the_run_and_controls_it_without_a_change_of_bits(front):
    page = seen(front)
    page.until(lambda p: p.frame > 5)
    assert page.last["scene"]["name"] == "a gas"
    page.say("pause")
    page.until(lambda p: p.phase == "paused")
    frame, digest = session_of(page)
    page.until(lambda p: p.frame == frame)
    assert digest == digest_alone(SCENE, GRID, frame)
    with mpsim.Simulation(SCENE, GRID) as alone:
        alone.run(frames=frame)
        assert np.abs(page.picture.position - alone.state.position).max() < 1e-3
    page.say("step", frames=2)
    page.until(lambda p: p.frame == frame + 2)


def test_an_output_that_is_cleared_or_scrolled_away_lets_the_run_rest(front):
    page, other = seen(front), seen(front, "other")
    other.say("visible", value=False)
    page.until(lambda p: p.frame > 3)
    for rest in (lambda: page.say("visible", value=False), lambda: front.say({"page": "a", "close": True})):
        rest()
        time.sleep(0.2)
        frame = session_of(other)[0]
        time.sleep(0.2)
        assert session_of(other)[0] == frame
        page.say("visible", value=True)
    again = seen(front, "again")
    again.until(lambda p: p.frame > frame)


def test_files_are_kept_in_a_notebook_as_on_a_page(front):
    page = seen(front)
    page.until(lambda p: p.frame > 3)
    for name, begin in {"session.zip": b"PK", "program.py": b'"""', "film.gif": b"GIF8"}.items():
        page.keep(name)
        page.until(lambda p, name=name: name in p.kept)
        assert page.kept[name][1].startswith(begin), page.kept[name]
    assert page.kept["session.zip"][0] == "application/zip"
    for name in ("", "../session.zip", "/etc/passwd", "x" * 3000):
        page.keep(name)
        page.until(lambda p, name=name: name[:40] in {each[:40] for each in p.kept})
    assert page.kept["/etc/passwd"] == "There is no '/etc/passwd' to keep."
    before = page.frame
    page.until(lambda p: p.frame > before)
    assert page.closed is None


def test_what_is_no_message_is_passed_over_and_a_broken_rule_ends_one_page(front):
    polite, rude = seen(front), seen(front, "rude")
    for noise in (None, 7, "text", [], {}, {"page": 1, "open": True}, {"page": "x" * 65, "open": True},
                  {"page": "who", "text": '{"do": "pause"}'}, {"page": "who", "close": True},
                  {"page": "a", "text": 5}, {"page": "a", "text": b"x"}):  # fmt: skip
        front.say(noise)
    for name, act, reason in (
        ("rude", lambda page: front.say({"page": "rude", "text": "garbage"}), "a message must be JSON; got 'garbage'"),
        ("flood", lambda page: [page.say("pause") for _ in range(1200)], "at most 200 messages a second are read"),
        ("twice", lambda page: front.say({"page": "twice", "open": True}), "a page opens once; 'twice' was open"),
    ):
        page = rude if name == "rude" else seen(front, name)
        act(page)
        page.until(lambda p: p.closed)
        assert page.closed["code"] == 1008
        assert page.closed["reason"].startswith(reason)
    polite.say("play")
    before, frame = rude.pictures, polite.frame
    polite.until(lambda p: p.frame > frame + 5)
    assert (rude.pictures, polite.closed) == (before, None)
    for number in range(7):
        seen(front, str(number))
    page = front.open("one more")
    page.until(lambda p: p.closed)
    assert page.closed == {"code": 1013, "reason": "at most 8 pages at a time: close another one"}
    assert page.opened == 0


def test_closing_ends_its_threads_and_says_so():
    threads = threading.active_count()
    live = mpsim.live(SCENE, GRID, name="gas")
    assert repr(live) == "<Live: 'gas'>"
    page = seen(front := FrontEnd(live))
    page.until(lambda p: p.frame > 3)
    live.close()
    assert page.closed == {"code": 1008, "reason": "the view was closed"}
    live.close()
    front.say({"page": "a", "text": '{"do": "play"}'})  # nobody listens
    assert threading.active_count() <= threads


def test_a_simulation_of_ones_own_and_further_options_are_shown_as_on_a_page_of_its_own():
    with mpsim.Simulation(SCENE, GRID) as sim:
        sim.run(frames=5)
        with mpsim.live(sim, playing=False) as live:
            page = seen(FrontEnd(live))
            page.until(lambda p: p.frame == 5)
            assert not page.last["scene"]["can_reset"]
            sim.run(frames=7)
            page.until(lambda p: p.frame == 12)
        sim.run(frames=1)
    with mpsim.live(SCENE, GRID, colour=np.arange(20.0), beside=mpsim.Settings(method="event"), playing=False) as live:
        page = seen(FrontEnd(live))
        page.until(lambda p: "pair" in p.last and "colours" in p.last)
        assert page.last["pair"]["second"] == "event"
        assert page.last["colours"]["values"][::3] == [0.0, 19.0]


@pytest.mark.parametrize("close", [lambda live: live.close(), lambda live: live.widget.close()], ids=["here", "there"])
def test_a_notebook_gets_a_widget_and_of_a_closed_view_its_name(close):
    live = mpsim.live(SCENE, name="gas", playing=False)
    assert "application/vnd.jupyter.widget-view+json" in live._repr_mimebundle_()[0]
    assert live._display_() is live.widget
    assert len(live.widget._esm) < 150_000
    close(live)
    assert live._repr_mimebundle_() == {"text/plain": "<Live: 'gas'> is closed; mpsim.live shows another."}
    live.close()


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"source": "gas"}, r"a view shows an mpsim.Scene, an mpsim.Simulation or an mpsim.Trajectory; got str. Use "),
        ({"height": 100}, r"height must be a whole number from 200 to 4000; got 100. 640 suits most screens."),
    ],
)
def test_what_is_wrong_is_named(arguments, text):
    with pytest.raises(mpsim.InputError, match=text):
        mpsim.live(**{"source": SCENE, **arguments})


def test_without_the_package_the_extra_is_named():
    """In a process of its own: the class of the widget is made once."""
    outcome = run_script(
        """
        import sys
        sys.modules["anywidget"] = None
        import mpsim
        try:
            mpsim.live(mpsim.Scene.load("cradle"))
        except mpsim.errors.OutputError as error:
            print(error)
        """,
        warm=True,
    )
    assert "needs the package anywidget" in outcome.out
    assert "pip install 'mpsim[notebook]'" in outcome.out
    assert "anywidget" in sys.modules


# --- browsers that die, messages that are lost, cells that take long


def losing(page, what):
    """Drop the next messages of a kind on their way to a page; returns those that were dropped."""
    dropped = []
    page.loses = lambda content: what in content and dropped.append(content) is None
    return dropped


@pytest.mark.long
def test_lost_messages_are_sent_again_and_pages_that_do_not_answer_let_the_run_rest():
    """One life of half a minute: a page is pinged each ten seconds."""
    with mpsim.live(SCENE, GRID) as live:
        front = FrontEnd(live)
        one, other, *dying = [seen(front, str(number)) for number in range(8)]
        one.until(lambda p: p.frame > 3)
        lost = losing(one, "bytes")
        texts = losing(other, "text")
        one.until(lambda p: lost)
        one.loses = lambda content: False
        one.say("speed", value=0.5)
        other.until(lambda p: any("0.5" in each["text"] for each in texts))
        other.loses = lambda content: False
        for page in dying:
            page.dead = True
        pictures, pings = one.pictures, one.pings
        time.sleep(0.5)
        assert one.pictures == pictures, "the control: it waits until it is asked"
        one.until(lambda p: p.pings > pings and p.pictures > pictures + 3)
        other.until(lambda p: p.last["status"]["speed"] == 0.5)
        assert (one.closed, other.closed) == (None, None)
        heard = one.received
        one.keep("session.zip")
        one.until(lambda p: p.kept and p.pings > pings + 1)
        assert one.received > heard
        # a long cell: answers wait, and nobody else watches
        front.busy = []
        frames = [one.frame]
        one.say("speed", value=2.0)
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline and (len(frames) < 3 or frames[-1] != frames[-3]):
            time.sleep(1.0)
            frames.append(one.frame)
        assert one.closed is None
        front.end_cell()
        one.until(lambda p: p.frame > frames[-1] + 3 and p.last["status"]["speed"] == 2.0)
        assert (one.opened, one.closed) == (1, None)
        # dead pages were sent nothing more, and one gives its place
        seen(front, "another").until(lambda p: p.frame > frames[-1])
        dying[0].until(lambda p: any(page.closed for page in dying))
        (closed,) = [page.closed for page in dying if page.closed]
        assert closed == {"code": 1013, "reason": "it did not answer, and another page needed its place"}
        working = live.widget.send

        def fail(content, buffers=None):
            raise RuntimeError("the kernel is ending")

        live.widget.send = fail
        time.sleep(0.5)
        live.widget.send = working
        front.say({"page": "0", "pong": True, "lost": True})  # as a page does that has heard nothing for long
        frame = one.frame
        one.until(lambda p: p.frame > frame + 5)


# --- the front end of a notebook without a browser: what the pages of one widget are sent and say

PATIENCE = 150.0


class FrontEnd:
    """Takes what the widget of a view sends, for all its pages.

    Attributes:
        busy: what waits for a kernel that takes no message while it runs a cell; None: it takes them as they come.
    """

    def __init__(self, live: Any):
        self.widget, self.pages = live.widget, dict[str, "NotebookPage"]()
        self.news = threading.Condition()
        self.busy: list[Any] | None = None
        live.widget.send = self._take  # in place of a notebook's connection

    def _take(self, content: dict[str, Any], buffers: Any = None) -> None:
        with self.news:
            self.pages[content["page"]].take(content, buffers)
            self.news.notify_all()

    def say(self, content: Any) -> None:
        """A message of the widget's module."""
        if self.busy is not None:
            self.busy.append(content)
            return
        self.widget._handle_custom_msg(content, [])

    def end_cell(self) -> None:
        """The kernel takes what has waited."""
        waited, self.busy = self.busy or [], None
        for content in waited:
            self.say(content)

    def open(self, name: str) -> "NotebookPage":
        page = self.pages[name] = NotebookPage(self, name)
        self.say({"page": name, "open": True})
        return page


class NotebookPage:
    """One page. Attributes: opened, closed (code and reason), last (messages by kind), picture, pictures, pings; dead:
    its browser has died, and says nothing; kept: files asked for, by name: media type and content, or why there is
    none; loses: what the notebook's server drops on the way to it: a function of a
    message."""

    frame, phase = Visitor.frame, Visitor.phase

    def __init__(self, front: FrontEnd, name: str):
        self.front, self.name = front, name
        self.opened, self.closed, self.pictures, self.pings, self.dead = 0, None, 0, 0, False
        self.last: dict[str, dict[str, Any]] = {}
        self.picture: Picture | None = None
        self.kept: dict[str, Any] = {}
        self.loses: Callable[[dict[str, Any]], bool] = lambda content: False
        self.received = 0

    def take(self, content: dict[str, Any], buffers: Any) -> None:
        if self.loses(content):
            return
        self.received += not content.keys().isdisjoint(("text", "bytes", "kept"))
        if content.get("opened"):
            self.opened += 1
        elif content.get("ping"):
            self.pings += 1
            lost, self.received = self.received != content["sent"], content["sent"]
            if not self.dead:
                self.front.say({"page": self.name, "pong": True, "lost": lost})
        elif "closed" in content:
            self.closed = content["closed"]
        elif "kept" in content:
            self.kept[content["kept"]] = content.get("refused") or (content["kind"], bytes(buffers[0]))
        elif "text" in content:
            found = json.loads(content["text"])
            self.last[found["type"]] = found
        else:
            found = read(bytes(buffers[0]))[2]
            if isinstance(found, Picture) and found.stage == 0:  # it comes last, and is acknowledged for both
                self.picture, self.pictures = found, self.pictures + 1
                self.say("ack", serial=found.serial)

    def say(self, do: str, **values: Any) -> None:
        if not self.dead:
            self.front.say({"page": self.name, "text": json.dumps({"do": do, **values})})

    def keep(self, name: str) -> None:
        self.front.say({"page": self.name, "keep": name})

    def until(self, holds: Callable[["NotebookPage"], Any]) -> None:
        end = time.monotonic() + PATIENCE
        with self.front.news:
            assert self.front.news.wait_for(lambda: holds(self), end - time.monotonic()), (self.last, self.closed)
