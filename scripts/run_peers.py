"""Compares mpsim with other engines: docs/peers.md, the claim of the README, game loops in docs/performance.md.

python scripts/run_peers.py                    everything, some 30 minutes on two cores
python scripts/run_peers.py --counts --accurate 0      game loops alone, which renews no page but theirs
python scripts/run_peers.py --quick            a look of seconds at mpsim, NumPy and the yardstick, under results/peers/
python scripts/run_peers.py --peers cpp mpsim-push taichi --counts 10000 --page results/peers/peers.md

Engines that are not installed get a row that says so; `pip install -e '.[peers]'` installs all. peers/engines.py lists
them and asks each in a process of its own, peers/with_NAME.py drives one behind the interface of peers/engine.py,
peers/study.py measures, and this file makes the page.
"""

import shlex
import sys
import textwrap
import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from harness import DOCS, TOP, exit_code, fill_page, is_busy, machine, make_folder, parser_of, slowed, table
from peers.engines import PEERS
from peers.study import (
    CALLS,
    EXACT,
    EXACT_LONGER,
    LIMITS,
    QUICK,
    SETTLE,
    STEP,
    TIME,
    Accuracy,
    Effort,
    Study,
    Times,
    Timing,
)
from rich.console import Console

from mpsim.core.text import with_error

YARDSTICK = "cpp"
CLAIM = 0.4, 100_000
"""Packing and discs of the claim."""

GAME, PICTURE, MANY = 1_000, 1 / 60, (100_000, 150_000, 200_000, 300_000, 400_000, 500_000, 600_000, 800_000, 1_000_000)
"""Of game loops: discs that the README compares, time between two pictures [s], and discs that may fit into it."""

SETTLED = 0.5
"""Units of time from the start up to which fewer discs touch than later."""

BUSY = (
    "**The machine was busy with other work: neither times nor their ratios are to be quoted, and nothing is claimed. "
    "Errors and drifts do not depend on it.**"
)

INTRODUCTION = """# Peers

How fast and how accurate are other engines on the same scenes? These have equal discs of mass 1 in a closed square box,
elastic and smooth, without gravity, from the same `Scene.random(seed=1)`. The thermal speed v is √kT, the root mean
square of *one component* of the velocity. A step is given as v·dt in diameters; in a unit of time v covers a diameter.

<!-- not run: half an hour on two cores, with engines that the tests do not need -->
```sh
pip install -e '.[peers]' && python scripts/run_peers.py
```

The *yardstick* is the algorithm of the term-project report in plain C++: a grid of lists of indices, with both orders
of each pair. Each engine runs in its own process, and is timed without set-up, compilation and warm-up. The engines
take turns, so that other programs slow all alike. Numbers are medians over the turns; "6x" means six times as fast as
the yardstick in the same turn.
"""

FRAMES_TEXT = """## A frame

Nanoseconds per disc and frame. Frames with the same dt have different errors; for costs at equal errors see
[below](#a-unit-of-time). Engines with adjustable effort, such as a number of iterations, run with the least. *Early*
marks engines so slow that they were timed only in the first half unit of time, when fewer discs touch.
"""

ERRORS_TEXT = """## A unit of time

This comparison is the fair one: the cost of a disc per unit of time (µs) with the longest step that keeps the pressure
within 1 %, and within 10 %. *Drift* is the relative change of the kinetic energy per unit of time with this step.
Errors are those of {accurate:,} discs at packing {packing:g}, costs those of {cost_count:,} discs. Each engine has one
process or thread.

The pressure is the impulse on the walls, over {time:g} units from up to {starts} starts, after {settle:g} unit of
equilibration. The exact value, {pressure} kT / diameter², is that of mpsim's event-driven solver, with the same starts
and runs {longer} times as long. In pymunk and Box2D the walls are heavy bodies during this measurement, whose momentum
is read. Steps tried: {steps}, from the longest until two in turn are within 1 %, each with every effort: {knobs}.
"""

console = Console(stderr=True, highlight=False, soft_wrap=True)


def number(value: float) -> str:
    """A number with three digits."""
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"


