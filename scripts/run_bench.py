"""The main job: the experiments of the term-project report with mpsim; tables and pictures under results/bench/.

python scripts/run_bench.py            everything, under a minute on two cores
python scripts/run_bench.py --quick    a few seconds
python scripts/run_bench.py --only fixed scaling
python scripts/run_bench.py --features                   what each feature of a scene costs

Every experiment checks its results in the same run. If one is wrong, it fails instead of reporting times. Frame times
are taken inside the compiled loop, after compilation and a warm-up run.
"""

import argparse
import json
import sys
import time
import warnings
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import harness
import matplotlib
import numpy as np
from harness import by_turns, console, exit_code, is_busy, machine, make_folder, parser_of, say, slowed
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from numpy.typing import NDArray

import mpsim
from mpsim import FixedDisc, Piston, Polyline, Scene, Settings, Simulation, State, ThermalWalls, Thermostat
from mpsim.measure import kinetic_energy
from mpsim.output.drawing import COARSE, DISC_COLOUR, FINE, STYLE, draw_discs, new_figure, plain_ticks, save_figure

PARTS = ("fixed", "growth", "repeat", "scaling")
SIZES = (100, 300, 1_000, 3_000, 10_000, 30_000, 100_000, 300_000, 1_000_000)
QUICK_SIZES = (100, 1_000, 10_000)

METHODS = ("naive", "grid", "parallel")

REPORT_MS = {
    "fixed": {"naive": 1.651, "grid": 0.133, "parallel": 3.898},
    "growth": {"naive": 32.82, "grid": 1.204, "parallel": 4.469},
}
"""Mean frame times of the term-project report [ms]: 100 discs, 500 frames, and one disc more after each of 1,000
frames. Its parallel version used threads."""

NAIVE_UP_TO = 3_000
"""Number of discs up to which a default run tests all pairs: the time of a frame grows with the square."""

DT = 0.01
PACKING = 0.4
RADIUS = 0.5


@dataclass
class Timing:
    """Frame times of one method on one scene; frame_seconds: of every measured frame [s]."""

    method: str
    workers: int
    discs: int
    frame_seconds: NDArray[np.float64]
    digest: str
    bytes_per_disc: float = 0.0

    @property
    def median(self) -> float:
        """Median frame time [s]."""
        return float(np.median(self.frame_seconds))

    @property
    def mean(self) -> float:
        """Mean frame time [s], the figure of the report."""
        return float(np.mean(self.frame_seconds))

    @property
    def nanoseconds_per_disc(self) -> float:
        """Median frame time per disc [ns]."""
        return self.median * 1e9 / max(self.discs, 1)

    def figures(self) -> dict[str, Any]:
        """All numbers but the times of single frames."""
        return {
            "method": self.method,
            "workers": self.workers,
            "discs": self.discs,
            "frames": len(self.frame_seconds),
            "median_seconds": self.median,
            "mean_seconds": self.mean,
            "least_seconds": float(np.min(self.frame_seconds)),
            "ns_per_disc": self.nanoseconds_per_disc,
            "bytes_per_disc": self.bytes_per_disc,
            "digest": self.digest,
        }


@dataclass
class Fixed:
    """Fixed number of discs: timings and final states by method, and the distances between these."""

    scene: Scene
    timings: dict[str, Timing]
    states: dict[str, State]
    distances: dict[str, float]


@dataclass
class Repeat:
    """Runs of one start: final states and digests of guarded and unguarded runs, digests by number of workers."""

    scene: Scene
    guarded: list[State]
    unguarded: list[State]
    by_workers: dict[int, str]


def gas(count: int, seed: int = 1) -> Scene:
    """The scene of all experiments: a gas of packing fraction 0.4."""
    return Scene.random(count=count, packing=PACKING, radius=RADIUS, temperature=1.0, seed=seed)


