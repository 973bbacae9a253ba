"""Makes the page, its pictures and the claim of the README from the record of a study."""

import textwrap
from pathlib import Path
from typing import Any

from harness import fill_page, table

from mpsim.core.text import with_error
from peers import pictures, study, tables
from peers.registry import PEERS

BUSY = (
    "**The machine was busy with other work: neither times nor their ratios are to be quoted, and nothing is claimed. "
    "Errors and drifts do not depend on it.**"
)

FRAMES, ERRORS = "peers-frames.png", "peers-errors.png"

INTRODUCTION = """# Peers

How fast and how accurate are other engines on the same scenes? These have equal discs of mass 1 in a closed square box,
elastic and smooth, without gravity, from the same `Scene.random(seed=1)`. The thermal speed v is √kT, the root mean
square of *one component* of the velocity. A step is given as v·dt in diameters; in a unit of time v covers a diameter.

<!-- not run: half an hour on two cores, with engines that the tests do not need -->
```sh
pip install -e '.[peers]' && npm install --prefix results/peers @dimforge/rapier2d-simd-compat
python scripts/run_peers.py
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
Errors are those of {count:,} discs at packing {packing:g}, costs those of {cost_count:,} discs. Each engine has one
process or thread.

The pressure is the impulse on the walls, over {time:g} units from up to {starts} starts, after {settle:g} unit of
equilibration. The exact value, {pressure} kT / diameter², is that of mpsim's event-driven solver, with the same starts
and runs {longer} times as long. In pymunk, Box2D and Rapier the walls are heavy bodies during this measurement, whose
momentum is read. Steps tried: {steps}, from the longest until two in turn are within 1 %, each with every effort:
{knobs}.
"""


def text(record: dict[str, Any]) -> str:
    """The page."""
    lines = [INTRODUCTION]
    said = tables.claim(record)
    if said:
        lines += [textwrap.fill(f"mpsim takes {said}.", 120), ""]
    lines += [made(record), "", FRAMES_TEXT]
    lines += [f"![Cost of a disc and frame against the number of discs, by engine](pictures/{FRAMES})", ""]
    lines += tables.frames_section(record)
    if "accuracy" in record:
        lines += [errors_text(record)]
        lines += [f"![Error of the pressure against the step, and costs at given errors](pictures/{ERRORS})", ""]
        lines += [tables.accuracy_table(record), ""]
    lines += ["## How each is driven", "", driven(record)]
    return "\n".join(lines).rstrip() + "\n"


def errors_text(record: dict[str, Any]) -> str:
    """What the second table shows, and how it was found."""
    kept = record["accuracy"]
    exact = tables.exact_of(record)
    knobs = [f"{peer.title} {' and '.join(map(str, peer.knobs))} {peer.knob}" for peer in PEERS.values() if peer.knob]
    return ERRORS_TEXT.format(
        count=kept["count"],
        cost_count=kept["cost_count"],
        packing=kept["packing"],
        time=study.TIME,
        settle=study.SETTLE,
        longer=study.EXACT_LONGER,
        starts=exact.starts,
        pressure=with_error(exact.pressure, exact.scatter),
        steps=", ".join(f"{step:g}" for step in kept["steps"]),
        knobs="; ".join(knobs),
    )


def driven(record: dict[str, Any]) -> str:
    """What each engine is, and how it is used here."""
    rows = []
    for name, found in record["peers"].items():
        peer = PEERS[name]
        how = found["missing"] or peer.driven
        rows.append((peer.title, found["version"] or "-", peer.precision, how))
    return table(("engine", "version", "numbers", "how"), rows)


def made(record: dict[str, Any]) -> str:
    """Where, when and with what effort the numbers came about."""
    machine, effort = record["machine"], record["effort"]
    note = " **A short run, for a look: not to be quoted.**" if record["quick"] else ""
    if tables.is_busy(record):
        note += f" {BUSY}"
    return (
        f"Made by `{record['command']}` in {record['minutes']:.1f} minutes: {effort['turns']} turns of "
        f"{effort['seconds']:g} s an engine; {machine['usable_cores']} cores of {machine['processor']}, load before "
        f"{machine['load_before']:.1f}, Python {machine['python']}, {machine['date'][:10]}, commit "
        f"{machine['commit']}.{note}"
    )


def write(record: dict[str, Any], page: Path, readme: Path | None) -> None:
    """Write the page and its pictures, and renew the claim of the README."""
    folder = page.parent / "pictures"
    folder.mkdir(parents=True, exist_ok=True)
    pictures.frames(record, folder / FRAMES)
    if "accuracy" in record:
        pictures.errors(record, folder / ERRORS)
    page.write_text(text(record))
    said = tables.claim(record)
    if readme and said:
        claim = textwrap.fill(f"{said} ([peers](docs/peers.md)).", 116)
        fill_page(readme, {"claim": textwrap.indent(claim, "  ")})
