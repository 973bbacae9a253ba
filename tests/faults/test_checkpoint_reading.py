"""Only what is damage counts as damage: for any other reason not to read a checkpoint, the older one is not taken."""

import errno
import os
import signal
import struct
import sys
import threading
import time
import warnings
import zipfile
from pathlib import Path

import pytest
from support.checkpoints import frame_in, rewrite_members, saved, two
from support.scenes import lattice

import mpsim
from mpsim.core import archive, untrusted
from mpsim.engine import checkpoint, checkpoint_validation


class ImpatienceError(Exception):
    """An exception of a user's own."""


PASSED_ON = [
    MemoryError("no memory"),
    KeyboardInterrupt(),
    SystemExit(143),
    TimeoutError("the user's alarm"),
    TimeoutError(errno.ETIMEDOUT, "the user's alarm"),
    InterruptedError("the user's"),
    OSError("the user's, without a number"),
    ImpatienceError("the user's own"),
    UserWarning("a warning that is an error"),
]

IN_WORDS = [
    PermissionError(errno.EACCES, "Permission denied"),
    IsADirectoryError(errno.EISDIR, "Is a directory"),
    OSError(errno.EMFILE, "Too many open files"),
    OSError(errno.ENOMEM, "Cannot allocate memory"),
    OSError(errno.ESTALE, "Stale file handle"),
]

DAMAGE = [
    OSError(errno.EIO, "Input/output error"),
    zipfile.BadZipFile("Bad CRC-32"),
    struct.error("unpack requires a buffer"),
    EOFError("cut off"),
    ValueError("no number"),
    KeyError("no such array"),
    NotImplementedError("zip file version 9.9"),
]

DOORS = {
    "opening": (untrusted, "opened"),
    "the table of contents": (archive.zipfile, "_EndRecData"),
    "the header": (checkpoint, "_header_of"),
    "an array": (archive.ArrayFile, "read"),
    "the digest": (checkpoint, "digest_of"),
}
"""What reads a file, in turn."""


def raising(error):
    def fail(*arguments, **options):
        raise error

    return fail


@pytest.mark.parametrize("door", DOORS)
@pytest.mark.parametrize("error", PASSED_ON, ids=repr)
def test_what_is_no_fault_of_the_file_is_passed_on(door, error, tmp_path, monkeypatch):
    path = two(tmp_path / "run")
    monkeypatch.setattr(*DOORS[door], raising(error))
    with pytest.raises(type(error)) as found:
        mpsim.Simulation.resume(path)
    assert found.value is error
    monkeypatch.undo()
    assert frame_in(path) == 3


@pytest.mark.parametrize("door", DOORS)
@pytest.mark.parametrize("error", IN_WORDS, ids=repr)
def test_what_the_system_refuses_is_said_and_the_older_one_is_not_taken(door, error, tmp_path, monkeypatch):
    path = two(tmp_path / "run")
    monkeypatch.setattr(*DOORS[door], raising(error))
    with pytest.raises(
        mpsim.CheckpointError, match=f"can be read; got: {error.strerror}. It may be undamaged"
    ) as found:
        mpsim.Simulation.resume(path)
    assert f"'{path}'" in str(found.value)
    assert found.value.__cause__ is error


@pytest.mark.parametrize("error", DAMAGE, ids=repr)
@pytest.mark.parametrize("door", ["the header", "an array"])
def test_damage_leads_to_the_one_before(door, error, tmp_path, monkeypatch):
    """The control: what does count, once, as the newest is read."""
    path = two(tmp_path / "run")
    place, name = DOORS[door]
    whole, left = getattr(place, name), [error]

    def fail_once(*arguments):
        if left:
            raise left.pop()
        return whole(*arguments)

    monkeypatch.setattr(place, name, fail_once)
    with pytest.warns(mpsim.errors.CheckpointWarning, match="Continuing from the previous one"):
        assert frame_in(path) == 2


@pytest.mark.parametrize(
    "error", [MemoryError("no memory"), TimeoutError("the user's"), ImpatienceError("mine")], ids=repr
)
@pytest.mark.parametrize(
    "place", [(checkpoint, "settings_from"), (checkpoint, "scene_from"), (checkpoint_validation, "check")]
)
def test_the_content_is_not_blamed_for_what_happens_while_it_is_looked_at(place, error, tmp_path, monkeypatch):
    path = two(tmp_path / "run")
    monkeypatch.setattr(*place, raising(error))
    with pytest.raises(type(error)) as found:
        mpsim.Simulation.resume(path)
    assert found.value is error


@pytest.fixture
def alarms_raise():
    """An alarm ends what is being done by a TimeoutError."""

    def ring(*_):
        raise TimeoutError("the user's alarm")

    before = signal.signal(signal.SIGALRM, ring)
    yield
    signal.signal(signal.SIGALRM, before)


