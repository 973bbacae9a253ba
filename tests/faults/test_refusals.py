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
from support.processes import SHARED_MEMORY, assert_clean, blocks_of, is_gone, limited, refusing, run_script, wait_until
from support.scenes import digest_after, gas, lattice, simulate
from support.selection import FORKS, long_but

import mpsim

pytestmark = [pytest.mark.compiled, FORKS]

METHODS = ["naive", "grid", "parallel", "event"]


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
    """Descriptors, blocks and children of this process. Its fork server may collect those that ended a moment later."""
    wait_until(lambda: not any(is_gone(child.pid) for child in psutil.Process().children(recursive=True)), 5)
    return psutil.Process().num_fds(), blocks_of(os.getpid()), len(psutil.Process().children(recursive=True))


def begin(scene, method, **settings):
    return simulate(scene, method=method, workers=3, **settings)


def refusal_of(scene, method, **settings):
    """The text of the error with which a start is refused; None: it was not refused."""
    try:
        begin(scene, method, **settings).close()
    except mpsim.errors.ResourceError as error:
        return str(error)
    return None


def started_before(method):
    """What is made once and kept: machine code, the fork server, the resource tracker."""
    begin(lattice(9, 9), method).close()
    gc.collect()  # of tests before
    return left()


def size_of_block(scene):
    with begin(scene, "grid"):
        (name,) = blocks_of(os.getpid())
        size = (SHARED_MEMORY / name).stat().st_size
    gc.collect()  # else a limit that is taken from the memory in use may be reached later
    return size


@pytest.mark.parametrize("method", long_but(METHODS, "grid", "parallel"))
def test_too_few_descriptors_are_an_error_with_numbers_and_nothing_leaks(method):
    """With none to spare, with one, with two ... until there are enough."""
    before = started_before(method)
    refusals = 0
    while True:
        with descriptors_to_spare(refusals) as limit:
            text = refusal_of(lattice(9, 9), method)
        assert left() == before, f"with {refusals} descriptors to spare"
        if text is None:
            break
        assert f"this process may have {limit:,}" in text, text
        assert "ulimit -n" in text
        refusals += 1
    assert refusals > 1, "the control: some starts were refused"


