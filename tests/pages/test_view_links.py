"""Links: what the address of a view asks for, what it may not ask for, and the command that opens it."""

import re
import signal

import pytest
from support.processes import Script, assert_clean, assert_nothing_left_of
from support.scenes import gas
from support.visitor import Visitor, kept, paused

import mpsim
from mpsim.viewer import share_url

pytestmark = pytest.mark.plain

ASKED = "scene=gas&seed=3&dt=0.005&method=grid&gravity=0.0,-1.5&restitution=0.9&beside=event"

HOSTILE = {
    "dt=0.005": "must have a scene",
    "scene=gass": "Did you mean 'gas'",
    "scene=/etc/passwd": "scene of a link must be one of",
    "scene=..%2F..%2Fmine.toml": "scene of a link must be one of",
    "scene=gas&scene=dense": "scene must be in a link once",
    "scene=gas&count=1000000000": "a name in a link must be one of",
    "scene=gas&workers=1024": "a name in a link must be one of",
    "scene=gas&%3Cscript%3E=1": "a name in a link must be one of",
    "scene=gas&dt=nan": "dt must be a finite number",
    "scene=gas&seed=99999999999999999999": "seed must be a whole number from 0",
    "scene=cradle&seed=3": "seed must be left out",
    "scene=gas&beside=frames=1000": "frames must be a whole number from 1 to 100",
    "scene=gas&method=events": "Did you mean 'event'",
    "scene=gas&gravity=5": "gravity in a link must be two numbers, such as gravity=0,-5; got '5'. Give x and y.",
    "scene=gas&gravity=inf,0": "gravity must be finite",
    "scene=gas&restitution=2": "restitution must be",
    "scene=gas&piston_speed=1": "piston_speed can be changed only in a scene with a piston",
    "scene=gas&friction=0.5": "friction can be changed only in a scene that has it",
    "scene=rough-hopper&friction=0": "friction must be > 0 in a change",
    "scene=gas&beside=event,event": "beside must be a method",
    "scene=%ff": "a link must be names and values",
    "&".join(["scene=gas"] * 100): "a link must be names and values",
}

WRITTEN = {
    ASKED: ASKED,
    "wait&dt=5e-3&scene=gas": "scene=gas&dt=0.005",
    "method=grid&wait&beside=%65vent&scene=gas&dt=5e-3": "scene=gas&dt=0.005&method=grid&beside=event",
    "scene=gas&dt=0.0050&method=grid&beside=method=event": "scene=gas&dt=0.005&method=grid&beside=event",
    "beside=dt%3D0.001&seed=007&dt=5e-3&wait&scene=gas&law=elastic": "scene=gas&seed=7&dt=0.005&beside=dt=0.001",
    "scene=gas&method=grid&dt=0.01&beside=dt=0.001,passes=100": "scene=gas&method=grid&beside=dt=0.001,passes=100",
    "scene=gas&beside=contact=push,passes=3": "scene=gas&beside=contact=push,passes=3",
    "scene=sediment&gravity=0,200": "scene=sediment&gravity=0.0,200.0",
    "scene=rough-hopper&friction=0.25": "scene=rough-hopper&friction=0.25",
}
"""Links, and each in its one standard form, which leaves out what concerns only the display."""


def test_what_a_link_means_and_what_it_may_not_ask_for():
    for query, text in WRITTEN.items():
        for each in (query, text):
            assert share_url.write(share_url.read(each)) == text
    for query, text in HOSTILE.items():
        with pytest.raises(mpsim.errors.InputError) as refused:
            share_url.read(query)
        assert text in str(refused.value), query
        assert len(str(refused.value)) < 500


def test_pages_are_told_the_link_to_what_is_shown():
    with paused(gas(20, 0.2), mpsim.Settings(method="grid"), name="mine") as page:
        page.hear_until(lambda v: "link" in v.last)
        assert page.last["link"]["text"] is None, "it does not come with mpsim"
    with paused(share_url.read(ASKED)) as page:
        page.hear_until(lambda v: (v.last.get("link") or {}).get("text") == ASKED)
        assert (page.last["scene"]["name"], len(page.picture.colour)) == ("gas", 100)
        assert page.last["pair"]["second"] == "event"
        page.do("change", name="dt", value=0.01, same=False)
        page.hear_until(lambda v: "dt=0.005" not in v.last["link"]["text"])
        page.say("reset")
        page.hear_until(lambda v: v.last["link"]["text"] == ASKED)


# --- the command


COMMAND = """
from mpsim.cli.app import main
main({!r})
"""


@pytest.mark.slow
def test_the_command_opens_what_an_address_asks_for_until_ctrl_c():
    words = ["view", f"http://127.0.0.1:8000/a-token/?{ASKED}&wait&speed=2#top", "--passes", "2", "--no-browser"]
    with Script(COMMAND.format(words), env={"NUMBA_DISABLE_JIT": "1"}) as script:
        base, _, query = re.search(r"http://\S+", script.line())[0].partition("?")
        assert query == f"{ASKED.replace('&gravity', '&passes=2&gravity')}&wait=&speed=2", "options count more"
        with Visitor(base, visible=True) as page:
            page.step_to(3)
            assert (page.last["scene"]["name"], page.last["pair"]["second"]) == ("gas", "event")
            found = kept(base)
            script.send(signal.SIGINT)
            outcome = script.finish()
    assert_clean(outcome)
    assert "Do not share this address: anyone who has it can control the view." in outcome.out
    assert_nothing_left_of(script.pid)
    with mpsim.Simulation(mpsim.Scene.load("gas").redrawn(3), mpsim.Settings(dt=0.005, method="grid", passes=2)) as sim:
        sim.change(gravity=(0.0, -1.5), restitution=0.9)
        sim.run(frames=3)
        assert found == (3, sim.digest(), ["change"])
