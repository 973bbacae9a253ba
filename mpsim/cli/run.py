"""`mpsim run` and `mpsim resume`, and the folder in which a run is kept."""

import contextlib
import dataclasses
import json
import os
import time
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click

from mpsim import __version__
from mpsim.cli import terminal
from mpsim.core import files
from mpsim.core.checks import Closable, refusal
from mpsim.core.deferred_signals import interrupts_held_back
from mpsim.core.files import FileLock
from mpsim.core.text import json_text
from mpsim.engine import checkpoint
from mpsim.engine.report import Report
from mpsim.engine.run import frames_skipped
from mpsim.engine.simulation import Simulation
from mpsim.engine.solvers.base import Terms, frames_until
from mpsim.errors import InputError, MpsimError, OutputError, reason_of
from mpsim.measure.registry import NAMES
from mpsim.output.frames import frame_of
from mpsim.output.tables import measure_text
from mpsim.output.trajectory import FORMATS, Trajectory
from mpsim.scene import scenefile
from mpsim.scene.scene import Scene, frames_between_pictures
from mpsim.scene.settings import MethodName, Settings
from mpsim.studies.findings import PROMISES, Promise, found_by

# --- The folder of a run
#
# run.json            scene, settings, versions, and what each part of the run did, averages with errors included
# checkpoint.mpsim    from which `mpsim resume` continues
# trajectory.xyz      (or .gsd) frames, for OVITO and mpsim.Trajectory
# measures.csv        energy, overlap and collision rate along the run
# timings.csv         time of each frame, phase and worker, of the first part; timings-2.csv of the second ...
# final.npz, .png     the last state

FORMAT = 1
RECORD = "run.json"
KINDS = {
    "scene": str, "settings": dict, "target": int, "every": int, "trajectory": str, "measures": list, "status": str,
    "parts": list,
}  # fmt: skip
"""What a record holds at least, and its kind."""

MOST_BYTES = 2**23  # bytes of a record at most, to which each part of a run adds some hundred

CHECKPOINT = "checkpoint.mpsim"
MEASURES = "measures.csv"
TIMINGS = "timings.csv"
STATE = "final.npz"
PICTURE = "final.png"

_OURS = (
    RECORD, CHECKPOINT, f"{CHECKPOINT}.previous", MEASURES, TIMINGS, "timings-[0-9]*.csv", STATE, PICTURE,
    "plot.png",
)  # fmt: skip
"""Files of a run, which --force removes, beside its trajectory; any other stays."""