def fixed(settings: Settings, frames: int, count: int = 100) -> Fixed:
    """100 discs, 500 frames, each method from a copy of the same start."""
    scene = gas(count)
    timings, states, early = {}, {}, {}
    for method in METHODS:
        chosen = replace(settings, method=method)
        with Simulation(scene, chosen) as sim:
            sim.run(frames=50)
            early[method] = sim.state.position
        with Simulation(scene, chosen) as sim:
            report = sim.run(frames=frames)
            states[method] = sim.state
            _check_state(sim, scene, settings)
            timings[method] = Timing(method, report.workers, count, report.frame_seconds, sim.digest())
    _demand_equal("grid and parallel", [timings["grid"].digest, timings["parallel"].digest])
    late = {method: state.position for method, state in states.items()}
    apart = {
        "naive to grid after 50 frames, largest": _largest_distance(early["naive"], early["grid"]),
        f"naive to grid after {frames} frames, largest": _largest_distance(late["naive"], late["grid"]),
        f"grid to parallel after {frames} frames, largest": _largest_distance(late["grid"], late["parallel"]),
    }
    return Fixed(scene, timings, states, apart)


def growth(settings: Settings, frames: int) -> dict[str, Timing]:
    """Timings by method while one disc is added after every frame, in a box of packing 0.4 at the end."""
    full = gas(frames + 1)
    timings = {}
    for method in METHODS:
        box = {"width": full.width, "height": full.height, "radius": full.radius}
        start = Scene(position=full.position[:1], velocity=full.velocity[:1], **box)
        with Simulation(start, replace(settings, method=method)) as sim:
            reports = []
            for disc in range(1, frames + 1):
                reports.append(sim.run(frames=1))
                sim.add(full.position[disc], full.velocity[disc])
            if sim.count != frames + 1:
                raise AssertionError(f"growth by {method} ended with {sim.count} discs, not {frames + 1}.")
            seconds = np.concatenate([report.frame_seconds for report in reports])
            timings[method] = Timing(method, reports[-1].workers, frames, seconds, sim.digest())
    _demand_equal("grid and parallel of growth", [timings["grid"].digest, timings["parallel"].digest])
    return timings


def repeat(settings: Settings, frames: int, count: int = 1000, runs: int = 4) -> Repeat:
    """Parallel runs of one start: equal for 1, 2 and 4 workers if columns are guarded, different if not."""
    scene = gas(count)
    chosen = replace(settings, method="parallel", workers=max(settings.workers or 2, 2))

    def final(settings: Settings, unguarded: bool = False) -> State:
        with Simulation(scene, settings, unguarded=unguarded) as sim:
            sim.run(frames=frames)
            return sim.state

    guarded = [final(chosen) for _ in range(runs)]
    by_workers = {workers: final(replace(chosen, workers=workers)).digest() for workers in (1, 2, 4)}
    unguarded = [final(chosen, unguarded=True) for _ in range(runs)]
    _demand_equal("repeated runs", [state.digest() for state in guarded] + list(by_workers.values()))
    return Repeat(scene, guarded, unguarded, by_workers)


def scaling(settings: Settings, sizes: Sequence[int], seconds: float) -> list[Timing]:
    """Timings of each method that is feasible at a size, and of `auto`: packing 0.4, about `seconds` of frames each."""
    timings = []
    for count in sizes:
        scene = gas(count)
        digests = {}
        for method in (*METHODS, "auto"):
            if method == "naive" and count > NAIVE_UP_TO:
                continue
            with Simulation(scene, replace(settings, method=method)) as sim:
                sim.run(frames=3)
                frame_time = float(np.median(sim.run(frames=5).frame_seconds))
                warm_up = min(max(int(0.1 * seconds / frame_time), 2), 2000)
                sim.run(frames=warm_up)
                report = sim.run(frames=min(max(int(seconds / frame_time), 5), 20_000))
                memory = report.block_bytes / count
                timings.append(Timing(method, report.workers, count, report.frame_seconds, sim.digest(), memory))
                _check_state(sim, scene, settings)
            with Simulation(scene, replace(settings, method=method)) as sim:
                sim.run(frames=10)
                digests[method] = sim.digest()
        _demand_equal(f"grid and parallel of {count} discs", [digests["grid"], digests["parallel"]])
    return timings


