"""What a worker process runs: wait for a command in the block, do one's part of the frames, wait again.

This module is what `spawn` and `forkserver` import in a new process; it therefore imports only what a worker needs.
"""

import os
import signal
import threading
import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from multiprocessing.process import parent_process
from typing import Any, NamedTuple

import numpy as np

from mpsim.engine.workers.shared import SharedBlock, Specs, refusal_of_process
from mpsim.errors import ResourceError
from mpsim.kernels import compiling, records
from mpsim.kernels.features.hooks import features_of
from mpsim.kernels.frame.stepping import run_grid
from mpsim.kernels.waiting import add_to_word, load_word, store_word

NAME = "mpsim-worker-"  # names of worker processes begin with it

LINGER = 2_000_000
"""Nanoseconds for which a worker without a command polls (giving its core away) before it sleeps in its pipe: a loop
of short runs then needs no system call to wake a worker, and an idle pool costs nothing."""

NAP = 0.0005  # seconds between two looks for a command that is announced and late

LATE, UNASKED = 0.001, 16
"""Seconds after which a worker that is woken off the coordinator's core is late, as other programs have the other
cores; and how many times it is then woken where the scheduler likes."""

ORPHANED = 3  # exit code of a worker whose coordinator is gone
REFUSED = 4  # exit code of a worker to which the system refuses what it needs


class Program(NamedTuple):
    """What the workers of a solver run. A worker imports the module of these functions, and no other solver's.

    Attributes:
        load: compiles or loads what coordinator and workers call; of a block it changes nothing.
        call: the kernel that waits for commands in a block, with its arguments for one worker.
    """

    load: Callable[[SharedBlock], object]
    call: Callable[[SharedBlock, int], Callable[[], int]]


class GridArguments(NamedTuple):
    """Views of the block: arguments of `run_part`, and of `run_grid` but its last two, in its order; see there.

    `control.live` tells which of the buffers of discs, a and b, holds the state.
    """

    a: records.Discs
    b: records.Discs
    start: Any
    changes: records.Changes
    features: Any
    parameters: Any
    control: Any
    team: Any
    sent: Any
    tally: Any
    times: Any


def kernel_arguments(block: SharedBlock, worker: int = 0) -> GridArguments:
    """What one worker calls its kernel with."""
    if (known := block.calls.get(worker)) is not None:
        return known
    arrays = block.arrays
    a, b = (records.Discs(*(arrays.get(f"{name}.{field}") for field in records.Discs._fields)) for name in "ab")
    changes = records.Changes(*(arrays[field] for field in records.Changes._fields))
    own = {name: arrays[name][worker] for name in ("tally", "times")}
    shared = {name: arrays[name] for name in ("start", "parameters", "control", "team", "sent")}
    found = block.calls[worker] = GridArguments(
        a, b, changes=changes, features=features_of(arrays, worker), **shared, **own
    )
    return found


_Control, _Member = (np.ctypeslib.as_ctypes_type(kind) for kind in (records.CONTROL, records.MEMBER))


def numbers_of(block: SharedBlock) -> tuple[Any, Any]:
    """The records `control` and `team` as ctypes has them: it reads and writes a number five times as fast as NumPy."""
    if (known := block.calls.get("numbers")) is None:
        control, team = records.row_of(block.arrays["control"]), block.arrays["team"]
        known = block.calls["numbers"] = _Control.from_buffer(control), (_Member * len(team)).from_buffer(team)
    return known


def write_command(block: SharedBlock, frames: int, count_enabled: bool) -> None:
    """Write a command into a block: how many frames, whether they are counted, and zeros where that is."""
    arrays, (control, _) = block.arrays, numbers_of(block)
    control.frames, control.tallied = frames, count_enabled
    arrays["team"]["collisions"] = 0
    arrays["team"]["fastest"] = 0
    arrays["times"][:, :frames] = 0
    if count_enabled:
        arrays["tally"][:, :frames] = 0


def call_of(block: SharedBlock, kernel: Callable[..., Any], *ending: int) -> Callable[[], Any]:
    """A kernel with the arguments of worker 0; `run_grid` with those of the worker in `ending`, which it takes too."""
    key = kernel, *ending
    if (known := block.calls.get(key)) is None:
        given = kernel_arguments(block, *ending[:1])
        rows = {"parameters": records.row_of(given.parameters), "control": records.row_of(given.control)}
        known = block.calls[key] = compiling.bound(kernel, *given._replace(**rows), *ending)
    return known


def _grid_call(block: SharedBlock, worker: int = 0) -> Callable[[], int]:
    """`run_grid` with the arguments of one worker."""
    return call_of(block, run_grid, worker, LINGER)


GRID = Program(_grid_call, _grid_call)  # of the methods grid and parallel


