"""`mpsim.view`: shows a running or recorded simulation on a page in the browser."""

from __future__ import annotations

import os
import sys
import webbrowser
from typing import Any
from urllib.parse import urlencode

from numpy.typing import ArrayLike

from mpsim.core import checks
from mpsim.core.errors import InputError
from mpsim.scene.settings import Settings
from mpsim.viewer import link
from mpsim.viewer.admission import Admission
from mpsim.viewer.link import Link
from mpsim.viewer.opening import Viewed, demand_viewed, source_of
from mpsim.viewer.server import Server, listening, websockets
from mpsim.viewer.source import Source

HOST = "127.0.0.1"
"""Where a view listens: other machines cannot reach it."""


def view(
    source: Viewed,
    settings: Settings | None = None,
    *,
    host: str = HOST,
    port: int = 0,
    browser: bool = True,
    playing: bool = True,
    name: str = "",
    colour: ArrayLike | None = None,
    beside: Settings | None = None,
    wait: bool = True,
) -> View:
    """Show a simulation as it runs, on a page in the browser.

    It runs while a page shows it, and pauses while none does. The page never slows it down by more than a few per cent,
    and the result has the same bits as without a page.

    Args:
        source: a scene, which the view simulates, again from the start at each reset; a simulation, which stays yours:
            the page can play and pause it, and shows it while your program runs it; only you close it; or a trajectory,
            whose file is played with a time line, and may still be written by a run.
        settings: how a scene is simulated; None: as it recommends, or the defaults.
        host: name or address of this machine at which the page is found. The default can be reached from this machine
            alone; any other from where the network allows it, without encryption.
        port: likewise, 0 to 65535; 0: one that is free.
        browser: open the page in a browser, if there is one. The address is printed in any case.
        playing: start with the first look; else wait for the page's button.
        name: what the page calls it.
        colour: a number for each disc, shape (N,), any unit, NaN for none, to colour them by; None: their speed. An
            array of float64 is read anew at each picture, so that your program can change it.
        beside: settings of a second stage, which runs the same scene beside the first one, such as
            Settings(method="event"): the page shows how far both are apart. Its dt is that of `settings` or a whole
            fraction of it; that of "event" follows. None: no second stage, until the page asks for one.
        wait: return only after Ctrl-C, which closes the view; else at once, with the view open.

    The page shows lengths, times and speeds in the scene's own units: [length], [time], [length/time].

    Returns:
        The view: its address, and `close`.

    Raises:
        InputError: naming the argument, its rule and the value received; for a trajectory without a frame.
        TrajectoryError: for a trajectory without velocities or radii.
        ResourceError: if the port is taken.
        OutputError: without the package websockets, which the extra `view` installs.

    >>> import mpsim
    >>> scene = mpsim.Scene.random(count=50, packing=0.2, radius=0.5, seed=1)
    >>> with view(scene, browser=False, wait=False) as page:  # doctest: +ELLIPSIS
    ...     page.address
    The live view is at http://127.0.0.1:.../
    Do not share this address: anyone who has it can control the view.
    'http://127.0.0.1:.../'
    """
    browser, wait = checks.truth("browser", browser), checks.truth("wait", wait)
    options: dict[str, Any] = {"host": host, "port": port, "playing": playing, "name": name}
    shown = View(source, settings, colour=colour, beside=beside, **options)
    try:
        shown.start(browser)
        if wait:
            shown.wait()
    except BaseException:
        shown.close()
        raise
    if wait:
        shown.close()
    return shown


class View:
    """A page that shows a simulation. `mpsim.view` makes it; leaving a `with` block closes it.

    Args:
        source, settings, host, port, playing, name, colour, beside: as in `mpsim.view`, with their bounds; lengths
            and times on the page are those of the scene, [length] and [time].

    Attributes:
        address: of the page. Its token keeps others out: do not pass it on to those who should not control the view.

    >>> import mpsim
    >>> scene = mpsim.Scene.random(count=50, packing=0.2, radius=0.5, seed=1)
    >>> with View(scene) as page:
    ...     page.address.startswith("http://127.0.0.1:")
    True
    """

    def __init__(
        self,
        source: Viewed,
        settings: Settings | None = None,
        *,
        host: str = HOST,
        port: int = 0,
        playing: bool = True,
        name: str = "",
        colour: ArrayLike | None = None,
        beside: Settings | None = None,
    ):
        demand_viewed(source, settings, beside)
        if not isinstance(host, str):
            raise InputError(f"host must be a name or an address; got {checks.brief(host)}. Use {HOST!r}.")
        port = checks.whole("port", port, 0, 65535, "0 takes one that is free.")
        websockets()  # or there is no need to begin
        found = listening(host, port)
        try:
            admission = Admission(host, found.getsockname()[1])
            self._server = Server(found, admission)
            playing = checks.truth("playing", playing)
            options: dict[str, Any] = {"name": str(name), "playing": playing, "colour": colour, "beside": beside}
            self._session: Source = source_of(source, settings, **options, audience=self._server)
        except BaseException:
            found.close()
            raise
        self.address: str = admission.address
        if isinstance(source, Link):  # whose page reads the rest of it
            self.address += f"?{link.write(source)}&{urlencode(source.seen)}".rstrip("&")

    def start(self, browser: bool) -> None:
        """Start it, and print its address; browser: open it there, too."""
        self._server.start(self._session)
        self._session.start()
        print(f"The live view is at {self.address}")
        print("Do not share this address: anyone who has it can control the view.", flush=True)
        if browser and _has_screen():
            webbrowser.open(self.address)

    def wait(self, seconds: float | None = None) -> None:
        """Wait until Ctrl-C, or at most so many seconds.

        Raises:
            MpsimError: whatever has ended the simulation for good.
        """
        ended = False
        try:
            ended = self._session.wait(seconds)
        except KeyboardInterrupt:
            return
        if ended and self._session.error is not None:
            raise self._session.error

    def close(self) -> None:
        """Close the page's connections and the simulation, unless that is yours. May be called again."""
        self._session.close()
        self._server.close()

    def __enter__(self) -> View:
        return self

    def __exit__(self, *exception: Any) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<View: {self.address}>"


def _has_screen() -> bool:
    """Whether a browser that is opened here can be seen: not one in the terminal, nor on a machine far away."""
    if sys.platform in ("darwin", "win32"):
        return True
    return any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"))
