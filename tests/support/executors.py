"""Executors of other processes."""

import multiprocessing
import warnings
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager

import distributed


def process_pool(number):
    """Processes that are no forks of this one, which has threads."""
    return ProcessPoolExecutor(number, mp_context=multiprocessing.get_context("forkserver"))


@contextmanager
def dask_pool():
    """That of a scheduler with two worker processes."""
    options = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None, "processes": True}
    with (
        warnings.catch_warnings(),
        distributed.LocalCluster(**options) as cluster,
        distributed.Client(cluster) as client,
    ):
        warnings.simplefilter("ignore")
        yield client.get_executor()
