"""The page and its pictures, and the claim of the README, from the record of a study."""

import textwrap
from pathlib import Path
from typing import Any

from pages import fill_blocks

from peers import accuracy, pictures, tables
from peers.accuracy import Point
from peers.registry import PEERS

BUSY = (
    "**The machine was busy with other work: neither times nor their ratios are to be quoted, and nothing is claimed. "
    "Errors and drifts do not depend on it.**"
)

FRAMES, ERRORS = "peers-frames.png", "peers-errors.png"
TOOL = "run_peers"

INTRODUCTION = """# Peers

mpsim and what a user would take instead, on the same scenes: equal discs of mass 1 in a closed square box, without
gravity, elastic and smooth. The thermal speed v is √kT, the root mean square of *one component* of the velocity; a step
is given as v·dt in diameters (0.02 here is twice the step on the page of [benchmarks](benchmarks.md)), and a unit of
time is that in which v covers a diameter. Every engine starts from the same `Scene.random(seed=1)`.

<!-- not run: half an hour on two cores, with engines that the tests do not need -->
```sh
pip install -e '.[peers]' && npm install --prefix results/peers @dimforge/rapier2d-simd-compat
python scripts/run_peers.py
```

writes this page. Each engine runs in a process of its own. Processes take turns: in each turn every engine runs for a
while, one after another, the yardstick among them, which is the term-project report's algorithm written straight: a
grid of lists of indices, both orders of each pair. What else runs on the machine shows in its times. Numbers are
medians over the turns, with quartiles in brackets; "6x" is six times as fast as the yardstick in the same turn. Times
are those of calls for many frames, without set-up, compilation and warm-up.
"""

FRAMES_TEXT = """## A frame

Nanoseconds per disc and frame. Frames of the same dt are not equally good: for that, see [below](#a-unit-of-time).
Engines with a setting of effort run with the least, where they are quickest. What is marked *early* are times of the
first half unit of time alone, as long frames leave room for few of them: fewer discs touch then than later.
"""

ERRORS_TEXT = """## A unit of time

Steps are not equal, so this is the comparison that counts: what a disc costs per unit of time (µs) with the longest
step at which the pressure is within 1 % and within 10 %, and how fast the kinetic energy changes then (drift: relative
change per unit of time). {count:,} discs at packing {packing:g} for errors, {cost_count:,} for costs, one process or
thread.

- The pressure is the impulse on the four walls over time and perimeter, in runs of {time:g} units from up to {starts}
  starts after {settle:g} unit to settle. The exact value is that of mpsim's event-driven solver from the same starts,
  {longer} times as long: {pressure:.4f} ± {scatter:.4f} kT / diameter² (the walls of a small box matter: it is not the
  bulk's). Errors are relative, ± one standard error from the scatter between starts.
- Energy that an engine loses or gains is in its error: that is the pressure a user would read.
- The impulse comes from mpsim's own measure; from the wall's reflections, summed, in the yardstick, NumPy, Taichi and
  Warp; from the force of the springs, summed over steps, in LAMMPS. In pymunk, Box2D and Rapier walls are bodies of 10⁸
  disc masses while this is measured: what one gained in a frame is the impulse, and it is brought back to rest and
  place. In each the difference between opposite walls equals the change of the discs' momentum, to rounding (LAMMPS:
  but for one step), which a test checks for the engines that are installed.
- Steps tried: {steps}, from the longest until two in turn are within 1 %. What counts is the longest step from which on
  all shorter ones tried are within the limit. Settings of effort are each tried: {knobs}.
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
    lines += ["### Marks", "", *tables.marks_section(record), ""]
    if "accuracy" in record:
        lines += [errors_text(record)]
        lines += [f"![Error of the pressure against the step, and costs at given errors](pictures/{ERRORS})", ""]
        lines += [*tables.accuracy_rows(record), ""]
    lines += ["## How each is driven", "", *driven(record)]
    return "\n".join(lines).rstrip() + "\n"


def errors_text(record: dict[str, Any]) -> str:
    """What the second table shows, and how it was found."""
    kept = record["accuracy"]
    exact = Point(**kept["exact"])
    knobs = [f"{peer.title} {' and '.join(map(str, peer.knobs))} {peer.knob}" for peer in PEERS.values() if peer.knob]
    return ERRORS_TEXT.format(
        count=kept["count"],
        cost_count=kept["cost_count"],
        packing=kept["packing"],
        time=accuracy.TIME,
        settle=accuracy.SETTLE,
        longer=accuracy.EXACT_LONGER,
        starts=exact.starts,
        pressure=exact.pressure,
        scatter=exact.scatter,
        steps=", ".join(f"{step:g}" for step in kept["steps"]),
        knobs="; ".join(knobs),
    )


def driven(record: dict[str, Any]) -> list[str]:
    """What each engine is, and how it is used here."""
    rows = ["| engine | version | numbers | how |", "|---|---|---|---|"]
    for name, found in record["peers"].items():
        peer = PEERS[name]
        how = found["missing"] or peer.driven
        rows.append(f"| {peer.title} | {found['version'] or '-'} | {peer.precision} | {how} |")
    return rows


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
        fill_blocks(readme, TOOL, {"claim": textwrap.indent(claim, "  ")})
