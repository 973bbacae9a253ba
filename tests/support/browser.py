"""A real browser for the tests of the live view's page: Debian's Chromium, driven by Playwright."""

import os
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from support.processes import descendants_of

DRIVERS: set[int] = set()
"""Processes that drive an open browser. It starts and ends others as it likes, which no test leaves behind."""

HOW = (
    "the page in a real browser is left out: {}. Have it by `pip install playwright` and a Chromium on the PATH "
    "(Debian: apt-get install chromium)"
)


def chromium() -> str:
    """Where Chromium is; the test is skipped if it or Playwright is missing."""
    pytest.importorskip("playwright.sync_api", reason=HOW.format("Playwright is not installed"))
    found = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if found is None:
        pytest.skip(HOW.format("there is no Chromium"))
    return found


@contextmanager
def browser() -> Iterator[Any]:
    """A browser without a window."""
    executable = chromium()
    from playwright.sync_api import sync_playwright  # noqa: PLC0415 - which may be missing

    before = descendants_of(os.getpid())
    with sync_playwright() as playwright:
        drivers = set(descendants_of(os.getpid())) - set(before)
        DRIVERS.update(drivers)
        opened = playwright.chromium.launch(
            executable_path=executable, args=["--no-sandbox", "--enable-unsafe-swiftshader"]
        )
        try:
            yield opened
        finally:
            opened.close()
            DRIVERS.difference_update(drivers)


def until(holds: Callable[[], Any], within: float = 150.0) -> Any:
    """What a function gives once that is true. Playwright's own waiting evaluates text, which the page forbids."""
    end = time.monotonic() + within
    while not (found := holds()):
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.02)
    return found
