"""The system says no: an error of mpsim that names sizes and a remedy, and nothing is left of what it did give."""

import contextlib
import errno
import gc
import os
import re
import resource
import subprocess

import psutil
import pytest
from support.internals import block_name
from support.processes import SHARED_MEMORY, assert_clean, blocks_of, run_script
from support.scenes import lattice, simulate
from support.selection import long_but

import mpsim

METHODS = ["naive", "grid", "parallel", "event"]


@contextlib.contextmanager
def limited(kind, soft):
    """A limit of this process."""
    before = resource.getrlimit(kind)
    resource.setrlimit(kind, (soft, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(kind, before)


@contextlib.contextmanager
def descriptors_to_spare(number):
    """Leave this process so many descriptors and no more; gives the limit that does it."""
    highest = max(int(name) for name in os.listdir("/proc/self/fd") if os.path.exists(f"/proc/self/fd/{name}"))
    fillers = [os.open(os.devnull, os.O_RDONLY)]
    while fillers[-1] < highest:
        fillers.append(os.open(os.devnull, os.O_RDONLY))
    os.close(fillers.pop())  # the first beyond
    try:
        with limited(resource.RLIMIT_NOFILE, highest + 1 + number):
            yield highest + 1 + number
    finally:
        for filler in fillers:
            os.close(filler)


def left():
    """Descriptors, blocks and children of this process."""
    return psutil.Process().num_fds(), blocks_of(os.getpid()), len(psutil.Process().children(recursive=True))


def refusal_of(scene, method):
    """The text of the error with which a start is refused; None: it was not refused."""
    try:
        simulate(scene, method=method, workers=3).close()
    except mpsim.errors.ResourceError as error:
        return str(error)
    return None


def started_before(method):
    """What is made once and kept: machine code, the fork server, the resource tracker."""
    simulate(lattice(9, 9), method=method, workers=3).close()
    gc.collect()  # of tests before
    return left()


@pytest.mark.slow
@pytest.mark.parametrize("method", long_but(METHODS, "grid", "parallel"))
def test_too_few_descriptors_are_an_error_with_numbers_and_nothing_leaks(method):
    """With none to spare, with one, with two ... until there are enough."""
    before = started_before(method)
    refusals, spare = 0, 0
    while True:
        with descriptors_to_spare(spare) as limit:
            text = refusal_of(lattice(9, 9), method)
        assert left() == before, f"with {spare} descriptors to spare"
        if text is None:
            break
        assert f"this process may have {limit:,}" in text, text
        assert "ulimit -n" in text
        refusals, spare = refusals + 1, spare + 1
    assert refusals > 1, "the control: some starts were refused"
    with simulate(lattice(9, 9), method=method, workers=3) as sim:
        assert sim.run(frames=2).frames == 2


@pytest.mark.slow
@pytest.mark.parametrize("method", long_but(METHODS, "grid", "event", "parallel"))
def test_too_little_address_space_is_an_error_with_sizes_and_nothing_leaks(method):
    before, scene = started_before(method), lattice(1000, 300)
    with simulate(scene, method=method) as sim:
        size = (SHARED_MEMORY / block_name(sim)).stat().st_size
    limit = psutil.Process().memory_info().vms + size // 2
    with limited(resource.RLIMIT_AS, limit):
        text = refusal_of(scene, method)
    assert text is not None, "the control: the limit was too high"
    assert f"may have {limit:,} bytes" in text
    assert re.match(r"the shared block needs [\d,]+ bytes of address space; ", text), text
    assert "ulimit -v" in text
    assert left() == before


def test_too_little_address_space_for_a_worker_is_an_error_of_mpsim_and_nothing_leaks():
    """A worker that is forked has all that its coordinator has, and maps the block once more."""
    before, scene = started_before("parallel"), lattice(1000, 300)
    with simulate(scene, method="grid") as sim:
        size = (SHARED_MEMORY / block_name(sim)).stat().st_size
    limit = psutil.Process().memory_info().vms + size + size // 2
    with (
        limited(resource.RLIMIT_AS, limit),
        pytest.raises(
            mpsim.errors.SharedMemoryError, match=rf"^worker 1 .* bytes of .* may have {limit:,} .*-v"
        ) as caught,
    ):
        simulate(scene, method="parallel", workers=3, start_method="fork")
    del caught
    assert left() == before


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::mpsim.FastWarning")  # of a disc that is added where others are
@pytest.mark.parametrize("refused", [False, True])
def test_a_worker_that_cannot_map_a_larger_block_is_an_error_of_mpsim_and_nothing_leaks(refused):
    """The simulation is then between two blocks, and so is closed."""
    before = started_before("parallel")
    with simulate(lattice(9, 9), method="parallel", workers=3) as sim:
        frames = sim.run(frames=3).frames
        worker = psutil.Process(sim.pids[1])
        if refused:
            worker.rlimit(psutil.RLIMIT_AS, (worker.memory_info().vms // 2,) * 2)
            with pytest.raises(mpsim.errors.SharedMemoryError, match=r"^worker 2 .* bytes of address space") as caught:
                sim.add((5.0, 5.0), (0.0, 0.0))
            del caught
            with pytest.raises(mpsim.errors.ClosedError, match="after frame 3"):
                sim.state  # noqa: B018
        else:
            sim.add((5.0, 5.0), (0.0, 0.0))  # the control
            frames += sim.run(frames=1).frames
        assert sim.frame == frames
    assert left() == before


ERRORS = {
    errno.EROFS: "Read-only file system",
    errno.EACCES: "Permission denied",
    errno.ENOENT: "No such file or directory",
    errno.ENFILE: "the whole machine",
    errno.ENOSPC: "--shm-size=",
}


@pytest.mark.parametrize("number", ERRORS)
def test_whatever_the_system_answers_is_named(number, monkeypatch):
    def refuse(*_, **__):
        raise OSError(number, os.strerror(number))

    before = started_before("parallel")
    monkeypatch.setattr("_posixshmem.shm_open", refuse)
    for _ in range(5):
        with pytest.raises(mpsim.errors.SharedMemoryError, match=r"^the shared block needs [\d,]+ bytes") as caught:
            simulate(lattice(9, 9), method="parallel", workers=3)
        assert ERRORS[number] in str(caught.value)
        assert isinstance(caught.value, OSError)
        del caught
        assert left() == before


def test_a_process_that_cannot_be_started_is_named(monkeypatch):
    def refuse(*_):
        raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))

    before = started_before("parallel")
    monkeypatch.setattr("multiprocessing.popen_forkserver.Popen._launch", refuse)
    with pytest.raises(
        mpsim.errors.ResourceError, match=r"^worker 1 could .* started: .*ulimit -u.*'grid', which starts no w"
    ):
        simulate(lattice(9, 9), method="parallel", workers=3)
    assert left() == before


NO_PROCESSES = {
    "by the system": "os.setgid(65534), os.setuid(65534), resource.setrlimit(resource.RLIMIT_NPROC, (0, 0))",
    "by a function": "util.spawnv_passfds = refuse",
}
"""Root may start any number of processes: so the script becomes somebody else."""

WITHOUT_PROCESSES = """
import errno, os, resource
from multiprocessing import resource_tracker, util
import numpy as np
import psutil
import mpsim
from mpsim.engine.workers.arrays import ArraySpec
from mpsim.engine.workers.shared import SharedBlock
from support.processes import blocks_of

def refuse(*_):
    raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))

def make_block():
    block = SharedBlock({{"x": ArraySpec(np.dtype(float), (8,))}})
    try:
        block.create()
    finally:
        block.close()

scene = mpsim.Scene.random(count=50, packing=0.2, radius=0.5, seed=1)
scene.overlaps_at_start()  # which loads a kernel from the cache of who starts this
{before}
{refuse}
before = psutil.Process().num_fds()
for act in {acts}:
    try:
        act()
        print("done")
    except mpsim.errors.ResourceError as error:
        print(type(error).__name__, error)
print(psutil.Process().num_fds() - before, blocks_of(os.getpid()))
"""


@pytest.mark.slow
@pytest.mark.parametrize("refused", NO_PROCESSES)
def test_no_process_for_the_resource_tracker_is_an_error_that_says_so(refused):
    """The first simulation of a program starts it, whatever the method. It was an error about /dev/shm."""
    if refused == "by the system" and os.getuid() != 0:
        pytest.skip("only root can become a user without processes")
    refuse, make = NO_PROCESSES[refused], "lambda: mpsim.Simulation(scene, mpsim.Settings(method={!r}, workers=2))"
    acts = f"[{', '.join(map(make.format, METHODS))}]"
    outcome = run_script(WITHOUT_PROCESSES.format(before="", refuse=refuse, acts=acts))
    assert_clean(outcome)
    *refusals, left = outcome.out.splitlines()
    assert len(refusals) == len(METHODS)
    for text in refusals:
        assert text.startswith("ResourceError the resource tracker, a process of Python that removes shared memory ")
        assert "Resource temporarily unavailable" in text
        assert "(ulimit -u)" in text
        assert "/dev/shm" not in text
    assert left == "0 set()", "descriptors leak, or blocks"

    before = "resource_tracker.ensure_running()"
    outcome = run_script(WITHOUT_PROCESSES.format(before=before, refuse=refuse, acts="[make_block]"))
    assert_clean(outcome)
    assert outcome.out == "done\n0 set()\n", "the control: the tracker was all that was missing"


READ_ONLY = ["unshare", "--mount", "sh", "-c", 'mount -t tmpfs -o ro tmpfs /dev/shm && exec "$@"', "sh"]


def test_a_read_only_dev_shm_is_an_error_that_says_so_or_is_not_needed():
    """Methods of one process take private memory, with the same bits."""
    try:
        subprocess.run([*READ_ONLY, "true"], check=True, capture_output=True, timeout=20)
    except (OSError, subprocess.CalledProcessError) as error:
        pytest.skip(f"no private mount can be made here: {error}")
    outcome = run_script(
        """
        import os
        import mpsim
        from support.scenes import lattice, simulate

        counts = []
        for _ in range(5):
            try:
                simulate(lattice(9, 9), method="parallel", workers=2)
            except mpsim.errors.SharedMemoryError as error:
                text = str(error)
            counts.append(len(os.listdir("/proc/self/fd")))
        print(text)
        print(len(set(counts)))
        for method in ("naive", "grid", "event"):
            with mpsim.Simulation(lattice(9, 9), mpsim.Settings(method=method)) as sim:
                sim.run(frames=3)
                print(method, sim.digest())
        """,
        prefix=READ_ONLY,
    )
    assert_clean(outcome)
    text, counts, *alone = outcome.out.splitlines()
    assert "Read-only file system" in text
    assert "remount,rw /dev/shm" in text
    assert counts == "1", "descriptors leak"
    assert len(alone) == 3
    for method, digest in map(str.split, alone):
        with mpsim.Simulation(lattice(9, 9), mpsim.Settings(method=method)) as sim:
            sim.run(frames=3)
            assert sim.digest() == digest


def test_a_worker_that_cannot_map_the_block_does_not_take_it_away():
    """SharedMemory does, of whoever made it, and the tracker complains. Nor is it the worker that died."""
    outcome = run_script(
        """
        import resource, psutil
        import mpsim
        from support.internals import block_name
        from support.processes import SHARED_MEMORY
        from support.scenes import lattice, simulate

        scene = lattice(1000, 300)
        with simulate(scene, method="grid") as sim:
            size = (SHARED_MEMORY / block_name(sim)).stat().st_size
        limit = psutil.Process().memory_info().vms + size + size // 2
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
        try:
            simulate(scene, method="parallel", workers=3, start_method="fork")
        except mpsim.errors.ResourceError as error:
            print(error)
        """
    )
    assert "ulimit -v" in outcome.out
    assert "KeyError" not in outcome.err
