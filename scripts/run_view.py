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
import os
import re
import shutil
import statistics
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import benchmark
from harness import exit_code, fill_page, made_by, make_folder, parser_of, say
from harness import table as markdown
from websockets.sync.client import connect

import mpsim
from mpsim.engine.simulation import read_in_place
from mpsim.scene import scenefile
from mpsim.viewer import protocol
from mpsim.viewer.colouring import scale_of
from mpsim.viewer.server import Admission, Server, listening, page_files
from mpsim.viewer.session import Session

if TYPE_CHECKING:
    from playwright.sync_api import Browser

SIZES = (10, 1_000, 10_000, 100_000, 1_000_000)
COUNT = 10_000
"""Discs of the run that is watched."""

WIDTHS = {390: 844, 1280: 800, 1920: 1080}
"""Sizes of the page in pictures: a telephone, a window, a projector."""

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


class Album:
    """In place of a session: each picture is packed as soon as it is asked for."""

    def __init__(self, sim: mpsim.Simulation, server: Server):
        self._sim, self._broadcast = sim, protocol.Broadcast(server, sim.scene)
        self._broadcast.scale = scale_of(sim.state)
        self._asked = threading.Semaphore(0)
        self.seconds: list[float] = []

    def ask(self) -> None:
        """A page wants a picture."""
        self._asked.release()

    def watched_by(self, pages: int) -> None:
        """Nothing runs here."""

    def charge(self, seconds: float) -> None:
        """Nothing waits for it here."""

    def send(self, pictures: int) -> float:
        """Hand over so many pictures; returns the processor time of each, packing and sending together [s]."""
        started = 0.0
        for number in range(1, pictures + 1):
            self._asked.acquire()
            if number == 4:  # the first ones allocate
                started = time.process_time()
            before = time.thread_time()
            read_in_place(self._sim, self._broadcast.show)
            self.seconds.append(time.thread_time() - before)
        self._asked.acquire()
        return (time.process_time() - started) / (pictures - 3)


def picture_cost(count: int) -> dict[str, float]:
    """Processor time of a picture of so many discs: of packing it alone, and of all."""
    scene = benchmark.gas(count)
    socket = listening("127.0.0.1", 0)
    admission = Admission("127.0.0.1", socket.getsockname()[1])
    server = Server(socket, admission)
    with mpsim.Simulation(scene, GRID) as sim:
        sim.run(frames=10)
        album = Album(sim, server)
        server.start(album)  # pyright: ignore[reportArgumentType]
        try:
            with page_at(admission.address):
                whole = album.send(13 if count >= 10**6 else 103)
        finally:
            server.close()
    return {"discs": count, "bytes": 96 + 5 * count, "packing": statistics.median(album.seconds[3:]), "whole": whole}


def watched(scene: mpsim.Scene, seconds: float, speed: float | None) -> dict[str, float]:
    """A run that a page watches: processor time of a frame [s], pictures and frames a second, part of a core."""
    with contextlib.redirect_stdout(io.StringIO()):
        view = mpsim.view(scene, GRID, browser=False, wait=False)
    with view, page_at(view.address, {"do": "speed", "value": speed}):
        session = view._session  # pyright: ignore[reportPrivateUsage]
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
        if alone.digest() != digest:
            raise benchmark.WrongAnswerError(f"watching has changed the bits of {scene.count} discs.")
    return {"frame": used / frames, "pictures": pictures / passed, "frames": frames / passed, "core": used / passed}


def alone(scene: mpsim.Scene, seconds: float) -> float:
    """Processor time of a frame without a view [s]."""
    with mpsim.Simulation(scene, GRID) as sim:
        sim.run(frames=200)
        started, frames = time.process_time(), 0
        end = time.perf_counter() + seconds
        while time.perf_counter() < end:
            frames += sim.run(frames=2000).frames
        return (time.process_time() - started) / frames


def alone_at_60(scene: mpsim.Scene, seconds: float) -> float:
    """Part of a core that a run of 60 frames a second takes without a view, each frame by a call of its own."""
    with mpsim.Simulation(scene, GRID) as sim:
        sim.run(frames=200)
        started, cpu = time.perf_counter(), time.process_time()
        for k in range(round(60 * seconds)):
            time.sleep(max(started + k / 60 - time.perf_counter(), 0.0))
            sim.run(frames=1)
        return (time.process_time() - cpu) / (time.perf_counter() - started)


def cost_of_watching(turns: int, seconds: float) -> dict[str, float]:
    """What a page costs a run, in turns with the run alone."""
    scene, ratios, rates = benchmark.gas(COUNT), [], []
    for _ in range(turns):
        before = alone(scene, seconds)
        found = watched(scene, seconds, None)
        ratios.append(found["frame"] / ((before + alone(scene, seconds)) / 2))
        rates.append(found["pictures"])
    slows = [(alone_at_60(scene, seconds), watched(scene, seconds, 1.0)) for _ in range(turns)]
    return {
        "percent": 100 * (statistics.median(ratios) - 1),
        "lowest": 100 * (min(ratios) - 1),
        "highest": 100 * (max(ratios) - 1),
        "pictures": statistics.median(rates),
        "core": 100 * statistics.median(slow["core"] for _, slow in slows),
        "alone": 100 * statistics.median(before for before, _ in slows),
        "slow_pictures": statistics.median(slow["pictures"] for _, slow in slows),
    }


