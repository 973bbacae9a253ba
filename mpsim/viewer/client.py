"""One connected page: what was sent to it, what may be sent next, and its limit on messages."""

import asyncio
from collections.abc import Mapping
from typing import Protocol

from mpsim.core.errors import InputError
from mpsim.viewer.broadcast import Shown

MOST_A_SECOND, BURST = 200.0, 400.0
"""Messages that a page may send: a second on average, and at once. It sends one for each picture, and one a key."""

ORDER = ("scene", "status", "timeline", "gauges", "hands", "link", "colours", "pair", "tune", "pass")
"""Kinds of messages, in the order in which they are sent."""


class Connection(Protocol):
    """What sends to one page."""

    async def send(self, message: str | bytes | bytearray) -> None:
        """Send a text, or bytes."""
        ...


class Client:
    """What one page is sent: at most one picture that it has not acknowledged; of what waits, the latest.

    Args:
        connection: to the page.

    Attributes:
        visible: whether somebody can see the page, as it says itself.
        silent: whether it has not answered for so long that there may be no page any more: it is sent nothing.
    """

    def __init__(self, connection: Connection):
        self.visible: bool = False
        self.silent: bool = False
        self._connection = connection
        self._texts: dict[str, str] = {}
        self._picture: Shown | None = None
        self._radii: list[bytes | None] = [None, None]  # of each stage
        self._in_flight: int | None = None
        self._twice: int | None = None  # a picture that was sent again, and may be acknowledged again
        self._last = 0
        self._news = asyncio.Event()
        self._allowance, self._asked = BURST, 0.0

    def spend(self, now: float) -> None:
        """Count a message that has come.

        Raises:
            InputError: if there are too many.
        """
        self._allowance = min(self._allowance + (now - self._asked) * MOST_A_SECOND, BURST)
        self._asked = now
        if self._allowance < 1:
            raise InputError(f"at most {MOST_A_SECOND:g} messages a second are read; got more. Send fewer.")
        self._allowance -= 1

    def tell(self, kind: str, text: str) -> None:
        """Have a message sent, in place of one of its kind that waits."""
        self._texts[kind] = text
        self._news.set()

    def show(self, picture: Shown) -> None:
        """Have a picture sent when the page is ready for it, in place of one that waits."""
        self._picture = picture
        self._news.set()

    def note(self, *, visible: bool | None = None, silent: bool | None = None) -> None:
        """Note whether somebody can see the page, and whether it is silent; None: as before."""
        self.visible = self.visible if visible is None else visible
        self.silent = self.silent if silent is None else silent
        self._news.set()

    @property
    def watches(self) -> bool:
        """Whether somebody sees what the page is sent."""
        return self.visible and not self.silent

    def acknowledge(self, serial: int) -> None:
        """Note that the page has drawn a picture.

        Raises:
            InputError: if it was sent no such picture.
        """
        if serial != self._in_flight and serial == self._twice:
            self._twice = None
            return
        if serial != self._in_flight:
            raise InputError(f"serial of an ack must be that of the last picture; got {serial}. Send one for each.")
        self._in_flight = None
        self._news.set()

    def send_again(self, texts: Mapping[str, str]) -> None:
        """Have all sent again, as something was lost on its way; texts: the last message of each kind."""
        self._texts = {**texts}
        self._radii = [None, None]
        self._last, self._in_flight, self._twice = 0, None, self._in_flight
        self._news.set()

    def needs_picture(self) -> bool:
        """Whether the page waits for a picture and there is none for it."""
        return self.watches and self._in_flight is None and not self._can_show()

    def _can_show(self) -> bool:
        return self._picture is not None and self._picture.serial > self._last

    async def send_all(self) -> None:
        """Send what there is, as it comes, without end."""
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
                self._in_flight = self._last = picture.serial  # before anything is waited for
                if picture.second is not None:
                    await self._send(1, picture.second.radii, picture.second.packed)
                await self._send(0, picture.radii, picture.packed)  # which the page acknowledges, for both

    async def _send(self, stage: int, radii: bytes, packed: bytes | bytearray) -> None:
        """Send what one stage shows, its radii before it where they are others."""
        if radii is not self._radii[stage]:
            self._radii[stage] = radii
            await self._connection.send(radii)
        await self._connection.send(packed)
