"""Time and memory of large scenes outside of frames: start, measures, files.

python scripts/run_large.py                       ten million discs; needs 4 GiB of memory and of disk, some minutes
python scripts/run_large.py --discs 100000 --page results/large.md

Times are per disc, and in frames of this machine on two workers: float32, packing 0.4, v dt = 0.02 diameters. Memory is
the largest resident set meanwhile, shared memory included, beyond what Python and mpsim take.
"""

import re
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from harness import DOCS, exit_code, fill_page, made_by, parser_of, say, table

import mpsim
from mpsim.output.frames import frame_of
from mpsim.output.gsd import GsdWriter
from mpsim.output.xyz import XyzWriter

PAGE = DOCS / "performance.md"

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
        self._base = psutil.Process().memory_info().rss

    def of(self, name: str, step: Callable[[], Any]) -> Any:
        """Do a step; what it returns."""
        Path("/proc/self/clear_refs").write_text("5")  # from now on VmHWM is the largest resident set from here (Linux)
        begun = time.perf_counter()
        result = step()
        self.seconds[name] = time.perf_counter() - begun
        peak = re.search(r"VmHWM:\s*(\d+)", Path("/proc/self/status").read_text())
        assert peak is not None
        self.peaks[name] = 1024 * int(peak[1]) - self._base
        return result


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


def main() -> None:
    """Measure, and write the table into the page."""
    parser = parser_of(__doc__)
    parser.add_argument("--discs", type=int, default=10_000_000)
    parser.add_argument("--page", type=Path, default=PAGE, help=f"default: {PAGE.name} of the docs")
    options = parser.parse_args()
    for kind in (mpsim.FastWarning, mpsim.errors.ResolutionWarning):  # of float32, which this is about
        warnings.simplefilter("ignore", kind)
    discs = options.discs
    with tempfile.TemporaryDirectory(dir=options.page.parent) as name:
        measure(1000, Path(name), Meter())  # so that nothing is compiled or imported in the times
        meter = Meter()
        frame, block = measure(discs, Path(name), meter)
    rows = (
        (step, f"{seconds / discs * 1e6:.3f}", f"{seconds / frame:.1f}", f"{meter.peaks[step] / discs:.0f}")
        for step, seconds in meter.seconds.items()
    )
    text = (
        f"{discs:,} discs; a frame takes {frame / discs * 1e9:.1f} ns per disc on two workers, and the block has "
        f"{block / discs:.0f} bytes per disc.\n\n"
        f"{table(('', 'µs per disc', 'frames', 'peak memory, bytes per disc'), rows)}\n\n{made_by()}"
    )
    say(text)
    fill_page(options.page, {"table": text})


if __name__ == "__main__":
    sys.exit(exit_code(main))
