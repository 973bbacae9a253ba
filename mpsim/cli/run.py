"""`mpsim run` and `mpsim resume`, and the folder in which a run is kept."""

import contextlib
import csv
import dataclasses
import fcntl
import io
import json
import os
import platform
import time
import warnings
from collections.abc import Callable, Iterator
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import click

from mpsim.cli import terminal
from mpsim.cli.terminal import interrupts_agreed, one_voice
from mpsim.core import files
from mpsim.core.deferred_signals import interrupts_held_back
from mpsim.core.state import State
from mpsim.core.text import json_text
from mpsim.engine import checkpoint
from mpsim.engine.report import Report, frames_skipped, frames_until
from mpsim.engine.simulation import Simulation
from mpsim.engine.solvers.base import DEATHS, OnWorkerDeath
from mpsim.engine.solvers.methods import METHODS, capabilities_of
from mpsim.errors import InputError, MpsimError, OutputError, reason_of
from mpsim.measure.registry import NAMES
from mpsim.output.frames import FirstRank, frame_of
from mpsim.output.tables import measure_text
from mpsim.output.trajectory import FORMATS, Trajectory
from mpsim.scene import scenefile
from mpsim.scene.scene import Scene, frames_between_pictures
from mpsim.scene.settings import MethodName, Settings
from mpsim.studies.findings import Promise, found_by, promise_of

# --- The folder of a run: its files, and the record run.json
#
# run.json scene, settings, versions, and what each part of the run did checkpoint.mpsim from which `mpsim resume`
# continues trajectory.xyz (or .gsd) frames, for OVITO and mpsim.Trajectory measures.csv energy, overlap and collision
# rate along the run averages.csv averages of the measures asked for, with their errors, of each part of the run
# timings.csv time of each frame, phase and worker, of the parts that reached their end final.npz, final.png the last
# state
#
# If MPI ranks share the run, all of them make the same calls, and the first one reads and writes the files.

AVERAGED = ("measure", "value", "error", "samples", "settled", "upper", "from_frame", "to_frame")
"""Columns of the averages: a `Measure` each, over the frames after from_frame up to to_frame."""

FORMAT = 1
RECORD = "run.json"

MOST_BYTES = 2**23
"""Bytes of that file at most, to which each part of a run adds some hundred."""

MOST_TIMINGS = 2**32
"""Bytes of the table of times at most, to which each frame adds a row."""

CHECKPOINT = "checkpoint.mpsim"
MEASURES = "measures.csv"
AVERAGES = "averages.csv"
TIMINGS = "timings.csv"
STATE = "final.npz"
PICTURE = "final.png"

_ALL = (
    CHECKPOINT,
    f"{CHECKPOINT}.previous",
    MEASURES,
    AVERAGES,
    TIMINGS,
    STATE,
    PICTURE,
    "plot.png",
    *(f"trajectory.{name}" for name in FORMATS),
)


