"""How long something takes, on a machine that may be busy with something else."""

import time
from collections.abc import Callable

TRIES = 3


def quickest(act: Callable[[], object], bound: float) -> float:
    """Seconds of processor time that `act` takes: the least of a few tries, which end with the first below the bound.

    Other programs take caches and halves of cores away, so processor time varies as well.
    """
    tried: list[float] = []
    while len(tried) < TRIES and (not tried or tried[-1] >= bound):
        before = time.process_time()
        act()
        tried.append(time.process_time() - before)
    return min(tried)