def crossover(timings: Sequence[Timing]) -> int | None:
    """Smallest measured number of discs from which parallel stays faster than grid, or None."""
    by = {(timing.method, timing.discs): timing.median for timing in timings}
    answer = None
    for discs in sorted({timing.discs for timing in timings}, reverse=True):
        if by[("parallel", discs)] >= by[("grid", discs)]:
            break
        answer = discs
    return answer


def _check_state(sim: Simulation, scene: Scene, settings: Settings) -> None:
    """Demand that all discs are finite and in the box, and that the energy is conserved, as by both laws."""
    state = sim.state
    low, high = scene.limits(scene.radius)
    rounding = np.finfo(settings.precision).eps * max(scene.width, scene.height)
    inside = (state.position >= low - rounding) & (state.position <= high + rounding)
    if not inside.all():
        raise AssertionError(f"{int((~inside).any(axis=1).sum())} discs are outside the box.")
    before, after = (kinetic_energy(each, scene) for each in (State(scene.position, scene.velocity), state))
    if abs(after - before) > 1e-3 * before:
        raise AssertionError(f"the kinetic energy changed from {before:.6g} to {after:.6g}.")


def _largest_distance(a: NDArray, b: NDArray) -> float:
    return float(np.hypot(*(a - b).T).max(initial=0.0))


def _demand_equal(what: str, digests: Sequence[str]) -> None:
    if len(set(digests)) != 1:
        raise AssertionError(f"{what} must have equal digests; got {', '.join(digests)}.")


# --- pictures

METHOD_COLOURS = {"naive": "#0072B2", "grid": "#D55E00", "parallel": "#009E73", "auto": "#CC79A7"}
ODD_ONE_OUT = "#D55E00"

WIDTH = 25
"""Frames of a running median."""

SPIKE = 2.0
"""Times the median, from which a frame is a dot of its own."""

WHOLE = "{x:,.0f}"
"""Numbers of discs on an axis."""


def draw_fixed(timings: Mapping[str, Timing], path: Path) -> None:
    """Distribution of frame times, a row for each method; the report's means are printed beside them."""
    times = {method: timing.frame_seconds[1:] * 1e6 for method, timing in timings.items()}
    low = min(float(each.min()) for each in times.values()) * 0.95
    high = max(float(np.quantile(each, 0.98)) for each in times.values()) * 1.15
    edges = np.geomspace(low, high, 80)
    with matplotlib.rc_context(fname=STYLE):
        figure = new_figure(8, 1.3 + 1.25 * len(times))
        panels = np.ravel(figure.subplots(len(times), 1, sharex=True))
        for axes, (method, found) in zip(panels, times.items(), strict=True):
            colour, median, mean = METHOD_COLOURS[method], float(np.median(found)), float(found.mean())
            axes.hist(found, edges, color=colour, alpha=0.55)
            axes.axvline(median, color=colour, linewidth=2)
            axes.axvline(mean, color=colour, linewidth=1.2, linestyle="--")
            beyond, words = found[found > high], f"{method}: median {_time(median)}, mean {_time(mean)}"
            if len(beyond):
                words += f"; {len(beyond)} frame{'s' * (len(beyond) != 1)} slower, up to {_time(beyond.max())}"
            report = REPORT_MS["fixed"][method] * 1e3
            words += f"\nreport's {_word(method)}: mean {_time(report)}, {report / mean:,.0f} times as long"
            axes.set_title(words, loc="left", fontsize=9, color=colour)
            axes.set_ylabel("frames", fontsize=9)
            axes.grid(False, axis="y")
        panels[-1].set(xscale="log", xlim=(low, high))
        plain_ticks(panels[-1].xaxis, FINE if high < 10 * low else COARSE)
        number = len(next(iter(times.values())))
        words = f"frames 2 to {number + 1} (the first one has to sort the discs, and is left out)"
        panels[-1].set_xlabel(f"time of a frame of 100 discs [µs]; {words}")
        handles = [Line2D([], [], color="black", linewidth=2), Line2D([], [], color="black", ls="--", linewidth=1.2)]
        figure.legend(handles, ["median", "mean"], loc="outside upper right", ncols=2, fontsize=9)
        save_figure(figure, path)


