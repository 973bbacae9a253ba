"""A page of a live view without a browser: what it is sent, and what it says."""

import json
import time
from collections.abc import Callable
from contextlib import contextmanager, suppress
from http.client import HTTPConnection, HTTPResponse
from typing import Any
from urllib.parse import urlsplit

from websockets.sync.client import connect

import mpsim
from mpsim.engine.solvers.in_place import InPlace, in_place
from mpsim.viewer import wire

PATIENCE = 150.0
"""Seconds for what must come: kernels may have to be compiled first."""


class Visitor:
    """A connection to a view. Attributes: last (messages by kind), picture and radii (those that came last)."""

    def __init__(self, address: str, **options: Any):
        where = urlsplit(address)
        options = {"origin": f"http://{where.netloc}", "compression": None, "max_size": None, **options}
        self._connected = connect(f"ws://{where.netloc}{where.path}socket", **options)
        self.socket = self._connected.__enter__()
        self.last: dict[str, dict[str, Any]] = {}
        self.picture: wire.Picture | None = None
        self.radii: Any = None
        self.pictures = 0

    def __enter__(self) -> "Visitor":
        return self

    def __exit__(self, *exception: object) -> None:
        self._connected.__exit__(*exception)

    def say(self, do: str, **values: Any) -> None:
        self.socket.send(json.dumps({"do": do, **values}))

    def hear(self, timeout: float | None = None, ack: bool = True) -> str:
        """Take the next message; returns its kind."""
        message = self.socket.recv(timeout)
        if isinstance(message, str):
            found = json.loads(message)
            self.last[found["type"]] = found
            return found["type"]
        if message[5] == wire.RADII:
            self.radii = wire.unpack_radii(message)
            return "radii"
        self.picture = wire.unpack(message)
        self.pictures += 1
        if ack and self.picture.header.stage == 0:  # which stands for both stages
            self.say("ack", serial=self.picture.header.serial)
        return "picture"

    def hear_until(self, holds: Callable[["Visitor"], bool]) -> None:
        """Take messages until something holds."""
        end = time.monotonic() + PATIENCE
        while not holds(self):
            self.hear(max(end - time.monotonic(), 0.001))

    def hear_for(self, seconds: float, ack: bool = True) -> None:
        """Take what comes for some time."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            with suppress(TimeoutError):
                self.hear(left, ack)

    @property
    def phase(self) -> str | None:
        return self.last.get("status", {}).get("phase")

    @property
    def frame(self) -> int:
        return -1 if self.picture is None else self.picture.header.frame


def packed(header: wire.Header, state: mpsim.State, periodic: tuple[bool, bool] = (False, False)) -> bytearray:
    """A picture of a state, as bytes."""
    return wire.pack(header, placed(state), periodic)


def placed(state: mpsim.State) -> InPlace:
    """The discs of a state where it has them, in a box of no interest."""
    return in_place(state, (0.0, 1.0, 0.0, 1.0), 0, 0.0, state.position[:, 0])


@contextmanager
def viewed(source: Any, settings: Any = None, **options: Any):
    """A view that is open, without a browser."""
    with mpsim.view(source, settings, browser=False, wait=False, **options) as view:
        yield view


def fetch(address: str, method: str = "GET", path: str = "", **headers: str) -> HTTPResponse:
    """The answer of a view to a request; `path` is added to that of the address."""
    where = urlsplit(address)
    connection = HTTPConnection(where.netloc, timeout=10)
    try:
        connection.putrequest(method, where.path + path, skip_host="Host" in headers)
        for name, value in headers.items():
            connection.putheader(name, value)
        connection.endheaders()
        answer = connection.getresponse()
        answer.body = answer.read()
        return answer
    finally:
        connection.close()