def title_of(name: str, threads: int) -> str:
    """Name of an engine with its threads."""
    word = "workers" if name.startswith("mpsim") else "threads"
    return PEERS[name].title + (f", {threads} {word}" if threads > 1 else "")


# --- frames


def faster(times: Times, name: str, threads: int) -> float | None:
    """How many times faster than the yardstick in the same turn: the median."""
    base, other = times.get((YARDSTICK, 1)), times.get((name, threads))
    if not isinstance(base, Timing) or not isinstance(other, Timing):
        return None
    return float(np.median(np.array(base.frame) / other.frame))


def frames_table(study: Study, cells: dict[int, Times]) -> str:
    """Times of frames at one packing, and the reasons for what is missing."""
    rows: list[list[str]] = []
    reasons: dict[str, list[str]] = {}
    for name, missing in study.missing.items():
        if not PEERS[name].steps:
            continue
        if missing:
            rows.append([PEERS[name].title, missing, *[""] * (len(cells) - 1)])
            continue
        for threads in PEERS[name].threads:
            title = title_of(name, threads)
            rows.append([title])
            for count, times in cells.items():
                timing, ratio = times[name, threads], faster(times, name, threads)
                if isinstance(timing, str):
                    rows[-1].append("-")
                    reasons.setdefault(f"discs: {timing}", []).append(f"{title} with {count:,}")
                    continue
                text = number(float(np.median(timing.frame)) * 1e9 / count)
                text += f" {number(ratio)}x" if ratio else ""
                early = timing.frames * len(timing.frame) * STEP < SETTLED
                rows[-1].append(f"{text} early" if early else text)
    text = table(("engine", *(f"{count:,}" for count in cells)), rows)
    if reasons:
        lines = [f"- {'; '.join(which)} {why}" for why, which in reasons.items()]
        text += "\n\nNot in this table:\n\n" + "\n".join(lines)
    return text


def in_time(study: Study, how: str) -> int:
    """The most discs of MANY that mpsim moves between two pictures of a game."""
    times = {count: each["mpsim-push", 1] for count, each in study.frames(CLAIM[0], MANY, how).items()}
    return max((n for n, one in times.items() if isinstance(one, Timing) and np.median(one.frame) < PICTURE), default=0)


def game_claim(study: Study, times: Times) -> str:
    """What the README says of game loops, if it was measured; times: of frames one by one, of GAME discs."""
    own, other = times.get(("mpsim-push", 1)), times.get(("pymunk", 1))
    if not isinstance(own, Timing) or not isinstance(other, Timing):
        return ""
    one, theirs = (number(float(np.median(each.frame)) * 1e6) for each in (own, other))
    moved, read = (in_time(study, how) for how in ("step", "watch"))
    return (
        f"In a game loop, one frame a call on one core, {GAME:,} discs take {one} µs, and {theirs} in pymunk; at 60 "
        f"pictures a second it moves {moved:,} discs, or {read:,} if a picture reads their places and velocities"
    )


def game_table(study: Study, ways: dict[str, dict[int, Times]]) -> str:
    """Times of frames by how they are asked for [us]."""
    counts, rows = study.effort.game, []
    for name in study.present:
        if PEERS[name].steps:
            cells = ([ways[how][count][name, 1] for how in CALLS] for count in counts)
            words = (
                [number(float(np.median(one.frame)) * 1e6) if isinstance(one, Timing) else "-" for one in cell]
                for cell in cells
            )
            rows.append((PEERS[name].title, *(" / ".join(cell) for cell in words)))
    return table(("engine", *(f"{count:,} discs" for count in counts)), rows)


# --- errors


def answer(found: Accuracy, name: str, limit: float) -> tuple[Any, float] | None:
    """The point of an engine within a limit that costs least, and its cost [ns per disc and unit of time]."""
    costs = [(each, found.costs[name, each]) for each in found.within(name, limit)]
    return min(
        ((each, cost) for each, cost in costs if isinstance(cost, float)), key=lambda pair: pair[1], default=None
    )


