"""Pressure of 128 x 128 discs close to melting, compared with the published one; can be stopped and continued.

python scripts/run_melting.py --minutes 15              begins, or continues, for so many minutes of one core
python scripts/run_melting.py --minutes 0 --docs        only writes what was found so far into docs/validation.md

Published: P (2R)^2 / kT = 9.17405(49) at packing 0.698 in a square periodic box, massively parallel Monte Carlo of Li,
Nishikawa, Hoellmer, Carillo, Maggs and Krauth (J. Chem. Phys. 157, 234111, 2022), from the table in their data
repository. The start is a lattice, which melts first; pieces of the run before the stationary part are left out.
"""

import json
import math
import sys
import time
from pathlib import Path

from harness import DOCS, exit_code, fill_page, made_by, parser_of, say, table

import mpsim
from mpsim.measure import Measure, equilibration, hexatic_order

COUNT, PACKING, PUBLISHED = 128**2, 0.698, Measure(9.17405, 0.00049, 1)
PIECE = 2.0
"""Time of a piece, in 2R sqrt(m/kT): each gives one value of the pressure and of the hexatic order."""

KEEP = 50
"""Pieces between two checkpoints."""


def begin(folder: Path) -> tuple[mpsim.Simulation, list[dict[str, float]]]:
    """The simulation and its pieces so far, of a new run or of the one in the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    if (folder / "run.mpsim").exists():
        sim = mpsim.Simulation.resume(folder / "run.mpsim", workers=1)
        done = json.loads((folder / "pieces.json").read_text())
        return sim, [piece for piece in done if piece["time"] <= sim.time * (1 + 1e-9)]
    side = math.sqrt(COUNT * math.pi / 4 / PACKING)
    scene = mpsim.Scene.lattice(count=COUNT, radius=0.5, width=side, height=side, seed=0, boundary="periodic")
    return mpsim.Simulation(scene, mpsim.Settings(dt=PIECE, method="event", workers=1)), []


def simulate(folder: Path, minutes: float) -> list[dict[str, float]]:
    """Continue the run for so long, and return all its pieces."""
    sim, pieces = begin(folder)
    end = time.process_time() + 60 * minutes
    with sim:
        temperature, area = COUNT / (COUNT - 1), sim.scene.width * sim.scene.height
        while time.process_time() < end:
            for _ in range(KEEP):
                found = sim.run(frames=1, measures=["pressure"]).measures["pressure"].value
                pieces.append({"time": sim.time, "pressure": found / temperature + 1 / area})
            pieces[-1]["hexatic"] = hexatic_order(sim.state, sim.scene).whole
            sim.save(folder / "run.mpsim")
            (folder / "pieces.json").write_text(json.dumps(pieces))
    return pieces


def words(pieces: list[dict[str, float]]) -> str:
    """The result, as a table and a sentence."""
    found = equilibration([piece["pressure"] for piece in pieces])
    first, last = pieces[min(found.start, len(pieces) - 1)]["time"], pieces[-1]["time"]
    mean = found.measure
    deviation = (mean.value - PUBLISHED.value) / math.hypot(mean.error, PUBLISHED.error)
    orders = [piece["hexatic"] for piece in pieces if "hexatic" in piece]
    later = orders[len(orders) // 2 :]
    what = f"P (2R)²/kT, {COUNT:,} discs, box 1 : 1, packing {PACKING}"
    row = what, "Li 2022", PUBLISHED, mean, f"{deviation:+.1f}"
    return (
        f"{table(('', 'source', 'expected', 'found', 'deviation'), [row], right=1)}\n\n"
        f"One run of length {last:,.0f} (in units of 2R √(m/kT)), of which the first {first - PIECE:,.0f} are left "
        f"out. The global hexatic order |ψ₆| fell from that of a lattice to between {min(later):.2f} and "
        f"{max(later):.2f} in the second half of the run."
    )


def main() -> None:
    """Run, print, and renew the page if asked for."""
    parser = parser_of(__doc__)
    parser.add_argument("--minutes", type=float, default=15.0, help="of one core (default: 15)")
    parser.add_argument("--out", type=Path, default=Path("results/melting"), help="default: results/melting")
    parser.add_argument("--docs", action="store_true", help="write the result into docs/validation.md")
    options = parser.parse_args()
    pieces = simulate(options.out, options.minutes)
    text = f"{words(pieces)}\n\n{made_by()}"
    say(text)
    if options.docs:
        fill_page(DOCS / "validation.md", {"row": text})


if __name__ == "__main__":
    sys.exit(exit_code(main))
