"""`mpsim.view`: shows a running or recorded simulation on a page in the browser."""

from __future__ import annotations

import contextlib
import os
import sys
import webbrowser
from multiprocessing.util import Finalize
from urllib.parse import urlencode

from numpy.typing import ArrayLike

from mpsim.core import checks
from mpsim.core.checks import Closable
from mpsim.engine.access import END_PRIORITY
from mpsim.engine.simulation import Simulation
from mpsim.errors import InputError
from mpsim.output.trajectory import Trajectory
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings
from mpsim.viewer import share_url
from mpsim.viewer.playback import Playback, Recording
from mpsim.viewer.protocol import in_utf8, own_colours
from mpsim.viewer.server import Server
from mpsim.viewer.session import Session
from mpsim.viewer.share_url import Link
from mpsim.viewer.source import Source

# --- Makes the source of pictures for a scene, a simulation, a trajectory or a link

Viewed = Scene | Simulation | Trajectory | Recording | Link
"""What a view can show. A recording is the file of a trajectory together with its scene; a link names a scene."""


def source_of(
    viewed: Viewed,
    settings: Settings | None,
    *,
    name: str,
    playing: bool,
    colour: ArrayLike | None,
    beside: Settings | None,
) -> Source:
    """The source for the pages of a view; it raises errors as `mpsim.view` does."""
    _demand_viewed(viewed, settings, colour, beside)
    name, playing = in_utf8(str(name)), checks.truth("playing", playing)
    if isinstance(viewed, Trajectory):
        viewed = Recording(viewed.path, **viewed.given)
    if isinstance(viewed, Recording):
        return Playback(viewed, name=name, playing=playing)
    own = own_colours(colour, viewed.given.count if isinstance(viewed, Link) else viewed.count)
    return Session(viewed, settings, name=name, playing=playing, colour=own, beside=beside)


def _demand_viewed(viewed: object, settings: object, colour: object, beside: object) -> None:
    if not isinstance(viewed, Viewed):
        raise InputError(
            f"a view shows an mpsim.Scene, an mpsim.Simulation or an mpsim.Trajectory; got {type(viewed).__name__}. "
            "Use mpsim.Scene.load(...) for the file of a scene, mpsim.Trajectory(...) for that of a run."
        )
    if beside is not None and not isinstance(beside, Settings):
        raise InputError(f"beside must be mpsim.Settings; got {type(beside).__name__}. Use Settings(method='event').")
    only_shown = isinstance(viewed, Trajectory | Recording)
    for argument, value in {"settings": settings, "beside": beside, "colour": colour}.items():
        if value is not None and (only_shown or (argument != "colour" and isinstance(viewed, Simulation))):
            what = "a trajectory, which is only shown" if only_shown else "a simulation, which has its own"
            raise InputError(f"{argument} can be given only with a scene; got it with {what}. Leave it out.")


