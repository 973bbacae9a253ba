"""All pages of a view, connected by a server or a notebook.

An event loop in a thread of its own serves them. A page that breaks a rule is disconnected; nothing else is affected.
"""

import asyncio
import contextlib
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

from mpsim.viewer import wire
from mpsim.viewer.broadcast import Shown
from mpsim.viewer.client import Client, Connection
from mpsim.viewer.downloads import Downloads
from mpsim.viewer.source import Source

MOST_PAGES = 8
"""Largest number of pages that are connected at a time."""


class Pages(ABC):
    """The pages of one view; the audience of its source.

    Args:
        name: name of the thread.
    """

    def __init__(self, name: str):
        self._source: Source | None = None
        self._clients: dict[Client, asyncio.Task[None]] = {}
        self._texts: dict[str, str] = {}
        self._picture: Shown | None = None
        self._downloads = Downloads()
        self._spent = 0.0  # processor time of the thread that was already charged [s]
        self._loop: asyncio.AbstractEventLoop | None = None  # set by `start`
        self._end = asyncio.Event()
        self._thread = threading.Thread(target=self._serve, name=name, daemon=True)

    @property
    def source(self) -> Source:
        """What the pages show; there is one after `start`."""
        assert self._source is not None
        return self._source

    def start(self, source: Source) -> None:
        """Start the thread, unless it was started before; the pages show this source."""
        if self._loop is not None:
            return
        self._source = source
        self._loop = asyncio.new_event_loop()
        self._thread.start()

    def close(self) -> None:
        """Close all connections and end the thread. May be called again."""
        if self._thread.ident is not None:
            self.from_outside(self._end.set)
            self._thread.join()
        self._downloads.close()

    # --- called by other threads

    def show(self, picture: Shown) -> None:
        """Pass a picture to the pages."""
        self.from_outside(self._show, picture)

    def tell(self, kind: str, text: str) -> None:
        """Pass a message to the pages."""
        self.from_outside(self._tell, kind, text)

    def from_outside(self, act: Callable[..., None], *arguments: Any) -> None:
        """Call a function in the thread of the pages; do nothing if that has ended."""
        if self._loop is None:
            return
        with contextlib.suppress(RuntimeError):
            self._loop.call_soon_threadsafe(act, *arguments)

    # --- the thread

    def _serve(self) -> None:
        loop = self._loop
        assert loop is not None  # since the start
        with asyncio.Runner(loop_factory=lambda: loop) as runner:
            runner.run(self._until_the_end())

    @abstractmethod
    async def _until_the_end(self) -> None:
        """Serve pages until `_end` is set."""

    def _show(self, picture: Shown) -> None:
        self._picture = picture
        self._downloads.show(picture)
        for client in self._clients:
            client.show(picture)

    def _tell(self, kind: str, text: str) -> None:
        self._texts[kind] = text
        for client in self._clients:
            client.tell(kind, text)

    def _join(self, connection: Connection) -> Client:
        """Serve another page, and send it the last messages and picture."""
        client = Client(connection)
        for kind, text in self._texts.items():
            client.tell(kind, text)
        if self._picture is not None:
            client.show(self._picture)
        self._clients[client] = asyncio.ensure_future(client.send_all())
        return client

    async def _leave(self, client: Client) -> None:
        """Stop serving a page, whatever has happened to its connection."""
        sending = self._clients.pop(client)
        sending.cancel()
        self._count()
        await asyncio.gather(sending, return_exceptions=True)

    def _do(self, client: Client, action: wire.Action) -> None:
        """Do the action that a page has sent.

        Raises:
            InputError: if the page breaks a rule.
        """
        spent, self._spent = self._spent, time.thread_time()
        self.source.charge(self._spent - spent)
        match action.name:
            case "ack":
                client.acknowledge(action.values["serial"])
            case "visible":
                client.note(visible=action.values["value"])
                self._count()
            case _:
                self.source.submit(action, client)
        if client.needs_picture():
            self.source.ask()

    def _count(self) -> None:
        """Tell the source how many pages are watching."""
        self.source.watched_by(sum(client.watches for client in self._clients))
