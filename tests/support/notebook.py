"""The front end of a notebook without a browser: the pages of one widget, what they are sent and what they say."""

import json
import threading
import time
from collections.abc import Callable
from typing import Any

from support.visitor import Picture, read

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

    @property
    def frame(self) -> int:
        return -1 if self.picture is None else self.picture.frame

    @property
    def phase(self) -> str | None:
        return self.last.get("status", {}).get("phase")