HOST = "127.0.0.1"  # address at which a view listens; other machines cannot reach it


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

    The simulation runs while a page shows it, and pauses while none does. The page slows it down by a few per cent at
    most, and the results have the same bits as without a page.

    Args:
        source: what to show. A scene: the view simulates it, from the start again after each reset. A simulation: the
            page can play and pause it, and shows it while your program runs it; you have to close it yourself. A
            trajectory: its file is played with a time line, also while a run still writes it.
        settings: settings for a scene; None: those it recommends, or the defaults.
        host: name or address of this machine at which the page is served. The default can be reached only from this
            machine. Others can be reached from the network, without encryption.
        port: port at which the page is served, 0 to 65535; 0: any free one.
        browser: open the page in a browser, if there is one. The address is printed in any case.
        playing: start as soon as a page is visible; else wait for its Play button.
        name: title on the page.
        colour: a number for each disc, shape (N,), in any unit, to colour the discs by; NaN: no value; None: colour by
            speed. A float64 array is read again for each picture, so your program can change it.
        beside: settings of a second stage, such as Settings(method="event"). It runs the same scene beside the first
            one, and the page shows the distance between both. Its dt must be that of `settings` or a whole fraction of
            it; with "event", dt is ignored. None: no second stage, until the page asks for one.
        wait: return only after Ctrl-C, which closes the view; else return at once, with the view open.

    The page shows lengths, times and speeds in the scene's own units: [length], [time], [length/time].

    Returns:
        The view, with its `address` and `close`.

    Raises:
        InputError: if an argument breaks a rule; the message gives its name, the rule and the value received. Also if
            a trajectory has no frame.
        TrajectoryError: if a trajectory has no velocities or radii.
        ResourceError: if the port is taken.
        OutputError: if the package websockets is missing; the extra `view` installs it.

    >>> import mpsim
    >>> scene = mpsim.Scene.random(count=50, packing=0.2, radius=0.5, seed=1)
    >>> with view(scene, browser=False, wait=False) as page:  # doctest: +ELLIPSIS
    ...     page.address
    The live view is at http://127.0.0.1:.../
    Do not share this address: anyone who has it can control the view.
    'http://127.0.0.1:.../'
    """
    browser, wait = checks.truth("browser", browser), checks.truth("wait", wait)
    shown = View(source, settings, host=host, port=port, playing=playing, name=name, colour=colour, beside=beside)
    with contextlib.ExitStack() as stack:
        stack.enter_context(shown)
        shown.start(browser)
        if wait:
            shown.wait()
        else:
            stack.pop_all()
    return shown


class View(Closable):
    """A page that shows a simulation. `mpsim.view` makes it; leaving a `with` block closes it.

    Args:
        source, settings, host, port, playing, name, colour, beside: as in `mpsim.view`.

    Attributes:
        address: address of the page. Anyone who has it can control the view, because it contains the secret token.

    The page shows lengths and times in the units of the scene, [length] and [time].
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
        if not isinstance(host, str):
            raise InputError(f"host must be a name or an address; got {checks.brief(host)}. Use {HOST!r}.")
        port = checks.whole("port", port, 0, 65535, "0 takes one that is free.")
        shown = source_of(source, settings, name=name, playing=playing, colour=colour, beside=beside)
        self._server = Server(host, port, shown)
        self._at_end: Finalize | None = None
        self.address: str = self._server.address
        if isinstance(source, Link):  # the page reads the rest of the link
            self.address += f"?{share_url.write(source)}&{urlencode(source.seen)}".rstrip("&")

    def start(self, browser: bool) -> None:
        """Start the view and print its address; browser: also open it in a browser."""
        # A thread that the interpreter ends inside numpy may abort the process: a view that is open at the end of the
        # program is closed, before the simulation of its program is.
        self._at_end = Finalize(None, self.close, exitpriority=END_PRIORITY + 1)
        self._server.start()
        print(f"The live view is at {self.address}")
        print("Do not share this address: anyone who has it can control the view.", flush=True)
        if browser and _has_screen():
            webbrowser.open(self.address)

    def wait(self, seconds: float | None = None) -> None:
        """Wait until Ctrl-C or until the simulation has ended, at most so many seconds; None: without a limit.

        Raises:
            MpsimError: the error that ended the simulation.
        """
        source = self._server.source
        with contextlib.suppress(KeyboardInterrupt):
            if source.wait(seconds) and source.error is not None:
                raise source.error

    def close(self) -> None:
        """Close the connections of the page, and the simulation unless it is yours. May be called again."""
        self._server.close()
        if self._at_end is not None:
            self._at_end.cancel()
            self._at_end = None

    def __repr__(self) -> str:
        return f"<View: {self.address}>"


def _has_screen() -> bool:
    """Whether a browser opened here would be visible: not a browser in a terminal, nor one on a remote machine."""
    if sys.platform in ("darwin", "win32"):
        return True
    return any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"))