def draw_growth(timings: Mapping[str, Timing], path: Path) -> None:
    """Frame time against the number of discs: running median and middle 80 %; frames far outside are dots."""
    with matplotlib.rc_context(fname=STYLE):
        figure = new_figure(8, 5.2)
        axes = figure.add_subplot()
        for method, timing in timings.items():
            colour, times = METHOD_COLOURS[method], timing.frame_seconds[1:] * 1e6
            discs = np.arange(2, len(times) + 2)
            low, median, high = (_running(times, each) for each in (0.1, 0.5, 0.9))
            spikes = times > SPIKE * median
            axes.fill_between(discs, low, high, color=colour, alpha=0.3, linewidth=0)
            axes.plot(discs[spikes], times[spikes], color=colour, linestyle="", marker=".", markersize=3, alpha=0.6)
            report = _time(REPORT_MS["growth"][method] * 1e3)
            label = f"{method}: mean {_time(times.mean())} (report's {_word(method)}: {report})"
            axes.plot(discs, median, color=colour, label=label)
        most = max(len(timing.frame_seconds) for timing in timings.values())
        axes.set(
            yscale="log",
            xlim=(0, most),
            xlabel="discs",
            ylabel="time of a frame [µs]",
            title=f"Growth from 1 disc to {most:,}: one more after every frame",
        )
        plain_ticks(axes.yaxis)
        axes.xaxis.set_major_formatter(WHOLE)
        axes.legend(loc="upper left", fontsize=9, frameon=True)  # dots of slow frames lie behind it
        caption = f"line: running median of {WIDTH} frames; band: the middle 80 % of them\n"
        caption += f"dots: frames that took more than {SPIKE:g} times the median; the first frame is left out"
        figure.supxlabel(caption, fontsize=9)
        save_figure(figure, path)


def draw_repeat(result: Repeat, frames: int, path: Path) -> None:
    """Final states of repeated parallel runs, guarded above, unguarded below; differences from run 1 are marked."""
    with matplotlib.rc_context(fname=STYLE):
        figure = new_figure(11, 6.6)
        rows = {"odd/even passes": result.guarded, "columns unguarded": result.unguarded}
        axes = figure.subplots(len(rows), len(result.guarded))
        for row, (word, states) in zip(axes, rows.items(), strict=True):
            for run, (panel, state) in enumerate(zip(row, states, strict=True), start=1):
                differs = (state.position != states[0].position).any(axis=1)
                colours = [ODD_ONE_OUT if d else DISC_COLOUR for d in differs]
                draw_discs(panel, state.position, result.scene, colours)
                panel.set_title(f"run {run}: {state.digest()[:8]}", fontsize=10)
                panel.set_xlabel(f"{int(differs.sum())} discs differ from run 1", fontsize=9)
            row[0].set_ylabel(word)
        figure.suptitle(f"Four parallel runs of one start, after {frames} frames, with their digests")
        save_figure(figure, path)


def draw_final_states(result: Fixed, frames: int, path: Path) -> None:
    """The start and each method's final state side by side, coloured by disc so that a disc can be followed."""
    with matplotlib.rc_context(fname=STYLE):
        figure = new_figure(11, 3.7)
        panels = {"initial": result.scene.position} | {name: state.position for name, state in result.states.items()}
        hues = matplotlib.colormaps["viridis"](np.linspace(0, 1, max(result.scene.count, 1)))
        order = np.argsort(np.argsort(result.scene.position[:, 0]))
        grid = result.states["grid"].position
        for panel, (name, position) in zip(figure.subplots(1, len(panels)), panels.items(), strict=True):
            draw_discs(panel, position, result.scene, hues[order])
            panel.set_title(name)
            if name != "initial":
                gap = float(np.hypot(*(position - grid).T).max(initial=0)) / (2 * result.scene.largest_radius)
                panel.set_xlabel("reference" if name == "grid" else f"largest distance to grid:\n{gap:.3g} diameters")
        figure.suptitle(f"After {frames} frames (colour: place at the start, from left to right)")
        save_figure(figure, path)


