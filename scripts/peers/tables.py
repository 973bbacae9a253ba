"""Tables of the page, and the claim of the README, from the record of a study."""

import re
from typing import Any

from mpsim.core.text import with_error
from peers import accuracy
from peers.accuracy import Point, longest
from peers.registry import PEERS
from peers.turns import LATE, Timing, quartiles, ratios

CONTACTS = ("mpsim-push", "mpsim")
MAIN = (0.4, 0.02)
CLAIM_COUNT = 100_000

SETTLED = 0.5
"""Units of time from the start up to which fewer discs touch than later."""

LARGEST_SPREAD = 0.25
"""Between the quartiles of the yardstick's times, over their median: beyond it nothing is claimed."""

Cell = dict[str, Any]


def title_of(key: str) -> str:
    """Name of an engine with its threads, for a table."""
    name, _, threads = key.partition("/")
    word = {"mpsim": "workers", "mpsim-push": "workers"}.get(name, "threads")
    return PEERS[name].title + (f", {threads} {word}" if threads != "1" else "")


def timing_of(cell: Cell | None, key: str) -> Timing | None:
    """Times of an engine on a scene, if it has all its turns."""
    found = (cell or {}).get("times", {}).get(key)
    return Timing(**found) if isinstance(found, dict) and found["frame"] else None


def cell_of(record: dict[str, Any], count: int, packing: float, step: float) -> Cell | None:
    """The scene with these numbers, or None."""
    wanted = {"count": count, "packing": packing, "step": step}
    return next((cell for cell in record["cells"] if all(cell[key] == value for key, value in wanted.items())), None)


def nanoseconds(timing: Timing, count: int) -> tuple[float, float, float]:
    """Quartiles of the cost of a disc and frame [ns]."""
    low, middle, high = quartiles([1e9 * seconds / count for seconds in timing.frame])
    return low, middle, high


def number(value: float) -> str:
    """A number with three digits."""
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"


def entry(timing: Timing, yardstick: Timing | None, count: int) -> str:
    """Cost of a disc and frame, and how many times faster than the yardstick."""
    text = number(nanoseconds(timing, count)[1])
    if yardstick:
        text += f" {number(quartiles(ratios(yardstick, timing))[1])}x"
    return text


def rows_of_frames(record: dict[str, Any], packing: float, step: float) -> tuple[list[str], list[str]]:
    """Rows of the table of frames at one packing and step, and the reasons for what is missing in them."""
    cells = [cell for cell in record["cells"] if (cell["packing"], cell["step"]) == (packing, step)]
    reasons: dict[tuple[str, str], list[str]] = {}
    rows = ["| engine | " + " | ".join(f"{cell['count']:,}" for cell in cells) + " |", "|---" * (len(cells) + 1) + "|"]
    for name, found in record["peers"].items():
        if not PEERS[name].steps:
            continue
        if found["missing"]:
            rows.append(f"| {PEERS[name].title} | {found['missing']} |" + " |" * (len(cells) - 1))
            continue
        for threads in PEERS[name].threads:
            key, texts = f"{name}/{threads}", []
            for cell in cells:
                timing = timing_of(cell, key)
                yardstick = timing_of(cell, f"{record['yardstick']}/1")
                texts.append(entry(timing, yardstick, cell["count"]) if timing else "-")
                if timing and timing.frames * len(timing.frame) * step < SETTLED:
                    texts[-1] += " early"
                why = cell["times"].get(key, "not run")
                if why == LATE or not timing:
                    counts = reasons.setdefault(("all" if why == LATE else title_of(key), why), [])
                    counts.append(f"{cell['count']:,}")
            rows.append(f"| {title_of(key)} | " + " | ".join(texts) + " |")
    every = ", ".join(f"{cell['count']:,}" for cell in cells)
    missing = {which: ", ".join(dict.fromkeys(counts)) for which, counts in reasons.items()}
    return rows, [
        f"{title} with {'any number of' if counts == every else counts} discs: {why}"
        for (title, why), counts in missing.items()
    ]


