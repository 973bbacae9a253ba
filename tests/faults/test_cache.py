"""The cache of machine code: never stale, not needed to be writable; and importing mpsim compiles nothing."""

import os
import shutil
import subprocess
import sys

import pytest
from support.processes import assert_clean, run_script
from support.script_server import PACKAGE_PARENT

IMPORT_WITHIN = 2.0  # seconds of processor time, also on a busy machine

RUN = """
import mpsim
scene = mpsim.Scene(width=9, height=9, position=[[3, 3], [3.75, 3], [6, 6]], velocity=[[1, 0], [-1, 0], [0, 1]],
                    radius=0.5)
import warnings
warnings.simplefilter("ignore")
with mpsim.Simulation(scene, mpsim.Settings(method="{method}", workers=2, dt=0.01)) as sim:
    sim.run(frames=4)
    print(mpsim.__file__)
    print(sim.digest())
"""


PLACE = """
import mpsim
print(mpsim.Scene.random(count=30, packing=0.5, radius=0.5, seed=1).digest())
"""
"""What needs few kernels."""


@pytest.fixture(scope="module")
def small_cache(tmp_path_factory):
    """A cache folder with the kernels of `PLACE`, and what the run that filled it printed."""
    cache = tmp_path_factory.mktemp("cache")
    outcome = run_script(PLACE, env={"NUMBA_CACHE_DIR": str(cache)}, bound=90)
    assert_clean(outcome)
    return cache, outcome.out


@pytest.mark.long
@pytest.mark.timeout(150)
def test_an_edit_in_a_file_that_kernels_call_is_never_answered_from_a_stale_cache(tmp_path):
    """Half the push in laws.py: Numba's own cache would go on running the old code, as stepping.py is the same."""
    folder, cache = tmp_path / "copy", tmp_path / "cache"
    shutil.copytree(PACKAGE_PARENT / "mpsim", folder / "mpsim", ignore=shutil.ignore_patterns("__pycache__"))
    laws = folder / "mpsim/kernels/frame/laws.py"
    text = laws.read_text()
    edited = text.replace("distance) / discs.x.dtype.type(2)", "distance) / discs.x.dtype.type(4)")
    assert edited != text
    found = []
    for each in (text, edited, text):
        laws.write_text(each)
        script = f"import sys; sys.path.insert(0, {str(folder)!r})\n" + RUN.format(method="naive")
        outcome = run_script(script, env={"NUMBA_CACHE_DIR": str(cache)}, bound=90)
        assert_clean(outcome)
        file, digest = outcome.out.split()
        assert file.startswith(str(folder)), "the copy was not the one that ran"
        found.append((digest, len(list((cache / "mpsim").iterdir()))))
    first, second, third = found
    assert second[0] != first[0] == third[0], "the edited kernel did not run"
    assert (first[1], second[1], third[1]) == (1, 2, 2)


@pytest.mark.long
def test_a_cache_folder_that_cannot_be_written_costs_one_log_line_and_nothing_else(small_cache):
    outcome = run_script(PLACE, env={"NUMBA_CACHE_DIR": "/proc/mpsim-cannot-write-here"}, bound=90)
    assert (outcome.code, outcome.out) == (0, small_cache[1])
    assert outcome.err.count("\n") == 1, outcome.err
    assert "no writable cache folder" in outcome.err
    assert "NUMBA_CACHE_DIR" in outcome.err


@pytest.mark.slow
def test_a_home_that_does_not_exist_is_no_error():
    env = {"HOME": "/proc/nowhere", "XDG_CACHE_HOME": "", "NUMBA_CACHE_DIR": ""}
    outcome = run_script("import mpsim; print(mpsim.Scene.__name__)", env=env)
    assert outcome.code == 0
    assert outcome.err.count("\n") == 1, outcome.err


@pytest.mark.slow
def test_truncated_cache_files_are_replaced(tmp_path, small_cache):
    """A full disk or a power cut leaves such files; they must not stop every later run with an unpickling error."""
    cache, expected = small_cache
    shutil.copytree(cache, tmp_path / "cache")
    for ending in ("nbi", "nbc"):
        files = list((tmp_path / "cache").rglob(f"*.{ending}"))
        assert files
        for file in files[: len(files) // 2]:
            file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    outcome = run_script(PLACE, env={"NUMBA_CACHE_DIR": str(tmp_path / "cache")}, bound=90)
    assert (outcome.code, outcome.out) == (0, expected), outcome.err
    assert "Traceback" not in outcome.err, outcome.err


COMPILING = """
import sys, threading
from mpsim.kernels import compiling
from mpsim.kernels.compiling import compiled
from numba.core import event

compiling.LONGEST = float(sys.argv[1])

@compiled
def sum_of(values):
    total = 0.0
    for value in values:
        total += value
    return total

class Count(event.Listener):
    number = 0
    def on_start(self, event): pass
    def on_end(self, event): Count.number += 1

import numpy as np
sum_of(np.zeros(3, np.float32))
print("ready", flush=True)
sys.stdin.readline()
with event.install_listener("numba:run_pass", Count()):
    sum_of(np.ones(3))
print(Count.number > 0)
"""


def compiled_by(folder, longest):
    """Which of two processes compiled a kernel, that both needed at once."""
    folder.mkdir()
    path = folder / "kernel.py"
    path.write_text(COMPILING)
    runs = [
        subprocess.Popen(
            [sys.executable, str(path), str(longest)],
            env=os.environ | {"NUMBA_CACHE_DIR": str(folder)},
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )
        for _ in range(2)
    ]  # fmt: skip
    for run in runs:
        assert run.stdout is not None
        assert run.stdout.readline() == "ready\n"
    for run in runs:
        assert run.stdin is not None
        run.stdin.write("\n")
        run.stdin.flush()
    return sorted(run.communicate(timeout=60)[0] for run in runs)


@pytest.mark.slow
def test_of_two_processes_that_need_a_kernel_at_once_one_compiles_it(tmp_path):
    assert compiled_by(tmp_path / "in turns", 60) == ["False\n", "True\n"]
    without = [compiled_by(tmp_path / f"control {number}", 0) for number in range(3)]
    assert ["True\n", "True\n"] in without, "the control: who waits for nobody compiles it, too"


def test_importing_mpsim_compiles_nothing_and_is_quick():
    text = """
    import time
    start = time.process_time()
    import mpsim
    print(time.process_time() - start)
    from mpsim.kernels.compiling import compiled_kernels
    print(compiled_kernels())
    import sys
    print("matplotlib" in sys.modules)
    mpsim.Scene.random(count=30, packing=0.5, radius=0.5, seed=1)
    print(compiled_kernels() > 0)  # the control
    """
    outcome = run_script(text)
    assert_clean(outcome)
    seconds, *others = outcome.out.split()
    assert others == ["0", "False", "True"]
    assert float(seconds) < IMPORT_WITHIN
