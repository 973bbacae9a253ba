"""What a worker process runs: wait for a command in the block, do one's part of the frames, wait again.

This module is what `spawn` and `forkserver` import in a new process; it therefore imports only what a worker needs.
"""

import os
import signal
import threading
import traceback
from multiprocessing.connection import Connection, wait
from multiprocessing.process import parent_process
from typing import Any

import numpy as np

from mpsim.engine.shared import SharedBlock
from mpsim.kernels import layout
from mpsim.kernels.stepping import run_grid
from mpsim.kernels.waiting import await_command, load_word, store_word
from mpsim.state import ArraySpec

LINGER = 2_000_000
"""Nanoseconds for which a worker without a command polls (giving its core away) before it sleeps in its pipe: a loop
of short runs then needs no system call to wake anybody, and an idle pool costs nothing."""

ORPHANED = 3
"""Exit code of a worker whose coordinator is gone."""


def kernel_arguments(block: SharedBlock, live: int) -> tuple[Any, ...]:
    """Arguments of `run_grid` up to `sent`, read from a block; `live` is the buffer that holds the state."""
    arrays = block.arrays
    buffers = [layout.Discs(*(arrays[f"{name}.{field}"] for field in layout.Discs._fields)) for name in "ab"]
    return (
        buffers[live],
        buffers[1 - live],
        arrays["start"],
        arrays["outbox"],
        arrays.get("gravity"),
        arrays.get("acceleration"),
        arrays["parameters"],
        arrays["control"],
        arrays["team"],
        arrays["sent"],
    )


def load_kernels(block: SharedBlock) -> None:
    """Compile or load everything that a worker calls, by running no frame on private copies of the control words."""
    *discs, control, team, sent = kernel_arguments(block, 0)
    control, team = control.copy(), np.zeros_like(team)
    control[layout.FRAMES], control[layout.WORKERS] = 0, 1
    run_grid(*discs, control, team, sent, block.arrays["times"][0], 0)
    store_word(control, layout.MAIL, 1)
    load_word(control, layout.MAIL)
    await_command(control, team[0], control[layout.COMMAND], control[layout.MAIL], 0)


def worker_main(worker: int, connection: Connection, name: str, specs: dict[str, ArraySpec]) -> None:
    """Entry point of worker `worker` (1 or above); ends with its coordinator, whatever happens."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the coordinator alone decides
    threading.Thread(target=_end_with_coordinator, daemon=True).start()
    try:
        _serve(worker, connection, SharedBlock.attach(name, specs))
    except (EOFError, BrokenPipeError, ConnectionResetError):
        os._exit(ORPHANED)
    except BaseException:
        connection.send(("error", traceback.format_exc()))
        raise


def _end_with_coordinator() -> None:
    """Exit at once when the coordinator is gone. Kernels release the GIL, so this also acts in the middle of a frame.

    The sentinel is right under every start method; the parent's process number is not (under forkserver it is the
    fork server's).
    """
    coordinator = parent_process()
    if coordinator is not None:
        wait([coordinator.sentinel])
        os._exit(ORPHANED)


def _serve(worker: int, connection: Connection, block: SharedBlock) -> None:
    """Run commands until the coordinator says stop. Does not return."""
    load_kernels(block)
    control, mine = block.arrays["control"], block.arrays["team"][worker]
    command, mail = load_word(control, layout.COMMAND), load_word(control, layout.MAIL)
    connection.send(("ready", None))
    while True:
        if not await_command(control, mine, command, mail, LINGER):
            _park(connection, control, mine, command)
        if load_word(control, layout.COMMAND) == command and connection.poll():
            kind, name, specs = connection.recv()
            if kind == "stop":
                os._exit(0)  # at once, views and all: a worker owns nothing that would need cleaning up
            if kind == "attach":
                control = mine = None
                block.close()
                block = SharedBlock.attach(name, specs)
                control, mine = block.arrays["control"], block.arrays["team"][worker]
                command = load_word(control, layout.COMMAND)
                connection.send(("ready", None))
            mail = load_word(control, layout.MAIL)
        elif load_word(control, layout.COMMAND) != command:
            command += 1
            arguments = kernel_arguments(block, int(control[layout.LIVE]))
            if run_grid(*arguments, block.arrays["times"][worker], worker) != layout.RUNNING:
                os._exit(0)
            del arguments


def _park(connection: Connection, control: Any, mine: Any, command: int) -> None:
    """Sleep in the pipe until a message comes.

    Parked is said first and the bell is looked at second; the coordinator rings first and looks at parked second.
    Whatever the timing, one of the two sees the other, and no command is slept through.
    """
    bell = load_word(control, layout.BELL)
    store_word(mine, layout.PARKED, 1)
    if load_word(control, layout.BELL) == bell and load_word(control, layout.COMMAND) == command:
        wait([connection])
    store_word(mine, layout.PARKED, 0)