def frames_section(record: dict[str, Any]) -> list[str]:
    """Tables of ns per disc and frame at the longest step, the main packing first, without thinner ones."""
    every = list(dict.fromkeys((cell["packing"], cell["step"]) for cell in record["cells"]))
    longest_step = max(step for _, step in every)
    kinds = [kind for kind in every if kind[1] == longest_step and kind[0] >= every[0][0]]
    lines = []
    for packing, step in kinds:
        lines += [f"### Packing {packing:g}, v·dt = {step:g} diameters", ""]
        cells = [cell for cell in record["cells"] if (cell["packing"], cell["step"]) == (packing, step)]
        if all(found == LATE for cell in cells for found in cell["times"].values()):
            lines += [f"{LATE.capitalize()}.", ""]
            continue
        rows, reasons = rows_of_frames(record, packing, step)
        lines += [*rows, ""]
        if reasons:
            lines += ["Not in this table:", "", *(f"- {reason}" for reason in reasons), ""]
    return lines


def answer(record: dict[str, Any], name: str, limit: float) -> tuple[Point, float] | None:
    """The point within a limit that costs least, and its cost [ns per disc and unit of time]; None: there is none."""
    kept = record["accuracy"]
    exact, count = Point(**kept["exact"]), kept["cost_count"]
    found = []
    for series in kept["series"].get(name, []):
        each = longest([Point(**point) for point in series["points"]], exact, limit)
        timing = kept.get("costs", {}).get(f"{name} {each.dt:g} {each.knob}") if each else None
        if each and isinstance(timing, dict) and timing["frame"]:
            median = quartiles(timing["frame"])[1]
            found.append((each, accuracy.cost_per_time(median, count, each.dt)))
    return min(found, key=lambda pair: pair[1], default=None)


def why_not(record: dict[str, Any], name: str, limit: float) -> str:
    """Why an engine has no cost at a limit: the least error that it had, or how it failed."""
    kept = record["accuracy"]
    exact = Point(**kept["exact"])
    ended = [series["ended"] for series in kept["series"].get(name, []) if series["ended"]]
    points = [Point(**point) for series in kept["series"].get(name, []) for point in series["points"]]
    if not points:
        return ended[0] if ended else "not measured"
    reached = [each for series in kept["series"][name] if (each := longest(points_of(series), exact, limit))]
    if reached:
        found = kept.get("costs", {}).get(f"{name} {reached[0].dt:g} {reached[0].knob}", "not timed")
        return f"reached at v·dt = {reached[0].dt:g}; its frames: {found if isinstance(found, str) else 'not timed'}"
    best = min(points, key=lambda each: abs(each.error(exact)))
    text = f"not reached: {per_cent(best.error(exact), best.uncertainty(exact))} at v·dt = {best.dt:g}"
    return text + (f"; then, {ended[0]}" if ended else "")


def per_cent(error: float, uncertainty: float) -> str:
    """An error with its standard error in brackets, such as +0.80(42)%."""
    return f"{'+' if error >= 0 else ''}{with_error(100 * error, 100 * uncertainty)}%"


def accuracy_rows(record: dict[str, Any]) -> list[str]:
    """Rows of the table of costs at given errors."""
    kept = record["accuracy"]
    exact = Point(**kept["exact"])
    limits = sorted(accuracy.LIMITS)
    rows = [
        "| engine | " + " | ".join(f"µs at {limit:.0%} | v·dt | error | drift" for limit in limits) + " |",
        "|---" * (1 + 4 * len(limits)) + "|",
    ]
    for name, found in record["peers"].items():
        peer = PEERS[name]
        if not peer.accuracy:
            continue
        if found["missing"]:
            rows.append(f"| {peer.title} | {found['missing']} |" + " |" * (4 * len(limits) - 1))
            continue
        if not peer.steps:
            rows.append(exact_row(record, peer.title, exact, len(limits)))
            continue
        texts = []
        for limit in limits:
            had = answer(record, name, limit)
            if had:
                each, cost = had
                error = per_cent(each.error(exact), each.uncertainty(exact))
                texts += [number(cost / 1e3), f"{each.dt:g}{peer.effort(each.knob)}", error, f"{each.drift:+.1e}"]
            else:
                texts += [why_not(record, name, limit), "", "", ""]
        rows.append(re.sub(" +", " ", f"| {peer.title} | " + " | ".join(texts) + " |"))
    return rows


