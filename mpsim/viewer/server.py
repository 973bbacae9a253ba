"""The server of a view: which requests it answers, files of the page, connected pages, downloads."""

import asyncio
import base64
import contextlib
import hmac
import http
import ipaddress
import json
import logging
import re
import secrets
import socket
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Awaitable, Callable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache
from importlib import resources
from typing import Any

from mpsim.core.late import imported
from mpsim.errors import InputError, MpsimError, ResourceError
from mpsim.viewer import export
from mpsim.viewer.protocol import MOST_BYTES, Action, SentPicture, read_action
from mpsim.viewer.source import Source

# --- Decides which requests a view answers: those with its token, addressed to this machine, from its own page
#
# A page of another site that is open in the same browser can also send requests to 127.0.0.1. Three checks stop it. It
# does not know the token. The browser names its site in `Origin`. And if it makes a domain name of its own point to
# 127.0.0.1 (DNS rebinding), that name stands in `Host`.

TOKEN_BYTES = 24  # random bytes of a token: 192 bits cannot be guessed


_HOST = re.compile(r"(\[[0-9a-f]*:[0-9a-f:.]+\]|[^\[\]:%]+)(?::[0-9]{1,5})?")
"""A host and perhaps a port, as browsers write them in `Host`."""


class Refusal(Exception):  # noqa: N818 - the answer to a request
    """A request is refused, with this HTTP status and this text."""

    def __init__(self, status: int, text: str):
        super().__init__(text)
        self.status = status


class Admission:
    """Checks requests to one view, which listens at this host, a name or an address, and this port.

    Attributes:
        address: at which a browser opens the page; it contains the token.
    """

    def __init__(self, host: str, port: int):
        self._token = secrets.token_urlsafe(TOKEN_BYTES)
        self._host = host.lower()
        self._loopback = is_loopback(host)
        name = socket.gethostname() if self._host in ("0.0.0.0", "::") else self._host
        self.address: str = f"http://{f'[{name}]' if ':' in name else name}:{port}/{self._token}/"

    def name_of(self, path: str, headers: Any) -> str:
        """The name of what a request asks for: the part of its path after the token, without a query.

        Raises:
            Refusal: if the request names another host, or lacks the token.
        """
        hosts = headers.get_all("Host")
        if len(hosts) != 1 or not self._is_here(hosts[0].lower()):
            raise Refusal(
                421,
                f"A view is opened at localhost or at an IP address; got {', '.join(hosts)[:80]!r}. Other sites can "
                "make other names lead here. Open the address that mpsim view has printed, with localhost in place of "
                "its host; where a port is forwarded, with that port; from another machine, with the IP address of "
                "this one.",
            )
        parts = path.partition("?")[0].split("/", 2)
        token = parts[1] if len(parts) == 3 and not parts[0] else ""
        if not hmac.compare_digest(token.encode("utf-8", "replace"), self._token.encode()):
            raise Refusal(404, "Not found. Open the complete address that mpsim view has printed.")
        return parts[2]

    def demand_own_page(self, headers: Any) -> None:
        """Raise Refusal for a connection that was not requested by a page of this view."""
        if headers.get_all("Origin") != [f"http://{headers.get_all('Host')[0]}"]:
            raise Refusal(403, "Only the page of this view may connect to it. Open the address that it has printed.")

    def _is_here(self, host: str) -> bool:
        """Whether a request to this host, given as `name` or `name:port`, is meant for this view.

        A numeric address always means itself. A domain name can be made to point to any machine, so only the names of
        this machine are accepted. Any port is, because the port may be forwarded; a page at another port has another
        origin.
        """
        found = _HOST.fullmatch(host)
        if found is None:
            return False
        name = found[1].strip("[]")
        try:
            return not ipaddress.ip_address(name).is_unspecified
        except ValueError:
            return name in {"localhost", self._host} or (not self._loopback and name == socket.gethostname().lower())


def is_loopback(host: str) -> bool:
    """Whether a name or an address is a loopback address, which other machines cannot reach.

    >>> is_loopback("127.0.0.1"), is_loopback("localhost"), is_loopback("::1"), is_loopback("192.168.0.7")
    (True, True, True, False)
    """
    if host.lower() == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


# --- The files of the page. They are read once from the package; no name from a request becomes a path

KINDS = {"html": "text/html", "css": "text/css", "js": "text/javascript", "svg": "image/svg+xml"}
"""Media types of the files, by extension."""

WIDGET = "widget.js"  # the only file that is used in notebooks alone

_FOLDER = resources.files("mpsim.viewer").joinpath("page")

