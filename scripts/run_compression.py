"""Packings that `Scene.compressed` reaches, and the time that it needs: the table of docs/howto/dense-starts.md.

Equal discs and discs of two sizes, periodic, are compressed from packing 0.4 at several rates: to a packing below
jamming, with the time that takes, and on until they jam.

python scripts/run_compression.py                                    some five minutes
python scripts/run_compression.py --docs docs/howto/dense-starts.md  the same, and renew the table of the page
python scripts/run_compression.py --counts 100 --rates 0.1           a second
"""

import re
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from harness import exit_code, fill_page, made_by, parser_of, say, table

import mpsim

KINDS = {"equal": (0.5, 0.8), "1 : 1.4": (0.7, 0.82)}
"""Radius of the other half of the discs, where one half has 0.5, and the packing that is timed."""

ALL = 0.906
"""Packing that is asked for so that discs jam: below that of the perfect crystal of equal discs."""

HEADS = ("discs", "", "rate", "time to packing", "", "jammed at", "time")


def start(count: int, other: float) -> mpsim.Scene:
    """Discs of radius 0.5 and the other one, half of each, at packing 0.4."""
    radius = np.repeat([0.5, other], [count - count // 2, count // 2])
    return mpsim.Scene.random(count=count, packing=0.4, radius=radius, boundary="periodic", seed=1)


def compressed(scene: mpsim.Scene, packing: float, rate: float) -> tuple[float | None, float]:
    """The packing at which discs jam before the one wanted, or None; and the seconds that it takes."""
    begun = time.perf_counter()
    try:
        dense = scene.compressed(packing, rate=rate)
    except mpsim.InputError as error:
        (found,) = re.findall(r"jammed at a packing of (0\.\d+)", str(error))
        return float(found), time.perf_counter() - begun
    seconds, state = time.perf_counter() - begun, mpsim.State(dense.position, dense.velocity)
    assert mpsim.measure.overlap(state, dense).pairs == 0
    return None, seconds


def in_words(seconds: float) -> str:
    """A time with two digits."""
    return f"{seconds:.0f} s" if seconds >= 100 else f"{seconds:.2g} s"


def rows(counts: list[int], rates: list[float]) -> Iterator[tuple[str, ...]]:
    """Rows of the table."""
    for kind, (other, packing) in KINDS.items():
        for count in counts:
            scene = start(count, other)
            compressed(scene, 0.45, 1.0)  # compiles, or loads, the kernels
            for rate in rates:
                before, first = compressed(scene, packing, rate)
                jammed, second = compressed(scene, ALL, rate)
                to = in_words(first) if before is None else "jammed"
                end = f"not, {ALL:g} reached" if jammed is None else f"{jammed:.4f}"
                row = kind, f"{count:,}", f"{rate:g}", f"{packing:g}", to, end, in_words(second)
                say(f"| {' | '.join(row)} |")
                yield row


def main() -> None:
    """The table, on the screen and in the page."""
    parser = parser_of(__doc__)
    parser.add_argument("--counts", type=int, nargs="+", default=[100, 1000, 5000], help="numbers of discs")
    parser.add_argument("--rates", type=float, nargs="+", default=[0.1, 0.01, 0.001], help="rates of growth")
    parser.add_argument("--docs", type=Path, help="page whose table is renewed")
    options = parser.parse_args()
    text = f"{table(HEADS, rows(options.counts, options.rates))}\n\n{made_by()}"
    if options.docs:
        fill_page(options.docs, {"table": text})


if __name__ == "__main__":
    sys.exit(exit_code(main))