class RunFolder:
    """A folder that holds one run. `create` makes one, `claim` locks one to continue it, `open` reads one.

    What `create` and `claim` return is locked: use it in a `with` block, after which another process may write to it.

    Attributes:
        path: of the folder.
        record: what run.json holds, plain values.
        first_rank: of the ranks that share the run.
    """

    def __init__(self, path: Path, record: dict[str, Any], first_rank: FirstRank | None = None):
        self.path = path
        self.record = record
        self.first_rank: FirstRank = FirstRank() if first_rank is None else first_rank
        self._lock = -1  # of the first rank

    def __enter__(self) -> "RunFolder":
        return self

    def __exit__(self, *exception: object) -> None:
        if self._lock >= 0:
            os.close(self._lock)
            self._lock = -1

    @classmethod
    def create(
        cls,
        path: str | os.PathLike[str],
        record: dict[str, Any],
        *,
        force: bool = False,
        first_rank: FirstRank | None = None,
    ) -> "RunFolder":
        """A new folder, or, with `force`, that of another run, whose files are removed.

        Raises:
            InputError: if there is anything in the folder that would be lost, or another process writes to it.
            OutputError: if it cannot be written.
        """
        made = cls(Path(path), {"format": FORMAT, "versions": versions(), **record, "parts": []}, first_rank)
        made.first_rank.once(lambda: made._take(force))
        made.save()
        return made

    def _take(self, force: bool) -> None:
        """Make the folder, or empty it, and lock it."""
        folder = self.path
        try:
            old = folder.exists() and (not folder.is_dir() or any(folder.iterdir()))
            if old:
                _demand_leave(folder, force)
            folder.mkdir(parents=True, exist_ok=True)
            self._lock = _locked(folder)
            if old:
                for name in (RECORD, *_ALL, *(path.name for path in folder.glob("timings-*.csv"))):
                    (folder / name).unlink(missing_ok=True)
        except OSError as error:
            raise _unwritable(folder, error) from error

    @classmethod
    def claim(cls, path: str | os.PathLike[str], first_rank: FirstRank | None = None) -> "RunFolder":
        """The folder of a run, to continue it.

        Raises:
            InputError: as `open`, or if another process writes to it.
        """
        claimed = cls(Path(path), {}, first_rank)
        claimed.record = claimed.first_rank.once(claimed._lock_and_read)
        return claimed

    def _lock_and_read(self) -> dict[str, Any]:
        """The record, locked."""
        self._lock = _locked(RunFolder.open(self.path).path)
        return RunFolder.open(self.path).record  # again: the last owner may have written to it

    @classmethod
    def open(cls, path: str | os.PathLike[str]) -> "RunFolder":
        """The folder of a run.

        Raises:
            InputError: if it is not one, or of a newer version.
        """
        folder = Path(path)
        try:
            record = files.json_value(folder / RECORD, MOST_BYTES)
            found = int(record["format"])
        except (OSError, ValueError, OverflowError, TypeError, KeyError, RecursionError) as error:
            raise InputError(
                f"the folder of a run must hold {RECORD}; {str(folder)!r} does not "
                f"({reason_of(error):.200}). Give a folder that `mpsim run --out` has made."
            ) from None
        if found > FORMAT:
            raise InputError(f"{str(folder)!r} is of format {found}; this mpsim reads up to {FORMAT}. Use a newer one.")
        missing = {"scene", "target", "every", "trajectory", "measures", "status", "parts"} - record.keys()
        missing |= {name for name in ("scene", "trajectory", "status") if not isinstance(record.get(name), str)}
        settings = record.get("settings")
        if not (isinstance(settings, dict) and isinstance(settings.get("method"), str)):
            missing.add("settings")
        if missing:
            raise InputError(f"{RECORD} must hold {', '.join(sorted(missing))}; that in {str(folder)!r} does not.")
        return cls(folder, record)

    def __getitem__(self, name: str) -> Path:
        return self.path / name

    @property
    def trajectory(self) -> Path:
        """The file of the trajectory."""
        return self.path / Path(self.record["trajectory"]).name  # in this folder, whatever the record says

    @property
    def method(self) -> MethodName:
        """The method of the run so far."""
        return self.record["settings"]["method"]

    @property
    def scene(self) -> Scene:
        """The scene, from the checkpoint.

        Raises:
            CheckpointError: if there is no complete one.
        """
        return checkpoint.read(self[CHECKPOINT], checkpoint.check).scene

    def save(self) -> None:
        """Write run.json: completely, or not at all."""
        self.first_rank.once(self._save)

    def _save(self) -> None:
        try:
            files.write_text(self.path / RECORD, json.dumps(self.record, indent=1) + "\n")
        except OSError as error:
            raise _unwritable(self.path, error) from error

    def note(self, sim: Simulation, status: str) -> None:
        """Record the state of the run."""
        self.record |= {"status": status, "frame": sim.frame, "time": sim.time, "discs": sim.count}
        self.record["digest"] = sim.digest()
        self.save()

    def note_failure(self, sim: Simulation) -> None:
        """Record, if possible, that the run cannot continue; one rank may call this alone."""
        self.record |= {"status": "ended early", "frame": sim.frame, "time": sim.time}
        with contextlib.suppress(MpsimError):
            self.first_rank.alone(self._save)

    def finish(self, sim: Simulation, report: Report, wall_seconds: float, compile_seconds: float) -> None:
        """Record what a part of the run did, its times, and the last state."""
        self.record["parts"].append(part_of(sim, report, wall_seconds, compile_seconds))
        table = report.to_csv(first_frame=sim.frame - report.frames + 1)
        sim.once(lambda: self._write_results(table, sim.state))
        self.note(sim, "done" if sim.frame >= self.record["target"] else "paused")

    def _write_results(self, table: str, state: State) -> None:
        """Write the times of a part of the run below those of earlier parts, and the last state."""
        head, _, lines = table.partition("\n")
        timings = self[TIMINGS]
        try:
            old = files.text(timings, MOST_TIMINGS) if timings.exists() else ""
            if old.partition("\n")[0] != head:  # another number of workers, so other columns: a file of its own
                number = len(self.record["parts"])
                timings, old = (self[TIMINGS] if not old else self[f"timings-{number}.csv"]), ""
            files.write_text(timings, old + lines if old else table)
            if averages := averages_of(self.record["parts"]):
                files.write_text(self[AVERAGES], averages)
        except OSError as error:
            raise _unwritable(self.path, error) from error
        state.save(self[STATE])

    @property
    def frames(self) -> Trajectory:
        """The trajectory, to be read."""
        return Trajectory(self.trajectory)


