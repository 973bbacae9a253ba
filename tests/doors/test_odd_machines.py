"""Machines that lack or forbid something: a sentence that says what, nothing lost, or no need of it."""

import errno
import os
import re
import resource

import pytest
from support.processes import assert_clean, run_script
from support.scenes import gas, simulate

import mpsim

pytestmark = pytest.mark.compiled  # workers

SCENE = gas(20, 0.2, seed=1)


@pytest.fixture
def saved(tmp_path):
    """A simulation at frame 30 and its path, where checkpoints of frames 20 and 10 lie."""
    path = tmp_path / "run.mpsim"
    with simulate(SCENE, method="naive") as sim:
        for _ in range(2):
            sim.run(frames=10)
            sim.save(path)
        sim.run(frames=10)
        yield sim, path


def frames(path):
    return [mpsim.Simulation.resume(each).frame for each in (path, f"{path}.previous")]


@pytest.mark.parametrize(
    ("call", "number"), [("open", errno.EROFS), *((call, errno.EIO) for call in ("link", "replace", "fsync"))]
)
def test_whatever_a_disk_answers_while_a_checkpoint_is_saved_the_words_are_true(call, number, saved, monkeypatch):
    sim, path = saved
    real, old = getattr(os, call), {each: each.read_bytes() for each in path.parent.iterdir()}
    failures = 0
    for failing in range(9):  # the first call, then the second ...
        calls = iter(range(100))

        def fail(*arguments, failing=failing, calls=calls, **options):
            if next(calls) == failing:
                raise OSError(number, os.strerror(number))
            return real(*arguments, **options)

        with monkeypatch.context() as patch:
            patch.setattr(os, call, fail)
            try:
                sim.save(path)
                expected = [[30, 20]]
            except mpsim.errors.OutputError as error:
                untouched, failures = "untouched" in str(error), failures + 1
                expected = [[20, 10]] if untouched else [[30, 20], [30, 10]] if "it is written" in str(error) else []
        assert frames(path) in expected
        for each, content in old.items():
            each.write_bytes(content)
        assert set(path.parent.iterdir()) == set(old), "a draft is left"
    assert failures > 0


REAPED = """
import os, signal
import mpsim
from support.scenes import lattice, simulate

def reap(*_):
    try:
        while os.waitpid(-1, os.WNOHANG) != (0, 0):
            pass
    except ChildProcessError:
        pass

signal.signal(signal.SIGCHLD, {handler})
for kill in (False, True):
    try:
        with simulate(lattice(20, 20), method="parallel", workers=2, start_method="fork") as sim:
            if kill:
                os.kill(sim.pids[0], signal.SIGKILL)
            print(sim.run(frames=10**6 if kill else 3).workers)
    except mpsim.WorkerDiedError as death:
        print(death)
print(len([name for name in os.listdir("/dev/shm") if name.startswith(f"mpsim-{{os.getpid()}}-")]))
"""


@pytest.mark.parametrize("handler", ["signal.SIG_IGN", "reap"])
def test_workers_whose_ends_the_program_takes_for_itself_are_closed_and_named(handler):
    """A server that is process 1, or was started with SIGCHLD ignored: Python then takes dead children for alive."""
    outcome = run_script(REAPED.format(handler=handler), warm=True)
    assert_clean(outcome)
    workers, death, blocks = outcome.out.splitlines()
    assert (workers, blocks) == ("2", "0")
    assert re.match(r"worker 1 \(process \d+\) ended by (an unknown cause|signal 9)", death)


@pytest.mark.parametrize("method", ["naive", "grid", "event"])
def test_a_limit_of_file_sizes_concerns_no_method_of_one_process(method):
    """`ulimit -f`. It counts for shared memory, too."""
    with simulate(SCENE, method=method) as sim:
        sim.run(frames=3)
        digest = sim.digest()
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, before[1]))
    try:
        with simulate(SCENE, method=method) as sim:
            sim.run(frames=3)
            assert sim.digest() == digest
        with pytest.raises(
            mpsim.errors.SharedMemoryError, match=r"bytes in one file; .* files of 4,096\. .* \(ulimit -f\)"
        ):
            simulate(SCENE, method="parallel", workers=2)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
