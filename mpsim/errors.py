"""All exceptions and warnings of mpsim. Each message says what, the rule, the value received, what to do.

Those that programs catch daily are names of `mpsim` too, such as `mpsim.InputError`.

>>> import mpsim
>>> issubclass(mpsim.errors.StalledError, mpsim.MpsimError)
True
"""

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any


def level_of_caller() -> int:
    """The `stacklevel` by which a warning names the line that called mpsim, however deep inside mpsim it is raised."""
    package = f"{Path(__file__).parent}{os.sep}"
    frame, depth = sys._getframe(1), 1  # pyright: ignore[reportPrivateUsage]
    while frame.f_back is not None and frame.f_code.co_filename.startswith(package):
        frame, depth = frame.f_back, depth + 1
    return depth


def is_of_the_system(error: OSError) -> bool:
    """Whether the error comes from the system, not from the program, such as a time limit of its own."""
    return error.errno is not None and not isinstance(error, TimeoutError)


def reason_of(error: Exception) -> str:
    """Why a file cannot be read: the system's reason, or what is wrong in the file.

    Raises:
        OSError: the error itself, if it does not come from the system.
    """
    if isinstance(error, OSError) and not is_of_the_system(error):
        raise error
    return getattr(error, "strerror", None) or str(error)


class MpsimError(Exception):
    """Base of all exceptions of mpsim: `except mpsim.MpsimError` catches every one of them.

    They can be pickled and sent to other processes.
    """

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self).__new__, (type(self), *self.args), self.__dict__  # without what a constructor makes of it


class InputError(MpsimError, ValueError):
    """A scene, a setting or an argument breaks a rule; nothing was changed."""


class UnknownArgumentError(InputError, TypeError):
    """A keyword is the name of no argument, or an argument lacks its name. It is a TypeError too, as in Python."""


class SceneFileError(InputError):
    """A scene file breaks rules.

    Attributes: problems (one sentence each: key path, rule, value received), file (as it was named).
    """

    def __init__(self, file: str, problems: Sequence[str]):
        self.file = file
        self.problems: tuple[str, ...] = tuple(problems)
        lines = [f"{file}: {problem}" for problem in problems]
        super().__init__("\n".join([f"{len(lines)} problems in a scene file:", *lines] if len(lines) > 1 else lines))


class ClosedError(MpsimError, RuntimeError):
    """A simulation was used after `close()`, after its `with` block, or after an error that ended it."""


class ForkedError(MpsimError, RuntimeError):
    """A simulation was used in a fork of the process that made it; nothing was read or changed."""


class BusyError(MpsimError, RuntimeError):
    """A simulation was used by one thread while another was changing it; nothing was changed."""


class DivergedError(MpsimError, ArithmeticError):
    """A disc's position or velocity became NaN or infinite.

    Attributes: particle (index in the scene), frame (frames finished before), position, velocity (two floats each).
    """

    def __init__(self, particle: int, frame: int, position: tuple[float, float], velocity: tuple[float, float]):
        self.particle = particle
        self.frame = frame
        self.position = position
        self.velocity = velocity
        super().__init__(
            f"disc {particle} is not finite in frame {frame}: position {position}, velocity {velocity}. "
            "A state must stay finite. Usual causes: a velocity so large that its square overflows the precision, an "
            "acceleration that never stops, or values written from outside. Use a smaller dt or precision='float64'."
        )


class TooFastError(InputError):
    """Discs may pass through each other in a step, or are pressed into each other, and on_fast="error" forbids it."""


class ResourceError(MpsimError, OSError):
    """The system refuses descriptors, processes or memory. Everything obtained so far was released."""


class SharedMemoryError(ResourceError):
    """The shared block could not be reserved."""


class WorkerDiedError(MpsimError, RuntimeError):
    """A worker process ended while it was needed.

    Attributes: worker (its number), pid, exitcode (negative: the signal that ended it), frame, phase.
    """

    def __init__(self, worker: int, pid: int | None, exitcode: int | None, cause: str, frame: int, phase: str):
        self.worker = worker
        self.pid = pid
        self.exitcode = exitcode
        self.frame = frame
        self.phase = phase
        super().__init__(
            f"worker {worker} (process {pid}) ended by {cause} in frame {frame}, phase '{phase}'. "
            "The run cannot continue and its last frames are lost; the other workers were stopped. "
            "SIGKILL often means that the machine ran out of memory. Start again, with fewer workers if it repeats."
        )


class WorkerStalledError(MpsimError, RuntimeError):
    """A worker is alive but did not reach a barrier in time."""


class NotRecordedError(MpsimError, KeyError):
    """A measure was asked for that the run did not record."""

    def __str__(self) -> str:
        """The sentence itself; KeyError would quote it."""
        return str(self.args[0])


class BudgetError(MpsimError, ValueError):
    """No settings meet the error budgets given to `tune`."""


class NotMeasurableError(MpsimError, ValueError):
    """An error that has a budget cannot be measured on this scene; the message says why, and what to do instead."""


class OutputError(MpsimError, OSError):
    """A file cannot be written as asked; nothing was written."""


class StalledError(MpsimError, RuntimeError):
    """The exact solver found more collisions at one instant than are possible, or a disc was crushed."""


class CheckpointError(MpsimError, OSError):
    """A checkpoint cannot be read: it is missing, damaged, or of a newer version."""


class TrajectoryError(MpsimError, OSError):
    """A trajectory cannot be read, or does not contain a requested quantity."""


class TrajectoryWarning(UserWarning):
    """The end of a trajectory was cut off in the middle of a frame, or frames of it are missing."""


class CheckpointWarning(UserWarning):
    """The newest checkpoint is damaged; the previous one was used instead."""


class EmitterWarning(UserWarning):
    """A disc of an emitter has to wait: its place is occupied, or there is no room for it."""


class FastWarning(UserWarning):
    """Discs may pass through each other in a step, are pressed together, or lose energy: the result is degraded."""


class GuardWarning(UserWarning):
    """In the exact solver some inelastic collisions lost no energy, which prevents an infinite number of collisions.

    A simulation warns once; `Report.guarded` has the number of each run.
    """


class OverlapWarning(UserWarning):
    """Discs overlap at the start. The first frames push them apart, which changes positions but not the energy.

    By `event`, discs that overlap obstacles leave them without a collision; those that overlap discs are refused.
    """


class ResolutionWarning(UserWarning):
    """The precision of the run is too coarse for coordinates or velocities of the scene: the result is degraded."""
