"""Long loops in pieces, by a thread for each core: for kernels, which run without the lock of the interpreter."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import TypeVar

from mpsim.core.cores import usable_cores

WORTH_A_THREAD = 100_000
"""Elements from which on a loop is shared out: below, threads take as long as they save."""


Result = TypeVar("Result")


def in_pieces(function: Callable[[int, int], Result], count: int, elements: int | None = None) -> list[Result]:
    """What function(first, last) returns for consecutive pieces of range(count), in their order.

    Args:
        function: may do one piece in the same time as another, and one twice.
        count: length of the range; each core that may be used has a piece of it.
        elements: that the loop goes through, by which it is seen whether threads are worth while; None: `count`.

    >>> in_pieces(lambda first, last: (first, last), 5)
    [(0, 5)]
    """
    elements = count if elements is None else elements
    cores = min(usable_cores(), count) if elements >= WORTH_A_THREAD else 1
    if cores > 1:
        function(0, 0)  # so that a kernel is compiled by this thread, which can be interrupted
        bounds = pairwise(count * core // cores for core in range(cores + 1))
        with ThreadPoolExecutor(cores) as pool:
            try:
                shares = [pool.submit(function, *each) for each in bounds]
            except RuntimeError:  # the system allows no more threads
                pool.shutdown(cancel_futures=True)
            else:
                return [share.result() for share in shares]
    return [function(0, count)]
