"""The widget's module in a real browser, without a notebook: what it answers, and what it does if messages are lost."""

import json

import pytest
from support.browser import until

from mpsim.viewer.page_files import widget_module

pytestmark = pytest.mark.slow

RENDER = """async (text) => {
  window.said = [];
  const model = {
    get: () => 500, send: (content) => window.said.push(content), off() {},
    on: (kind, hear) => { window.hear = hear; },
  };
  const address = URL.createObjectURL(new Blob([text], { type: "text/javascript" }));
  window.end = (await import(address)).default.render({ model, el: document.body });
}"""
STATUS = {"type": "status", "phase": "paused", "speed": 1, "note": None, "can_remember": True, "snapshot": None}


class Widget:
    """The module with a model that keeps what it says; its page is in a frame."""

    def __init__(self, opened):
        self.page = opened.new_page()
        self.page.clock.install()
        self.page.goto("data:text/html,<title>a notebook</title>")
        self.page.evaluate(RENDER, widget_module())
        self.name = until(lambda: [each for each in self.said if each.get("open")])[-1]["page"]

    @property
    def said(self):
        return self.page.evaluate("said")

    def hear(self, **content):
        self.page.evaluate("(content) => hear(content, [])", {"page": self.name, **content})

    def tell(self, **values):
        self.hear(text=json.dumps({**STATUS, **values}))

    def pass_seconds(self, seconds):
        self.page.clock.run_for(1000 * seconds)

    def answer(self):
        """The last sign of life."""
        return [each for each in self.said if each.get("pong")][-1:]

    @property
    def phase(self):
        return self.page.frames[-1].inner_text("#phase")


@pytest.fixture
def widget(opened):
    made = Widget(opened)
    yield made
    made.page.close()


def test_it_says_whether_a_message_was_lost(widget):
    widget.hear(opened=True)
    widget.tell(phase="playing")
    until(lambda: widget.phase == "playing")
    widget.hear(ping=True, sent=1)
    assert widget.answer() == [{"page": widget.name, "pong": True, "lost": False}]
    widget.hear(ping=True, sent=3)  # of which two did not come
    assert widget.answer() == [{"page": widget.name, "pong": True, "lost": True}]
    widget.tell(phase="paused")
    widget.hear(ping=True, sent=4)
    assert widget.answer() == [{"page": widget.name, "pong": True, "lost": False}], "it counts from there"


def test_it_asks_again_after_half_a_minute_of_silence(widget):
    widget.hear(opened=True)
    widget.hear(ping=True, sent=0)
    asked = len(widget.said)
    widget.pass_seconds(25)
    assert not [each for each in widget.said[asked:] if each.get("pong")], "negative control: it is patient"
    widget.pass_seconds(15)
    assert [each for each in widget.said[asked:] if each.get("pong")] == [
        {"page": widget.name, "pong": True, "lost": True}
    ]
    widget.page.evaluate("end()")
    asked = len(widget.said)
    widget.pass_seconds(100)
    assert len(widget.said) == asked, "a page that was taken away asks nothing"


def test_it_opens_by_any_message_as_the_one_that_says_so_may_be_lost(widget):
    assert widget.phase == "connecting"
    widget.tell()
    until(lambda: widget.phase == "paused")
    opened = [each for each in widget.said if "visible" in each.get("text", "")]
    assert len(opened) == 1
    widget.hear(opened=True)
    widget.tell(phase="playing")
    until(lambda: widget.phase == "playing")
    assert len([each for each in widget.said if "visible" in each.get("text", "")]) == 1