def exact_row(record: dict[str, Any], title: str, exact: Point, limits: int) -> str:
    """The row of the exact solver, which has one cost, no step and no error but that of the sample."""
    kept = record["accuracy"]
    timing = kept.get("costs", {}).get("mpsim-event 1 0")
    cost = "-"
    if isinstance(timing, dict) and timing["frame"]:
        cost = number(accuracy.cost_per_time(quartiles(timing["frame"])[1], kept["cost_count"], 1.0) / 1e3)
    own = f"{cost} | none | exact, {with_error(0.0, 100 * exact.scatter / exact.pressure)}% | {exact.drift:+.1e}"
    return f"| {title} | " + " | ".join([own] * limits) + " |"


def points_of(series: dict[str, Any]) -> list[Point]:
    """Points of a series of the record."""
    return [Point(**point) for point in series["points"]]


def next_best(record: dict[str, Any]) -> tuple[str, float] | None:
    """The cheapest engine but mpsim and the yardsticks at the least limit, and its cost over mpsim's."""
    if "accuracy" not in record:
        return None
    limit = min(accuracy.LIMITS)
    own = [had[1] for name in CONTACTS if (had := answer(record, name, limit))]
    others = {
        name: had[1]
        for name in record["peers"]
        if not name.startswith("mpsim") and name not in ("cpp", "numba") and (had := answer(record, name, limit))
    }
    if not own or not others:
        return None
    best = min(others, key=lambda name: others[name])
    return PEERS[best].title, others[best] / min(own)


def is_busy(record: dict[str, Any]) -> bool:
    """Whether other work has disturbed the times: before the study, or between turns of the yardstick."""
    machine = record["machine"]
    if machine["load_before"] > machine["usable_cores"] / 2:
        return True
    timing = timing_of(cell_of(record, CLAIM_COUNT, *MAIN), f"{record['yardstick']}/1")
    low, middle, high = quartiles(timing.frame) if timing else (1.0, 1.0, 1.0)
    return (high - low) / middle > LARGEST_SPREAD


def about(ratio: float) -> str:
    """A ratio to the two digits that hold from day to day.

    >>> about(130.5), about(7.26)
    ('about 130', 'about 7.3')
    """
    return f"about {float(f'{ratio:.2g}'):g}"


def claim(record: dict[str, Any]) -> str:
    """What the README says of speed: medians of this study. Empty if it was disturbed, or has not measured them."""
    cell = cell_of(record, CLAIM_COUNT, *MAIN)
    one, two = timing_of(cell, "mpsim-push/1"), timing_of(cell, "mpsim-push/2")
    yardstick = timing_of(cell, "cpp/1")
    if not cell or not one or not two or not yardstick or is_busy(record):
        return ""
    costs = [f"{nanoseconds(timing, CLAIM_COUNT)[1]:.0f}" for timing in (one, two)]
    text = (
        f"{costs[0]} ns per disc and frame on one core and {costs[1]} ns on two ({CLAIM_COUNT:,} discs, "
        f"steps of {MAIN[1]:g} diameters), "
        f"{about(quartiles(ratios(yardstick, one))[1])} times as fast as the report's algorithm in C++ on one core"
    )
    best = next_best(record)
    if best:
        title, times = best
        compared = f"{about(times)} times less than" if times >= 1 else f"{about(1 / times)} times as much as"
        text += f"; a pressure to 1 % costs {compared} with {title.split(',')[0]}, the next best engine"
    return text
