"""Tables of the page, and the claim of the README, from the record of a study."""

from typing import Any

from harness import quartiles, table

from mpsim.core.text import with_error
from peers.registry import PEERS, YARDSTICKS
from peers.study import EXACT, LATE, LIMITS, Point, Timing, longest, ratios

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
    return found if isinstance(found, dict) and found["frame"] else None


def cell_of_claim(record: dict[str, Any]) -> Cell | None:
    """The scene of which the claim is, or None."""
    wanted = CLAIM_COUNT, *MAIN
    return next((cell for cell in record["cells"] if (cell["count"], cell["packing"], cell["step"]) == wanted), None)


def nanoseconds(timing: Timing, count: int) -> tuple[float, float, float]:
    """Quartiles of the cost of a disc and frame [ns]."""
    return quartiles([1e9 * seconds / count for seconds in timing["frame"]])


def number(value: float) -> str:
    """A number with three digits."""
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"


def entry(timing: Timing, yardstick: Timing | None, count: int) -> str:
    """Cost of a disc and frame, and how many times faster than the yardstick."""
    text = number(nanoseconds(timing, count)[1])
    if yardstick:
        text += f" {number(quartiles(ratios(yardstick, timing))[1])}x"
    return text


def frames_table(record: dict[str, Any], cells: list[Cell], step: float) -> list[str]:
    """The table of frames at one packing and step, and the reasons for what is missing in it."""
    reasons: dict[tuple[str, str], list[str]] = {}
    rows = []
    for name, found in record["peers"].items():
        if not PEERS[name].steps:
            continue
        if found["missing"]:
            rows.append([PEERS[name].title, found["missing"], *[""] * (len(cells) - 1)])
            continue
        for threads in PEERS[name].threads:
            key = f"{name}/{threads}"
            rows.append([title_of(key)])
            for cell in cells:
                timing, count = timing_of(cell, key), f"{cell['count']:,}"
                yardstick = timing_of(cell, f"{record['yardstick']}/1")
                text = entry(timing, yardstick, cell["count"]) if timing else "-"
                early = timing and timing["frames"] * len(timing["frame"]) * step < SETTLED
                rows[-1].append(f"{text} early" if early else text)
                if not timing:
                    why = cell["times"].get(key, "not run")
                    reasons.setdefault(("all" if why == LATE else title_of(key), why), []).append(count)
    lines = [table(("engine", *(f"{cell['count']:,}" for cell in cells)), rows), ""]
    if reasons:
        lines += ["Not in this table:", ""]
        for (title, why), counts in reasons.items():
            which = list(dict.fromkeys(counts))
            lines.append(
                f"- {title} with {'any number of' if len(which) == len(cells) else ', '.join(which)} discs: {why}"
            )
        lines.append("")
    return lines


def frames_section(record: dict[str, Any]) -> list[str]:
    """Tables of ns per disc and frame at the longest step, the main packing first, without thinner ones."""
    every = list(dict.fromkeys((cell["packing"], cell["step"]) for cell in record["cells"]))
    longest_step = max(step for _, step in every)
    lines = []
    for packing, step in every:
        if step != longest_step or packing < every[0][0]:
            continue
        lines += [f"### Packing {packing:g}, v·dt = {step:g} diameters", ""]
        cells = [cell for cell in record["cells"] if (cell["packing"], cell["step"]) == (packing, step)]
        if all(found == LATE for cell in cells for found in cell["times"].values()):
            lines += [f"{LATE.capitalize()}.", ""]
        else:
            lines += frames_table(record, cells, step)
    return lines


def cost_of(record: dict[str, Any], name: str, each: Point) -> float | str:
    """Nanoseconds per disc and unit of time of an engine at a point, or why there are none."""
    kept = record["accuracy"]
    timing = kept.get("costs", {}).get(f"{name} {each.dt:g} {each.knob}", "not timed")
    if isinstance(timing, str) or not timing["frame"]:
        return timing if isinstance(timing, str) else "not timed"
    return quartiles(timing["frame"])[1] * 1e9 / kept["cost_count"] / each.dt


def reached(record: dict[str, Any], name: str, limit: float) -> list[Point]:
    """The points of an engine that are within a limit, one for each effort that has any."""
    exact = exact_of(record)
    found = (longest(points_of(series), exact, limit) for series in record["accuracy"]["series"].get(name, []))
    return [each for each in found if each]


