"""The server of a view: it sends the files of the page by HTTP, and has a WebSocket to each page.

It runs in a thread of its own. A page that breaks a rule is disconnected; nothing else is affected.
"""

import asyncio
import http
import logging
import socket
import time
from typing import Any

from mpsim.core.optional_packages import imported
from mpsim.errors import InputError, MpsimError, ResourceError
from mpsim.viewer import link, wire
from mpsim.viewer.admission import Admission, Refusal
from mpsim.viewer.client import Client
from mpsim.viewer.page_files import page_files
from mpsim.viewer.pages import MOST_PAGES, Pages

SOCKET = "socket"
"""Name that a page requests to open its WebSocket."""

KEEP = "keep/"
"""Prefix of the names of files to download."""

LINK = "link"
"""Name that a page requests, with a link as the query, to have the link checked and written in its standard form."""

OPEN_SECONDS, CLOSE_SECONDS, PING_SECONDS = 10, 1, 20
"""Time limits of the opening and of the closing handshake, and the time between two pings [s]."""

UNACCEPTABLE, POLICY, LATER = 1003, 1008, 1013
"""WebSocket codes (RFC 6455) for closing a connection: it sent bytes, it broke a rule, there are too many pages."""

HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-store",
}
"""Headers of all answers: browsers must not guess types, embed the page, pass on its address, or cache it."""


def websockets() -> Any:
    """The package websockets.

    Raises:
        OutputError: if it is not installed.
    """
    imported("websockets.asyncio.server", "a live view", "view", "write a film by mpsim.animate or `mpsim animate`")
    return imported("websockets", "a live view", "view", "write a film by mpsim.animate or `mpsim animate`")


def listening(host: str, port: int) -> socket.socket:
    """Open a listening socket.

    Raises:
        ResourceError: if the port is taken, or the host is not one of this machine.
    """
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        return socket.create_server((host, port), family=family)
    except OSError as error:
        reason = (error.strerror or str(error)).partition(" (while")[0]  # which repeats the address
        raise ResourceError(
            f"a view needs a host of this machine and a free port; got {host!r}{f' and {port}' if port else ''} "
            f"({reason}). Leave them out for 127.0.0.1 and a port that is free."
        ) from None


class Server(Pages):
    """The server of one view; the audience of its source.

    Args:
        found: listening socket.
        admission: decides which requests are answered.
    """

    def __init__(self, found: socket.socket, admission: Admission):
        super().__init__("mpsim view: server")
        self._socket = found
        self._admission = admission
        self._websockets = websockets()

    def close(self) -> None:
        """Close all connections and end the thread."""
        super().close()
        self._socket.close()

    # --- the thread

    async def _until_the_end(self) -> None:
        async with self._websockets.asyncio.server.serve(
            self._talk,
            sock=self._socket,
            process_request=self._answer,
            compression=None,
            max_size=wire.MOST_BYTES,
            max_queue=16,
            open_timeout=OPEN_SECONDS,
            close_timeout=CLOSE_SECONDS,
            ping_interval=PING_SECONDS,
            ping_timeout=PING_SECONDS,
            server_header=None,
            logger=_quiet(),
        ):
            await self._end.wait()

    async def _answer(self, connection: Any, request: Any) -> Any:
        """The answer to an HTTP request; None: open a WebSocket instead."""
        try:
            if getattr(request, "method", "GET") != "GET":  # older versions of websockets refuse others themselves
                raise Refusal(405, "Only GET is answered here.")
            name = self._admission.name_of(request.path, request.headers)
            if name == SOCKET:
                self._admission.demand_own_page(request.headers)
                return None
            if name == LINK:
                asked = await asyncio.to_thread(_read_link, request.path)
                return self._response(200, asked.encode(), "text/plain; charset=utf-8", "")
            if name.startswith(KEEP):
                kept = await self._downloads.made(name.removeprefix(KEEP), self.source)
                return self._response(200, kept.content, kept.kind, "")
            if (file := page_files().get(name)) is None:
                raise Refusal(404, f"There is no {name[:40]!r} here.")
        except Refusal as refusal:
            return self._response(refusal.status, str(refusal).encode(), "text/plain; charset=utf-8", "")
        return self._response(200, file.content, file.kind, request.headers["Host"])

    def _response(self, status: int, body: bytes, kind: str, host: str) -> Any:
        policy = (
            f"default-src 'none'; script-src 'self'; style-src 'self'; img-src data:; connect-src 'self' ws://{host}; "
            "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
        )
        headers = {"Content-Type": kind, "Content-Length": str(len(body)), "Connection": "close", **HEADERS}
        if host:
            headers["Content-Security-Policy"] = policy
        every = self._websockets.datastructures.Headers(headers)
        return self._websockets.http11.Response(status, http.HTTPStatus(status).phrase, every, body)

    async def _talk(self, connection: Any) -> None:
        """Serve one page until its connection ends."""
        if len(self._clients) >= MOST_PAGES:
            await connection.close(LATER, f"at most {MOST_PAGES} pages at a time: close another one")
            return
        client = self._join(connection)
        try:
            await self._listen(client, connection)
        finally:
            await self._leave(client)

    async def _listen(self, client: Client, connection: Any) -> None:
        """Do the actions that a page sends; close its connection if it breaks a rule."""
        try:
            async for message in connection:
                client.spend(time.monotonic())
                if not isinstance(message, str):
                    await connection.close(UNACCEPTABLE, "a page sends text, not bytes")
                    return
                self._do(client, wire.read_action(message))
        except InputError as error:
            self.source.forget(client)
            await connection.close(POLICY, _short(str(error)))
        except self._websockets.exceptions.ConnectionClosed:
            pass  # a message was too long, or a ping was not answered


def _read_link(path: str) -> str:
    """The link in an address, checked and in its standard form; "" for one that concerns only the display.

    Raises:
        Refusal: if the link is not allowed.
    """
    try:
        return link.checked(link.query_of(path))
    except MpsimError as error:
        raise Refusal(409, str(error)) from None


def _short(text: str) -> str:
    """A reason, cut to the length that WebSocket allows: 123 bytes."""
    return text.encode()[:120].decode(errors="ignore")


def _quiet() -> logging.Logger:
    """A logger that drops messages about requests that break rules, of which there may be many."""
    logger = logging.getLogger("mpsim.viewer.connections")
    logger.setLevel(logging.CRITICAL + 1)
    return logger