_IMPORT, _BARE = re.compile(r'\b(import|from) "\./([\w-]+\.js)"'), r'\1 "mpsim/\2"'
"""How a module imports another module of the page, and how it does so with an import map."""

_INDENT = re.compile(r"^ +", re.MULTILINE)  # indentation, which is removed to make notebooks smaller


@cache
def page_files() -> dict[str, export.Download]:
    """All files of the page, by the name that a browser requests; the page itself has the empty name."""
    found = {}
    for file in _FOLDER.iterdir():
        ending = file.name.rpartition(".")[2]
        if ending in KINDS and file.name != WIDGET:
            name = "" if file.name == "index.html" else file.name
            found[name] = export.Download(file.read_bytes(), f"{KINDS[ending]}; charset=utf-8")
    return found


def widget_module() -> str:
    """The JavaScript module of the widget that shows the page in a notebook.

    It contains the page as a single HTML text, with the style sheet, and the modules in an import map.
    """
    files = {name: _INDENT.sub("", file.content.decode()) for name, file in page_files().items()}
    modules = {
        f"mpsim/{name}": f"data:text/javascript;base64,{base64.b64encode(_IMPORT.sub(_BARE, text).encode()).decode()}"
        for name, text in files.items()
        if name.endswith(".js")
    }
    imports = json.dumps({"imports": modules})
    script = f'<script type="importmap">{imports}</script>\n<script type="module">import "mpsim/page.js";</script>'
    text = files[""]
    for found, instead in (
        ('<html lang="en">', '<html lang="en" data-place="notebook">'),
        ('<link rel="stylesheet" href="page.css">', f"<style>{files['page.css']}</style>"),
        ('<script type="module" src="page.js"></script>', script),
    ):
        assert text.count(found) == 1, found  # the page has been changed
        text = text.replace(found, instead)
    return f"{_FOLDER.joinpath(WIDGET).read_text()}\nconst PAGE = {json.dumps(text)};\n"


# --- One connected page: what was sent to it, what may be sent next, and how many messages it may send

MOST_A_SECOND, BURST = 200.0, 400.0
"""Messages that a page may send: per second on average, and at most at once. A page sends one for each picture and one
for each key press."""

ORDER = (
    "scene", "obstacles", "status", "compiling", "timeline", "gauges", "hands", "link", "colours", "pair",
)  # fmt: skip
"""Kinds of messages. Waiting messages are sent in this order."""


Send = Callable[[str | bytes | bytearray], Awaitable[None]]  # sends a message to one page


class Client:
    """Sends pictures and messages to one page.

    The page gets the next picture only after it has acknowledged the last one. Of several pictures that wait, or
    several messages of one kind, only the latest is sent.

    pages: hold the latest messages and picture.
    """

    def __init__(self, pages: "Pages", send: Send):
        self.visible: bool = False  # as the page reports itself
        self.silent: bool = False  # it has not answered for so long that it may no longer exist: nothing is sent to it
        self._pages, self._send = pages, send
        self._waiting = set(pages.texts)  # kinds of messages
        self._radii: list[bytes | None] = [None, None]  # of each stage
        self._in_flight: int | None = None
        self._sent_again = 0  # pictures up to this number may be acknowledged late, and more than once
        self._last = 0
        self._news = asyncio.Event()
        self._news.set()
        self._allowance, self._asked = BURST, 0.0

    def spend(self, now: float) -> None:
        """Count a message from the page, or raise InputError if it sends too many; now: time of a clock [s]."""
        self._allowance = min(self._allowance + (now - self._asked) * MOST_A_SECOND, BURST)
        self._asked = now
        if self._allowance < 1:
            raise InputError(f"at most {MOST_A_SECOND:g} messages a second are read; got more. Send fewer.")
        self._allowance -= 1

    def wake(self, *kinds: str) -> None:
        """Send the latest messages of these kinds soon, and what else waits for the page to be ready."""
        self._waiting.update(kinds)
        self._news.set()

    @property
    def watches(self) -> bool:
        """Whether the page is visible and answers."""
        return self.visible and not self.silent

    def acknowledge(self, serial: int) -> None:
        """Note that the page has drawn a picture, or raise InputError if none with this number was sent."""
        if serial != self._in_flight and 0 < serial <= self._sent_again:
            return
        if serial != self._in_flight:
            raise InputError(f"serial of an ack must be that of the last picture; got {serial}. Send one for each.")
        self._in_flight = None
        self._news.set()

    def send_again(self) -> None:
        """Send everything again, because a message was lost."""
        self._radii = [None, None]
        self._sent_again = max(self._sent_again, self._in_flight or 0)
        self._last, self._in_flight = 0, None
        self.wake(*self._pages.texts)

    def needs_picture(self) -> bool:
        """Whether the page is ready for a picture and no new one is there."""
        return self.watches and self._in_flight is None and self._next_picture() is None

    def _next_picture(self) -> SentPicture | None:
        picture = self._pages.picture
        return picture if picture is not None and picture.serial > self._last else None

    async def send_all(self) -> None:
        """Send pictures and messages as they come, until cancelled."""
        while True:
            await self._news.wait()
            self._news.clear()
            if self.silent:
                continue
            for kind in ORDER:
                if kind in self._waiting:
                    self._waiting.remove(kind)
                    await self._send(self._pages.texts[kind])
            picture = self._next_picture()
            if picture is None or not self.visible or self._in_flight is not None:
                continue
            self._in_flight = self._last = picture.serial  # before the first await
            for number, stage in reversed([*enumerate(picture.stages)]):  # the page acknowledges the first, for both
                if stage.radii is not self._radii[number]:
                    self._radii[number] = stage.radii
                    await self._send(stage.radii)
                await self._send(stage.packed)


