"""The folder of a run: its files, and the record run.json.

run.json            scene, settings, versions, and what each part of the run did
checkpoint.mpsim    from which `mpsim resume` continues
trajectory.xyz      (or .gsd) frames, for OVITO and mpsim.Trajectory
measures.csv        energy, overlap and collision rate along the run
averages.csv        averages of the measures asked for, with their errors, of each part of the run
timings.csv         time of each frame, phase and worker, of the parts that reached their end
final.npz, final.png    the last state

If MPI ranks share the run, all of them make the same calls, and the first one reads and writes the files.
"""

import contextlib
import csv
import dataclasses
import fcntl
import io
import json
import os
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from mpsim.core import atomic, untrusted
from mpsim.core.state import State
from mpsim.engine import checkpoint, checkpoint_validation
from mpsim.engine.report import Report
from mpsim.engine.simulation import Simulation
from mpsim.errors import InputError, MpsimError, OutputError, reason_of
from mpsim.output.first_rank import FirstRank
from mpsim.output.frame_file import FORMATS
from mpsim.output.trajectory import Trajectory
from mpsim.scene.scene import Scene
from mpsim.scene.settings import MethodName

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
            record = untrusted.json_value(folder / RECORD, MOST_BYTES)
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
        return checkpoint.read(self[CHECKPOINT], checkpoint_validation.check).scene

    def save(self) -> None:
        """Write run.json: completely, or not at all."""
        self.first_rank.once(self._save)

    def _save(self) -> None:
        try:
            atomic.write_text(self.path / RECORD, json.dumps(self.record, indent=1) + "\n")
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
            old = untrusted.text(timings, MOST_TIMINGS) if timings.exists() else ""
            if old.partition("\n")[0] != head:  # another number of workers, so other columns: a file of its own
                number = len(self.record["parts"])
                timings, old = (self[TIMINGS] if not old else self[f"timings-{number}.csv"]), ""
            atomic.write_text(timings, old + lines if old else table)
            if averages := averages_of(self.record["parts"]):
                atomic.write_text(self[AVERAGES], averages)
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
