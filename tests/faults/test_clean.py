"""Blocks of dead owners are found and removed, those of the living never."""

import fcntl
import os
import signal
import stat
import subprocess
import sys
import time

import psutil
import pytest
from click.testing import CliRunner
from support.internals import block_name
from support.processes import SHARED_MEMORY, Script, blocks_of, run_script, wait_until
from support.scenes import lattice, simulate

from mpsim.cli.app import main
from mpsim.engine.workers import shared


@pytest.fixture
def dead_pid():
    """Number of a process that has ended."""
    process = subprocess.Popen([sys.executable, "-c", "pass"])
    process.wait()
    return process.pid


def leave(folder, name, size=5000, age=0.0):
    """A file that looks like a block, made so many seconds ago."""
    path = folder / name
    path.write_bytes(bytes(size))
    moment = time.time() - age
    os.utime(path, (moment, moment))
    return path


def names(blocks):
    return [block.name for block in blocks]


def test_only_blocks_of_dead_owners_are_removed(tmp_path, dead_pid, figures):
    stale = leave(tmp_path, f"mpsim-{dead_pid}-0123abcd")
    others = [
        leave(tmp_path, f"mpsim-{os.getpid()}-0123abcd"),  # ours: alive
        leave(tmp_path, "mpsim-1-0123abcd"),
        leave(tmp_path, f"mpsim-{dead_pid}-0123abcd.bak"),
        leave(tmp_path, f"mpsim-{dead_pid}-short"),
        leave(tmp_path, f"other-{dead_pid}-0123abcd"),
        leave(tmp_path, "psm_0123abcd"),
    ]
    os.mkfifo(tmp_path / f"mpsim-{dead_pid}-00000000.fifo")
    assert shared.stale_blocks(tmp_path) == [shared.StaleBlock(stale.name, dead_pid, 5000)]
    assert stale.exists()
    assert names(shared.remove_stale_blocks(tmp_path)) == [stale.name]
    assert not stale.exists()
    assert all(path.exists() for path in others)
    assert shared.remove_stale_blocks(tmp_path) == []
    figures.note(
        "R12",
        "",
        "blocks of dead owners, among other blocks",
        "only they are removed",
        f"1 removed, {len(others)} kept",
    )


def test_a_lock_tells_of_an_owner_whose_number_means_nothing_here(tmp_path, dead_pid):
    """As in containers that share /dev/shm and not their processes."""
    path = leave(tmp_path, f"mpsim-{dead_pid}-0123abcd")
    with path.open("rb+") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        assert shared.remove_stale_blocks(tmp_path) == []
    assert names(shared.remove_stale_blocks(tmp_path)) == [path.name]


def test_a_number_that_another_process_has_by_now_protects_nothing(tmp_path):
    """The block is older than the process with its owner's number."""
    age = time.time() - psutil.Process().create_time()
    path = leave(tmp_path, f"mpsim-{os.getpid()}-0123abcd", age=age + 3600)
    young = leave(tmp_path, f"mpsim-{os.getpid()}-89abcdef", age=age + 1)
    assert names(shared.remove_stale_blocks(tmp_path)) == [path.name]
    assert young.exists(), "within the precision of clocks, the doubt is for the block"


def test_a_zombie_owns_nothing(tmp_path):
    pid = os.fork()
    if pid == 0:
        os._exit(0)
    try:
        assert wait_until(lambda: psutil.Process(pid).status() == psutil.STATUS_ZOMBIE, 5)
        path = leave(tmp_path, f"mpsim-{pid}-0123abcd")
        assert names(shared.remove_stale_blocks(tmp_path)) == [path.name]
    finally:
        os.waitpid(pid, 0)


def test_links_are_not_followed(tmp_path, dead_pid):
    (tmp_path / "precious").write_bytes(b"mine")
    (tmp_path / f"mpsim-{dead_pid}-0123abcd").symlink_to(tmp_path / "precious")
    assert shared.remove_stale_blocks(tmp_path) == []


@pytest.mark.slow
@pytest.mark.parametrize("method", ["naive", "grid", "parallel", "event"])
def test_a_block_belongs_to_its_user_alone_and_is_locked(method):
    with simulate(lattice(9, 9), method=method, workers=2) as sim:
        path = SHARED_MEMORY / block_name(sim)
        status = path.stat()
        assert stat.S_IMODE(status.st_mode) == 0o600
        assert status.st_uid == os.getuid()
        with path.open("rb") as file, pytest.raises(BlockingIOError):
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        assert path.name not in names(shared.remove_stale_blocks())
        assert sim.run(frames=2).frames == 2
        sim.run(frames=1, measures=["pressure"])  # another block
        with (SHARED_MEMORY / block_name(sim)).open("rb") as file, pytest.raises(BlockingIOError):
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


LEFT = """
import os, time
from multiprocessing import resource_tracker
from support.scenes import lattice, simulate

sim = simulate(lattice(9, 9), method="parallel", workers=2, start_method="fork")
print(resource_tracker._resource_tracker._pid)
time.sleep(100)
"""


@pytest.fixture
def living():
    """A block of a simulation that lives on, which no cleaning may touch."""
    with simulate(lattice(3, 3), method="grid") as sim:
        yield SHARED_MEMORY / block_name(sim)


def test_mpsim_clean_removes_what_a_killed_program_and_its_helper_leave(living, figures):
    with Script(LEFT) as script:
        tracker = int(script.line())
        (name,) = blocks_of(script.pid)
        assert name not in CliRunner().invoke(main, ["clean", "--dry-run"]).output
        os.kill(tracker, signal.SIGKILL)
        script.send_to_group(signal.SIGKILL)
        script.finish(10)
    assert blocks_of(script.pid) == {name}, "something else has removed it, so this tests nothing"
    tried = CliRunner().invoke(main, ["clean", "--dry-run"])
    assert tried.exit_code == 0
    assert f"{name}  " in tried.output
    assert "would be removed" in tried.output
    assert blocks_of(script.pid) == {name}
    done = CliRunner().invoke(main, ["clean"])
    assert f"of process {script.pid}" in done.output
    assert " removed, " in done.output
    assert blocks_of(script.pid) == set()
    assert living.exists()
    figures.note(
        "R12",
        "parallel on 2",
        "coordinator, worker and resource tracker killed at once",
        "`mpsim clean` removes the block",
        "as expected",
    )


def test_a_program_that_ends_without_closing_ends():
    """Also one that has imported mpsim before multiprocessing, whose own end would wait for the workers for ever."""
    outcome = run_script(
        """
        import mpsim
        from support.scenes import lattice
        sim = mpsim.Simulation(lattice(20, 20), mpsim.Settings(method="parallel", workers=2), start_method="fork")
        sim.run(frames=2)
        raise SystemExit(3)
        """,
        bound=20,
    )
    assert (outcome.code, outcome.err) == (3, "")
