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
from peers.study import FULL, QUICK, Study
from rich.console import Console

WORK = TOP / "results" / "peers"
PAGE = DOCS / "peers.md"

console = Console(stderr=True)


def arguments() -> argparse.Namespace:
    """The command line; what it leaves out is that of `FULL` or `QUICK`."""

    def default(name: str) -> str:
        value = FULL[name]
        return f"default: {' '.join(f'{each:g}' for each in value) if isinstance(value, tuple) else value}"

    parser = parser_of(__doc__)
    parser.add_argument("--peers", nargs="+", choices=tuple(PEERS), metavar="NAME", help=f"{', '.join(PEERS)} (all)")
    parser.add_argument("--counts", nargs="+", type=int, help=f"numbers of discs ({default('counts')})")
    parser.add_argument("--packings", nargs="+", type=float, help=default("packings"))
    parser.add_argument("--steps", nargs="+", type=float, help=f"v dt in diameters ({default('steps')})")
    parser.add_argument(
        "--accurate", type=int, help=f"discs of the second table; 0: leave it out ({default('accurate')})"
    )
    parser.add_argument("--turns", type=int, help=default("turns"))
    parser.add_argument("--seconds", type=float, help=f"of an engine in one turn ({default('seconds')})")
    parser.add_argument("--budget", type=float, help=f"seconds of an engine for one scene ({default('budget')})")
    parser.add_argument("--point", type=float, help=f"seconds at one step of the second table ({default('point')})")
    parser.add_argument("--minutes", type=float, help=f"after which nothing new is begun ({default('minutes')})")
    parser.add_argument("--quick", action="store_true", help="little of everything")
    parser.add_argument("--again", action="store_true", help="measure nothing")
    parser.add_argument("--page", type=Path, help="default: docs/peers.md, of --quick results/peers/peers.md")
    parser.add_argument("--work", type=Path, default=WORK, help="for starts, messages and the record of what was found")
    return parser.parse_args()


def measured(options: argparse.Namespace, record_file: Path) -> dict[str, Any]:
    """The record of a study, kept in a file as it grows."""
    asked = QUICK if options.quick else FULL
    asked = {
        name: default if vars(options).get(name) is None else vars(options)[name] for name, default in asked.items()
    }
    head = {"machine": machine(), "quick": options.quick, "command": f"python {shlex.join(sys.argv)}"}

    def save(record: dict[str, Any]) -> None:
        record_file.write_text(json.dumps(record, indent=1) + "\n")

    with console.status("starting") as status:
        return Study(asked, options.work, status.update, save, head).run()


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
