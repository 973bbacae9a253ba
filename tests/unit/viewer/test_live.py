"""`mpsim.view` and `mpsim view`: what they print, when they end, and what they refuse."""

import os
import re
import signal
import sys
import time
import webbrowser

import pytest
from support.commands import mpsim_command
from support.processes import Script, assert_clean, assert_nothing_left_of, run_script
from support.scenes import gas
from support.viewing import Visitor, viewed

import mpsim

SCENE = gas(50, 0.2)


@pytest.mark.parametrize(
    ("arguments", "error", "text"),
    [
        ({"source": "gas"}, mpsim.InputError, r"a view shows an mpsim.Scene, an .* or an mpsim.Trajectory; got str. "),
        ({"settings": {"dt": 1}}, mpsim.InputError, r"settings must be mpsim.Settings; got dict. Use Settings\(dt="),
        ({"host": 7}, mpsim.InputError, r"host must be a name or an address; got 7. Use '127.0.0.1'"),
        ({"port": 70000}, mpsim.InputError, r"port must be a whole number from 0 to 65535; got 70000. 0 takes one"),
        ({"port": True}, mpsim.InputError, r"port must be a whole number"),
        ({"browser": "yes"}, mpsim.InputError, r"browser must be True or False; got 'yes'"),
        ({"wait": 1}, mpsim.InputError, r"wait must be True or False; got 1"),
        ({"playing": None}, mpsim.InputError, r"playing must be True or False; got None"),
        ({"settings": mpsim.Settings(method="mpi")}, mpsim.InputError, r"a view runs in one process"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named_before_anything_is_open(arguments, error, text):
    before = len(os.listdir("/proc/self/fd"))
    with pytest.raises(error, match=text):
        mpsim.view(**{"source": SCENE, "wait": False, **arguments})
    assert len(os.listdir("/proc/self/fd")) <= before


def test_without_websockets_it_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "websockets.asyncio.server", None)
    with pytest.raises(
        mpsim.errors.OutputError, match=r"a live view needs the package websockets, .* `pip install 'mpsim\[view\]'`"
    ):
        mpsim.view(SCENE)
    failed = mpsim_command("view", "gas")
    assert failed.exit_code == 1
    assert "pip install 'mpsim[view]'" in failed.stderr


def test_the_address_is_printed_and_the_browser_opened_where_there_is_one(monkeypatch, capsys):
    opened = []
    monkeypatch.setattr(webbrowser, "open", opened.append)
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"):
        monkeypatch.delenv(name, raising=False)
    with mpsim.view(SCENE, wait=False) as view:
        assert f"The live view is at {view.address}\n" in capsys.readouterr().out
    assert opened == []
    monkeypatch.setenv("DISPLAY", ":0")
    with mpsim.view(SCENE, wait=False, browser=False):
        assert opened == []
    with mpsim.view(SCENE, wait=False) as view:
        assert opened == [view.address]
    assert re.fullmatch(r"http://127\.0\.0\.1:\d+/[\w-]{32}/", view.address)


def test_two_views_are_strangers(capsys):
    with viewed(SCENE) as one, viewed(SCENE) as other:
        assert one.address != other.address
        with Visitor(one.address) as visitor:
            visitor.say("visible", value=True)
            visitor.hear_until(lambda v: v.frame > 3)
        assert other._session._sim is None or other._session._sim.frame == 0


def test_an_error_of_the_start_comes_to_the_caller(capsys):
    settings = mpsim.Settings(method="event", law="reflect")
    with pytest.raises(mpsim.InputError, match="reflect"):
        mpsim.view(SCENE, settings, browser=False)


WAITING = """
import mpsim
scene = mpsim.Scene.random(count=50, packing=0.2, radius=0.5, seed=1)
mpsim.view(scene, mpsim.Settings(method="parallel", workers=2), browser=False)
print("and on")
"""


def address_in(line: str) -> str:
    return re.search(r"http://\S+/", line)[0]


@pytest.mark.parametrize("watched", [False, True])
def test_ctrl_c_ends_the_view_and_the_program_goes_on(watched):
    with Script(WAITING) as script:
        address = address_in(script.line())
        if watched:
            with Visitor(address) as visitor:
                visitor.say("visible", value=True)
                visitor.hear_until(lambda v: v.frame > 3)
                script.send(signal.SIGINT)
                outcome = script.finish()
        else:
            time.sleep(0.5)
            script.send(signal.SIGINT)
            outcome = script.finish()
    assert_clean(outcome)
    assert outcome.out.endswith("and on\n")
    assert_nothing_left_of(script.pid)


def test_a_program_that_ends_takes_an_open_view_with_it():
    text = WAITING.replace("browser=False)", "browser=False, wait=False)")
    assert_clean(run_script(text))


# --- the command


def test_the_command_names_an_unknown_scene_and_wrong_options():
    failed = mpsim_command("view", "gass")
    assert failed.exit_code == 2
    assert "gass" in failed.stderr
    assert mpsim_command("view", "gas", "--port", "-1").exit_code == 2
    refused = mpsim_command("view", "gas", "--method", "mpi")
    assert refused.exit_code == 2
    assert "This command runs in one process" in refused.stderr


COMMAND = """
import sys
from mpsim.cli.app import main
main(["view", "gas", "--no-browser", "--paused", "--method", "grid", "--dt", "0.02"])
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_command_shows_a_scene_until_ctrl_c(number):
    with Script(COMMAND) as script:
        address = address_in(script.line())
        with Visitor(address) as visitor:
            visitor.say("visible", value=True)
            visitor.hear_until(lambda v: v.phase == "paused" and v.frame == 0)
            assert visitor.last["scene"]["name"] == "gas"
            assert (visitor.last["scene"]["method"], visitor.last["scene"]["dt"]) == ("grid", 0.02)
            visitor.say("step", frames=2)
            visitor.hear_until(lambda v: v.frame == 2)
            assert visitor.picture.header.time == 0.04
            script.send(number)
            outcome = script.finish()
    assert_clean(outcome)
    assert_nothing_left_of(script.pid)
