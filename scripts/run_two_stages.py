"""Pictures of the live view with two stages, for the tutorial.

python scripts/run_two_stages.py                    those of the tutorial, into docs/pictures
python scripts/run_two_stages.py --sizes FOLDER     each moment at 390, 1280 and 1920 px, to look at

Needs Playwright and Chromium.
"""

import contextlib
import io
import sys
import time
from collections.abc import Callable
from pathlib import Path

from harness import DOCS, parser_of, say
from playwright.sync_api import Page
from run_view import WIDTHS, chromium

import mpsim
from mpsim.scene import scenefile

FIRST_MISSED = 3
"""Frame of the scene `gas` at dt=0.01 in which a collision is missed."""

LATE = 3.0
"""Time of the second picture, when the two stages have parted [time]."""

ROUNDING = 1e-9
"""Largest distance that is rounding, in diameters."""

PATIENCE = 90.0
"""Longest wait for the page, as loops may have to be compiled [s]."""

TALL = 1248
"""Height of the picture of a telephone's page, down to its buttons [px]."""

TUTORIAL = {("first", 1280), ("parted", 1280), ("parted", 390)}
"""Pictures that the tutorial shows: moment and width."""


def wait_for(page: Page, what: str, condition: Callable[[], bool]) -> None:
    """Wait until something is so; what: the name for it."""
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end, f"waited for {what} for {PATIENCE} s"
        page.wait_for_timeout(50)


def frame_of(page: Page) -> int:
    return int(page.get_attribute("#stage", "data-frame") or -1)


def distance_of(page: Page) -> float:
    return float(page.get_attribute("#trade-distance", "data-value") or 0.0)


def go_to_first(page: Page) -> None:
    """Reset, and run single frames up to that of the first missed collision."""
    page.click("#reset")
    wait_for(page, "the start", lambda: frame_of(page) == 0)
    for frame in range(1, FIRST_MISSED + 1):
        page.click("#step")
        wait_for(page, f"frame {frame}", lambda frame=frame: frame_of(page) == frame)
        page.wait_for_timeout(300)  # for the comparison
    wait_for(page, "the missed collision", lambda: distance_of(page) > ROUNDING)


def go_on_until_late(page: Page) -> None:
    """Play until the two have parted and the Lyapunov time is known, then pause."""
    page.click("#play")
    wait_for(page, f"time {LATE}", lambda: frame_of(page) >= round(LATE / 0.01))
    wait_for(page, "the Lyapunov time", lambda: "Lyapunov" in page.inner_text("#parted"))
    page.click("#play")
    wait_for(page, "the pause", lambda: page.inner_text("#phase") == "paused")


MOMENTS = {"first": go_to_first, "parted": go_on_until_late}
"""How the page comes to each moment, one after the other."""


def take(view: mpsim.View, page: Page, folder: Path, width: int, moments: set[str]) -> list[Path]:
    """The moments at one width of the page."""
    found: list[Path] = []
    page.goto(f"{view.address}?wait&speed=1")
    wait_for(page, "a picture", lambda: frame_of(page) >= 0)
    for moment, go in MOMENTS.items():
        go(page)
        if moment in moments:
            time.sleep(0.5)  # for the last gauges
            found.append(folder / f"two-{moment}-{width}.png")
            whole = width < 800  # the stages are below each other
            height = TALL if whole else WIDTHS[width]
            page.screenshot(path=found[-1], full_page=whole, clip={"x": 0, "y": 0, "width": width, "height": height})
    return found


def main() -> int:
    parser = parser_of(__doc__)
    parser.add_argument("--sizes", type=Path, metavar="FOLDER")
    options = parser.parse_args()
    folder = options.sizes or DOCS / "pictures"
    folder.mkdir(parents=True, exist_ok=True)
    wanted = {(moment, width) for moment in MOMENTS for width in WIDTHS} if options.sizes else TUTORIAL
    file = scenefile.load("gas")
    with contextlib.redirect_stdout(io.StringIO()):
        exact = mpsim.Settings(method="event")
        scene = file.scene
        view = mpsim.view(scene, scene.settings, beside=exact, browser=False, wait=False, playing=False, name="gas")
    with view, chromium() as browser:
        for width in sorted({width for _, width in wanted}):
            page = browser.new_page(viewport={"width": width, "height": WIDTHS[width]})
            page.set_default_timeout(1e3 * PATIENCE)  # of a click on a button that is not enabled yet
            for path in take(view, page, folder, width, {moment for moment, each in wanted if each == width}):
                say(f"written: {path}")
            page.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
