"""Executors of other processes."""

import multiprocessing
from concurrent.futures import ProcessPoolExecutor


def process_pool(number):
    """Processes that are no forks of this one, which has threads."""
    return ProcessPoolExecutor(number, mp_context=multiprocessing.get_context("forkserver"))
