"""Functions of a sweep that other processes can import."""

import multiprocessing
import os
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import mpsim


def gas(packing, seed):
    """A run that depends on its seed, in every bit of the result."""
    scene = mpsim.Scene.random(count=12, packing=packing, radius=0.5, seed=seed)
    with mpsim.Simulation(scene, mpsim.Settings(method="naive", dt=0.05)) as sim:
        sim.run(until=2.0)
        return {"x": float(sim.state.position[0, 0]), "seed_again": str(seed)}


def double(x):
    return {"y": 2 * x}


def noted(x, folder):
    """Notes in a folder that it was called."""
    with (Path(folder) / "calls").open("a") as file:
        file.write(f"{x}\n")
    return {"y": 2 * x}


def deadly(x):
    """Ends its process at 3."""
    if x == 3:
        time.sleep(0.2)  # so that the others are back
        os._exit(1)
    return {"y": 2 * x}


def gated(x, folder):
    """Notes its call, and waits for a file of the name of x."""
    result = noted(x, folder)
    while not (Path(folder) / f"go{x}").exists():
        time.sleep(0.005)
    return result


def process_pool(number):
    """Processes that are no forks of this one, which has threads."""
    return ProcessPoolExecutor(number, mp_context=multiprocessing.get_context("forkserver"))
