"""What containers and surfaces that move cost: frames of 100,000 discs, timed in turns; fails where they cost too much.

python scripts/check_surfaces.py

A circular container of one surface beside a box of the same area, and a rough drum of 200 segments that turns beside
the same one at rest. Only meaningful on a machine that does nothing else.
"""

import sys

import numpy as np
from harness import console, exit_code, parser_of

import mpsim

COUNT, RADIUS, PACKING = 100_000, 0.5, 0.4
ROUGH = {"gravity": (0, -0.1), "restitution": 0.7, "wall_restitution": 0.7, "friction": 0.5, "wall_friction": 0.5}
REACH = RADIUS * float(np.sqrt(COUNT / PACKING))  # of a container of that packing
ROUND = {"width": 2 * REACH + 4, "height": 2 * REACH + 4}
CENTRE = (REACH + 2, REACH + 2)


def gas(**scene: object) -> mpsim.Scene:
    """The discs of all scenes."""
    return mpsim.Scene.random(count=COUNT, radius=RADIUS, seed=3, **scene)  # pyright: ignore[reportArgumentType]


def drum(motion: mpsim.Rotation | None) -> mpsim.Scene:
    """A drum of 200 segments, and rough discs in it."""
    angles = np.linspace(0, 2 * np.pi, 201)
    points = np.add(CENTRE, (REACH + 1) * np.stack([np.cos(angles), np.sin(angles)], axis=1))
    points[-1] = points[0]
    heap = mpsim.Circle(CENTRE, REACH, inside=True)
    return gas(inside=heap, temperature=0.1, obstacles=mpsim.Polyline(points, motion=motion), **ROUND, **ROUGH)


PAIRS = {
    "a circular container / a box of its area": (
        1.1,
        lambda: gas(obstacles=mpsim.Circle(CENTRE, REACH, inside=True), **ROUND),
        lambda: gas(width=REACH * np.sqrt(np.pi), height=REACH * np.sqrt(np.pi)),
    ),
    "a drum of 200 segments that turns / at rest": (
        1.5,
        lambda: drum(mpsim.Rotation(CENTRE, rate=0.002)),
        lambda: drum(None),
    ),
}
"""Largest ratio of the times of a frame, and both scenes."""


def main() -> int:
    """Exit code: 1 where a ratio is too large."""
    parser_of(__doc__).parse_args()
    too_slow = 0
    for name, (most, *pair) in PAIRS.items():
        settings = mpsim.Settings(dt=0.02)
        with mpsim.Simulation(pair[0](), settings) as one, mpsim.Simulation(pair[1](), settings) as other:
            frames = [[float(np.median(sim.run(frames=30).frame_seconds)) for sim in (one, other)] for _ in range(21)]
        low, ratio, high = np.quantile(np.divide(*np.transpose(frames[3:])), (0.25, 0.5, 0.75))
        console.print(f"{name}: {ratio:.2f}, quartiles {low:.2f} to {high:.2f}, at most {most} allowed")
        too_slow += ratio > most
    return int(too_slow > 0)


if __name__ == "__main__":
    sys.exit(exit_code(main))
