"""Obstacles that move: the same bits on any number of workers, after a resume, and in plain Python."""

import math

import numpy as np
import pytest
from support.processes import run_script
from support.scenes import digest_after, simulate

import mpsim
from mpsim import FixedDisc, Oscillation, Path, Polyline, Rotation

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]  # machine code of its own for each precision

HOW = {"contact": "impact", "dt": 0.01}


def scene() -> mpsim.Scene:
    """Rough discs under gravity among all kinds of motion, in a box that is periodic along x."""
    obstacles = [
        FixedDisc((3, 5), 0.7, surface_velocity=-3.0),
        Polyline([(4, 10), (16, 10)], thickness=0.4, motion=Rotation((10, 10), rate=0.9)),
        Polyline([(0, 1), (20, 1)], motion=Oscillation((0.5, 0.2), period=0.5, phase=0.3)),
        Polyline([(0, 19), (20, 19)], motion=Path([0, 1, 2], [(0, 0), (0, -1.5), (0, -0.5)]), surface_velocity=2.0),
        FixedDisc((18, 5), 0.5, motion=Rotation((17, 5), rate=-1 + math.pi / 8)),
    ]
    return mpsim.Scene.random(
        count=150, width=20, height=20, radius=0.3, seed=3, obstacles=obstacles, gravity=(0, -1), wall_friction=0.5,
        friction=0.3, boundary=("periodic", "walls"),
    )  # fmt: skip


PLAIN = """
from contracts.test_moving_obstacles import HOW, scene
from support.scenes import digest_after
print(digest_after(scene(), 80, method="grid", precision="{}", **HOW))
"""


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_any_number_of_workers_and_plain_python_have_the_same_bits(precision, tmp_path):
    alone = digest_after(scene(), 80, method="grid", precision=precision, **HOW)
    for workers in (2, 3):
        how = {"method": "parallel", "workers": workers, "precision": precision, **HOW}
        assert digest_after(scene(), 80, **how) == alone
    with simulate(scene(), method="parallel", workers=2, precision=precision, **HOW) as sim:
        sim.run(frames=50)
        sim.save(tmp_path / "run.mpsim")
    with mpsim.Simulation.resume(tmp_path / "run.mpsim", workers=1) as resumed:
        resumed.run(frames=30)
        assert resumed.digest() == alone
    ran = run_script(PLAIN.format(precision), env={"NUMBA_DISABLE_JIT": "1"}, flags=(), bound=300)
    assert ran.out.split() == [alone], ran.err
    assert np.abs(scene().capsules_at(0.8) - scene().capsules_at(0.0)).max() > 0.1