def part_of(sim: Simulation, report: Report, wall_seconds: float, compile_seconds: float) -> dict[str, Any]:
    """What one call of `run` did, as plain values. `compile_seconds` of its wall time were spent on compiling."""
    frame_seconds = float(report.frame_seconds.sum())
    return {
        "from_frame": sim.frame - report.frames,
        "to_frame": sim.frame,
        "method": report.method,
        "workers": report.workers,
        "wall_seconds": wall_seconds,
        "compile_seconds": compile_seconds,
        "frame_seconds": frame_seconds,
        "writing_seconds": report.observing_seconds,
        "waiting": report.waiting,
        "collisions": report.collisions,
        "block_bytes": report.block_bytes,
        "measures": {name: dataclasses.asdict(measure) for name, measure in report.measures.items()},
    }


def averages_of(parts: list[dict[str, Any]]) -> str:
    """The averages of all parts of a run as CSV, a line for each measure of each part; "" if none was asked for."""
    rows = [
        {**part, "measure": name, **values}
        for part in parts
        if isinstance(part, dict) and isinstance(part.get("measures"), dict)  # others, a record may hold by mistake
        for name, values in part["measures"].items()
        if isinstance(values, dict)
    ]
    text = io.StringIO()
    writer = csv.DictWriter(text, AVERAGED, extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue() if rows else ""


def versions() -> dict[str, str]:
    """Versions of everything that determines the bits or reads the files."""
    found = {"python": platform.python_version()}
    for name in ("mpsim", "numpy", "numba"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:  # run from a folder, not installed
            found[name] = "unknown"
    return found


def _demand_leave(folder: Path, force: bool) -> None:
    """Refuse a folder that is not that of a run, or whose replacement was not asked for."""
    if not folder.is_dir():
        raise InputError(f"--out must be a folder; {str(folder)!r} is a file. Give another name.")
    if not (folder / RECORD).exists():
        raise InputError(
            f"--out must be a new or empty folder, or that of a run; {str(folder)!r} holds other files, which are not "
            "overwritten. Give another name."
        )
    if not force:
        raise InputError(
            f"--out already holds a run: {str(folder)!r} is not overwritten. Give another name, --force to replace "
            f"it, or continue it: mpsim resume {folder}"
        )


def _locked(folder: Path) -> int:
    """A descriptor that holds the folder's lock until it is closed, by the end of the process at the latest.

    Raises:
        InputError: if another process holds it.
    """
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(descriptor)
        raise InputError(
            f"only one process may write to the folder of a run; another one is writing to {str(folder)!r} at this "
            "moment. Wait for its end, or give another name."
        ) from None
    return descriptor


def _unwritable(folder: Path, error: OSError) -> OutputError:
    return OutputError(
        f"--out must be a folder that can be written to, with room on its disk; got {str(folder)!r} "
        f"({error.strerror or error}). Choose another place, or make room."
    )


# --- `mpsim run` and `mpsim resume`: simulate a scene; a folder keeps the results and a checkpoint

FRAMES = 500
"""Number of frames of a run of a scene without a duration."""

FEWEST = 10
"""Frames of a trajectory, at least."""

CHECKPOINT_SECONDS = 30.0
"""Seconds between checkpoints: the time of a run that a kill may cost."""

SHORTEST = 1e-4
"""Times that are shorter do not appear in the summary [s]."""

RUN_EXAMPLES = """\b
Examples:
  mpsim run gas                                          with the recommended duration and measures
  mpsim run gas --until 50 --out run                     until time 50, with results in the folder run/
  mpsim run hopper --frames 2000 --every 20 --out run --format gsd
  mpiexec -n 4 mpsim run gas --method mpi --out run      on the ranks of MPI
  mpsim run my_scene.toml --method parallel --workers 4 --measure pressure --json
"""


on_death_option = click.option(
    "--on-worker-death",
    type=terminal.OneOf(DEATHS),
    default="raise",
    help="restart: continue from a snapshot in memory.",
)


@click.command(epilog=RUN_EXAMPLES, short_help="Simulate a scene.")
@click.argument("scene", shell_complete=terminal.complete_scene)
@click.option("--frames", type=terminal.Whole(1), help=f"Number of frames; default: the scene's duration, or {FRAMES}.")
@click.option("--until", type=terminal.Positive("time"), help="Simulated time at which to stop.")
@terminal.settings_options
@on_death_option
@click.option(
    "--measure",
    "measures",
    type=terminal.OneOf(NAMES),
    multiple=True,
    help="What to measure; default: the scene's own.",
)
@click.option("--start", type=terminal.NonNegative("time"), help="Measure only from this simulated time on.")
@click.option("--out", type=click.Path(path_type=Path), help="Folder for the results.")
@click.option(
    "--every", type=terminal.Whole(1), help="Write every n-th frame to the trajectory; default: the scene's own."
)
@click.option(
    "--format",
    "kind",
    type=terminal.OneOf(FORMATS),
    default=FORMATS[0],
    show_default=True,
    help="File format of the trajectory.",
)
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
    on_worker_death: OnWorkerDeath,
    **options: Any,
) -> None:
    """Simulate SCENE with its recommended duration, settings and measures. Options replace these.

    With --out, the results go to a folder: the trajectory for OVITO, tables of times and measures, the last state, a
    picture of it, and a checkpoint. After Ctrl-C, `mpsim resume` continues the run.
    """
    with one_voice(options["method"] == "mpi"):  # one rank may lack the file
        if frames is not None and until is not None:
            raise click.UsageError("Give --frames or --until, not both.")
        for option, given in (("--every", every), ("--force", force), ("--format", kind != FORMATS[0])):
            if given and out is None:
                raise click.UsageError(f"{option} needs --out, the folder to write to.")
        file = scenefile.load(scene)
        settings = terminal.settings_of(file, options, on_ranks=True)
    watched = promise_of(file.name, file.scene, settings) if _is_as_recommended(file, frames, until, settings) else None
    until, end = (file.scene.duration, "the scene's duration") if until is None else (until, "until")
    target = frames or (FRAMES if until is None else frames_until(until, settings.dt, end))
    measures = measures or file.scene.measures
    frames_skipped(start, measures, target, settings.dt, 0)  # refused before anything is made
    with (
        one_voice(capabilities_of(settings).on_ranks) as first_rank,
        Simulation(file.scene, settings, on_worker_death=on_worker_death) as sim,
    ):
        if out is None:
            measured = {"measures": measures or None, "start": start}
            _without_folder(sim, file, target, measured, as_json, quiet, first_rank, watched)
            return
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
        with RunFolder.create(out, record, force=force, first_rank=first_rank) as folder:
            sim.save(folder[CHECKPOINT])  # so that the run can be continued, however early it ends
            folder.note(sim, "running")
            _advance(folder, sim, target, as_json, quiet, watched)


def _is_as_recommended(file: scenefile.SceneFile, frames: int | None, until: float | None, settings: Settings) -> bool:
    """Whether a run is of a named scene, of the recommended duration, and in one process."""
    return file.comes_with_mpsim and frames is None and until is None and not capabilities_of(settings).on_ranks


SAME_BITS = tuple(name for name, each in METHODS.items() if each.by_columns)
"""Methods between which a run may change."""

RESUME_EXAMPLES = """\b
Examples:
  mpsim resume run                                to the end that was asked for
  mpsim resume run --frames 1000                  1000 frames more
  mpsim resume run --until 200 --workers 8
  mpiexec -n 3 mpsim resume run --method mpi      on the ranks of MPI, and by --method grid back in one process
"""


@click.command(epilog=RESUME_EXAMPLES, short_help="Continue a run.")
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--frames", type=terminal.Whole(1), help="Number of further frames.")
@click.option("--until", type=terminal.Positive("time"), help="Simulated time at which to stop.")
@click.option("--method", type=terminal.OneOf(SAME_BITS), help="Change to another method with the same bits.")
@click.option(
    "--workers",
    type=terminal.Whole(1, terminal.MOST_WORKERS),
    help="Number of processes; it does not change the result.",
)
@on_death_option
@terminal.json_option
@terminal.quiet_option
def resume(
    folder: Path,
    frames: int | None,
    until: float | None,
    method: MethodName | None,
    workers: int | None,
    on_worker_death: OnWorkerDeath,
    as_json: bool,
    quiet: bool,
) -> None:
    """Continue the run in FOLDER. The result has the same bits as a run that never stopped.

    Without --frames or --until, it continues to the end that was given to `mpsim run`.
    """
    if frames is not None and until is not None:
        raise click.UsageError("Give --frames or --until, not both.")
    method = method or RunFolder.open(folder).method
    with (
        one_voice(capabilities_of(Settings(method=method)).on_ranks) as first_rank,
        RunFolder.claim(folder, first_rank) as found,
        Simulation.resume(found[CHECKPOINT], workers=workers, method=method, on_worker_death=on_worker_death) as sim,
    ):
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
        if not quiet:
            first_rank.once(lambda: _report_lost_frames(found, sim))
        found.record["target"] = max(target, found.record["target"])  # the end that was asked for stays
        found.record["settings"] = dataclasses.asdict(sim.settings)
        found.note(sim, "running")
        _advance(found, sim, target, as_json, quiet)


def _report_lost_frames(folder: RunFolder, sim: Simulation) -> None:
    """After a kill, the trajectory may hold frames that are later than the checkpoint."""
    if not folder.trajectory.exists():
        return
    frames = folder.frames
    kept = len(frames)
    while kept and frames[kept - 1].frame > sim.frame:
        kept -= 1
    if kept < len(frames):
        click.echo(
            f"Continuing from the checkpoint of frame {sim.frame}: the run was ended without a later one. Its "
            f"{len(frames) - kept} recorded frames after that, up to {frames[-1].frame}, are computed again, to the "
            "same bits.",
            err=True,
        )


def _advance(
    folder: RunFolder, sim: Simulation, target: int, as_json: bool, quiet: bool, watched: Promise | None = None
) -> None:
    """Run to a frame, and record everything."""
    # With matplotlib, whose import would only delay the start of other commands.
    from mpsim.output.figures import final_picture  # noqa: PLC0415
    from mpsim.output.recorder import Recorder  # noqa: PLC0415
    from mpsim.output.trajectory import Trajectory  # noqa: PLC0415

    every, measures, first_rank = folder.record["every"], folder.record["measures"] or None, folder.first_rank
    start = folder.record.get("start")  # which older folders do not have
    if start is not None and frames_until(start, sim.settings.dt) >= target:  # this part of the run ends before
        measures = start = None
    with interrupts_agreed(first_rank) as interruption:
        compiled, started = _compiled(sim, measures)
        with (
            Trajectory.write(folder.trajectory, every, mode="a", comm=first_rank.comm) as trajectory,
            Recorder(folder[MEASURES], every, sim, first_rank) as recorder,
            _left_resumable(folder, sim),
            _progress(quiet, interruption) as progress,
        ):
            report = sim.run(
                frames=target - sim.frame,
                measures=measures,
                start=start,
                observe=[trajectory, recorder, *(watched.observers if watched else [])],
                checkpoint=folder[CHECKPOINT],
                checkpoint_seconds=CHECKPOINT_SECONDS,
                progress=progress,
            )
            folder.finish(sim, report, time.perf_counter() - started, compiled + report.compile_seconds)
        sim.once(lambda: final_picture(sim.scene, frame_of(sim).whole(), folder[PICTURE]))
    if as_json:
        click.echo(json_text(folder.record))
        return
    for line in [*summary(folder.record["parts"][-1], report, sim), *_found(watched, folder.record["scene"], sim)]:
        click.echo(line)
    averages = [AVERAGES] if report.measures else []
    names = (folder.record["trajectory"], MEASURES, *averages, TIMINGS, STATE, PICTURE)
    written = first_rank.once(lambda: len(folder.frames))
    click.echo(f"written to {folder.path}/: {', '.join(names)}; {written} frames in the trajectory")


@contextlib.contextmanager
def _progress(quiet: bool, interruption: Callable[[], None]) -> Iterator[Callable[[int, int], None]]:
    """What a run calls between two slices of frames: shows progress, and lets ranks agree on Ctrl-C."""
    with terminal.progress(quiet) as show:

        def between(done: int, of: int) -> None:
            interruption()
            if show is not None:
                show(done, of, "frames")

        yield between


def _compiled(sim: Simulation, measures: tuple[str, ...] | None) -> tuple[float, float]:
    """Compile what is missing before progress is shown, as it would distort the rate.

    Returns:
        Seconds of compiling since `sim` was made, and the `time.perf_counter` at which a run that has them began.
    """
    compiled = sim.run(frames=0, measures=measures).compile_seconds
    return compiled, time.perf_counter() - compiled


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
        folder.note_failure(sim)
        if isinstance(end, SystemExit):  # by SIGTERM, after a checkpoint
            click.echo(f"Ended by SIGTERM at frame {sim.frame}. Continue with: mpsim resume {folder.path}", err=True)
        raise


def _without_folder(
    sim: Simulation,
    file: scenefile.SceneFile,
    frames: int,
    measured: dict[str, Any],
    as_json: bool,
    quiet: bool,
    first_rank: FirstRank,
    watched: Promise | None,
) -> None:
    """Run and print a summary, without writing files."""
    with interrupts_agreed(first_rank) as interruption:
        compiled, started = _compiled(sim, measured["measures"])
        try:
            with _progress(quiet, interruption) as progress:
                observe = watched.observers if watched else None
                report = sim.run(frames=frames, **measured, progress=progress, observe=observe)
        except KeyboardInterrupt:
            raise terminal.Interrupted(
                f"Interrupted at frame {sim.frame} of {frames}. Nothing is kept without --out FOLDER."
            ) from None
    part = part_of(sim, report, time.perf_counter() - started, compiled + report.compile_seconds)
    if as_json:
        found = {"scene": file.name, "scene_digest": sim.scene.digest(), "settings": dataclasses.asdict(sim.settings)}
        shown = {} if watched is None else {"findings": found_by(file.name, watched, sim).record()}
        click.echo(json_text({**found, "digest": sim.digest(), **part, **shown}))
        return
    for line in [*summary(part, report, sim), *_found(watched, file.name, sim)]:
        click.echo(line)


def _found(watched: Promise | None, name: str, sim: Simulation) -> list[str]:
    """What a named scene has shown, beside what it promises, line by line."""
    return [] if watched is None else found_by(name, watched, sim).lines()


def interval_of(scene: Scene, settings: Settings, target: int) -> int:
    """Default number of frames between two of a trajectory: as recommended, if the run has FEWEST of these."""
    every = frames_between_pictures(scene, settings)
    if every is None or target < FEWEST * every:
        return max(target // pictures_of(scene.count), 1)
    return every


def pictures_of(count: int) -> int:
    """Default number of frames in a trajectory: writing a million discs takes seconds."""
    return min(max(1_000_000 // max(count, 1), FEWEST), 100)


def _brief(seconds: float) -> str:
    """A time with one decimal, or with two digits if it is short [s].

    >>> _brief(117.73), _brief(1.19), _brief(0.0412), _brief(0.0003)
    ('117.7', '1.2', '0.041', '0.0003')
    """
    return f"{seconds:.1f}" if seconds >= 1 else f"{seconds:.2g}"


def summary(part: dict[str, Any], report: Report, sim: Simulation) -> Iterator[str]:
    """Summary of a run, line by line."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield dataclasses.replace(report, compile_seconds=0.0).summary  # all compiling is in the next line
    spent = {
        "compiling": part["compile_seconds"],
        "simulating": part["frame_seconds"],
        "writing": part["writing_seconds"],
    }
    spent["other"] = max(part["wall_seconds"] - sum(spent.values()), 0.0)
    parts = ", ".join(f"{name} {_brief(each)}" for name, each in spent.items() if each >= SHORTEST)
    yield (
        f"frame {sim.frame}, time {sim.time:g}, {sim.count} disc{'s' * (sim.count != 1)}; "
        f"{_brief(part['wall_seconds'])} s: {parts}"
    )
    over = f", over frames {part['from_frame'] + 1} to {part['to_frame']}" if part["from_frame"] else ""
    if report.workers > 1:
        yield f"{100 * report.waiting:.0f} % of the workers' time was waiting for each other"
    for name, measure in report.measures.items():
        yield f"{name}: {measure_text(name, measure)}{over}"
    yield f"digest {sim.digest()}"