# --- All pages of a view, connected by a server or a notebook
#
# An event loop in a thread of its own serves them. A page that breaks a rule is disconnected; nothing else is
# affected.

MOST_PAGES = 8  # largest number of pages that are connected at a time

MOST_FILES, FILE_SECONDS = 2, 8.0
"""Number of files that are made at a time for pages, and the longest wait for one [s], less than OPEN_SECONDS."""


class Pages(ABC):
    """The pages of one view and its source, which they show; name: of their thread.

    Attributes:
        texts: the latest message of each kind, from the source's thread.
        picture: the latest one.
    """

    def __init__(self, name: str, source: Source):
        self.source: Source = source
        self._clients: dict[Client, asyncio.Task[None]] = {}
        self.texts: dict[str, str] = {}
        self.picture: SentPicture | None = None
        self._film = export.Film()
        self._drawing = ThreadPoolExecutor(MOST_FILES, "mpsim view: film")
        self._making: list[Future[export.Download]] = []  # files
        self._spent = 0.0  # processor time of the thread that was already charged [s]
        self._loop: asyncio.AbstractEventLoop | None = None  # set by `start`
        self._end = asyncio.Event()
        self._thread = threading.Thread(target=self._serve, name=name, daemon=True)

    def start(self) -> None:
        """Start the threads of the pages and of the source, unless they were started before."""
        if self._loop is not None:
            return
        self._loop = asyncio.new_event_loop()
        self._thread.start()
        self.source.start(self)

    def close(self) -> None:
        """Close the source, then all connections, and end the threads. May be called again."""
        self.source.close()
        if self._thread.ident is not None:
            self.from_outside(self._end.set)
            self._thread.join()
        self._drawing.shutdown(cancel_futures=True)

    def from_outside(self, act: Callable[..., None], *arguments: Any) -> None:
        """Call a function in the thread of the pages, from another one; do nothing if that has ended."""
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

    def show(self, picture: SentPicture) -> None:
        """Pass a picture to the pages."""
        self.picture = picture
        self._film.add(picture, time.monotonic())
        self.wake()

    def wake(self, *kinds: str) -> None:
        """Have the latest messages of these kinds sent to all pages, and the latest picture."""
        for client in self._clients:
            client.wake(*kinds)

    def _join(self, client: Client) -> None:
        """Serve another page, which gets the latest messages and picture."""
        self._clients[client] = asyncio.ensure_future(client.send_all())

    async def _leave(self, client: Client) -> None:
        """Stop serving a page, whatever has happened to its connection."""
        sending = self._clients.pop(client)
        sending.cancel()
        self._count()
        await asyncio.gather(sending, return_exceptions=True)

    def _do(self, client: Client, action: Action) -> None:
        """Do the action that a page has sent, or raise InputError if it breaks a rule."""
        spent, self._spent = self._spent, time.thread_time()
        self.source.charge(self._spent - spent)
        match action.name:
            case "ack":
                client.acknowledge(action.values["serial"])
            case "visible":
                client.visible = action.values["value"]
                client.wake()
                self._count()
            case _:
                self.source.submit(action, client)
        if client.needs_picture():
            self.source.ask()

    async def _made(self, name: str) -> export.Download:
        """A file of what is shown, or raise Refusal if none has this name, or it cannot be made now."""
        if name != export.FILM and name not in export.FILES:
            raise Refusal(404, f"There is no {name[:40]!r} to keep.")
        self._making = [each for each in self._making if not each.done()]
        if len(self._making) >= MOST_FILES:
            raise Refusal(503, f"At most {MOST_FILES} files are made at a time. Try again.")
        try:
            if name == export.FILM:
                making = self._drawing.submit(export.film, list(self._film.pictures), self.source.scene)
            else:
                making = self.source.export(name)
            self._making.append(making)
            return await asyncio.wait_for(asyncio.wrap_future(making), FILE_SECONDS)
        except TimeoutError:
            raise Refusal(503, "The simulation is busy. Try again.") from None
        except MpsimError as error:
            raise Refusal(409, str(error)) from None

    def _count(self) -> None:
        self.source.watched_by(sum(client.watches for client in self._clients))


