"""Files that pages download. They are made in other threads, a few at a time."""

import asyncio
import contextlib
import time
from concurrent.futures import Future, ThreadPoolExecutor

from mpsim.errors import MpsimError
from mpsim.viewer import film, keep
from mpsim.viewer.admission import Refusal
from mpsim.viewer.broadcast import Shown
from mpsim.viewer.source import Source

FILMS = {"film.gif": (film.gif, "image/gif"), "film.mp4": (film.mp4, "video/mp4")}
"""Films to download: the function that makes each, and its media type. The other files are in `keep.KEEPING`."""

MOST, SECONDS = 2, 8.0
"""Number of files that are made at a time, and the longest wait for one [s], less than the server's OPEN_SECONDS."""


class Downloads:
    """Makes the files that the pages of one view request."""

    def __init__(self) -> None:
        self._film = film.Film()
        self._drawing = ThreadPoolExecutor(MOST, "mpsim view: film")
        self._making = 0

    def close(self) -> None:
        """Cancel the films that wait, and end the threads."""
        self._drawing.shutdown(cancel_futures=True)

    def show(self, picture: Shown) -> None:
        """Keep a picture for films."""
        self._film.add(picture, time.monotonic())

    async def made(self, name: str, source: Source) -> keep.Kept:
        """A file of what the source shows.

        Raises:
            Refusal: if no file has this name, or it cannot be made now.
        """
        if name not in FILMS and name not in keep.KEEPING:
            raise Refusal(404, f"There is no {name[:40]!r} to keep.")
        if self._making >= MOST:
            raise Refusal(503, f"At most {MOST} files are made at a time. Try again.")
        try:
            making = self._begin(name, source)
            self._making += 1
            loop = asyncio.get_running_loop()
            making.add_done_callback(lambda _: self._end_in(loop))
            return await asyncio.wait_for(asyncio.wrap_future(making), SECONDS)
        except TimeoutError:
            raise Refusal(503, "The simulation is busy. Try again.") from None
        except MpsimError as error:
            raise Refusal(409, str(error)) from None

    def _begin(self, name: str, source: Source) -> Future[keep.Kept]:
        """Start to make a file in another thread, which may continue after the request has timed out."""
        if name not in FILMS:
            return source.keep(name)
        make, kind = FILMS[name]
        pictures = self._film.pictures()
        return self._drawing.submit(lambda: keep.Kept(make(pictures), kind))

    def _end_in(self, loop: asyncio.AbstractEventLoop) -> None:
        """Count a file as made, in the thread of the pages, unless that has ended."""
        with contextlib.suppress(RuntimeError):
            loop.call_soon_threadsafe(self._end)

    def _end(self) -> None:
        self._making -= 1
