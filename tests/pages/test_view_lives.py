"""Views that live in programs and commands of their own: what they print, what ends them, and what they leave."""

import re
import signal

import pytest
from support.commands import mpsim_command
from support.processes import Script, assert_clean, assert_nothing_left_of, run_script
from support.selection import long_but
from support.visitor import Visitor

import mpsim

PLAIN = {"NUMBA_DISABLE_JIT": "1"}


def address_in(line):
    return re.search(r"http://\S+", line)[0]


TWO = """
from mpsim.cli.app import main
for path in {!r}:
    try:
        main(["view", path, "--no-browser", "--paused"])
    except SystemExit:
        pass
"""


@pytest.mark.long
def test_the_command_shows_the_folder_of_a_run_with_its_obstacles_and_its_file(tmp_path):
    scene, folder = tmp_path / "pegs.toml", tmp_path / "run"
    mpsim.Scene(
        width=9, height=9, position=[[2, 2]], velocity=[[1, 0]], radius=0.5, obstacles=[mpsim.FixedDisc((6, 6), 0.5)]
    ).save(scene)
    words = ["run", scene, "--frames", "20", "--every", "5", "--out", folder, "--method", "naive"]
    assert mpsim_command(*words).exit_code == 0
    with Script(TWO.format([str(folder), str(folder / "trajectory.xyz")]), env=PLAIN) as script:
        for name, obstacles in (("run", 1), ("trajectory.xyz", 0)):
            with Visitor(address_in(script.line()), visible=True) as page:
                page.hear_until(lambda v: v.frame == 0 and "timeline" in v.last)
                assert (page.last["scene"]["name"], len(page.last["obstacles"]["capsules"])) == (name, obstacles)
                assert (page.last["timeline"]["count"], page.last["timeline"]["follow"]) == (5, False)
                script.send(signal.SIGINT)
            assert script.line().startswith("Do not share")
        assert_clean(script.finish())


WORKERS = """
import mpsim
scene = mpsim.Scene.random(count=300, packing=0.2, radius=0.5, seed=1)
mpsim.view(scene, mpsim.Settings(method="parallel", workers=2), browser=False)
print("and on")
"""


@pytest.mark.slow
@pytest.mark.parametrize("number", long_but([signal.SIGINT, signal.SIGTERM], signal.SIGINT))
def test_a_signal_ends_a_view_with_its_workers_and_after_ctrl_c_the_program_goes_on(number):
    with Script(WORKERS, warm=True) as script, Visitor(address_in(script.line()), visible=True) as page:
        page.hear_until(lambda v: v.frame > 30)
        script.send(number)
        outcome = script.finish()
    assert outcome.out.endswith("and on\n") is (number == signal.SIGINT)
    assert (outcome.err == "") or number == signal.SIGTERM
    assert_nothing_left_of(script.pid)


def test_a_program_that_ends_takes_an_open_view_with_it():
    outcome = run_script(WORKERS.replace("browser=False)", "browser=False, wait=False)"), warm=True)
    assert_clean(outcome)
    assert outcome.out.endswith("and on\n")