@pytest.mark.usefixtures("alarms_raise")
def test_an_alarm_at_any_call_while_a_checkpoint_is_read_is_passed_on(tmp_path):
    """A handler of a signal runs between two steps of Python: here it raises as each function is entered, in turn."""
    path = two(tmp_path / "run")
    limit, other = 1, []
    while True:
        calls, where = 0, ""

        def trace(frame, event, argument):
            nonlocal calls, where
            calls += 1
            if calls == limit:  # noqa: B023 - used at once
                where = frame.f_code.co_qualname if hasattr(frame.f_code, "co_qualname") else frame.f_code.co_name
                signal.raise_signal(signal.SIGALRM)

        sys.settrace(trace)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                warnings.filterwarnings("ignore", "unclosed file", ResourceWarning)  # that was just opened
                found = checkpoint._unpacked(path)
        except TimeoutError:
            found = None
        except Exception as error:
            found, other = None, [*other, (where, repr(error))]
        finally:
            sys.settrace(None)
        if found:
            break
        limit += 1
    assert limit > 100, "so few calls test little"
    assert not other


def test_a_real_alarm_while_a_checkpoint_is_read_is_passed_on(tmp_path, monkeypatch):
    path = two(tmp_path / "run")
    whole = archive.ArrayFile.read

    def slow(*arguments):
        time.sleep(5)
        return whole(*arguments)

    def impatient(*_):
        raise TimeoutError("the user's alarm")

    monkeypatch.setattr(archive.ArrayFile, "read", slow)
    assert threading.current_thread() is threading.main_thread()
    before = signal.signal(signal.SIGALRM, impatient)
    signal.setitimer(signal.ITIMER_REAL, 0.1)
    try:
        with pytest.raises(TimeoutError, match="the user's alarm"):
            mpsim.Simulation.resume(path)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def test_a_folder_a_pipe_or_a_file_for_a_folder_is_no_damage(tmp_path):
    path = two(tmp_path / "run")
    path.unlink()
    path.mkdir()
    with pytest.raises(mpsim.CheckpointError, match=r"Is a directory\. It may be undamaged"):
        mpsim.Simulation.resume(path)
    path.rmdir()
    os.mkfifo(path)
    with pytest.raises(mpsim.CheckpointError, match="it is a named pipe, not a file"):
        mpsim.Simulation.resume(path)
    with pytest.raises(mpsim.CheckpointError, match="Not a directory"):
        mpsim.Simulation.resume(tmp_path / "run.previous" / "run")
    path.unlink()
    with pytest.warns(mpsim.errors.CheckpointWarning, match="no such file"):
        assert frame_in(path) == 2


HEADERS = {
    "minus signs": b"-" * 9000 + b"1",
    "brackets": b"[" * 9000,
    "a sum": b"1+" * 4000 + b"1",
    "another order of axes": b"{'descr': '<f8', 'fortran_order': True, 'shape': (5, 2), }\n",
    "objects": b"{'descr': '|O', 'fortran_order': False, 'shape': (5, 2), }\n",
    "a number that is too long": b"{'descr': '<f8', 'fortran_order': False, 'shape': (" + b"9" * 5000 + b",), }\n",
    "a dtype that is none": b"{'descr': '<f3', 'fortran_order': False, 'shape': (5, 2), }\n",
}


@pytest.mark.parametrize("name", HEADERS)
def test_the_header_of_an_array_is_not_evaluated(name, tmp_path):
    """Minus signs in it ended in a MemoryError, which is not to be told from a real one."""
    text = HEADERS[name]
    path = two(tmp_path / "run")
    member = b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + bytes(80)
    rewrite_members(path, lambda members: members.update({"solver.position.npy": member}))
    with pytest.warns(mpsim.errors.CheckpointWarning, match="Continuing from the previous one"):
        assert frame_in(path) == 2


# --- overwriting


def read_bytes():
    """What this process has read from files so far."""
    lines = Path("/proc/self/io").read_text().splitlines()
    return int(dict(line.split(": ") for line in lines)["rchar"])


def test_overwriting_a_checkpoint_does_not_read_the_one_that_is_there(tmp_path):
    read = []
    for _ in range(3):
        before = read_bytes()
        saved(tmp_path / "run", lattice(100, 100), frames=0)
        read.append(read_bytes() - before)
    size = (tmp_path / "run").stat().st_size
    assert size > 500_000
    assert max(read[1:]) < read[0] + size / 10


@pytest.mark.long
@pytest.mark.timeout(900)
def test_overwriting_a_checkpoint_takes_no_longer_than_writing_it(tmp_path, figures):
    """10^6 discs, five pairs in turns."""
    times = {"first": [], "again": []}
    with mpsim.Simulation(lattice(1000, 1000), mpsim.Settings(dt=0.01, method="grid")) as sim:
        for turn in range(6):
            for found in times.values():
                started = time.perf_counter()
                sim.save(tmp_path / f"run{turn}")
                found.append(time.perf_counter() - started)
            for path in tmp_path.iterdir():
                path.unlink()
    first, again = (sorted(each[1:])[2] for each in times.values())  # the first pair warms up
    ratio = again / first
    figures.note("R19", "grid", "overwriting against writing, 10^6 discs", "a ratio of at most 1.15", f"{ratio:.2f}")
    assert ratio <= 1.15


def test_a_checkpoint_that_is_damaged_inside_costs_none_that_is_whole(tmp_path):
    """It ends as it should, so it becomes the previous one, after the new one stands."""
    path = two(tmp_path / "run")
    content = bytearray(path.read_bytes())
    content[content.index(b"solver.position.npy") + 200] ^= 1  # behind some 170 bytes of headers
    path.write_bytes(content)
    saved(path, frames=5)
    assert frame_in(path) == 5
    with pytest.raises(mpsim.CheckpointError):
        frame_in(tmp_path / "run.previous")
