"""Estimates of how fast discs are or will be."""

import numpy as np
import pytest
from support.scenes import gas

import mpsim
from mpsim.engine import speed_estimates, step_limits
from mpsim.engine.solvers import speeds


def test_the_estimate_of_meetings_is_that_of_a_gas():
    """Of the exact solver's rate, 2.34 per time and disc at packing 0.3 and 21.2 at 0.7, both of this project."""
    for packing, rate in ((0.3, 2.34), (0.7, 21.2)):
        scene = gas(2000, packing)
        assert speeds.speeds_of(scene.velocity, scene.radii, scene).collision_rate == pytest.approx(rate, rel=0.2)


def test_the_number_of_cells_does_not_grow_with_the_aspect_of_a_box():
    scene = mpsim.Scene(width=4e9, height=4.0, position=[[1, 2], [3e9, 2]], velocity=[[1, 0], [-1, 0]], radius=0.5)
    with mpsim.Simulation(scene, mpsim.Settings(dt=0.1, method="grid")) as sim:
        report = sim.run(frames=3)
    assert report.block_bytes < 2e6
    assert mpsim.Scene.random(count=10, width=4e9, height=4.0, radius=0.5).count == 10
    assert mpsim.Scene.random(count=10, width=1e6, height=1e6, radius=0.5).count == 10
    assert mpsim.Scene.random(count=3, width=1e200, height=1.0, radius=[0.1, 0.2, 0.3]).count == 3


@pytest.mark.parametrize("on_fast", ["error", "substep"])
def test_a_scene_without_discs_is_judged_alike_in_all_units_of_length(on_fast):
    """With lengths times 100 it was refused: no disc has no radius, and 1 was taken for it."""
    seen = []
    for unit in (0.01, 1.0, 100.0):
        scene = mpsim.Scene(
            width=10 * unit, height=10 * unit, position=np.zeros((0, 2)), velocity=np.zeros((0, 2)), radius=0.5 * unit,
            gravity=(0, -unit), emitters=mpsim.Emitter((5 * unit, 9 * unit), (0.5 * unit, 0), interval=1.5),
        )  # fmt: skip
        with mpsim.Simulation(scene, mpsim.Settings(dt=0.1, method="naive", on_fast=on_fast)) as sim:
            steps = [sim.run(frames=4).frames and sim.substeps for _ in range(5)]
        seen.append(steps)
        heavy = mpsim.Scene(
            width=10 * unit, height=10 * unit, position=np.zeros((0, 2)), velocity=np.zeros((0, 2)), radius=0.5 * unit,
            gravity=(0, -2 * unit), emitters=mpsim.Emitter((5 * unit, 9 * unit), (0, 0), interval=1.0),
        )  # fmt: skip
        found = step_limits.StepLimits(heavy, mpsim.Settings(dt=0.1), has_steps=True).forecast()
        assert found is not None
        assert "after a fall through the box a disc moves 1.26 times its radius" in found, "the control"
    assert seen[0] == seen[1] == seen[2]


def test_discs_that_share_their_energy_meet_in_the_box_at_the_start():
    """A piston that starts half-way leaves half the box, where they meet more than twice as often."""
    places = np.array([[0.6 + 1.1 * (i // 8), 0.6 + 1.1 * (i % 8)] for i in range(40)])
    parts = {"height": 9.0, "position": places, "velocity": np.ones((40, 2)), "radius": 0.5, "mass": np.arange(1, 41.0)}
    half = mpsim.Scene(width=12, **parts, piston=mpsim.Piston("right", -1, 5.7, start=6))
    whole = mpsim.Scene(width=6, **parts)
    assert [
        speed_estimates.speeds_in_equilibrium(speeds.Speeds(), scene).collision_rate for scene in (half, whole)
    ] == pytest.approx([speed_estimates.speeds_in_equilibrium(speeds.Speeds(), whole).collision_rate] * 2)