def answer(record: dict[str, Any], name: str, limit: float) -> tuple[Point, float] | None:
    """The point within a limit that costs least, and its cost [ns per disc and unit of time]; None: there is none."""
    costs = [(each, cost_of(record, name, each)) for each in reached(record, name, limit)]
    found = [(each, cost) for each, cost in costs if isinstance(cost, float)]
    return min(found, key=lambda pair: pair[1], default=None)


def why_not(record: dict[str, Any], name: str, limit: float) -> str:
    """Why an engine has no cost at a limit: the least error that it had, or how it failed."""
    exact, every = exact_of(record), record["accuracy"]["series"].get(name, [])
    ended = [series["ended"] for series in every if series["ended"]]
    points = [each for series in every for each in points_of(series)]
    if not points:
        return ended[0] if ended else "not measured"
    if within := reached(record, name, limit):
        return f"reached at v·dt = {within[0].dt:g}; its frames: {cost_of(record, name, within[0])}"
    best = min(points, key=lambda each: abs(each.error(exact)))
    text = f"not reached: {per_cent(best.error(exact), best.uncertainty(exact))} at v·dt = {best.dt:g}"
    return text + (f"; then, {ended[0]}" if ended else "")


def per_cent(error: float, uncertainty: float) -> str:
    """An error with its standard error in brackets, such as +0.80(42)%."""
    return f"{'+' if error >= 0 else ''}{with_error(100 * error, 100 * uncertainty)}%"


def accuracy_table(record: dict[str, Any]) -> str:
    """The table of costs at given errors."""
    exact, limits, rows = exact_of(record), sorted(LIMITS), []
    for name, found in record["peers"].items():
        peer, texts = PEERS[name], []
        if not peer.accuracy:
            continue
        for limit in limits:
            had = answer(record, name, limit)
            if not peer.steps:
                texts += exact_texts(record, exact)
            elif had:
                each, cost = had
                error = per_cent(each.error(exact), each.uncertainty(exact))
                texts += [number(cost / 1e3), f"{each.dt:g}{peer.effort(each.knob)}", error, f"{each.drift:+.1e}"]
            else:
                texts += [why_not(record, name, limit), "", "", ""]
        rows.append((peer.title, *([found["missing"], *[""] * (len(texts) - 1)] if found["missing"] else texts)))
    heads = (head for limit in limits for head in (f"µs at {limit:.0%}", "v·dt", "error", "drift"))
    return table(("engine", *heads), rows)


def exact_texts(record: dict[str, Any], exact: Point) -> list[str]:
    """Of the exact solver, which has one cost, no step and no error but that of the sample."""
    cost = cost_of(record, EXACT, Point(1.0, 0))
    error = f"exact, {with_error(0.0, 100 * exact.scatter / exact.pressure)}%"
    return [number(cost / 1e3) if isinstance(cost, float) else "-", "none", error, f"{exact.drift:+.1e}"]


def exact_of(record: dict[str, Any]) -> Point:
    """What the exact solver has found."""
    return Point(**record["accuracy"]["exact"])


def points_of(series: dict[str, Any]) -> list[Point]:
    """Points of a series of the record."""
    return [Point(**point) for point in series["points"]]


def next_best(record: dict[str, Any]) -> tuple[str, float] | None:
    """The cheapest engine but mpsim and the yardsticks at the least limit, and its cost over mpsim's."""
    if "accuracy" not in record:
        return None
    limit = min(LIMITS)
    own = [had[1] for name in CONTACTS if (had := answer(record, name, limit))]
    others = {
        name: had[1]
        for name in record["peers"]
        if not name.startswith("mpsim") and name not in YARDSTICKS and (had := answer(record, name, limit))
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
    timing = timing_of(cell_of_claim(record), f"{record['yardstick']}/1")
    low, middle, high = quartiles(timing["frame"]) if timing else (1.0, 1.0, 1.0)
    return (high - low) / middle > LARGEST_SPREAD


def about(ratio: float) -> str:
    """A ratio to the two digits that hold from day to day.

    >>> about(130.5), about(7.26)
    ('about 130', 'about 7.3')
    """
    return f"about {float(f'{ratio:.2g}'):g}"


def claim(record: dict[str, Any]) -> str:
    """What the README says of speed: medians of this study. Empty if it was disturbed, or has not measured them."""
    cell = cell_of_claim(record)
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
