"""Divides long loops among threads, one per core, for kernels that run without the interpreter's lock."""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from itertools import pairwise
from typing import TypeVar

from mpsim.core.cores import usable_cores

WORTH_A_THREAD = 100_000
"""Elements from which on a loop is shared out: below, threads take as long as they save."""


Result = TypeVar("Result")


def in_pieces(function: Callable[[int, int], Result], count: int, elements: int | None = None) -> list[Result]:
    """What function(first, last) returns for consecutive pieces of range(count), in their order, each done once.

    Args:
        function: may do one piece in the same time as another; function(0, 0) does nothing.
        count: length of the range; there is a piece of it for each core that may be used.
        elements: that the loop goes through, by which it is seen whether threads are worth while; None: `count`.

    >>> in_pieces(lambda first, last: (first, last), 5)
    [(0, 5)]
    """
    elements = count if elements is None else elements
    cores = min(usable_cores(), count) if elements >= WORTH_A_THREAD else 1
    if cores <= 1:
        return [function(0, count)]
    function(0, 0)  # so that a kernel is compiled by this thread, which can be interrupted
    waiting = list(enumerate(pairwise(count * core // cores for core in range(cores + 1))))
    done: dict[int, Result] = {}

    def work() -> None:
        while True:
            try:
                index, (first, last) = waiting.pop()
            except IndexError:
                return
            done[index] = function(first, last)

    helpers: list[Future[None]] = []
    with ThreadPoolExecutor(cores - 1) as pool:
        with suppress(RuntimeError):  # the system allows no more threads: then there are fewer of them
            for _ in range(cores - 1):
                helpers.append(pool.submit(work))
        work()
    for helper in helpers:
        helper.result()
    return [done[index] for index in range(cores)]