class RunFolder(Closable):
    """A folder that holds one run. `create` makes one, `claim` locks one to continue it, `open` reads one.

    What `create` and `claim` return is locked: use it in a `with` block, after which another process may write to it.

    Attributes:
        path: of the folder.
        record: what run.json holds, plain values.
    """

    def __init__(self, path: Path, record: dict[str, Any], lock: FileLock | None = None):
        self.path = path
        self.record = record
        self._lock = lock

    def close(self) -> None:
        if self._lock is not None:
            self._lock.release()

    @classmethod
    def create(cls, path: str | os.PathLike[str], record: dict[str, Any], *, force: bool = False) -> "RunFolder":
        """A new folder, or, with `force`, that of another run, whose files are removed; never of anything else."""
        folder = Path(path)
        with _writing(folder):
            if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
                _demand_leave(folder, force)
            folder.mkdir(parents=True, exist_ok=True)
            lock = _lock_of(folder)
            for pattern in (*_OURS, *(f"trajectory.{name}" for name in FORMATS)):
                for old in folder.glob(pattern):
                    old.unlink()
        versions = {"mpsim": __version__, **checkpoint.VERSIONS}
        made = cls(folder, {"format": FORMAT, "versions": versions, **record, "parts": []}, lock)
        made.save()
        return made

    @classmethod
    def claim(cls, path: str | os.PathLike[str]) -> "RunFolder":
        """The folder of a run, to continue it; an OutputError if another process writes to it."""
        lock = _lock_of(cls.open(path).path)
        return cls(Path(path), cls.open(path).record, lock)  # again: the last owner may have written to it

    @classmethod
    def open(cls, path: str | os.PathLike[str]) -> "RunFolder":
        """The folder of a run; an InputError if it is not one, or of another version."""
        folder = Path(path)
        try:
            record = json.loads(files.text(folder / RECORD, MOST_BYTES))
            found = int(record["format"])
        except (OSError, ValueError, OverflowError, TypeError, KeyError, RecursionError) as error:
            raise InputError(
                f"the folder of a run must hold {RECORD}; {str(folder)!r} does not "
                f"({reason_of(error):.200}). Give a folder that `mpsim run --out` has made."
            ) from None
        if found != FORMAT:
            newer, older = "of a newer version. Use a newer mpsim.", "from a development version. Run the scene again."
            raise InputError(
                f"{str(folder)!r} must hold a run of format {FORMAT}, which this mpsim reads; it is of format {found}, "
                f"{newer if found > FORMAT else older}"
            )
        if missing := sorted(name for name, kind in KINDS.items() if not isinstance(record.get(name), kind)):
            raise InputError(f"{RECORD} must hold {', '.join(missing)}; that in {str(folder)!r} does not.")
        return cls(folder, record)

    def __getitem__(self, name: str) -> Path:
        return self.path / name

    @property
    def trajectory(self) -> Path:
        """The file of the trajectory."""
        return self.path / Path(self.record["trajectory"]).name  # in this folder, whatever the record says

    @property
    def scene(self) -> Scene:
        """The scene, from the checkpoint; a CheckpointError if there is no complete one."""
        return checkpoint.read(self[CHECKPOINT]).snapshot.start[0]

    @property
    def timings(self) -> str:
        """Name of the table of times of the last part."""
        number = len(self.record["parts"])
        return TIMINGS if number == 1 else f"timings-{number}.csv"

    def save(self) -> None:
        """Write run.json: completely, or not at all."""
        self._write(RECORD, json.dumps(self.record, indent=1) + "\n")

    def note(self, sim: Simulation, status: str) -> None:
        """Record the state of the run."""
        self.record |= {"status": status, "frame": sim.frame, "time": sim.time, "discs": sim.count}
        self.record["digest"] = sim.digest()
        self.save()

    def finish(self, sim: Simulation, report: Report, part: dict[str, Any]) -> None:
        """Record a part of the run, its times, and the last state."""
        self.record["parts"].append(part)
        self._write(self.timings, report.to_csv(first_frame=sim.frame - report.frames + 1))
        sim.state.save(self[STATE])
        self.note(sim, "done" if sim.frame >= self.record["target"] else "paused")

    def _write(self, name: str, text: str) -> None:
        with _writing(self.path):
            files.write_text(self[name], text)


def _demand_leave(folder: Path, force: bool) -> None:
    """Refuse a folder that is not that of a run, or whose replacement was not asked for."""
    if not folder.is_dir():
        raise InputError(f"--out must be a folder; {str(folder)!r} is a file. Give another name.")
    try:
        RunFolder.open(folder)
    except InputError:
        raise InputError(
            f"--out must be a new or empty folder, or that of a run; {str(folder)!r} holds other files, which are not "
            "overwritten. Give another name."
        ) from None
    if not force:
        raise InputError(
            f"--out already holds a run: {str(folder)!r} is not overwritten. Give another name, --force to replace "
            f"it, or continue it: mpsim resume {folder}"
        )


def _lock_of(folder: Path) -> FileLock:
    try:
        return FileLock(folder)
    except OutputError:
        rule, got = "be written by one command at a time", "a folder that another one is writing to"
        raise refusal(repr(str(folder)), rule, got, "Wait for its end, or give another folder.", OutputError) from None


def _writing(folder: Path) -> contextlib.AbstractContextManager[None]:
    rule = "be a folder that can be written to, with room on its disk"
    return files.writable("--out", folder, rule, "Choose another place, or make room.")


# --- `mpsim run` and `mpsim resume`: simulate a scene; a folder keeps the results and a checkpoint

FRAMES = 500  # number of frames of a run of a scene without a duration
FEWEST = 10  # frames of a trajectory, at least
CHECKPOINT_SECONDS = 30.0  # seconds between checkpoints: the time of a run that a kill may cost

