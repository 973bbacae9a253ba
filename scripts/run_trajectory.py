"""Cost of writing trajectories: a table and a picture under results/trajectory/.

python scripts/run_trajectory.py            a minute
python scripts/run_trajectory.py --quick    a few seconds
"""

import argparse
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import benchmark
import matplotlib
import numpy as np
from rich.console import Console

import mpsim
from mpsim.output.drawing import STYLE, new_figure

SIZES = (100, 1_000, 10_000, 100_000)
QUICK_SIZES = (100, 1_000)
FORMATS = ("xyz", "gsd")
FRAMES = 20
"""Frames that are written, each after one that is simulated."""

COLOURS = {"frame": "#000000", "xyz": "#0072B2", "gsd": "#D55E00"}

console = Console()


def cost(count: int, kind: str, folder: Path) -> dict[str, Any]:
    """Time of writing a frame and of simulating one, and the size of what was written. Fails if a bit is changed."""
    scene, settings = benchmark.gas(count), mpsim.Settings(method="grid")
    path = folder / f"{count}.{kind}"
    with mpsim.Simulation(scene, settings) as sim:
        alone = sim.run(frames=FRAMES)
        digest = sim.digest()
    with mpsim.Simulation(scene, settings) as sim, mpsim.Trajectory.write(path, mode="w") as out:
        seconds = []
        sim.run(frames=1, observe=out)
        for _ in range(FRAMES - 1):
            before = out.seconds
            sim.run(frames=1, observe=out)
            seconds.append(out.seconds - before)
        if sim.digest() != digest:
            raise benchmark.WrongAnswerError(f"writing {kind} has changed the bits of {count} discs.")
    with mpsim.Trajectory(path) as found:
        if found[-1].state.digest() != digest:
            raise benchmark.WrongAnswerError(f"{kind} of {count} discs was not read back to the bit.")
    return {
        "discs": count,
        "format": kind,
        "write_ns_per_disc": float(np.median(seconds)) * 1e9 / count,
        "frame_ns_per_disc": float(np.median(alone.frame_seconds)) * 1e9 / count,
        "bytes_per_disc": path.stat().st_size / (FRAMES + 1) / count,
    }


def table(rows: list[dict[str, Any]]) -> str:
    lines = [
        "| discs | format | written, ns a disc | simulated, ns a disc and frame | frames it is worth | bytes a disc |"
    ]
    lines += ["|---|---|---|---|---|---|"]
    for row in rows:
        write, frame = row["write_ns_per_disc"], row["frame_ns_per_disc"]
        lines.append(
            f"| {row['discs']:,} | {row['format']} | {write:,.0f} | {frame:.1f} | {write / frame:.0f} | "
            f"{row['bytes_per_disc']:.0f} |"
        )
    return "\n".join(lines) + "\n"


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Nanoseconds per disc against the number of discs: to write a frame, and to simulate one."""
    with matplotlib.rc_context(fname=STYLE):
        figure = new_figure(7, 4.2)
        axes = figure.add_subplot()
        for kind in FORMATS:
            chosen = [row for row in rows if row["format"] == kind]
            discs, write = ([row[name] for row in chosen] for name in ("discs", "write_ns_per_disc"))
            axes.plot(discs, write, color=COLOURS[kind], marker="o", label=f"a frame written as {kind}")
        chosen = [row for row in rows if row["format"] == FORMATS[0]]
        discs, frame = ([row[name] for row in chosen] for name in ("discs", "frame_ns_per_disc"))
        axes.plot(discs, frame, color=COLOURS["frame"], marker="x", linestyle=":", label="a frame simulated (grid)")
        axes.set(xscale="log", yscale="log", xlabel="discs", ylabel="ns per disc", title="What a trajectory costs")
        axes.legend()
        figure.savefig(path)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--out", type=Path, default=Path("results/trajectory"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        sizes = QUICK_SIZES if options.quick else SIZES
        try:
            rows = [cost(count, kind, Path(folder)) for count in sizes for kind in FORMATS]
        except mpsim.MpsimError as error:
            console.print(f"run_trajectory: {error}", style="red", highlight=False, soft_wrap=True)
            return 1
    (options.out / "trajectory.md").write_text(table(rows))
    (options.out / "trajectory.json").write_text(json.dumps(rows, indent=1) + "\n")
    draw(rows, options.out / "trajectory.png")
    console.print(table(rows), highlight=False, markup=False, soft_wrap=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
