"""One connected page: what was sent to it, what may be sent next, and how many messages it may send."""

import asyncio
from collections.abc import Mapping
from typing import Protocol

from mpsim.errors import InputError
from mpsim.viewer.broadcast import Shown

MOST_A_SECOND, BURST = 200.0, 400.0
"""Messages that a page may send: per second on average, and at most at once. A page sends one for each picture and one
for each key press."""

ORDER = ("scene", "status", "compiling", "timeline", "gauges", "hands", "link", "colours", "pair", "tune", "pass")
"""Kinds of messages. Waiting messages are sent in this order."""


class Connection(Protocol):
    """A connection to one page."""

    async def send(self, message: str | bytes | bytearray) -> None:
        """Send a text, or bytes."""
        ...


class Client:
    """Sends pictures and messages to one page.

    The page gets the next picture only after it has acknowledged the last one. Of several pictures that wait, or
    several messages of one kind, only the latest is sent.

    Args:
        connection: connection to the page.

    Attributes:
        visible: whether the page is visible, as it reports itself.
        silent: whether it has not answered for so long that it may no longer exist. Nothing is sent to a silent page.
    """

    def __init__(self, connection: Connection):
        self.visible: bool = False
        self.silent: bool = False
        self._connection = connection
        self._texts: dict[str, str] = {}
        self._picture: Shown | None = None
        self._radii: list[bytes | None] = [None, None]  # of each stage
        self._in_flight: int | None = None
        self._sent_again = 0  # pictures up to this number may be acknowledged late, and more than once
        self._last = 0
        self._news = asyncio.Event()
        self._allowance, self._asked = BURST, 0.0

    def spend(self, now: float) -> None:
        """Count a message from the page; now: time of a clock [s].

        Raises:
            InputError: if the page sends too many.
        """
        self._allowance = min(self._allowance + (now - self._asked) * MOST_A_SECOND, BURST)
        self._asked = now
        if self._allowance < 1:
            raise InputError(f"at most {MOST_A_SECOND:g} messages a second are read; got more. Send fewer.")
        self._allowance -= 1

    def tell(self, kind: str, text: str) -> None:
        """Send a message soon; it replaces a waiting one of its kind."""
        self._texts[kind] = text
        self._news.set()

    def show(self, picture: Shown) -> None:
        """Send a picture when the page is ready for it; it replaces a waiting one."""
        self._picture = picture
        self._news.set()

    def note(self, *, visible: bool | None = None, silent: bool | None = None) -> None:
        """Note whether the page is visible, and whether it is silent; None: as before."""
        self.visible = self.visible if visible is None else visible
        self.silent = self.silent if silent is None else silent
        self._news.set()

    @property
    def watches(self) -> bool:
        """Whether the page is visible and answers."""
        return self.visible and not self.silent

    def acknowledge(self, serial: int) -> None:
        """Note that the page has drawn a picture.

        Raises:
            InputError: if no picture with this number was sent.
        """
        if serial != self._in_flight and 0 < serial <= self._sent_again:
            return
        if serial != self._in_flight:
            raise InputError(f"serial of an ack must be that of the last picture; got {serial}. Send one for each.")
        self._in_flight = None
        self._news.set()

    def send_again(self, texts: Mapping[str, str]) -> None:
        """Send everything again, because a message was lost; texts: the last message of each kind."""
        self._texts = {**texts}
        self._radii = [None, None]
        self._sent_again = max(self._sent_again, self._in_flight or 0)
        self._last, self._in_flight = 0, None
        self._news.set()

    def needs_picture(self) -> bool:
        """Whether the page is ready for a picture and no new one is there."""
        return self.watches and self._in_flight is None and not self._can_show()

    def _can_show(self) -> bool:
        return self._picture is not None and self._picture.serial > self._last

    async def send_all(self) -> None:
        """Send pictures and messages as they come, until cancelled."""
        while True:
            await self._news.wait()
            self._news.clear()
            if self.silent:
                continue
            for kind in ORDER:
                if (text := self._texts.pop(kind, None)) is not None:
                    await self._connection.send(text)
            picture = self._picture
            if picture is not None and self.visible and self._in_flight is None and self._can_show():
                self._in_flight = self._last = picture.serial  # before the first await
                if picture.second is not None:
                    await self._send(1, picture.second.radii, picture.second.packed)
                await self._send(0, picture.radii, picture.packed)  # the page acknowledges this one, for both

    async def _send(self, stage: int, radii: bytes, packed: bytes | bytearray) -> None:
        """Send the picture of one stage, after its radii if these have changed."""
        if radii is not self._radii[stage]:
            self._radii[stage] = radii
            await self._connection.send(radii)
        await self._connection.send(packed)