RUN_EXAMPLES = """\b
Examples:
  mpsim run gas                                          with the recommended duration and measures
  mpsim run gas --until 50 --out run                     until time 50, with results in the folder run/
  mpsim run hopper --frames 2000 --every 20 --out run --format gsd
  mpsim run my_scene.toml --method parallel --workers 4 --measure pressure --json
"""


@click.command(epilog=RUN_EXAMPLES, short_help="Simulate a scene.")
@click.argument("scene", shell_complete=terminal.complete_scene)
@terminal.option("--frames", click.IntRange(1), f"Number of frames; default: the scene's duration, or {FRAMES}.")
@terminal.option("--until", terminal.POSITIVE, "Simulated time at which to stop.")
@terminal.settings_options
@terminal.option("--measure measures", click.Choice(NAMES), "What to measure; default: the scene's own.", multiple=True)
@terminal.option("--start", terminal.NOT_NEGATIVE, "Measure only from this simulated time on.")
@terminal.option("--out", terminal.PATH, "Folder for the results.")
@terminal.option("--every", click.IntRange(1), "Write every n-th frame to the trajectory; default: the scene's.")
@terminal.option("--format kind", click.Choice(FORMATS), "Format of the trajectory.", "xyz")
@click.option("--force", is_flag=True, help="Replace an existing run in the folder.")
@terminal.json_option
@terminal.quiet_option
def run(
    scene: str,
    frames: int | None,
    until: float | None,
    measures: tuple[str, ...],
    start: float | None,
    out: Path | None,
    every: int | None,
    kind: str,
    force: bool,
    as_json: bool,
    quiet: bool,
    **options: Any,
) -> None:
    """Simulate SCENE with its recommended duration, settings and measures. Options replace these.

    With --out, the results go to a folder: the trajectory for OVITO, tables of times and measures, the last state, a
    picture of it, and a checkpoint. After Ctrl-C, `mpsim resume` continues the run.
    """
    if frames is not None and until is not None:
        raise click.UsageError("Give --frames or --until, not both.")
    for option, given in (("--every", every), ("--force", force), ("--format", kind != FORMATS[0])):
        if given and out is None:
            raise click.UsageError(f"{option} needs --out, the folder to write to.")
    file = scenefile.load(scene)
    settings = terminal.settings_of(file, options)
    as_recommended = file.comes_with_mpsim and frames is None and until is None
    promise = PROMISES.get(file.name) if as_recommended else None
    watched = promise and promise(file.scene, settings)
    until, end = (file.scene.duration, "the scene's duration") if until is None else (until, "until")
    target = frames or (FRAMES if until is None else frames_until(until, settings.dt, end))
    measures = measures or file.scene.measures
    frames_skipped(start, measures, target, Terms(file.scene, settings), 0)  # refused before anything is made
    record = {
        "scene": file.name,
        "scene_digest": file.scene.digest(),
        "settings": dataclasses.asdict(settings),
        "target": target,
        "every": every or interval_of(file.scene, settings, target),
        "trajectory": f"trajectory.{kind}",
        "measures": list(measures),
        "start": start,
        "status": "starting",
    }
    with Simulation(file.scene, settings) as sim:
        if out is None:
            _without_folder(sim, record, as_json, quiet, watched)
            return
        with RunFolder.create(out, record, force=force) as folder:
            sim.save(folder[CHECKPOINT])  # so that the run can be continued, however early it ends
            folder.note(sim, "running")
            _advance(folder, sim, target, as_json, quiet, watched)


RESUME_EXAMPLES = """\b
Examples:
  mpsim resume run                                to the end that was asked for
  mpsim resume run --frames 1000                  1000 frames more
  mpsim resume run --until 200 --workers 8
"""

SAME_BITS = ("grid", "parallel")  # methods between which a run may change