# --- The server of a view: it sends the files of the page by HTTP, and has a WebSocket to each page

SOCKET = "socket"  # name that a page requests to open its WebSocket
KEEP = "keep/"  # prefix of the names of files to download

OPEN_SECONDS, CLOSE_SECONDS, PING_SECONDS = 10, 1, 20
"""Time limits of the opening and of the closing handshake, and the time between two pings [s]."""

UNACCEPTABLE, POLICY, LATER = 1003, 1008, 1013
"""WebSocket codes (RFC 6455) for closing a connection: it sent bytes, it broke a rule, there are too many pages."""

TEXT = "text/plain; charset=utf-8"

HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-store",
}
"""Headers of all answers: browsers must not guess types, embed the page, pass on its address, or cache it."""


def _listening(host: str, port: int) -> socket.socket:
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
    """The server of one view, at a host and a port of this machine; 0: any free port.

    Raises:
        OutputError: if the package websockets is missing.
        ResourceError: if the port is taken, or the host is not one of this machine.
    """

    def __init__(self, host: str, port: int, source: Source):
        super().__init__("mpsim view: server", source)
        self._logger = logging.getLogger("mpsim.viewer.connections")
        self._logger.setLevel(logging.CRITICAL + 1)  # not of requests that break rules, of which there may be many
        instead = "write a film by mpsim.animate or `mpsim animate`"
        imported("websockets.asyncio.server", "a live view", "view", instead)
        self._websockets: Any = imported("websockets", "a live view", "view", instead)
        self._socket = _listening(host, port)
        self._admission = Admission(host, self._socket.getsockname()[1])
        self.address: str = self._admission.address

    def close(self) -> None:
        super().close()
        self._socket.close()

    # --- the thread

    async def _until_the_end(self) -> None:
        async with self._websockets.asyncio.server.serve(
            self._talk,
            sock=self._socket,
            process_request=self._answer,
            compression=None,
            max_size=MOST_BYTES,
            max_queue=16,
            open_timeout=OPEN_SECONDS,
            close_timeout=CLOSE_SECONDS,
            ping_interval=PING_SECONDS,
            ping_timeout=PING_SECONDS,
            server_header=None,
            logger=self._logger,
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
            if name.startswith(KEEP):
                kept = await self._made(name.removeprefix(KEEP))
                return self._response(kept.content, kept.kind)
            if (file := page_files().get(name)) is None:
                raise Refusal(404, f"There is no {name[:40]!r} here.")
        except Refusal as refusal:
            return self._response(str(refusal), status=refusal.status)
        return self._response(file.content, file.kind, host=request.headers["Host"])

    def _response(self, content: str | bytes, kind: str = TEXT, status: int = 200, host: str = "") -> Any:
        """An answer; host: of the page, which may connect to it."""
        body = content.encode() if isinstance(content, str) else content
        headers = {"Content-Type": kind, "Content-Length": str(len(body)), "Connection": "close", **HEADERS}
        if host:
            headers["Content-Security-Policy"] = (
                "default-src 'none'; script-src 'self'; style-src 'self'; img-src data:; connect-src 'self' "
                f"ws://{host}; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
            )
        every = self._websockets.datastructures.Headers(headers)
        return self._websockets.http11.Response(status, http.HTTPStatus(status).phrase, every, body)

    async def _talk(self, connection: Any) -> None:
        if len(self._clients) >= MOST_PAGES:
            await connection.close(LATER, f"at most {MOST_PAGES} pages at a time: close another one")
            return
        client = Client(self, connection.send)
        self._join(client)
        try:
            async for message in connection:
                client.spend(time.monotonic())
                if not isinstance(message, str):
                    await connection.close(UNACCEPTABLE, "a page sends text, not bytes")
                    return
                self._do(client, read_action(message))
        except InputError as error:
            self.source.forget(client)
            await connection.close(POLICY, str(error).encode()[:120].decode(errors="ignore"))  # it allows 123 bytes
        except self._websockets.exceptions.ConnectionClosed:
            pass  # a message was too long, or a ping was not answered
        finally:
            await self._leave(client)
