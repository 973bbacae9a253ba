"""The tests' own tools must be able to fail: scripts that hang, make noise or leave something."""

import signal

import pytest
from support.processes import Script, assert_clean, assert_nothing_left_of, is_gone, run_script

WARM = pytest.mark.parametrize("warm", [False, True], ids=["new", "warm"])


@WARM
def test_a_script_that_hangs_says_nothing_or_makes_noise_is_a_failure(warm):
    hangs = "import time\ndef wait_for_ever():\n    time.sleep(1000)\nwait_for_ever()"
    with Script(hangs, warm=warm) as script:
        with pytest.raises(AssertionError, match="no line within"):
            script.line(0.2)
        with pytest.raises(AssertionError, match=r"still running after 1 s(.|\n)*in wait_for_ever"):
            script.finish(1)
    assert is_gone(script.pid)
    for text in ("import sys; print('noise', file=sys.stderr)", "raise SystemExit(3)"):
        with pytest.raises(AssertionError, match="exit code"):
            assert_clean(run_script(text, bound=20, warm=warm))
    with Script("import time; print('up'); time.sleep(1000)", warm=warm) as script:
        assert script.line(20) == "up"
        script.send_to_group(signal.SIGTERM)
        assert script.finish(20).code == -signal.SIGTERM


@pytest.mark.parametrize(
    ("leave", "how"),
    [
        ("import subprocess; subprocess.Popen(['sleep', '1000'], stdout=-3, stderr=-3)", {"flags": ()}),
        ("import os, time\nif not os.fork():\n    os.closerange(1, 3)\n    time.sleep(1000)", {"warm": True}),
    ],
    ids=["new", "warm"],
)
def test_a_process_that_a_script_leaves_behind_is_noticed(leave, how):
    with Script(leave, **how) as script:
        script.finish(20)
        with pytest.raises(AssertionError, match="processes left behind"):
            assert_nothing_left_of(script.pid, within=0.1)