@pytest.mark.parametrize("method", long_but(["grid", "parallel"], "grid"))
def test_too_little_address_space_is_an_error_with_sizes_and_nothing_leaks(method):
    """A forked worker gives back its copy of the block before it maps it, and needs no more than this process."""
    before, size = started_before(method), size_of_block(scene := lattice(1000, 300))
    with limited(resource.RLIMIT_AS, psutil.Process().memory_info().vms + size // 2):
        text = refusal_of(scene, method)
    gc.collect()
    assert text is not None, "the control: the limit was too high"
    assert re.match(r"the shared block needs [\d,]+ bytes", text)
    assert "ulimit -v" in text
    with limited(resource.RLIMIT_AS, psutil.Process().memory_info().vms + size + size // 2):
        assert refusal_of(scene, "parallel", start_method="fork") is None
    assert left() == before


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::mpsim.FastWarning")  # of a disc that is added where others are
def test_a_worker_that_cannot_map_a_larger_block_is_an_error_of_mpsim_and_nothing_leaks():
    """The simulation is then between two blocks, and so is closed. The control: without the limit it goes on."""
    before = started_before("parallel")
    for refused in (False, True):
        with begin(lattice(9, 9), "parallel") as sim:
            sim.run(frames=3)
            if not refused:
                sim.add((5.0, 5.0), (0.0, 0.0))
                assert sim.run(frames=1).frames == 1
                continue
            worker = psutil.Process(sim.pids[1])
            worker.rlimit(psutil.RLIMIT_AS, (worker.memory_info().vms // 2,) * 2)
            with pytest.raises(
                mpsim.errors.SharedMemoryError, match=r"^worker 2 .* needs [\d,]+ bytes .*ulimit -v"
            ) as caught:
                sim.add((5.0, 5.0), (0.0, 0.0))
            del caught
            with pytest.raises(mpsim.errors.ClosedError, match="after frame 3"):
                sim.state  # noqa: B018
    assert left() == before


ERRORS = {
    errno.EROFS: "Read-only file system",
    errno.EACCES: "Permission denied",
    errno.ENOENT: "No such file or directory",
    errno.ENFILE: "the whole machine",
    errno.ENOSPC: "--shm-size=",
}


def test_whatever_the_system_answers_is_named(monkeypatch):
    """And a process that cannot be started."""
    before = started_before("parallel")
    for number, words in ERRORS.items():
        with monkeypatch.context() as patch:
            patch.setattr("_posixshmem.shm_open", refusing(number))
            for _ in range(3):
                with pytest.raises(mpsim.errors.SharedMemoryError, match=r"^the shared block needs [\d,]+ b") as caught:
                    begin(lattice(9, 9), "parallel")
                assert words in str(caught.value)
                assert isinstance(caught.value, OSError)
                del caught
                assert left() == before, "nothing leaks"
    monkeypatch.setattr("multiprocessing.popen_forkserver.Popen._launch", refusing(errno.EAGAIN))
    rule = r"^worker 1 could .* started: .*ulimit -u.*'grid', which starts no w"
    with pytest.raises(mpsim.errors.ResourceError, match=rule):
        begin(lattice(9, 9), "parallel")
    assert left() == before


def test_discs_whose_workers_are_refused_are_not_added(monkeypatch):
    """`auto` goes from naive to parallel as discs are added."""
    before, whole = started_before("parallel"), lattice(20, 20)
    box = {"width": whole.width, "height": whole.height, "radius": 0.5}
    scene = mpsim.Scene(position=whole.position[:144], velocity=whole.velocity[:144], **box)
    with begin(scene, "auto") as sim:
        sim.run(frames=1)
        digest = sim.digest()
        with monkeypatch.context() as patch:
            patch.setattr("multiprocessing.popen_forkserver.Popen._launch", refusing(errno.EAGAIN))
            with pytest.raises(mpsim.errors.ResourceError, match=r"^worker 1 could"):
                sim.add(whole.position[200:300], whole.velocity[200:300])
        assert (sim.count, sim.digest(), sim.pids) == (144, digest, [])
        assert sim.run(frames=1).method == "naive"
        sim.add(whole.position[200:300], whole.velocity[200:300])
        assert (sim.count, len(sim.pids)) == (244, 2)
    assert left() == before


# --- a /dev/shm of one's own


def with_shared_memory(options, text):
    """Run a script that sees a /dev/shm of its own."""
    prefix = ["unshare", "--mount", "sh", "-c", f'mount -t tmpfs -o {options} tmpfs /dev/shm && exec "$@"', "sh"]
    try:
        subprocess.run([*prefix, "true"], check=True, capture_output=True, timeout=20)
    except (OSError, subprocess.CalledProcessError) as error:
        pytest.skip(f"no private mount can be made here: {error}")
    outcome = run_script(text, prefix=prefix)
    assert_clean(outcome)
    return outcome.out.splitlines()


@pytest.mark.slow
def test_a_read_only_dev_shm_is_an_error_that_says_so_or_is_not_needed():
    """Methods of one process take private memory, with the same bits."""
    text, counts, *alone = with_shared_memory(
        "ro",
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
            with simulate(lattice(9, 9), method=method) as sim:
                sim.run(frames=3)
                print(method, sim.digest())
        """,
    )
    assert "Read-only file system" in text
    assert "remount,rw" in text
    assert counts == "1", "descriptors leak"
    assert [line.split()[1] for line in alone] == [
        digest_after(lattice(9, 9), 3, method=method) for method in ("naive", "grid", "event")
    ]


def test_too_little_shared_memory_is_an_error_with_sizes_and_keeps_a_simulation_that_is_to_grow():
    """Before any worker starts; never a SIGBUS."""
    size = 2 * 2**20
    error, rest, ran, *grown = with_shared_memory(
        f"size={size}",
        """
        import os
        import warnings
        import mpsim
        from support.scenes import lattice, simulate

        warnings.simplefilter("ignore", mpsim.FastWarning)  # of discs that are added where others are
        for method in ("parallel", "grid"):
            try:
                with simulate(lattice(1000, 100), method=method, workers=2) as sim:
                    print(sim.run(frames=3).frames)
            except mpsim.errors.SharedMemoryError as error:
                print(error)
                print(os.listdir("/dev/shm"))
        scene, more = lattice(60, 60), lattice(60, 60)
        with simulate(scene, method="parallel", workers=2) as sim:
            sim.run(frames=3)
            try:
                for _ in range(20):
                    sim.add(more.position, more.velocity)
            except mpsim.errors.SharedMemoryError as error:
                print("refused")
            before = sim.state
            for number in (1, 20, 500):
                try:
                    sim.add(more.position[:number], more.velocity[:number])
                except mpsim.errors.SharedMemoryError as error:
                    print("refused again")
            assert (sim.count, sim.digest()) == (len(before.position), before.digest())
            sim.run(frames=3)
            assert sim.frame == 6
        print(os.listdir("/dev/shm"))
        """,
    )
    needed, free = (int(number.replace(",", "")) for number in re.findall(r"([\d,]+) bytes", error))
    assert needed > size >= free > size / 2, error
    assert "--shm-size=" in error
    assert "fewer discs" in error
    assert (rest, ran) == ("[]", "3")
    assert grown == ["refused", *["refused again"] * 3, "[]"]


# --- machines that lack or forbid something

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
    digest, rule = digest_after(SCENE, 3, method=method), r"^the shared block needs [\d,]+ bytes .*ulimit -f"
    with limited(resource.RLIMIT_FSIZE, 4096):
        assert digest_after(SCENE, 3, method=method) == digest
        with pytest.raises(mpsim.errors.SharedMemoryError, match=rule):
            simulate(SCENE, method="parallel", workers=2)