def load_kernels(block: SharedBlock, program: Program = GRID) -> None:
    """Compile or load everything that coordinator and workers call."""
    program.load(block)
    control = block.arrays["control"].copy()
    store_word(control.signals, records.MAIL, 1)
    add_to_word(control.signals, records.ANNOUNCED, load_word(control.signals, records.MAIL))


def worker_main(
    worker: int, connection: Connection, name: str, specs: Specs, program: Program, coordinator: int
) -> None:
    """Entry point of worker `worker` (1 or above); ends with its coordinator (a process number), whatever happens."""
    for number in (signal.SIGINT, signal.SIGTERM):  # they may reach the whole group; the coordinator alone decides
        signal.signal(number, signal.SIG_IGN)
    compiling.LOOPS.clear()  # nothing is announced: the coordinator has told of the same kernels
    try:
        _watch(coordinator)
        _serve(worker, connection, SharedBlock.attach(name, specs), program)
    except ResourceError as refusal:
        connection.send(("refused", refusal))
        os._exit(REFUSED)
    except (EOFError, BrokenPipeError, ConnectionResetError, FileNotFoundError):
        os._exit(ORPHANED)  # the pipe's other end or the block is gone: the coordinator has given up
    except BaseException:
        connection.send(("error", traceback.format_exc()))
        raise


def _watch(coordinator: int) -> None:
    """Start the thread that ends this worker with its coordinator."""
    try:
        threading.Thread(target=_end_with_coordinator, args=(coordinator,), daemon=True).start()
    except RuntimeError as error:
        raise refusal_of_process("its thread that watches the coordinator", error) from error


def _end_with_coordinator(pid: int) -> None:
    """Exit at once when the coordinator is gone. Kernels release the GIL, so this also acts in the middle of a frame.

    The sentinel is right under every start method; the parent's process number is not (under forkserver it is the
    fork server's). But it is a pipe that forks of the coordinator hold open, too, so where there are such things a
    descriptor of the process itself is waited on as well.
    """
    if (coordinator := parent_process()) is not None:
        ends = [coordinator.sentinel]
        with suppress(AttributeError, OSError):  # not on this system; or it is gone by now, which the sentinel tells
            ends.append(os.pidfd_open(pid))
        wait(ends)
        os._exit(ORPHANED)


def _serve(worker: int, connection: Connection, block: SharedBlock, program: Program) -> None:
    """Run commands until the coordinator says stop. Does not return."""
    load_kernels(block, program)
    call = _join(worker, connection, block, program)
    naps, crowded = 0, 0  # and the nap until whose end it wakes on any core
    while True:
        outcome, message = call(), None
        if outcome == records.IDLE:
            naps += 1
            message = _park(connection, block.arrays, worker, naps if naps > crowded else -naps)
        elif outcome == records.MAILED:
            # Counted as read before the pipe is looked at: a message that comes in between is announced once more.
            block.arrays["team"][worker].mails = load_word(block.arrays["control"].signals, records.MAIL)
        else:
            os._exit(0)  # the frame loop was aborted, and the coordinator knows why
        while message is not None or connection.poll():
            kind, *given = message or connection.recv()
            message = None
            if kind == "stop":
                os._exit(0)  # at once, views and all: a worker owns nothing that would need cleaning up
            if kind == "wake":
                cores, called = given
                if cores:
                    with suppress(OSError):  # they may be taken away by now
                        os.sched_setaffinity(0, cores)
                if time.monotonic() - called > LATE and naps > crowded:
                    crowded = naps + UNASKED
                if outcome == records.IDLE:
                    break  # to the command at once; all other messages are announced
            if kind == "attach":
                del call
                block.close()
                block = SharedBlock.attach(*given)
                load_kernels(block, program)
                call = _join(worker, connection, block, program)


def _join(worker: int, connection: Connection, block: SharedBlock, program: Program) -> Callable[[], int]:
    """Say that this worker is ready for the next command in the block; returns the call of its kernel."""
    control, mine = block.arrays["control"], block.arrays["team"][worker]
    mine.commands = load_word(control.signals, records.COMMAND)
    mine.mails = load_word(control.signals, records.MAIL)
    connection.send(("ready", None))
    return program.call(block, worker)


def _park(connection: Connection, arrays: dict[str, Any], worker: int, nap: int) -> Any:
    """Sleep in the pipe until a message comes, unless a command is announced. Returns the message, or else None.

    Parked is said first and the announcement looked at second; the coordinator announces first and looks at parked
    second. Whatever the timing, one of the two sees the other, and no command is slept through.
    """
    control, mine = arrays["control"], arrays["team"][worker]
    message = None
    store_word(mine.signals, records.PARKED, nap)
    if load_word(control.signals, records.ANNOUNCED) <= mine.commands:
        message = connection.recv()
    else:
        time.sleep(NAP)  # the coordinator lost its core between announcing the command and giving it
    store_word(mine.signals, records.PARKED, 0)
    return message
