"""Which method a run uses: what `auto` stands for."""

import logging

from mpsim.engine.cores import may_start_processes, usable_cores
from mpsim.scene import Scene
from mpsim.settings import Settings

logger = logging.getLogger("mpsim")

NAIVE_UP_TO = 120
"""Discs up to which `auto` tests all pairs. A constant, not a measurement: naive and grid resolve contacts in different
orders, so the choice between them must depend on the scene alone for the bits to be the same on every machine."""

PARALLEL_FROM = 400
"""Discs from which `auto` starts workers, where there are cores for them. Then it measures whether they pay: it may,
because one worker or many give the same bits."""


def choose(scene: Scene, settings: Settings) -> tuple[str, int, tuple[int, ...]]:
    """Method ("naive", "grid" or "parallel"), workers to start, and numbers of workers to choose from while running."""
    method = settings.method
    if method == "auto":
        method = "naive" if scene.count <= NAIVE_UP_TO else "parallel" if scene.count >= PARALLEL_FROM else "grid"
    if method != "parallel":
        return method, 1, (1,)
    workers = settings.workers or usable_cores()
    if workers > 1 and not may_start_processes():
        logger.info("mpsim: this process is daemonic and may not start others; running on one worker.")
        workers = 1
    if settings.method != "auto":
        return method, workers, (workers,)
    return (method, workers, (workers, 1)) if workers > 1 else ("grid", 1, (1,))
