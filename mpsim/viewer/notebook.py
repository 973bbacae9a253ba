"""`mpsim.live`: the live view in the output of a notebook cell."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial
from typing import Any

from numpy.typing import ArrayLike

from mpsim.core import checks
from mpsim.core.checks import Closable
from mpsim.core.late import imported
from mpsim.errors import InputError
from mpsim.scene.settings import Settings
from mpsim.viewer.live import Viewed, source_of
from mpsim.viewer.protocol import read_action
from mpsim.viewer.server import LATER, MOST_PAGES, POLICY, Client, Pages, Refusal, widget_module
from mpsim.viewer.source import Source

HEIGHT = 640  # default height of the page in a notebook, in pixels
LONGEST_NAME = 64  # largest number of characters in the name that a page gives itself
PING_SECONDS = 10.0  # time between two pings. A page that has sent nothing for one to two times as long is silent


def live(
    source: Viewed,
    settings: Settings | None = None,
    *,
    playing: bool = True,
    height: int = HEIGHT,
    name: str = "",
    colour: ArrayLike | None = None,
    beside: Settings | None = None,
) -> Live:
    """Show a simulation as it runs, in a notebook: the page of `mpsim.view` as the output of a cell.

    It is tested in JupyterLab; docs/howto/notebook.md says what was tried in other notebooks. The simulation runs while
    the output is visible in the browser, and pauses while it is not. The page loads nothing from other servers, and no
    port is opened: all messages use the notebook's own connection.

    Args:
        source: what to show. A scene: it is simulated, from the start again after each reset. A simulation: it stays
            yours. A trajectory: it is played with a time line.
        settings: settings for a scene; None: those it recommends, or the defaults.
        playing: start as soon as the page is visible; else wait for its Play button.
        height: height of the output in pixels, 200 to 4000.
        name: title on the page.
        colour, beside: numbers to colour discs by, and settings of a second stage, as in `mpsim.view`.

    The page shows lengths, times and speeds in the scene's own units: [length], [time], [length/time].

    Returns:
        An object that the notebook shows as the page if it is the last line of a cell. Its `close` ends the simulation.

    Raises:
        InputError: if an argument breaks a rule; the message gives its name, the rule and the value received.
        OutputError: if the package anywidget is missing; the extra `notebook` installs it.

    >>> import mpsim
    >>> scene = mpsim.Scene.random(count=50, packing=0.2, radius=0.5, seed=1)
    >>> with live(scene, name="gas") as shown:
    ...     shown
    <Live: 'gas'>
    """
    height = checks.whole("height", height, 200, 4000, f"{HEIGHT} suits most screens.")
    widget = _widget_class()
    shown = source_of(source, settings, name=name, playing=playing, colour=colour, beside=beside)
    return Live(NotebookPages(widget(height=height), shown), str(name))


class Live(Closable):
    """A page in a notebook that shows a simulation. `mpsim.live` makes it; leaving a `with` block closes it.

    Attributes:
        widget: the widget that the notebook shows, an `anywidget.AnyWidget`.
    """

    def __init__(self, pages: NotebookPages, name: str):
        self.widget: Any = pages.widget
        self._name = name
        self._pages = pages
        pages.start()

    def close(self) -> None:
        """Close the simulation, unless it is yours, and remove the page from the notebook. May be called again."""
        self._pages.close()
        self.widget.close()

    def _repr_mimebundle_(self, **options: Any) -> Any:
        """For Jupyter."""
        show = self.widget._repr_mimebundle_  # None of a widget that was closed, here or by the notebook
        return show(**options) if show else {"text/plain": f"{self!r} is closed; mpsim.live shows another."}

    def _display_(self) -> Any:
        """For marimo."""
        return self.widget

    def __repr__(self) -> str:
        return f"<Live: {self._name!r}>"


class _Page(Client):
    """One of the pages: its name, the number of messages sent to it, and whether it owes an answer to its last ping."""

    def __init__(self, pages: NotebookPages, name: str):
        super().__init__(pages, self._pass_on)
        self.name: str = name
        self.sent: int = 0
        self.asked: bool = False
        self._post = pages.post

    async def _pass_on(self, message: str | bytes | bytearray) -> None:
        if isinstance(message, str):
            self.post_counted({"text": message})
        else:
            self.post_counted({"bytes": True}, [message])

    def post_counted(self, content: dict[str, Any], buffers: Sequence[bytes | bytearray] = ()) -> None:
        self.sent += 1
        self._post(self.name, content, buffers)


class NotebookPages(Pages):
    """Pages in the outputs of a notebook, whose messages go through a widget.

    A notebook may show one widget in several places. Each is a page, with a name of its own in all messages.

    A browser that crashed does not close its connection, so each page is pinged from time to time. A page that does not
    answer is silent: it does not count as watching, and nothing is sent to it. Its connection is not closed, because
    the cause may be the kernel, which reads no messages while it runs a cell. The answers wait there, and the first one
    makes the page active again. A silent page is closed only if its place is needed for another page.

    The server of a notebook may drop messages when there are many. So each ping contains the number of messages sent. A
    page that has received fewer is sent everything again.
    """

    def __init__(self, widget: Any, source: Source):
        super().__init__("mpsim live: notebook", source)
        self.widget: Any = widget
        self._named: dict[str, _Page] = {}
        self._sending: set[asyncio.Task[None]] = set()  # files that pages download
        widget.on_msg(lambda _, content, buffers: self.from_outside(self._take, content))

    async def _until_the_end(self) -> None:
        while not self._end.is_set():
            try:
                await asyncio.wait_for(self._end.wait(), PING_SECONDS)
            except TimeoutError:
                self._ask_for_life()
        for page in list(self._named.values()):
            await self._end_of(page, POLICY, "the view was closed")

    def _ask_for_life(self) -> None:
        """Ping each page; one that has not answered the last ping is silent."""
        for page in self._named.values():
            if page.asked:
                page.silent = True
            else:
                page.asked = True
                self.post(page.name, {"ping": True, "sent": page.sent})
        self._count()

    def _take(self, content: Any) -> None:
        """Take a message from the widget's JavaScript module; ignore anything else."""
        match content:
            case {"page": str(name), "open": True} if len(name) <= LONGEST_NAME:
                self._open(name)
            case {"page": str(name), **more} if name in self._named:
                self._hear(self._named[name], more)
            case _:
                pass

    def _open(self, name: str) -> None:
        if name in self._named:
            self._end_of(self._named[name], POLICY, f"a page opens once; {name!r} was open")
            return
        if len(self._named) >= MOST_PAGES:
            silent = next((page for page in self._named.values() if page.silent), None)
            if silent is None:
                self._refuse(name, LATER, f"at most {MOST_PAGES} pages at a time: close another one")
                return
            self._end_of(silent, LATER, "it did not answer, and another page needed its place")
        self.post(name, {"opened": True})
        self._named[name] = page = _Page(self, name)
        self._join(page)

    def _hear(self, page: _Page, content: dict[str, Any]) -> None:
        match content:
            case {"close": True}:
                del self._named[page.name]
                asyncio.ensure_future(self._leave(page))  # noqa: RUF006 - nothing waits for its end
                return
            case {"pong": True}:
                act = page.send_again if content.get("lost") is True else None
            case {"text": str(text)}:
                act = partial(self._obey, page, lambda: self._do(page, read_action(text)))
            case {"keep": str(name)}:
                act = partial(self._obey, page, lambda: self._keep(page, name))
            case _:
                return
        page.asked = False
        if page.silent:
            page.silent = False
            page.wake()
            self._count()
        if act is not None:
            act()

    def _obey(self, page: _Page, act: Callable[[], None]) -> None:
        """Do what a page requests; close its connection if it breaks a rule."""
        try:
            page.spend(asyncio.get_running_loop().time())
            act()
        except InputError as error:
            self.source.forget(page)
            self._end_of(page, POLICY, str(error))

    def _keep(self, page: _Page, name: str) -> None:
        making = asyncio.ensure_future(self._send_made(page, name))
        self._sending.add(making)
        making.add_done_callback(self._sending.discard)

    async def _send_made(self, page: _Page, name: str) -> None:
        try:
            made = await self._made(name)
        except Refusal as refusal:
            page.post_counted({"kept": name, "refused": str(refusal)})
        else:
            page.post_counted({"kept": name, "kind": made.kind}, [made.content])

    def _end_of(self, page: _Page, code: int, reason: str) -> asyncio.Task[None]:
        """Close the connection of a page; the returned task ends when that is done."""
        del self._named[page.name]
        return asyncio.ensure_future(self._leave_and_say(page, code, reason))

    async def _leave_and_say(self, page: _Page, code: int, reason: str) -> None:
        await self._leave(page)
        self._refuse(page.name, code, reason)

    def _refuse(self, name: str, code: int, reason: str) -> None:
        self.post(name, {"closed": {"code": code, "reason": reason}})

    def post(self, name: str, content: Mapping[str, Any], buffers: Sequence[bytes | bytearray] = ()) -> None:
        """Send a message to a page. If the notebook's connection fails, the page is silent until it is heard again."""
        try:
            self.widget.send({"page": name, **content}, list(buffers))
        except Exception:  # whatever the notebook's packages raise, such as for a kernel that is ending
            if name in self._named:
                self._named[name].silent = True
                self._count()


@cache
def _widget_class() -> Any:
    """The class of the widget, or raise OutputError if the package anywidget is missing."""
    instead = "watch it on a page of its own, by mpsim.view"
    anywidget = imported("anywidget", "a live view in a notebook", "notebook", instead)
    traitlets = imported("traitlets", "a live view in a notebook", "notebook", instead)

    class LiveWidget(anywidget.AnyWidget):
        _esm = widget_module()
        height = traitlets.Int(HEIGHT).tag(sync=True)

    return LiveWidget