def why_not(found: Accuracy, name: str, limit: float) -> str:
    """Why an engine has no cost at a limit: the least error that it had, or how it failed."""
    ended = [words for _, words in found.series[name] if words]
    points = [each for points, _ in found.series[name] for each in points]
    if within := found.within(name, limit):
        return f"reached at v·dt = {within[0].dt:g}; its frames: {found.costs[name, within[0]]}"
    if not points:
        return ended[0]
    best = min(points, key=lambda each: abs(each.error(found.exact)))
    text = f"not reached: {per_cent(best.error(found.exact), best.uncertainty(found.exact))} at v·dt = {best.dt:g}"
    return text + (f"; then, {ended[0]}" if ended else "")


def per_cent(error: float, uncertainty: float) -> str:
    """An error with its standard error in brackets, such as +0.80(42)%."""
    return f"{'+' if error >= 0 else ''}{with_error(100 * error, 100 * uncertainty)}%"


def accuracy_table(study: Study, found: Accuracy) -> str:
    """Costs at given errors."""
    exact, rows = found.exact, []
    for name, missing in study.missing.items():
        peer, texts = PEERS[name], []
        for limit in LIMITS:
            if name == EXACT:
                cost = next(each for key, each in found.costs.items() if key[0] == EXACT)
                error = f"exact, {with_error(0.0, 100 * exact.scatter / exact.pressure)}%"
                texts += [number(cost / 1e3) if isinstance(cost, float) else cost, "none", error, f"{exact.drift:+.1e}"]
            elif missing:
                texts += [missing, "", "", ""]
            elif (best := answer(found, name, limit)) is not None:
                each, cost = best
                error = per_cent(each.error(exact), each.uncertainty(exact))
                texts += [number(cost / 1e3), f"{each.dt:g}{peer.effort(each.knob)}", error, f"{each.drift:+.1e}"]
            else:
                texts += [why_not(found, name, limit), "", "", ""]
        rows.append((peer.title, *texts))
    heads = (head for limit in LIMITS for head in (f"µs at {limit:.0%}", "v·dt", "error", "drift"))
    return table(("engine", *heads), rows)


# --- the page


def claim(times: Times, found: Accuracy | None) -> str:
    """What the README says of speed, if it was measured: medians of this study."""
    one, two, ratio = times.get(("mpsim-push", 1)), times.get(("mpsim-push", 2)), faster(times, "mpsim-push", 1)
    if not isinstance(one, Timing) or not isinstance(two, Timing) or ratio is None:
        return ""
    costs = [f"{float(np.median(each.frame)) * 1e9 / CLAIM[1]:.0f}" for each in (one, two)]
    text = (
        f"{costs[0]} ns per disc and frame on one core and {costs[1]} ns on two ({CLAIM[1]:,} discs, "
        f"steps of {STEP:g} diameters), about {float(f'{ratio:.2g}'):g} times as fast as the report's algorithm in C++ "
        "on one core"
    )
    if found is None:
        return text
    costs = {name: best[1] for name in found.series if (best := answer(found, name, min(LIMITS)))}
    own = [cost for name, cost in costs.items() if name.startswith("mpsim")]
    others = {name: cost for name, cost in costs.items() if name != YARDSTICK and not name.startswith("mpsim")}
    if own and others:
        best = min(others, key=lambda name: others[name])
        times_less = float(f"{others[best] / min(own):.2g}")
        text += (
            f"; a pressure to 1 % costs about {times_less:g} times less than with {PEERS[best].title.split(',')[0]}, "
        )
        text += "the next best engine"
    return text


def page_of(study: Study, cells: dict[float, dict[int, Times]], found: Accuracy | None, made: str, said: str) -> str:
    """The page."""
    effort, parts = study.effort, [INTRODUCTION]
    if said:
        parts.append(textwrap.fill(f"mpsim takes {said}.", 120) + "\n")
    parts += [f"{made}\n", FRAMES_TEXT]
    for packing, by_count in cells.items():
        parts += [f"### Packing {packing:g}, v·dt = {STEP:g} diameters\n", f"{frames_table(study, by_count)}\n"]
    if found:
        knobs = [
            f"{peer.title} {' and '.join(map(str, peer.knobs))} {peer.knob}" for peer in PEERS.values() if peer.knob
        ]
        words = asdict(effort) | {
            "starts": found.exact.starts,
            "steps": ", ".join(f"{step:g}" for step in effort.steps),
        }
        words |= {"packing": next(iter(cells)), "time": TIME, "settle": SETTLE, "longer": EXACT_LONGER}
        words |= {"pressure": with_error(found.exact.pressure, found.exact.scatter), "knobs": "; ".join(knobs)}
        parts += [ERRORS_TEXT.format(**words), f"{accuracy_table(study, found)}\n"]
    rows = []
    for name, missing in study.missing.items():
        peer = PEERS[name]
        rows.append((peer.title, "-" if missing else peer.version(), peer.precision, missing or peer.driven))
    parts += ["## How each is driven\n", table(("engine", "version", "numbers", "how"), rows)]
    return "\n".join(parts) + "\n"