def seconds_to_first_picture() -> float:
    """From the command until its page has the first picture, in a process of its own [s].

    Python may keep its bytecode, as it does unless the environment forbids it.
    """
    started = time.perf_counter()
    command = [sys.executable, "-u", "-m", "mpsim", "view", "gas", "--no-browser"]
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as process:
        try:
            assert process.stdout is not None
            address = re.search(r"http://\S+/", process.stdout.readline())
            assert address is not None
            where, origin = address[0].replace("http", "ws", 1) + "socket", address[0].rsplit("/", 2)[0]
            with connect(where, origin=origin, compression=None, max_size=None) as socket:  # pyright: ignore[reportArgumentType]
                socket.send('{"do": "visible", "value": true}')
                while not (isinstance(message := socket.recv(), bytes) and message[5] == protocol.PICTURE):
                    pass
                return time.perf_counter() - started
        finally:
            process.terminate()


@contextlib.contextmanager
def chromium() -> Iterator["Browser"]:
    """The browser of this machine, for pictures; needs Playwright."""
    from playwright.sync_api import sync_playwright  # noqa: PLC0415 - only for pictures

    found = shutil.which("chromium") or shutil.which("google-chrome")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=found, args=["--no-sandbox"])
        yield browser
        browser.close()


def take_pictures(folder: Path) -> list[Path]:
    """The page of a scene at three sizes, as a browser shows it."""
    found, file = [], scenefile.load("dense")
    with contextlib.redirect_stdout(io.StringIO()):
        view = mpsim.view(file.scene, file.scene.settings, browser=False, wait=False, name=file.name)
    with view, chromium() as browser:
        for width, height in WIDTHS.items():
            page = browser.new_page(viewport={"width": width, "height": height})
            page.goto(view.address)
            end = time.monotonic() + 90  # loops may have to be compiled
            while int(page.get_attribute("#stage", "data-frame") or 0) < 300 * (1 + len(found)):
                assert time.monotonic() < end, "no pictures came"
                page.wait_for_timeout(100)
            path = folder / f"view-{width}.png"
            page.screenshot(path=path, full_page=width < 800)
            found.append(path)
            page.close()
    return found


def table(pictures: list[dict[str, float]], cost: dict[str, float], first: float) -> str:
    """What the view is asked to keep to, and what was found; and each picture's cost."""
    size = sum(len(file.content) for file in page_files().values()) / 1000
    marks = [
        (
            f"a page that watches {COUNT:,} discs at full speed, of the run's processor time",
            "≤ 3 %",
            f"{cost['percent']:.1f} % (turns: {cost['lowest']:.1f} to {cost['highest']:.1f}), at "
            f"{cost['pictures']:.0f} pictures a second; the same digest",
        ),
        (
            f"a page that watches {COUNT:,} discs at 60 frames a second, of a core",
            "≤ 3 %",
            f"{cost['core'] - cost['alone']:.1f} %, at {cost['slow_pictures']:.0f} pictures a second; the run "
            f"alone takes {cost['alone']:.1f} %",
        ),
        ("from the command to the first picture, compiled", "≤ 1 s", f"{first:.2f} s"),
        ("the page, all files", "≤ 150 kB", f"{size:.1f} kB"),
    ]
    for each in pictures:
        if each["discs"] == 100_000:
            found = f"{1e3 * each['whole']:.2f} ms"
            marks.insert(1, ("a picture of 100,000 discs, packed and sent", "≤ 1.5 ms", found))
    rows = (
        (f"{each['discs']:,}", f"{each['bytes']:,}", f"{1e3 * each['packing']:.3f}", f"{1e3 * each['whole']:.3f}")
        for each in pictures
    )
    heads = ("discs", "bytes of a picture", "packing, ms", "packing and sending, ms")
    return f"{markdown(('quantity', 'limit', 'measured'), marks)}\n\n{markdown(heads, rows)}\n"


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--pictures", type=Path, metavar="FOLDER")
    parser.add_argument("--out", type=Path, default=Path("results/view"))
    parser.add_argument("--docs", type=Path)
    options = parser.parse_args()
    if options.pictures is not None:
        for path in take_pictures(options.pictures):
            say(f"written: {path}")
        return
    make_folder(options.out)
    pictures = [picture_cost(count) for count in (SIZES[:3] if options.quick else SIZES)]
    cost = cost_of_watching(1 if options.quick else 7, 1.0 if options.quick else 3.0)
    first = min(seconds_to_first_picture() for _ in range(1 if options.quick else 3))
    text = table(pictures, cost, first)
    (options.out / "view.md").write_text(text)
    (options.out / "view.json").write_text(json.dumps({"pictures": pictures, "cost": cost, "first": first}, indent=1))
    say(text)
    if options.docs is not None:
        fill_page(options.docs, {"table": f"{text}\n{made_by()}"})


if __name__ == "__main__":
    sys.exit(exit_code(main))