def draw_scaling(timings: Sequence[Timing], path: Path) -> None:
    """Nanoseconds per disc and frame against the number of discs, and the speed-up of the workers."""
    with matplotlib.rc_context(fname=STYLE):
        figure = new_figure(8, 6.6)
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=[3, 2])
        rows: dict[str, dict[int, NDArray[np.float64]]] = {}
        for method, colour in METHOD_COLOURS.items():
            of = sorted((t for t in timings if t.method == method), key=lambda t: t.discs)
            if of:
                rows[method] = {t.discs: np.quantile(t.frame_seconds, [0.5, 0.25, 0.75]) * 1e9 / t.discs for t in of}
                label = f"{method}, {max(t.workers for t in of)} workers" if method == "parallel" else method
                marks = {"marker": "x", "linestyle": ":"} if method == "auto" else {"marker": "o"}
                _bars(above, rows[method], color=colour, label=label, **marks)
        above.set(
            xscale="log",
            yscale="log",
            ylabel="ns per disc and frame",
            title="Cost of a frame at packing 0.4: median, and the middle half of the frames",
        )
        plain_ticks(above.yaxis)
        above.legend()
        grid, parallel = rows["grid"], rows["parallel"]
        common = sorted(grid.keys() & parallel.keys())
        speed_up = {discs: grid[discs] / parallel[discs][[0, 2, 1]] for discs in common}
        _bars(below, speed_up, color=METHOD_COLOURS["parallel"], marker="o")
        below.axhline(1, color="black", linewidth=1)
        below.set(ylabel="speed-up of the workers\n(grid / parallel)", xlabel="discs")
        below.set_ylim(0, max(2.2, 1.05 * max(float(ratio.max()) for ratio in speed_up.values())))
        below.xaxis.set_major_formatter(WHOLE)
        save_figure(figure, path)


def _bars(axes: Axes, rows: Mapping[int, NDArray[np.float64]], **style: Any) -> None:
    """Points with bars; rows: median, low and high by number of discs."""
    middle, low, high = np.array(list(rows.values())).T
    axes.errorbar(list(rows), middle, [middle - low, high - middle], capsize=2, **style)


