"""Cost of the live view, and pictures of its page.

python scripts/run_view.py                     two minutes
python scripts/run_view.py --quick             some seconds
python scripts/run_view.py --pictures FOLDER   only pictures of the page, which need Playwright and Chromium
python scripts/run_view.py --docs docs/howto/live-view.md

Times are of the processor, of all threads of the process that simulates; the page is another process. A run with and
one without a page take turns, and of their ratios the median counts, as the machine may be shared.
"""

import contextlib
import io
import json
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from harness import exit_code, fill_page, made_by, make_folder, parser_of, say
from numpy.typing import NDArray

import mpsim
from mpsim.scene import scenefile
from mpsim.viewer.session import Session

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page, ViewportSize

COUNT = 10_000
"""Discs of the run that is watched."""

FIRST_MISSED, LATE = 3, 3.0
"""Frame of the scene `gas` in which a collision is missed, and time at which the two stages have parted."""

PATIENCE = 90.0
"""Longest wait for the page [s]."""

WINDOW: "ViewportSize" = {"width": 1280, "height": 800}

GRID = mpsim.Settings(method="grid")

PAGE = """
import json, struct, sys
from websockets.sync.client import connect
from websockets.exceptions import ConnectionClosed
address = sys.argv[1]
origin = address.rsplit("/", 2)[0]
try:
    with connect(address.replace("http", "ws", 1) + "socket", origin=origin, compression=None, max_size=None) as socket:
        socket.send(json.dumps({"do": "visible", "value": True}))
        for deed in sys.argv[2:]:
            socket.send(deed)
        while True:
            message = socket.recv()
            if isinstance(message, bytes) and message[5] == 1:
                socket.send(json.dumps({"do": "ack", "serial": struct.unpack_from("<I", message, 8)[0]}))
except ConnectionClosed:
    pass
"""
"""A page without a browser: it takes each picture and asks for the next."""


@contextlib.contextmanager
def page_at(address: str, *deeds: dict[str, Any]) -> Iterator[None]:
    """A page that looks, in a process of its own; it does these deeds first."""
    process = subprocess.Popen([sys.executable, "-c", PAGE, address, *map(json.dumps, deeds)])
    try:
        yield
    finally:
        process.terminate()
        process.wait()


def watched(scene: mpsim.Scene, seconds: float) -> tuple[float, float]:
    """Processor time of a frame of a run that a page watches [s], and pictures per second."""
    with contextlib.redirect_stdout(io.StringIO()):
        view = mpsim.view(scene, GRID, browser=False, wait=False)
    with view, page_at(view.address, {"do": "speed", "value": None}):
        session = view._server.source  # pyright: ignore[reportPrivateUsage]
        assert isinstance(session, Session)  # of a scene
        while (sim := session._sim) is None or sim.frame < 10:  # pyright: ignore[reportPrivateUsage]
            time.sleep(0.01)
        time.sleep(0.5)
        serial, frame = session._broadcast._serial, sim.frame  # pyright: ignore[reportPrivateUsage]
        started, cpu = time.perf_counter(), time.process_time()
        time.sleep(seconds)
        passed, used = time.perf_counter() - started, time.process_time() - cpu
        frames = sim.frame - frame
        pictures = session._broadcast._serial - serial  # pyright: ignore[reportPrivateUsage]
        session.watched_by(0)
        time.sleep(0.2)
        digest, end = sim.digest(), sim.frame
    with mpsim.Simulation(scene, GRID) as alone:
        alone.run(frames=end)
        assert alone.digest() == digest, "watching has changed the bits"
    return used / frames, pictures / passed


def alone(scene: mpsim.Scene, seconds: float) -> float:
    """Processor time of a frame without a view [s]."""
    with mpsim.Simulation(scene, GRID) as sim:
        sim.run(frames=200)
        started, frames = time.process_time(), 0
        end = time.perf_counter() + seconds
        while time.perf_counter() < end:
            frames += sim.run(frames=2000).frames
        return (time.process_time() - started) / frames