@click.command(epilog=RESUME_EXAMPLES, short_help="Continue a run.")
@click.argument("folder", type=terminal.PATH)
@terminal.option("--frames", click.IntRange(1), "Number of further frames.")
@terminal.option("--until", terminal.POSITIVE, "Simulated time at which to stop.")
@terminal.option("--method", click.Choice(SAME_BITS), "Change to another method with the same bits.")
@terminal.option("--workers", terminal.SETTINGS["--workers"][0], "Number of processes; it does not change the result.")
@terminal.json_option
@terminal.quiet_option
def resume(
    folder: Path,
    frames: int | None,
    until: float | None,
    method: MethodName | None,
    workers: int | None,
    as_json: bool,
    quiet: bool,
) -> None:
    """Continue the run in FOLDER. The result has the same bits as a run that never stopped.

    Without --frames or --until, it continues to the end that was given to `mpsim run`.
    """
    if frames is not None and until is not None:
        raise click.UsageError("Give --frames or --until, not both.")
    with RunFolder.claim(folder) as found, Simulation.resume(found[CHECKPOINT], workers=workers, method=method) as sim:
        target = found.record["target"]
        if frames is not None:
            target = sim.frame + frames
        elif until is not None:
            target = frames_until(until, sim.settings.dt)
        if target <= sim.frame:
            asked = f"--until {until:g} is frame {target}" if until is not None else f"it was to go to frame {target}"
            raise click.UsageError(
                f"The run in {str(folder)!r} is at frame {sim.frame}, time {sim.time:g}; {asked}. Say how far it is "
                "to continue: --frames or --until."
            )
        found.record["target"] = max(target, found.record["target"])  # the end that was asked for stays
        found.record["settings"] = dataclasses.asdict(sim.settings)
        found.note(sim, "running")
        _advance(found, sim, target, as_json, quiet)


def _advance(
    folder: RunFolder, sim: Simulation, target: int, as_json: bool, quiet: bool, watched: Promise | None = None
) -> None:
    """Run to a frame, and record everything."""
    # With matplotlib, whose import would only delay the start of other commands.
    from mpsim.output.drawing import draw, save_figure  # noqa: PLC0415
    from mpsim.output.history import Recorder  # noqa: PLC0415

    every, measures, start = folder.record["every"], folder.record["measures"] or None, folder.record.get("start")
    if start is not None and frames_until(start, sim.settings.dt) >= target:  # this part of the run ends before
        measures = start = None
    with (
        Trajectory.write(folder.trajectory, every, mode="a") as trajectory,
        Recorder(folder[MEASURES], every, sim) as recorder,
        _left_resumable(folder, sim),
    ):
        observers = [trajectory, recorder, *(watched.observers if watched else [])]
        saved = {"checkpoint": folder[CHECKPOINT], "checkpoint_seconds": CHECKPOINT_SECONDS}
        report, part = _run(sim, target, quiet, measures=measures, start=start, observe=observers, **saved)
        folder.finish(sim, report, part)
    save_figure(draw(frame_of(sim), sim.scene), folder[PICTURE])
    if as_json:
        click.echo(json_text(folder.record))
        return
    _print_summary(part, report, sim, folder.record["scene"], watched)
    names = ", ".join((folder.record["trajectory"], MEASURES, folder.timings, STATE, PICTURE))
    frames = len(Trajectory(folder.trajectory))
    click.echo(f"written to {folder.path}/: {names}; {frames} frames in the trajectory")


def _run(sim: Simulation, target: int, quiet: bool, **how: Any) -> tuple[Report, dict[str, Any]]:
    """Run to a frame, with progress; returns the report, and what is recorded of it, as plain values."""
    compiled = sim.run(frames=0, measures=how["measures"]).compile_seconds  # before progress, whose rate it distorts
    started = time.perf_counter() - compiled
    report = sim.run(frames=target - sim.frame, **how, progress=not quiet)
    return report, {
        "from_frame": sim.frame - report.frames,
        "to_frame": sim.frame,
        "method": report.method,
        "workers": report.workers,
        "wall_seconds": time.perf_counter() - started,
        "compile_seconds": compiled + report.compile_seconds,
        "frame_seconds": float(report.frame_seconds.sum()),
        "writing_seconds": report.observing_seconds,
        "waiting": report.waiting,
        "collisions": report.collisions,
        "block_bytes": report.block_bytes,
        "measures": {name: dataclasses.asdict(measure) for name, measure in report.measures.items()},
    }


