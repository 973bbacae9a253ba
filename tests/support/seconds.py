"""How long something takes, on a machine that may be busy with something else, or slow today."""

import time
from collections.abc import Callable

TRIES = 3

USUAL = 0.17
"""Seconds of processor time of `_work` on the machines for which bounds are given, when calm."""


def quickest(act: Callable[[], object], bound: float) -> float:
    """Seconds of processor time that `act` takes: the least of a few tries, which end with the first below the bound.

    Other programs take caches and halves of cores away, so processor time varies as well. What a machine takes that is
    slower now than those for which bounds are given is divided by how much slower it is.
    """
    tried: list[float] = []
    while len(tried) < TRIES and (not tried or tried[-1] >= bound):
        seconds = _seconds(act)
        tried.append(seconds if seconds < bound else seconds / slowness())
    return min(tried)


def slowness() -> float:
    """How many times longer than usual this machine needs for some work in Python now, at least 1."""
    return max(1.0, _seconds(_work) / USUAL)


def _work() -> None:
    found = 0
    for number in range(2_000_000):
        found += number * number % 7


def _seconds(act: Callable[[], object]) -> float:
    before = time.process_time()
    act()
    return time.process_time() - before
