"""The system says no: an error of mpsim that names sizes and a remedy, and nothing is left of what it did give."""

import contextlib
import errno
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
    except mpsim.ResourceError as error:
        return str(error)
    return None


def started_before(method):
    """What is made once and kept: machine code, the fork server, the resource tracker."""
    simulate(lattice(9, 9), method=method, workers=3).close()
    return left()


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
        pytest.raises(mpsim.MpsimError, match=r"(?s)worker 1.*Cannot allocate") as caught,
    ):
        simulate(scene, method="parallel", workers=3, start_method="fork")
    del caught
    assert left() == before


ERRORS = {
    errno.EROFS: "Read-only file system",
    errno.EACCES: "Permission denied",
    errno.ENOENT: "No such file or directory",
    errno.ENFILE: "the whole machine",
    errno.ENOSPC: "--shm-size=",
}


@pytest.mark.parametrize("number", ERRORS)
@pytest.mark.parametrize("method", long_but(METHODS, "grid"))
def test_whatever_the_system_answers_is_named(method, number, monkeypatch):
    def refuse(*_, **__):
        raise OSError(number, os.strerror(number))

    before = started_before(method)
    monkeypatch.setattr("_posixshmem.shm_open", refuse)
    for _ in range(5):
        with pytest.raises(mpsim.SharedMemoryError, match=r"^the shared block needs [\d,]+ bytes") as caught:
            simulate(lattice(9, 9), method=method, workers=3)
        assert ERRORS[number] in str(caught.value)
        assert isinstance(caught.value, OSError)
        del caught
        assert left() == before


def test_a_process_that_cannot_be_started_is_named(monkeypatch):
    def refuse(*_):
        raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))

    before = started_before("parallel")
    monkeypatch.setattr("multiprocessing.popen_forkserver.Popen._launch", refuse)
    with pytest.raises(mpsim.ResourceError, match=r"^worker 1 could not be started: .*ulimit -u.*method='grid'"):
        simulate(lattice(9, 9), method="parallel", workers=3)
    assert left() == before


READ_ONLY = ["unshare", "--mount", "sh", "-c", 'mount -t tmpfs -o ro tmpfs /dev/shm && exec "$@"', "sh"]


@pytest.mark.parametrize("method", long_but(METHODS, "parallel"))
def test_a_read_only_dev_shm_is_an_error_that_says_so(method):
    try:
        subprocess.run([*READ_ONLY, "true"], check=True, capture_output=True, timeout=20)
    except (OSError, subprocess.CalledProcessError) as error:
        pytest.skip(f"no private mount can be made here: {error}")
    outcome = run_script(
        f"""
        import os
        import mpsim
        from support.scenes import lattice, simulate

        counts = []
        for _ in range(5):
            try:
                simulate(lattice(9, 9), method="{method}", workers=2)
            except mpsim.SharedMemoryError as error:
                text = str(error)
            counts.append(len(os.listdir("/proc/self/fd")))
        print(text)
        print(len(set(counts)))
        """,
        prefix=READ_ONLY,
    )
    assert_clean(outcome)
    text, counts = outcome.out.splitlines()
    assert "Read-only file system" in text
    assert "remount,rw /dev/shm" in text
    assert counts == "1", "descriptors leak"
