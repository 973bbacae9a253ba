"""Time and memory of large scenes outside of frames: start, measures, files.

python scripts/run_large.py                       ten million discs; needs 4 GiB of memory and of disk, some minutes
python scripts/run_large.py --discs 100000 --page results/large.md

Times are per disc, and in frames of this machine on two workers: float32, packing 0.4, v dt = 0.02 diameters. Memory is
the largest resident set meanwhile, shared memory included, beyond what Python and mpsim take.
"""

import argparse
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from pages import begin_page, fill_blocks, made_by
from rich.console import Console
from run_bench import machine

import mpsim
from mpsim.output.frames import frame_of
from mpsim.output.gsd import GsdWriter
from mpsim.output.xyz import XyzWriter

PAGE = Path(__file__).parents[1] / "docs" / "performance.md"

FRAMES = 20


class Meter:
    """Times and largest resident sets of steps, by name.

    Attributes:
        seconds: of each step.
        peaks: largest resident set during each, in bytes, beyond the one at the start.
    """

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self.peaks: dict[str, int] = {}
        self._base = _resident("VmRSS")

    def of(self, name: str, step: Callable[[], Any]) -> Any:
        """Do a step; what it returns."""
        _forget_peak()
        begun = time.perf_counter()
        result = step()
        self.seconds[name] = time.perf_counter() - begun
        self.peaks[name] = _resident("VmHWM") - self._base
        return result


def _resident(field: str) -> int:
    """A field of this process' status in bytes."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith(f"{field}:"))


def _forget_peak() -> None:
    """From now on VmHWM is the largest resident set from here (Linux)."""
    Path("/proc/self/clear_refs").write_text("5")


def measure(discs: int, folder: Path, meter: Meter) -> tuple[float, int]:
    """Seconds of a frame on two workers, and bytes of the block."""
    settings = mpsim.Settings(dt=0.02, method="parallel", workers=2, precision="float32")
    scene = meter.of(
        "Scene.random", lambda: mpsim.Scene.random(count=discs, packing=0.4, radius=0.5, temperature=1.0, seed=1)
    )

    def begin() -> mpsim.Simulation:
        sim = mpsim.Simulation(scene, settings)
        sim.run(frames=1)
        return sim

    with meter.of("Simulation and first frame", begin) as sim:
        sim.run(frames=2)
        frame = float(np.median(sim.run(frames=FRAMES).frame_seconds))
        meter.of("state", lambda: len(sim.state.position))
        meter.of("state and digest", lambda: str(sim.state.digest()))
        meter.of("state and kinetic energy", lambda: mpsim.measure.kinetic_energy(sim.state, scene))
        checkpoint = folder / "large.mpsim"
        meter.of("save", lambda: sim.save(checkpoint))
        meter.of("save, replacing a checkpoint", lambda: sim.save(checkpoint))
        for name, writer in (("XYZ frame", XyzWriter), ("GSD frame", GsdWriter)):
            target = folder / f"large.{name[:3].lower()}"
            out = writer(target, "w")
            meter.of(name, lambda out=out: out.write(frame_of(sim)))
            out.close()
            target.unlink()
        block = sim.run(frames=1).block_bytes
    with meter.of("resume", lambda: mpsim.Simulation.resume(checkpoint)):
        for file in folder.glob("large.*"):
            file.unlink()
    return frame, block


def table(discs: int, frame: float, block: int, meter: Meter) -> str:
    """The table, in Markdown."""
    lines = [
        f"{discs:,} discs; a frame takes {frame / discs * 1e9:.1f} ns per disc on two workers, and the block has "
        f"{block / discs:.0f} bytes per disc.\n",
        "| | µs per disc | frames | peak memory, bytes per disc |",
        "|---|---|---|---|",
    ]
    for name, seconds in meter.seconds.items():
        lines.append(
            f"| {name} | {seconds / discs * 1e6:.3f} | {seconds / frame:.1f} | {meter.peaks[name] / discs:.0f} |"
        )
    return "\n".join(lines)


def main() -> int:
    """Measure, and write the table into the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--discs", type=int, default=10_000_000)
    parser.add_argument("--page", type=Path, default=PAGE, help=f"default: {PAGE.name} of the docs")
    options = parser.parse_args()
    console = Console(soft_wrap=True, highlight=False)
    for kind in (mpsim.FastWarning, mpsim.errors.ResolutionWarning):  # of float32, which this is about
        warnings.simplefilter("ignore", kind)
    with tempfile.TemporaryDirectory(dir=options.page.parent) as name:
        try:
            measure(1000, Path(name), Meter())  # so that nothing is compiled or imported in the times
            meter = Meter()
            frame, block = measure(options.discs, Path(name), meter)
        except (mpsim.MpsimError, OSError) as error:
            console.print(f"run_large: {error}", style="red")
            return 2 if isinstance(error, mpsim.InputError) else 1
    text = table(options.discs, frame, block, meter)
    console.print(text)
    begin_page(options.page, "run_large", "table")
    fill_blocks(options.page, "run_large", {"table": f"{text}\n\n{made_by(machine())}"})
    return 0


if __name__ == "__main__":
    sys.exit(main())
