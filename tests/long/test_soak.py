"""Hundreds of simulations in one process, however they begin and end: nothing of them stays."""

import pytest
from support.processes import assert_clean, run_script

pytestmark = pytest.mark.long

SOAK = """
import gc, logging, os, random, signal, tempfile, threading, time, warnings
import psutil
import mpsim
from support.scenes import lattice, simulate, zoo

FEATURES = ["", "gravity", "radii masses", "periodic", "obstacles lossy", "emitters", "piston", "absorbing radii"]
leaks = []

class Interrupting:
    every = 2

    def observe(self, sim, collisions):
        raise KeyboardInterrupt

def scene_of(rng, method):
    return lattice(6, 6) if method == "event" else zoo(rng.choice(FEATURES), count=20)

def started(rng, **more):
    method = rng.choice(["naive", "grid", "event", "parallel"])
    start = rng.choice(["fork", "spawn", "forkserver"]) if rng.random() < 0.2 else "forkserver"
    sim = simulate(scene_of(rng, method), method=method, workers=rng.choice([1, 2, 3]), start_method=start, **more)
    sim.run(frames=3)
    return sim

def closed(rng, place):
    started(rng).close()

def dropped(rng, place):
    started(rng)

def kept_in_a_circle(rng, place):
    circle = [started(rng)]
    circle.append(circle)

def resumed(rng, place):
    with started(rng) as sim:
        sim.save(place)
    with mpsim.Simulation.resume(place, workers=2) as sim:
        sim.run(frames=2)

def interrupted(rng, place):
    with started(rng) as sim:
        try:
            sim.run(frames=10, observe=Interrupting())
        except KeyboardInterrupt:
            sim.run(frames=1)

def killed(rng, place):
    with started(rng, on_worker_death=rng.choice(["raise", "restart"])) as sim:
        for pid in sim.pids[:1]:
            os.kill(pid, signal.SIGKILL)
        try:
            sim.run(frames=5)
        except mpsim.WorkerDiedError:
            pass

def refused(rng, place):
    scene = mpsim.Scene(width=9, height=9, position=[[2, 2]], velocity=[[1e300, 0]], radius=0.5)
    try:
        mpsim.Simulation(scene, mpsim.Settings(method="parallel", workers=2))
    except mpsim.InputError:
        pass

def in_a_thread(rng, place):
    thread = threading.Thread(target=closed, args=(rng, place))
    thread.start()
    thread.join()

def forked(rng, place):
    with started(rng) as sim:
        child = os.fork()
        if not child:
            try:
                closed(rng, place)
            finally:
                os._exit(0)
        sim.run(frames=2)
        assert os.waitpid(child, 0)[1] == 0

def leaking(rng, place):
    leaks.append((started(rng), bytearray(2**23)))

def held():
    '''Descriptors, blocks, threads, and processes other than the two that Python keeps: tracker and fork server.'''
    gc.collect()
    me = psutil.Process()
    blocks = [name for name in os.listdir("/dev/shm") if name.startswith(f"mpsim-{{os.getpid()}}-")]
    return me.num_fds(), len(blocks), threading.active_count(), len(me.children(recursive=True))

acts = {acts}
warnings.simplefilter("ignore")
logging.getLogger("mpsim").setLevel(logging.ERROR)
place = tempfile.mkdtemp() + "/run.mpsim"
for act in acts:  # what is made once: fork server, tracker, compiled kernels
    act(random.Random(0), place)
before = held()
for number in range({simulations}):
    if number == {settled}:
        memory = psutil.Process().memory_info().rss
    rng = random.Random(number)
    rng.choice(acts)(rng, place)
wait = time.monotonic() + 5
while (after := held()) != before and time.monotonic() < wait:
    time.sleep(0.1)
print(before == after, (psutil.Process().memory_info().rss - memory) // 2**20, *before, *after)
for sim, _ in leaks:
    sim.close()
"""

ACTS = "[closed, dropped, kept_in_a_circle, resumed, interrupted, killed, refused, in_a_thread, forked]"
MOST_GROWTH = 4  # MiB that a process may grow by, once it has read the kernels of all combinations of features


def soak(simulations, acts=ACTS, settled=0):
    script = SOAK.format(simulations=simulations, acts=acts, settled=settled)
    outcome = run_script(script, flags=(), bound=60 + 4 * simulations)
    assert_clean(outcome)
    equal, growth, *numbers = outcome.out.split()
    return equal == "True", int(growth), list(map(int, numbers))


@pytest.mark.timeout(3000)
def test_nothing_stays_of_many_simulations():
    equal, growth, numbers = soak(600, settled=100)
    words = f"descriptors, blocks, threads, processes: {numbers[:4]} before, {numbers[4:]} after"
    assert equal, words
    assert growth < MOST_GROWTH, f"it grew by {growth} MiB"
    equal, growth, numbers = soak(3, "[leaking]")
    assert not equal, "the control: simulations that are kept"
    assert growth > MOST_GROWTH, "memory"
    assert numbers[4] > numbers[0], "descriptors"
    assert numbers[5] > numbers[1], "blocks"