def main() -> None:
    """Measure, and write the page."""
    parser = parser_of(__doc__)

    def option(name: str, kind: type, words: str, **more: Any) -> None:
        value = getattr(Effort(), name)
        default = " ".join(map(str, value)) if isinstance(value, Sequence) else value
        parser.add_argument(f"--{name}", type=kind, help=f"{words} (default: {default})", **more)

    option("peers", str, "engines", nargs="+", choices=tuple(PEERS), metavar="NAME")
    option("counts", int, "numbers of discs of the first tables", nargs="*")
    option("packings", float, "packing fractions", nargs="+")
    option("game", int, "numbers of discs of the game loops; none: leave them out", nargs="*")
    option("accurate", int, "discs of the second table; 0: leave it out")
    option("turns", int, "turns of each engine")
    parser.add_argument("--quick", action="store_true", help="little of everything")
    parser.add_argument("--page", type=Path, help="default: docs/peers.md, of --quick results/peers/peers.md")
    parser.add_argument("--work", type=Path, default=TOP / "results" / "peers", help="for starts and messages")
    options = parser.parse_args()
    asked = {name: value for name, value in vars(options).items() if value is not None and hasattr(QUICK, name)}
    effort = replace(QUICK if options.quick else Effort(), **asked)
    page = options.page or (options.work / "peers.md" if options.quick else DOCS / "peers.md")
    make_folder(options.work)
    now, begun = machine(), time.monotonic()
    with console.status("looking for engines") as status:
        study = Study(effort, options.work, status.update)
        cells = {packing: study.frames(packing, effort.counts) for packing in effort.packings if effort.counts}
        ways = {how: study.frames(effort.packings[0], effort.game, how) for how in CALLS}
        found = study.accuracy(effort.packings[0]) if effort.accurate else None
        alone = Study(replace(effort, peers=("mpsim-push",)), options.work, status.update)
        game = game_claim(alone, ways["step"].get(GAME, {}))
    times = cells.get(CLAIM[0], {}).get(CLAIM[1], {})
    now["slowed"].append(slowed())
    busy = is_busy(now)
    made = (
        f"Made by `python {shlex.join(sys.argv)}` in {(time.monotonic() - begun) / 60:.1f} minutes: {effort.turns} "
        f"turns of {effort.seconds:g} s an engine; {now['usable_cores']} cores of {now['processor']}, load before "
        f"{now['load_before']:.1f}, Python {now['python']}, {now['date'][:10]}, commit {now['commit']}."
    )
    made += " **A short run, for a look: not to be quoted.**" if options.quick else ""
    made += f" {BUSY}" if busy else ""
    said = "" if busy else claim(times, found)
    if effort.game:
        words = f"Microseconds a frame: {' / '.join(CALLS.values())}.\n\n{game_table(study, ways)}\n\n{made}"
        fill_page(DOCS / "performance.md" if page == DOCS / "peers.md" else page.with_name("game.md"), {"game": words})
    if cells or found:
        page.write_text(page_of(study, cells, found, made, said))
        console.print(f"the page is {page}")
    if not busy and page == DOCS / "peers.md":
        claims = (("claim", said, "peers](docs/peers.md"), ("game", game, "table](docs/performance.md#a-game-loop"))
        lines = {name: textwrap.fill(f"{text} ([{where})).", 116) for name, text, where in claims if text}
        fill_page(TOP / "README.md", {name: textwrap.indent(text, "  ") for name, text in lines.items()})


if __name__ == "__main__":
    sys.exit(exit_code(main))
