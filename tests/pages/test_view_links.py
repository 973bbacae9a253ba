"""Links: what the address of a view asks for, what it may not ask for, and the command and the page that open it."""

import re
import signal

import pytest
from support.processes import Script, assert_clean, assert_nothing_left_of
from support.scenes import gas
from support.trajectories import written
from support.visitor import Visitor, fetch, kept, paused

import mpsim

pytestmark = pytest.mark.plain

GRID = mpsim.Settings(method="grid")
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
    "scene=gas&dt=1e300": "size of dt must be a number from 0.0001 to 1",
    "scene=gas&passes=1000": "passes must be a whole number from 1 to 100",
    "scene=gas&seed=99999999999999999999": "seed must be a whole number from 0",
    "scene=cradle&seed=3": "seed must be left out",
    "scene=gas&method=mpi": "that runs in one process",
    "scene=gas&method=events": "Did you mean 'event'",
    "scene=gas&gravity=5": "gravity in a link must be two numbers, such as gravity=0,-5; got '5'. Give x and y.",
    "scene=gas&gravity=inf,0": "gravity must be finite",
    "scene=gas&restitution=2": "restitution must be",
    "scene=gas&piston_speed=1": "piston_speed can be changed only in a scene with a piston",
    "scene=piston&piston_speed=-1e9": "size of piston_speed must be",
    "scene=gas&friction=0.5": "friction can be changed only in a scene that has it",
    "scene=rough-hopper&friction=0": "friction must be > 0 in a change",
    "scene=galton&interval=1e-9": "size of interval must be",
    "scene=gas&beside=event,event": "beside must be a method",
    "scene=gas&beside=dt=0.003": "must be that of the first one",
    "scene=gas&gravity=1e300,0": "size of gravity must be a number from 0 to 50; got 1e+300",
    "scene=sediment&gravity=0,200.1": "size of gravity must be a number from 0 to 200",
    "scene=gas&speed=quick": "speed must be",
    "scene=gas&zoom=1000": "zoom must be a number from 0.5 to 64; got 1000",
    "scene=gas&canvas=3d": "canvas must be",
    "scene=gas&passes=50&substeps=50": "at most 1,000 passes in one frame of the first stage; got 2,500",
    "scene=gas&method=grid&dt=0.01&beside=dt=0.001,passes=100,substeps=2": "got 2,000 (frames 10, substeps 2, passes",
    "scene=%ff": "a link must be names and values",
    "&".join(["scene=gas"] * 100): "a link must be names and values",
    "scene=" + "x" * 2000: "at most 1000 characters",
    "wait&speed=0": "speed must be a number",
    "zoom=2&zoom=3": "zoom must be in a link once",
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
    "wait&zoom=2&x=3&y=4&speed=0.5&canvas=2d": "",
    "": "",
}
"""Links, and each in its one standard form: what concerns only the display is checked and left out."""


def test_what_a_link_means_and_what_it_may_not_ask_for():
    with paused(gas(20, 0.2), GRID) as page:
        for query, text in WRITTEN.items():
            for each in {query, text or query}:
                answer = fetch(page.view.address, path=f"link?{each}")
                assert (answer.status, answer.body.decode()) == (200, text), each
        assert answer.getheader("Content-Type").startswith("text/plain")
        for query, text in HOSTILE.items():
            answer = fetch(page.view.address, path=f"link?{query}")
            assert (answer.status, text in answer.body.decode()) == (409, True), (query, answer.body)
            assert len(answer.body) < 500
        assert fetch(page.view.address.rstrip("/") + "x/", path="link?scene=gas").status == 404, "without the token"
        with Visitor(page.view.address) as hostile:
            hostile.say("open", link="scene=/etc/passwd")
            with pytest.raises(Exception, match="scene of a link must be one of"):
                hostile.hear_for(60)
        page.step_to(1)
        assert len(page.picture.colour) == 20, "nothing has changed"


def test_a_running_view_begins_anew_with_another_scene_on_all_pages():
    with paused(gas(20, 0.2), GRID, name="mine") as page, Visitor(page.view.address, visible=True) as other:
        page.hear_until(lambda v: "link" in v.last)
        assert page.last["link"]["text"] is None, "it does not come with mpsim"
        page.say("open", link=ASKED)
        for each in (page, other):
            each.hear_until(lambda v: (v.last.get("link") or {}).get("text") == ASKED)
            each.hear_until(lambda v: v.phase == "paused" and v.picture and len(v.picture.colour) == 100)
            each.hear_until(lambda v: v.last["pair"]["second"] == "event")
            assert each.last["scene"]["name"] == "gas"
        page.say("change", name="dt", value=0.01, same=False)
        page.hear_until(lambda v: "dt=0.005" not in v.last["link"]["text"])
        page.say("reset")
        page.hear_until(lambda v: v.last["link"]["text"] == ASKED)


@pytest.mark.parametrize("kind", ["a recording", "a simulation of a program"])
def test_what_is_no_scene_of_its_own_understands_a_link_and_does_not_follow_it(tmp_path, kind):
    """The page needs both to say which command to use: what was asked for, and that nothing that runs has a link."""
    scene = gas(20, 0.2)
    with mpsim.Simulation(scene, GRID) as sim:
        if kind == "a recording":
            written(tmp_path / "run.xyz", scene, frames=2, every=1, method="naive")
        with paused(mpsim.Trajectory(tmp_path / "run.xyz") if kind == "a recording" else sim) as page:
            page.hear_until(lambda v: "link" in v.last)
            assert page.last["link"]["text"] is None
            answer = fetch(page.view.address, path="link?wait&method=grid&scene=cradle")
            assert (answer.status, answer.body) == (200, b"scene=cradle&method=grid")
            assert page.refused("open", link="scene=cradle")
            assert (page.frame, page.last["scene"]["width"]) == (0, scene.width)


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
