"""A trade that is interrupted, by Ctrl-C or by a kill, ends soon, leaves nothing behind, and is gone on with."""

import json
import signal
import threading
import time

import pytest
from support.processes import Script, assert_nothing_left_of
from support.scenes import gas

from mpsim import Settings, tradeoff
from mpsim.studies import cost, ensemble

SCENE = gas(20, 0.3)
CANDIDATES = [Settings(dt=dt, method="grid") for dt in (0.1, 0.05)]
LONG_RUNS, SHORT_RUNS = 2 * 2 + 2 * 2, 2 * 8
"""Of two replicas: two of each candidate, four of the reference; and one short run from each of eight starts."""


@pytest.fixture
def made(monkeypatch):
    """What was run, by name: the fewer of these, the more was kept."""
    runs, lock = [], threading.Lock()

    def counted(name, task):
        def run(*arguments):
            with lock:
                runs.append(name)
            return task(*arguments)

        return run

    for module, name in ((ensemble, "long_run"), (ensemble, "short_runs"), (cost, "measure")):
        monkeypatch.setattr(module, name, counted(name, getattr(module, name)))
    return runs


def trade(path, **options):
    return tradeoff(SCENE, CANDIDATES, until=5, replicas=2, path=path, **options)


@pytest.mark.slow
@pytest.mark.parametrize("after", [("accuracy", 1), ("accuracy", 13), ("timing", 1)])
def test_ctrl_c_keeps_what_is_finished_and_the_next_call_does_the_rest_alone(tmp_path, made, after):
    path = tmp_path / "kept.json"

    def press(done, of, what):
        if (what, done) == after:
            raise KeyboardInterrupt

    threads = threading.active_count()
    with pytest.raises(KeyboardInterrupt):
        trade(path, progress=press)
    assert threading.active_count() == threads, "no thread goes on"
    before = len(made)
    kept = json.loads(path.read_text())["results"]
    assert len(kept) >= after[1] + (after[0] == "timing") * (LONG_RUNS + SHORT_RUNS)
    made.clear()
    resumed = trade(path)
    assert len(made) == LONG_RUNS + SHORT_RUNS + 2 - len(kept), "what was kept is not run again"
    assert before < LONG_RUNS + SHORT_RUNS + 2, "the control: the interruption came before the end"
    made.clear()
    again = trade(path)
    assert made == []
    assert again == resumed
    assert [row.errors for row in resumed.rows] == [row.errors for row in trade(None).rows]
    assert [each.name for each in tmp_path.iterdir()] == ["kept.json"]


@pytest.mark.slow
def test_further_candidates_use_the_reference_that_is_there(tmp_path, made):
    path = tmp_path / "kept.json"
    trade(path)
    made.clear()
    more = tradeoff(SCENE, [*CANDIDATES, Settings(dt=0.02, method="grid")], until=5, replicas=2, path=path)
    assert (made.count("long_run"), made.count("short_runs"), made.count("measure")) == (2, 8, 1)
    assert len(more.rows) == 3


SCRIPT = """
from mpsim import Settings, tradeoff
from support.scenes import gas

if __name__ == "__main__":
    candidates = [Settings(dt=dt, method="grid") for dt in (0.1, 0.05)]
    print("begun")
    tell = lambda *told: print("did", *told)
    tradeoff(gas(20, 0.3), candidates, until={until}, replicas=2, path="{path}", progress=tell)
    print("over")
"""


@pytest.mark.slow
def test_a_kill_leaves_a_file_to_go_on_from(tmp_path, made):
    path = tmp_path / "kept.json"
    text = "from mpsim.studies import saved_results\nsaved_results.SAVE_EVERY = 0.0\n"
    text += SCRIPT.format(until=5, path=path)
    # Warnings are not errors here: CPython's resource tracker inherits the flag, and with it gives up all blocks after
    # the first whose thread was killed between announcing and making it.
    with Script(text, flags=()) as script:
        while not script.line().startswith("did 5 "):
            pass
        script.send(signal.SIGKILL)
        assert script.finish(10).code == -signal.SIGKILL
        assert_nothing_left_of(script.pid)
    kept = json.loads(path.read_text())["results"]
    assert len(kept) >= 4
    resumed = trade(path)
    assert len(made) == LONG_RUNS + SHORT_RUNS + 2 - len(kept)
    assert [row.errors for row in resumed.rows] == [row.errors for row in trade(None).rows]


@pytest.mark.timeout(120)
def test_ctrl_c_ends_a_trade_of_long_runs_within_seconds(tmp_path):
    """Each run would take minutes; threads that nobody waits for must not go on."""
    said = "from mpsim.studies import ensemble\nrun = ensemble.long_run\n"
    said += "ensemble.long_run = lambda *given: print('running') or run(*given)\n"
    with Script(said + SCRIPT.format(until=1e6, path=tmp_path / "kept.json"), warm=True) as script:
        while script.line() != "running":
            pass
        time.sleep(0.5)
        pressed = time.monotonic()
        script.send_to_group(signal.SIGINT)
        outcome = script.finish(30)
        took = time.monotonic() - pressed
        assert_nothing_left_of(script.pid)
    assert outcome.code == -signal.SIGINT, outcome.err
    assert outcome.err.count("Traceback") == 1, outcome.err
    assert outcome.err.rstrip().endswith("KeyboardInterrupt")
    assert took < 4, f"it took {took:.1f} s to end"
    assert "over" not in outcome.out


AT_BIRTH = """
import _posixshmem
import os
import signal
from mpsim import Settings, Simulation
from support.scenes import gas

make = _posixshmem.shm_open

def make_and_die(*given, **named):
    make(*given, **named)
    print(len([name for name in os.listdir("/dev/shm") if name.startswith(f"mpsim-{os.getpid()}-")]))
    os.kill(os.getpid(), signal.SIGKILL)

_posixshmem.shm_open = make_and_die
Simulation(gas(20, 0.3), Settings(method="grid"))
"""


def test_a_kill_at_the_very_birth_of_a_block_leaves_no_block():
    """Threads of a trade make blocks all the time, and wait for each other just then."""
    with Script(AT_BIRTH, warm=True) as script:
        assert script.finish(30).code == -signal.SIGKILL
        assert script.line() == "1", "the control: there was a block"
        assert_nothing_left_of(script.pid)