def cost_of_watching(turns: int, seconds: float) -> tuple[NDArray[np.float64], float]:
    """Least, median and largest share of processor time that a page costs a run [%], and pictures per second."""
    scene = mpsim.Scene.random(count=COUNT, packing=0.4, radius=0.5, temperature=1.0, seed=1)
    ratios, rates = [], []
    for _ in range(turns):
        before = alone(scene, seconds)
        frame, pictures = watched(scene, seconds)
        ratios.append(frame / ((before + alone(scene, seconds)) / 2))
        rates.append(pictures)
    return 100 * (np.quantile(ratios, [0, 0.5, 1]) - 1), float(np.median(rates))


@contextlib.contextmanager
def chromium() -> Iterator["Browser"]:
    """The browser of this machine, for pictures; needs Playwright."""
    from playwright.sync_api import sync_playwright  # noqa: PLC0415 - only for pictures

    found = shutil.which("chromium") or shutil.which("google-chrome")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=found, args=["--no-sandbox"])
        yield browser
        browser.close()


def wait_for(page: "Page", what: str, condition: Callable[[], bool]) -> None:
    """Wait until something is so, as loops may have to be compiled; what: the name for it."""
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end, f"waited for {what} for {PATIENCE} s"
        page.wait_for_timeout(50)


def frame_of(page: "Page") -> int:
    return int(page.get_attribute("#stage", "data-frame") or -1)


def one_stage(browser: "Browser", folder: Path) -> None:
    """The picture of the page that shows one scene."""
    file = scenefile.load("dense")
    with mpsim.view(file.scene, file.scene.settings, browser=False, wait=False, name=file.name) as view:
        page = browser.new_page(viewport=WINDOW)
        page.goto(view.address)
        wait_for(page, "readings in the charts", lambda: frame_of(page) >= 5000)
        page.screenshot(path=folder / "view-1280.png")


def two_stages(browser: "Browser", folder: Path) -> None:
    """The pictures of the tutorial: the first missed collision, and when the two stages have parted."""
    scene, exact = mpsim.Scene.load("gas"), mpsim.Settings(method="event")
    how: dict[str, Any] = {"browser": False, "wait": False, "playing": False, "name": "gas"}
    with mpsim.view(scene, scene.settings, beside=exact, **how) as view:
        page = browser.new_page(viewport=WINDOW)
        page.set_default_timeout(1e3 * PATIENCE)  # of a click on a button that is not enabled yet
        page.goto(f"{view.address}?wait&speed=1")
        wait_for(page, "a picture", lambda: frame_of(page) >= 0)
        for frame in range(1, FIRST_MISSED + 1):
            page.click("#step")
            wait_for(page, f"frame {frame}", lambda frame=frame: frame_of(page) == frame)
            page.wait_for_timeout(800)  # for the comparison and the last gauges
        page.screenshot(path=folder / "two-first-1280.png")
        page.click("#play")
        wait_for(page, f"time {LATE}", lambda: frame_of(page) >= round(LATE / 0.01))
        wait_for(page, "the Lyapunov time", lambda: "Lyapunov" in page.inner_text("#parted"))
        page.click("#play")
        wait_for(page, "the pause", lambda: page.inner_text("#phase") == "paused")
        page.wait_for_timeout(500)
        page.screenshot(path=folder / "two-parted-1280.png")


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--pictures", type=Path, metavar="FOLDER")
    parser.add_argument("--docs", type=Path, help="page whose numbers are renewed")
    options = parser.parse_args()
    if options.pictures is not None:
        make_folder(options.pictures)
        with contextlib.redirect_stdout(io.StringIO()), chromium() as browser:
            one_stage(browser, options.pictures)
            two_stages(browser, options.pictures)
        return
    turns, seconds = (1, 1.0) if options.quick else (7, 3.0)
    (low, middle, high), pictures = cost_of_watching(turns, seconds)
    text = (
        f"A page that watches {COUNT:,} discs at full speed takes {middle:.1f} % of the run's processor time (turns: "
        f"{low:.1f} to {high:.1f}), at {pictures:.0f} pictures a second.\n\n{made_by()}"
    )
    say(text)
    if options.docs is not None:
        fill_page(options.docs, {"cost": text})


if __name__ == "__main__":
    sys.exit(exit_code(main))
