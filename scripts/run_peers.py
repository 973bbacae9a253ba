"""Compares mpsim with other engines: docs/peers.md, its pictures and the claim of the README.

python scripts/run_peers.py                    everything, at most 25 minutes on two cores
python scripts/run_peers.py --quick            a look of seconds at mpsim, NumPy and the yardstick, under results/peers/
python scripts/run_peers.py --peers cpp mpsim-push taichi --counts 10000 --page results/peers/peers.md
python scripts/run_peers.py --again            the page anew, from what the last call has measured

Engines that are not installed get a row that says so. `pip install -e '.[peers]'` installs all but Rapier, which is
`npm install --prefix results/peers @dimforge/rapier2d-simd-compat`.
"""

import argparse
import json
import shlex
import sys
import time
from pathlib import Path
from typing import Any

from harness import DOCS, TOP, exit_code, machine, make_folder, parser_of
from peers import page
from peers.client import FailedError
from peers.registry import PEERS
from peers.study import Asked, Study
from peers.turns import Effort
from rich.console import Console

WORK = TOP / "results" / "peers"
PAGE = DOCS / "peers.md"

COUNTS = (100, 1_000, 10_000, 100_000, 1_000_000)
PACKINGS = (0.1, 0.4, 0.7)
STEPS = (0.02, 0.002)
QUICK_PEERS = ("cpp", "numba", "mpsim-push", "mpsim-event", "numpy")
"""The exact solver gives the pressure that others are compared with."""

console = Console(stderr=True)


def arguments() -> argparse.Namespace:
    parser = parser_of(__doc__)
    parser.add_argument("--peers", nargs="+", choices=tuple(PEERS), metavar="NAME", help=f"{', '.join(PEERS)} (all)")
    parser.add_argument("--counts", nargs="+", type=int, help=f"numbers of discs (default: {_words(COUNTS)})")
    parser.add_argument("--packings", nargs="+", type=float, help=f"default: {_words(PACKINGS)}")
    parser.add_argument("--steps", nargs="+", type=float, help=f"v dt in diameters (default: {_words(STEPS)})")
    parser.add_argument("--accurate", type=int, help="discs of the second table; 0: leave it out (default: 1000)")
    parser.add_argument("--turns", type=int, help="default: 5")
    parser.add_argument("--seconds", type=float, help="of an engine in one turn (default: 0.12)")
    parser.add_argument("--budget", type=float, help="seconds of an engine for one scene (default: 10)")
    parser.add_argument("--point", type=float, help="seconds of an engine at one step of the second table (default: 8)")
    parser.add_argument("--minutes", type=float, help="after which nothing new is begun (default: 25)")
    parser.add_argument("--quick", action="store_true", help="little of everything")
    parser.add_argument("--again", action="store_true", help="measure nothing")
    parser.add_argument("--page", type=Path, help="default: docs/peers.md, of --quick results/peers/peers.md")
    parser.add_argument("--work", type=Path, default=WORK, help="for starts, messages and the record of what was found")
    return parser.parse_args()


def _words(numbers: tuple[float, ...]) -> str:
    return " ".join(f"{number:g}" for number in numbers)


def asked(options: argparse.Namespace) -> Asked:
    """What the options ask for."""
    quick = options.quick
    effort = Effort(
        turns=options.turns or (2 if quick else 5),
        seconds=options.seconds or (0.01 if quick else 0.12),
        budget=options.budget or 10.0,
    )
    small: dict[str, Any] = {"cost_count": 100, "starts": 3, "accurate_steps": (0.1, 0.05)}
    count = (100 if quick else 1_000) if options.accurate is None else options.accurate
    return Asked(
        peers=options.peers or (QUICK_PEERS if quick else tuple(PEERS)),
        counts=options.counts or ((100,) if quick else COUNTS),
        packings=options.packings or ((0.4,) if quick else PACKINGS),
        steps=options.steps or ((0.02,) if quick else STEPS),
        effort=effort,
        minutes=options.minutes or 25.0,
        accurate_count=count,
        point_seconds=options.point or (2.0 if quick else 8.0),
        **(small if quick else {}),
    )


def measured(options: argparse.Namespace, record_file: Path) -> dict[str, Any]:
    """The record of a study, kept in a file as it grows."""

    def save(record: dict[str, Any]) -> None:
        record_file.write_text(json.dumps(record, indent=1) + "\n")

    head = {"machine": machine(), "quick": options.quick, "command": f"python {shlex.join(sys.argv)}"}
    with console.status("starting") as status:
        study = Study(asked(options), options.work, status.update, save, record=head)
        return study.run()


def main() -> int:
    """Measure and write; returns the exit status."""
    options = arguments()
    begun = time.perf_counter()
    target = options.page or (options.work / "peers.md" if options.quick else PAGE)
    make_folder(options.work)
    record_file = options.work / ("quick.json" if options.quick else "peers.json")
    try:
        record = json.loads(record_file.read_text()) if options.again else measured(options, record_file)
    except KeyboardInterrupt:
        console.print("Interrupted; what was measured is in the record, and --again writes the page from it.")
        return 130
    except FailedError as error:
        console.print(f"run_peers: {error}", style="red", highlight=False, soft_wrap=True)
        return 1
    page.write(record, target, TOP / "README.md" if target == PAGE else None)
    console.print(f"{time.perf_counter() - begun:.1f} s; the page is {target}", highlight=False, soft_wrap=True)
    return 0


if __name__ == "__main__":
    sys.exit(exit_code(main))