def _running(values: NDArray[np.float64], part: float) -> NDArray[np.float64]:
    """A running quantile, as long as the values."""
    padded = np.pad(values, (WIDTH // 2, WIDTH - 1 - WIDTH // 2), mode="edge")
    return np.quantile(np.lib.stride_tricks.sliding_window_view(padded, WIDTH), part, axis=1)


def _word(method: str) -> str:
    """The report's name of a method."""
    return "threads" if method == "parallel" else method


def _time(microseconds: float) -> str:
    return f"{microseconds / 1e3:.3g} ms" if microseconds >= 1e3 else f"{microseconds:.3g} µs"


# --- features

SIDE, PITCH = 100, 1.4
"""Discs along each side of the square lattice from which the scenes start, and its spacing [diameters]: packing 0.4."""

WARM_UP, FRAMES, ROUNDS = 100, 150, 5
"""Frames in which the lattice melts; frames of a turn; turns, of which the least median counts."""

SPREADS = (1, 2, 4, 8, 16)
"""Ratios of the largest radius to the smallest: cells follow the largest disc, so that they hold many small ones."""

OBSERVED = "collisions observed"
"""The bare scene, with all its collisions handed over after each turn, outside the time of frames."""


def lattice(giant: bool = False, **features: Any) -> Scene:
    """10,000 discs of radius 0.5 with thermal velocities and the given features; giant: also one disc of radius 10."""
    rng, side = np.random.default_rng(1), SIDE * PITCH
    places = (np.arange(SIDE) + 0.5) * PITCH
    position = np.stack(np.meshgrid(places, places, indexing="ij"), axis=-1).reshape(-1, 2)
    velocity = rng.normal(size=position.shape)
    if giant:
        clear = np.hypot(*(position - side / 2).T) > 10.6
        position = np.concatenate([position[clear], [[side / 2, side / 2]]])
        velocity = np.concatenate([velocity[clear], [[0.0, 0.0]]])
        features["radius"] = np.append(np.full(int(clear.sum()), 0.5), 10.0)
    return Scene(width=side, height=side, position=position, velocity=velocity, **{"radius": 0.5, **features})


def featured() -> dict[str, Scene]:
    """The bare scene, each feature alone, and all that can be combined."""
    rng, side, pegs = np.random.default_rng(2), SIDE * PITCH, np.arange(1, 100, 10) * PITCH
    combined: dict[str, dict[str, Any]] = {
        "radii": {"radius": rng.uniform(0.3, 0.5, SIDE**2)},
        "masses": {"mass": rng.uniform(0.5, 2.0, SIDE**2)},
        "gravity": {"gravity": (0.0, -0.1)},
        "acceleration per disc": {"acceleration": rng.normal(size=(SIDE**2, 2)) * 0.1},
        "restitution": {"restitution": 0.95},
        "100 pegs": {"obstacles": [FixedDisc((x, y), 0.1) for x in pegs for y in pegs]},
        "a piston": {"piston": Piston("bottom", 0.01, side / 2)},
        "an absorbing edge": {"absorbing": "top"},
        "friction": {"friction": 0.5},
        "a thermostat": {"thermostat": Thermostat(1.0, 1.0)},
    }
    alone = {
        "bare": {},
        "periodic": {"boundary": "periodic"},
        **combined,
        "a polyline": {"obstacles": [Polyline([(0, side / 2), (side / 3, side / 2)])]},
        "thermal walls": {"thermal_walls": ThermalWalls(left=1.0, right=1.0, bottom=1.0, top=1.0)},
    }
    together = {key: value for features in combined.values() for key, value in features.items()}
    found = {name: lattice(**features) for name, features in alone.items()}
    found |= {"one giant": lattice(giant=True), "all together": lattice(boundary=("periodic", "walls"), **together)}
    for spread in SPREADS:
        radius = 0.5 * np.exp(-np.random.default_rng(3).random(SIDE**2) * np.log(spread))
        found[f"radii 1 to {spread}, packing 0.5"] = Scene.random(count=SIDE**2, packing=0.5, radius=radius, seed=3)
    return found | {OBSERVED: lattice()}


def feature_costs() -> str:
    """A table in Markdown: every scene by `grid` in float64, timed in turns."""
    sims: dict[str, Simulation] = {}
    observers = {OBSERVED: mpsim.Collisions(callback=lambda _, table: None, every=FRAMES)}

    def cost(name: str) -> float:
        report = sims[name].run(frames=FRAMES, observe=observers.get(name))
        return float(np.median(report.frame_seconds)) / sims[name].count * 1e9

    with ExitStack() as stack, console.status("compiling") as status:
        for name, scene in featured().items():
            status.update(f"compiling {name}")
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", mpsim.FastWarning)  # of very small discs: only times are wanted
                sims[name] = stack.enter_context(Simulation(scene, Settings(dt=DT, method="grid")))
                sims[name].run(frames=WARM_UP, observe=observers.get(name))
        status.update("timing")
        turns = by_turns({name: partial(cost, name) for name in sims}, ROUNDS)
        bare, rows = min(turns["bare"]), []
        for name, sim in sims.items():
            size = sim.run(frames=0, observe=observers.get(name)).block_bytes / sim.count
            rows.append((name, f"{min(turns[name]):.2f}", f"{min(turns[name]) / bare:.2f}", f"{size:.0f}"))
    return harness.table(("scene", "ns per disc and frame", "over bare", "bytes per disc"), rows)


# --- tables


def run(options: argparse.Namespace, settings: Settings) -> dict[str, Any]:
    """The results of each part that was asked for."""
    sizes = QUICK_SIZES if options.quick else SIZES
    frames, growth_frames = (100, 200) if options.quick else (500, 1000)
    results: dict[str, Any] = {"frames": frames}
    with console.status("compiling") as status:
        jobs = {
            "fixed": lambda: fixed(settings, frames),
            "growth": lambda: growth(settings, growth_frames),
            "repeat": lambda: repeat(settings, frames),
            "scaling": lambda: scaling(settings, sizes, 0.1 if options.quick else 0.4),
        }
        for part in options.only:
            status.update(part)
            results[part] = jobs[part]()
    return results


def compare(part: str, title: str, timings: Mapping[str, Timing], busy: bool) -> None:
    """Print times beside the report's; ratios only if the machine was not busy."""
    rows = []
    for method, timing in timings.items():
        median, mean, report = timing.median * 1e6, timing.mean * 1e6, REPORT_MS[part][method] * 1e3
        ratios = ["-", "-"] if busy else [f"{report / mean:.4g}", f"{timing.mean / timings['grid'].mean:.4g}"]
        rows.append([method, str(timing.workers), *(f"{cell:.4g}" for cell in (median, mean, report)), *ratios])
    caption = "times of a frame in microseconds; the first frame is in the means, compilation and warm-up are not"
    heads = ("method", "workers", "median", "mean", "report's mean", "report / mpsim", "mean / grid's")
    say(f"{title}: {caption}\n\n{harness.table(heads, rows)}\n")


def compare_sizes(timings: Sequence[Timing], busy: bool) -> None:
    """Print costs by number of discs."""
    methods, rows = (*METHODS, "auto"), []
    for discs in sorted({timing.discs for timing in timings}):
        of = {timing.method: timing for timing in timings if timing.discs == discs}
        costs = [f"{of[m].nanoseconds_per_disc:.3g}" if m in of else "-" for m in methods]
        best = min(of[m].median for m in METHODS if m in of)
        ratios = of["grid"].median / of["parallel"].median, of["auto"].median / best
        texts = ("-" if busy else f"{ratio:.2f}" for ratio in ratios)
        rows.append([f"{discs:,}", *costs, *texts, f"{of['parallel'].bytes_per_disc:.0f}"])
    caption = "median nanoseconds per disc and frame, packing 0.4, warm; bytes: of the shared block, per disc"
    heads = ("discs", *methods, "grid/parallel", "auto/best", "bytes")
    say(f"Scaling: {caption}\n\n{harness.table(heads, rows)}\n")


def show(results: dict[str, Any], settings: Settings, out: Path, busy: bool) -> dict[str, Any]:
    """Tables on the terminal, pictures in the folder; returns all numbers."""
    frames, record = results["frames"], {}
    if found := results.get("fixed"):
        compare("fixed", f"Fixed: 100 discs, {frames} frames", found.timings, busy)
        for what, distance in found.distances.items():
            console.print(f"  distance {what}: {distance / (2 * found.scene.radius):.3g} diameters")
        draw_fixed(found.timings, out / "fixed.png")
        draw_final_states(found, frames, out / "final_states.png")
        chosen = replace(settings, method="grid")
        mpsim.animate(found.scene, chosen, out / "animation.gif", frames // 6, every=5, pixels=320, progress=False)
        record["fixed"] = {method: each.figures() for method, each in found.timings.items()}
        record["distances"] = found.distances
    if found := results.get("growth"):
        discs = len(found["grid"].frame_seconds)
        compare("growth", f"Growth: one disc more after every frame, from 1 disc to {discs:,}", found, busy)
        draw_growth(found, out / "growth.png")
        record["growth"] = {method: each.figures() for method, each in found.items()}
    if found := results.get("repeat"):
        guarded, unguarded = ([state.digest() for state in states] for states in (found.guarded, found.unguarded))
        console.print(f"Repeat: {len(guarded)} runs with odd/even passes gave {len(set(guarded))} digest")
        console.print(f"  1, 2, 4 workers: {len(set(found.by_workers.values()))} digest, {found.by_workers[1]}")
        console.print(f"  {len(unguarded)} runs with the columns unguarded gave {len(set(unguarded))} digests")
        draw_repeat(found, frames, out / "repeat.png")
        record["repeat"] = {"guarded": guarded, "unguarded": unguarded, "by_workers": found.by_workers}
    if found := results.get("scaling"):
        from_here = crossover(found)
        compare_sizes(found, busy)
        if not busy:
            words = f"parallel is faster than grid from {from_here:,} discs on" if from_here else "no crossover"
            console.print(f"  {words}")
        draw_scaling(found, out / "scaling.png")
        record["scaling"] = [each.figures() for each in found]
    return record


def summary(results: dict[str, Any], now: dict[str, Any]) -> str:
    """The README's table, in Markdown: the report's two experiments and the cost at 100,000 discs."""
    rows = []
    experiments = {
        "fixed": ("100 discs, 500 frames", results["fixed"].timings),
        "growth": ("1 to 1,000 discs, one more after every frame", results["growth"]),
    }
    for part, (words, timings) in experiments.items():
        for method, timing in timings.items():
            report, mean = REPORT_MS[part][method] * 1e3, timing.mean * 1e6
            name = f"parallel, {timing.workers} workers (report: threads)" if method == "parallel" else method
            rows.append((words, name, f"{report:,.0f} µs", f"{mean:.1f} µs", f"{report / mean:,.0f}"))
    for timing in results["scaling"]:
        if timing.discs == 100_000 and timing.method in ("grid", "parallel"):
            name = f"parallel, {timing.workers} workers" if timing.method == "parallel" else timing.method
            scene, cost = "100,000 discs, packing 0.4, steps of 0.01 diameters", timing.nanoseconds_per_disc
            rows.append((scene, name, "-", f"{cost:.1f} ns a disc", "-"))
    heads, versions = ("experiment", "method", "report", "mpsim", "times faster"), now["versions"]
    return (
        f"{harness.table(heads, rows, right=3)}\n\nMean frame times (100,000 discs: median), without compilation, "
        f"on {now['usable_cores']} cores of {now['processor']}, Python {now['python']}, numpy {versions['numpy']}, "
        f"numba {versions['numba']}, {now['date'][:10]}, commit {now['commit']}.\n"
    )


def main() -> int:
    parser = parser_of(__doc__)
    parser.add_argument("--only", nargs="+", choices=PARTS, default=PARTS, metavar="PART", help=", ".join(PARTS))
    parser.add_argument("--quick", action="store_true", help="fewer frames and sizes: a few seconds")
    parser.add_argument("--features", action="store_true", help="the cost of each feature of a scene instead")
    parser.add_argument("--out", type=Path, default=Path("results/bench"), help="default: results/bench")
    options = parser.parse_args()
    started = time.perf_counter()
    settings = Settings(dt=DT, contact="push", precision="float32")  # the report's contact and precision
    make_folder(options.out)
    now = machine()
    if options.features:
        words = f"10,000 discs, packing 0.40, `grid`, float64, impact. {harness.made_by(now)}"
        text = f"{feature_costs()}\n\n{words}\n"
        (options.out / "features.md").write_text(text)
        say(text)
        return 0
    expected = "10 s" if options.quick else "a minute"
    console.print(f"At most {expected} on two idle cores; where kernels must be compiled first, half a minute more.")
    results = run(options, settings)
    now["slowed"].append(slowed())
    console.print("Collision law: elastic (the report has reflect); contact: push")
    if busy := is_busy(now):
        console.print(
            f"The machine was busy; no verdict. Load before: {now['load_before']:.2g} on {now['usable_cores']} cores; "
            f"a loop took {max(now['slowed']):.2g} times its shortest time. Times below hold for now only, and their "
            "ratios are left out. Repeat when nothing else runs."
        )
    record = {"machine": now, "settings": vars(settings), **show(results, settings, options.out, busy)}
    (options.out / "bench.json").write_text(json.dumps(record, indent=1, default=str) + "\n")
    if {"fixed", "growth", "scaling"} <= results.keys() and not (options.quick or busy):
        (options.out / "summary.md").write_text(summary(results, now))
    console.print(f"{time.perf_counter() - started:.1f} s; tables and pictures are in {options.out}/")
    return 0


if __name__ == "__main__":
    sys.exit(exit_code(main))
