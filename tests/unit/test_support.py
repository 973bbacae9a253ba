"""Negative controls of the tests' own tools: each of them must be able to fail."""

import os
import signal
import subprocess
import sys
from multiprocessing.shared_memory import SharedMemory

import numpy as np
import pytest
from support.compare import assert_inside_and_finite, assert_same_bits, overlapping_pairs
from support.processes import Script, assert_clean, assert_nothing_left_of, blocks_of, is_gone, run_script
from support.scenes import gas, lattice

import mpsim


def test_a_script_that_hangs_is_a_failure_with_its_stacks():
    script = Script("import time\ndef wait_for_ever():\n    time.sleep(1000)\nwait_for_ever()")
    with script, pytest.raises(AssertionError, match=r"still running after 1 s(.|\n)*in wait_for_ever"):
        script.finish(1)
    assert is_gone(script.pid)


def test_a_script_that_says_nothing_is_a_failure():
    with Script("import time; time.sleep(1000)") as script, pytest.raises(AssertionError, match="no line within"):
        script.line(0.2)


def test_a_process_that_a_script_leaves_behind_is_noticed():
    leave = "import subprocess; subprocess.Popen(['sleep', '1000'], stdout=-3, stderr=-3)"
    with Script(leave, flags=()) as script:
        script.finish(20)
        with pytest.raises(AssertionError, match="processes left behind"):
            assert_nothing_left_of(script.pid, within=0.1)


def test_a_block_that_is_left_behind_is_noticed():
    memory = SharedMemory(f"mpsim-{os.getpid()}-test", create=True, size=10)
    try:
        assert blocks_of(os.getpid()) == {memory.name}
        with pytest.raises(AssertionError, match="blocks left behind"):
            assert_nothing_left_of(os.getpid(), within=0.1)
    finally:
        memory.close()
        memory.unlink()


def test_noise_and_exit_codes_of_a_script_are_noticed():
    for text in (
        "import sys; print('noise', file=sys.stderr)",
        "raise SystemExit(3)",
        "import warnings; warnings.warn('x')",
    ):
        with pytest.raises(AssertionError, match="exit code"):
            assert_clean(run_script(text, bound=20))


def test_a_script_ended_by_a_signal_has_it_as_exit_code():
    with Script("import time; print('up'); time.sleep(1000)") as script:
        assert script.line(20) == "up"
        script.send_to_group(signal.SIGTERM)
        assert script.finish(20).code == -signal.SIGTERM


def test_a_stopped_process_is_not_gone_and_an_ended_one_is():
    process = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(1000)"])
    assert not is_gone(process.pid)
    process.send_signal(signal.SIGSTOP)
    assert not is_gone(process.pid)
    process.kill()
    process.wait()
    assert is_gone(process.pid)


def test_a_difference_of_one_bit_is_named():
    scene = gas(50, 0.2)
    state, other = (mpsim.State(scene.position.copy(), scene.velocity.copy()) for _ in range(2))
    assert_same_bits(state, other, "equal")
    other.velocity[31, 1] = np.nextafter(other.velocity[31, 1], 9)
    with pytest.raises(AssertionError, match="note: 1 of 50 discs differ in velocity; the first is disc 31"):
        assert_same_bits(state, other, "note")
    other.velocity[31, 1], other.position[0, 0] = state.velocity[31, 1], -0.0
    state.position[0, 0] = 0.0
    with pytest.raises(AssertionError, match="differ in position; the first is disc 0"):
        assert_same_bits(state, other, "zeros of two signs")


def test_a_disc_outside_or_not_finite_is_named():
    scene = gas(50, 0.2)
    state = mpsim.State(scene.position.copy(), scene.velocity.copy())
    assert_inside_and_finite(state, scene, "as given")
    state.position[7] = 0.4
    with pytest.raises(AssertionError, match="disc 7 is outside"):
        assert_inside_and_finite(state, scene, "note")
    state.velocity[7] = np.nan
    with pytest.raises(AssertionError, match="not finite"):
        assert_inside_and_finite(state, scene, "note")


def test_overlapping_pairs_are_those_of_all_pairs():
    position = np.random.default_rng(1).random((80, 2)) * 8
    i, j, distance = overlapping_pairs(position, 1.0)
    apart = np.hypot(*(position[:, None] - position[None]).transpose(2, 0, 1))
    expected = {(a, b) for a, b in np.argwhere(apart < 1) if a < b}
    assert set(zip(i.tolist(), j.tolist(), strict=True)) == expected
    assert np.allclose(distance, apart[i, j])


def test_the_lattice_is_legal_and_moves():
    scene = lattice(7, 5)
    assert not len(overlapping_pairs(scene.position, 1.0)[0])
    assert (np.abs(scene.velocity) <= 2).all()
    assert len(np.unique(scene.velocity)) == 70
