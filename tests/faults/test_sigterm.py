"""SIGTERM, by which machines ask programs to end, writes a checkpoint where the run has one."""

import signal
import time
from pathlib import Path

import pytest
from support.checkpoints import frame_in
from support.processes import Script, assert_clean, assert_nothing_left_of, run_script
from support.scenes import lattice, simulate, state_after
from support.selection import long_but

import mpsim
from mpsim.core import archive

TERMINATED = """
import mpsim
from support.scenes import lattice

{before}
settings = mpsim.Settings(method="{method}", workers={workers}, dt={dt})
sim = mpsim.Simulation(lattice(20, 20), settings, start_method="{start}")
print("running")
sim.run(frames=10**9{options})
"""


def terminate(path, method="parallel", workers=3, start="fork", group=False, before="", with_checkpoint=True, dt=0.01):
    """Run, end by SIGTERM, and require that nothing is left."""
    options = f", checkpoint={str(path)!r}, checkpoint_every=10**9" if with_checkpoint else ""
    text = TERMINATED.format(method=method, workers=workers, start=start, options=options, before=before, dt=dt)
    with Script(text, warm=start == "fork") as script:
        assert script.line() == "running"
        time.sleep(0.3)
        (script.send_to_group if group else script.send)(signal.SIGTERM)
        outcome = script.finish(20)
        assert_nothing_left_of(script.pid)
    return outcome


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "start", "group"),
    [
        ("grid", "fork", False),
        ("event", "fork", False),
        pytest.param("parallel", "fork", True, marks=pytest.mark.long),
        pytest.param("parallel", "spawn", True, marks=pytest.mark.long),
        ("parallel", "forkserver", True),
        pytest.param("parallel", "forkserver", False, marks=pytest.mark.long),
    ],
)
def test_sigterm_writes_a_checkpoint_that_goes_on_with_the_same_bits(method, start, group, tmp_path, figures):
    path = tmp_path / "run"
    outcome = terminate(path, method, 3 if method == "parallel" else 1, start, group)
    assert (outcome.code, outcome.err) == (143, "")
    with mpsim.Simulation.resume(path, workers=2) as sim:
        frame = sim.frame
        assert frame > 0
        sim.run(frames=10)
        state = sim.state
    alone = "grid" if method == "parallel" else method
    expected = state_after(lattice(20, 20), frame + 10, method=alone, contact="impact")
    assert (state.digest()) == expected.digest(), f"ended at frame {frame}"
    to = "the whole group" if group else "the coordinator"
    figures.note(
        "R8",
        f"{method}, {start}",
        f"SIGTERM to {to}",
        "exit code 143, a checkpoint, the same bits when resumed",
        f"as expected, at frame {frame}",
    )


def test_sigterm_inside_a_long_exact_frame_is_heard(tmp_path):
    assert terminate(tmp_path / "run", "event", 1, dt=1e6).code == 143
    with mpsim.Simulation.resume(tmp_path / "run") as sim:
        assert sim.frame == 0 < sim.time


@pytest.mark.parametrize("method", long_but(["grid", "parallel"], "parallel"))
def test_sigterm_without_a_checkpoint_does_what_it_did(method, tmp_path):
    assert terminate(tmp_path / "run", method, with_checkpoint=False).code == -signal.SIGTERM
    handler = "import signal, sys; signal.signal(signal.SIGTERM, lambda *_: sys.exit(7))"
    assert terminate(tmp_path / "run", method, with_checkpoint=False, before=handler).code == 7
    assert not list(tmp_path.iterdir())


def test_the_handler_of_the_user_is_back_after_the_run(tmp_path):
    def mine(number, frame):
        caught.append(number)

    caught, before = [], signal.signal(signal.SIGTERM, mine)
    try:
        with simulate(lattice(4, 4), method="grid") as sim:
            sim.run(frames=3, checkpoint=tmp_path / "run")
            assert signal.getsignal(signal.SIGTERM) is mine
            with pytest.raises(SystemExit) as ended:
                sim.run(
                    frames=10**9, checkpoint=tmp_path / "run", progress=lambda *_: signal.raise_signal(signal.SIGTERM)
                )
            assert ended.value.code == 143
            assert signal.getsignal(signal.SIGTERM) is mine
            assert frame_in(tmp_path / "run") == sim.frame
    finally:
        signal.signal(signal.SIGTERM, before)
    assert caught == []


IN_C = """
import ctypes, faulthandler, signal
import mpsim
from support.scenes import gas, lattice, simulate

def address():
    action = ctypes.create_string_buffer(512)
    ctypes.CDLL(None).sigaction(signal.SIGTERM, None, action)
    return action.raw[:8]

caught = []
mine = ctypes.CFUNCTYPE(None, ctypes.c_int)(caught.append)
dump = open({dump!r}, "w+b", buffering=0)
{register}
before = address()
{act}
print(address() == before)
signal.raise_signal(signal.SIGTERM)
print(caught, dump.seek(0, 2) > 0)
dump.close()
"""
REGISTER = {
    "ctypes": "ctypes.CDLL(None).signal(signal.SIGTERM, mine)",
    "before Python": "ctypes.CDLL(None).signal(signal.SIGTERM, mine)\nknown = signal.getsignal\n"
    "signal.getsignal = lambda number: None if known(number) == signal.SIG_DFL else known(number)",
    "faulthandler": "faulthandler.register(signal.SIGTERM, file=dump)",
}
ACTS = {
    "run": """
with simulate(lattice(4, 4), method="grid") as sim:
    sim.run(frames=3, checkpoint={path!r})
    try:
        sim.run(frames=10**9, checkpoint={path!r}, progress=lambda *_: signal.raise_signal(signal.SIGTERM))
    except SystemExit as end:
        print(end.code)
""",
    "tradeoff": """
mpsim.tradeoff(
    gas(20, 0.3), [mpsim.Settings(dt=0.1, method="grid")], until=2.0, replicas=2, measures=["overlap"],
    progress=lambda *_: print(address() == before),
)
""",
}


@pytest.mark.slow
@pytest.mark.parametrize("act", ACTS)
@pytest.mark.parametrize("register", REGISTER)
def test_a_handler_in_c_is_back_after_a_run_and_left_alone_by_a_search_of_settings(register, act, tmp_path):
    """Python set what it knew of, the default; of what came before it, nothing: the handler of the run stayed."""
    path, dump = str(tmp_path / "run"), str(tmp_path / "dump")
    outcome = run_script(
        IN_C.format(register=REGISTER[register], act=ACTS[act].format(path=path), dump=dump), warm=True
    )
    assert_clean(outcome)
    *during, back, called = outcome.out.splitlines()
    assert during == ["143"] if act == "run" else set(during) == {"True"}
    assert (back, called) == ("True", "[] True" if register == "faulthandler" else "[15] False")


def test_a_sigterm_that_comes_after_the_last_look_is_not_lost(tmp_path):
    """The progress callback is called after the last checkpoint of the run."""
    with simulate(lattice(4, 4), method="grid") as sim:

        def end(done, of):
            if done == of:
                signal.raise_signal(signal.SIGTERM)

        with pytest.raises(SystemExit) as ended:
            sim.run(frames=5, checkpoint=tmp_path / "run", progress=end)
        assert ended.value.code == 143
    assert frame_in(tmp_path / "run") == 5


def test_importing_the_checker_of_files_needs_no_pickle():
    """Nothing that reads a checkpoint may load numpy's pickled arrays."""
    source = Path(archive.__file__).read_text()
    assert "np.load" not in source
    assert "pickle.load" not in source