@contextlib.contextmanager
def _left_resumable(folder: RunFolder, sim: Simulation) -> Iterator[None]:
    """Ensure that a run that ends early can be continued, and say so."""
    try:
        yield
    except KeyboardInterrupt:
        with interrupts_held_back(), contextlib.suppress(MpsimError):  # else the last checkpoint counts
            sim.save(folder[CHECKPOINT])
            folder.note(sim, "interrupted")
        raise terminal.Interrupted(
            f"Interrupted at frame {sim.frame} of {folder.record['target']}. Continue with: mpsim resume {folder.path}"
        ) from None
    except BaseException as end:
        folder.record |= {"status": "ended early", "frame": sim.frame, "time": sim.time}
        with contextlib.suppress(MpsimError):
            folder.save()
        if isinstance(end, SystemExit):  # by SIGTERM, after a checkpoint
            click.echo(f"Ended by SIGTERM at frame {sim.frame}. Continue with: mpsim resume {folder.path}", err=True)
        raise


def _without_folder(
    sim: Simulation, record: dict[str, Any], as_json: bool, quiet: bool, watched: Promise | None
) -> None:
    """Run and print a summary, without writing files."""
    target, observe = record["target"], watched.observers if watched else None
    try:
        report, part = _run(
            sim, target, quiet, measures=record["measures"] or None, start=record["start"], observe=observe
        )
    except KeyboardInterrupt:
        raise terminal.Interrupted(
            f"Interrupted at frame {sim.frame} of {target}. Nothing is kept without --out FOLDER."
        ) from None
    if as_json:
        known = {name: record[name] for name in ("scene", "scene_digest", "settings")}
        shown = {} if watched is None else {"findings": found_by(record["scene"], watched, sim).record()}
        click.echo(json_text({**known, "digest": sim.digest(), **part, **shown}))
    else:
        _print_summary(part, report, sim, record["scene"], watched)


def interval_of(scene: Scene, settings: Settings, target: int) -> int:
    """Default number of frames between two of a trajectory: as recommended, if the run has FEWEST of these."""
    every = frames_between_pictures(scene, settings)
    if every is None or target < FEWEST * every:
        pictures = min(max(1_000_000 // max(scene.count, 1), FEWEST), 100)  # writing a million discs takes seconds
        return max(target // pictures, 1)
    return every


def _brief(seconds: float) -> str:
    """A time with one decimal, or with two digits if it is short [s].

    >>> _brief(117.73), _brief(1.19), _brief(0.0412), _brief(0.0003)
    ('117.7', '1.2', '0.041', '0.0003')
    """
    return f"{seconds:.1f}" if seconds >= 1 else f"{seconds:.2g}"


def _print_summary(part: dict[str, Any], report: Report, sim: Simulation, name: str, watched: Promise | None) -> None:
    """Print a summary of a run, and what a named scene has shown, beside what it promises."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        click.echo(dataclasses.replace(report, compile_seconds=0.0).summary)  # all compiling is in the next line
    names = {"compiling": "compile", "simulating": "frame", "writing": "writing"}
    spent = {word: part[f"{name}_seconds"] for word, name in names.items()}
    spent["other"] = max(part["wall_seconds"] - sum(spent.values()), 0.0)
    words = ", ".join(f"{name} {_brief(each)}" for name, each in spent.items() if each >= 1e-4)
    discs = f"{sim.count} disc{'s' * (sim.count != 1)}"
    click.echo(f"frame {sim.frame}, time {sim.time:g}, {discs}; {_brief(part['wall_seconds'])} s: {words}")
    if report.workers > 1:
        click.echo(f"{100 * report.waiting:.0f} % of the workers' time was waiting for each other")
    over = f", over frames {part['from_frame'] + 1} to {part['to_frame']}" if part["from_frame"] else ""
    for measured, measure in report.measures.items():
        click.echo(f"{measured}: {measure_text(measured, measure)}{over}")
    click.echo(f"digest {sim.digest()}")
    if watched is not None:
        click.echo(found_by(name, watched, sim))
