"""What an address asks for: read and written, refused by name, and opened by `mpsim view` and by a view that runs."""

import dataclasses

import pytest
from click.testing import CliRunner
from support.commands import mpsim_command
from support.scenes import gas
from support.trajectories import written
from support.viewing import Visitor, fetch, viewed

import mpsim
from mpsim.cli.view import view as command
from mpsim.viewer import link, live

ASKED = "scene=gas&seed=3&dt=0.005&method=grid&gravity=0.0,-1.5&restitution=0.9&beside=event"

HOSTILE = {
    "": "must have a scene",
    "wait": "must have a scene",
    "dt=0.005": "must have a scene",
    "scene=": "scene of a link must be one of",
    "scene=gass": "Did you mean 'gas'",
    "scene=/etc/passwd": "scene of a link must be one of",
    "scene=..%2F..%2Fmine.toml": "scene of a link must be one of",
    "scene=mine.toml": "scene of a link must be one of",
    "scene=gas%00": "scene of a link must be one of",
    "scene=gas&scene=dense": "scene must be in a link once",
    "scene=gas&dt=0.01&dt=0.01": "dt must be in a link once",
    "scene=gas&count=1000000000": "a name in a link must be one of",
    "scene=gas&workers=1024": "a name in a link must be one of",
    "scene=gas&unguarded=true": "a name in a link must be one of",
    "scene=gas&start_method=fork": "a name in a link must be one of",
    "scene=gas&%3Cscript%3E=1": "a name in a link must be one of",
    "scene=gas&dt=nan": "dt must be a finite number",
    "scene=gas&dt=-1": "dt must be a finite number > 0",
    "scene=gas&dt=1e300": "size of dt must be a number from 0.0001 to 1",
    "scene=gas&dt=1e-300": "size of dt must be a number from 0.0001 to 1",
    "scene=gas&passes=1000": "passes must be a whole number from 1 to 100",
    "scene=gas&substeps=1000000": "substeps must be a whole number from 1 to 100",
    "scene=gas&passes=1e2": "passes must be",
    "scene=gas&seed=-1": "seed must be a whole number from 0",
    "scene=gas&seed=99999999999999999999": "seed must be a whole number from 0",
    "scene=cradle&seed=3": "seed must be left out",
    "scene=gas&method=mpi": "must run in one process",
    "scene=gas&method=events": "Did you mean 'event'",
    "scene=gas&gravity=5": "gravity in a link must be two numbers, such as gravity=0,-5; got '5'. Give x and y.",
    "scene=gas&gravity=1,2,3": "gravity in a link must be two numbers",
    "scene=gas&gravity=0,down": "gravity in a link must be two numbers",
    "scene=gas&gravity=inf,0": "gravity must be finite",
    "scene=gas&restitution=2": "restitution must be",
    "scene=gas&piston_speed=1": "piston_speed can be changed only in a scene with a piston",
    "scene=piston&piston_speed=-1e9": "size of piston_speed must be",
    "scene=gas&friction=0.5": "friction can be changed only in a scene that has it",
    "scene=rough-hopper&friction=0": "friction must be > 0 in a change",
    "scene=rough-hopper&friction=1e-9": "size of friction must be",
    "scene=rough-hopper&wall_friction=inf": "size of wall_friction must be",
    "scene=galton&interval=1e-9": "size of interval must be",
    "scene=gas&beside=": "beside must be a method",
    "scene=gas&beside=event,event": "beside must be a method",
    "scene=gas&beside=workers=8": "beside must be a method",
    "scene=gas&beside=dt=0.003": "must be that of the first one",
    "scene=gas&beside=dt=1e-9": "size of dt must be",
    "scene=gas&beside=substeps=1000000": "substeps must be",
    "scene=gas&gravity=1e300,0": "size of gravity must be a number from 0 to 50; got 1e+300",
    "scene=gas&gravity=0,-50.1": "size of gravity must be",
    "scene=gas&gravity=1e308,1e308": "size of gravity must be",
    "scene=sediment&gravity=0,200.1": "size of gravity must be a number from 0 to 200",
    "scene=gas&speed=quick": "speed must be",
    "scene=gas&speed=1e9": "speed must be",
    "scene=gas&zoom=nan": "zoom must be a number from 0.5 to 64",
    "scene=gas&zoom=1000": "zoom must be a number from 0.5 to 64; got 1000",
    "scene=gas&zoom=2&x=inf": "x must be finite",
    "scene=gas&x=2": "x must come with zoom",
    "scene=gas&canvas=3d": "canvas must be",
    "scene=gas&passes=50&substeps=50": "at most 1,000 passes in one frame of the first stage; got 2,500",
    "scene=gas&method=grid&dt=0.01&beside=dt=0.001,passes=100,substeps=2": "got 2,000 (frames 10, substeps 2, passes",
    "scene=%ff": "a link must be names and values",
    "&".join(["scene=gas"] * 100): "a link must be names and values",
    "scene=" + "x" * 2000: "at most 1000 characters",
}


@pytest.mark.parametrize("query", HOSTILE)
def test_what_cannot_be_had_is_refused_by_name(query):
    with pytest.raises(mpsim.InputError) as refused:
        link.read(query)
    assert HOSTILE[query] in str(refused.value)
    assert len(str(refused.value)) < 500


@pytest.mark.parametrize(
    ("query", "text"),
    [
        ("zoom=nan", "zoom must be a number"),
        ("wait&speed=0", "speed must be a number"),
        ("zoom=2&x=here", "x must be"),
        ("y=1", "y must come with zoom"),
        ("zoom=2&zoom=3", "zoom must be in a link once"),
    ],
)
def test_what_concerns_only_the_display_is_checked_without_a_scene(query, text):
    with pytest.raises(mpsim.InputError, match=text):
        link.checked(query)


def test_passes_substeps_and_frames_may_be_up_to_a_thousand_together():
    assert link.read("scene=gas&passes=50&substeps=20").settings.substeps == 20
    second = link.read("scene=gas&method=grid&dt=0.01&beside=dt=0.001,passes=100").beside
    assert (second.dt, second.passes) == (0.001, 100)


def test_gravity_may_be_a_hundred_times_the_longest_arrow():
    assert link.read("scene=gas&gravity=-50,0").changed == {"gravity": [-50.0, 0.0]}
    assert link.read("scene=sediment&gravity=0,200").changed == {"gravity": [0.0, 200.0]}


def test_friction_is_in_a_link_of_a_scene_that_has_it():
    found = link.read("scene=rough-hopper&friction=0.25")
    assert found.changed == {"friction": 0.25}
    assert link.write(found) == "scene=rough-hopper&friction=0.25"
    assert link.changed_of(found.given.changed(friction=0.25), found.given) == {"friction": 0.25}


def test_a_link_says_what_it_holds_and_is_written_again_as_it_was():
    found = link.read(ASKED)
    assert (found.scene, found.seed, found.beside.method, found.beside.dt) == ("gas", 3, "event", 0.005)
    assert found.settings == mpsim.Settings(dt=0.005, method="grid")
    assert found.changed == {"gravity": [0.0, -1.5], "restitution": 0.9}
    assert link.write(found) == ASKED


@pytest.mark.parametrize(
    "query",
    [
        "method=grid&wait&beside=%65vent&scene=gas&dt=5e-3",
        "scene=gas&dt=0.0050&method=grid&beside=method=event",
    ],
)
def test_links_that_ask_for_the_same_have_one_text(query):
    assert link.write(link.read(query)) == "scene=gas&dt=0.005&method=grid&beside=event"


@pytest.mark.parametrize("beside", ["event", "dt=0.001", "contact=push,passes=3", "grid,precision=float32", "naive"])
def test_a_second_stage_is_written_as_it_is_read(beside):
    found = link.read(f"scene=gas&beside={beside}")
    again = link.read(link.write(found))
    assert again == found
    assert found.beside != found.settings


@pytest.mark.parametrize("where", ["?", "http://127.0.0.1:8000/a-token/?", "https://elsewhere.example/?"])
def test_a_command_opens_what_an_address_asks_for(where, monkeypatch):
    seen = []
    monkeypatch.setattr(live, "view", lambda asked, **more: seen.append((asked, more)))
    outcome = CliRunner().invoke(command, [f"{where}{ASKED}&wait&speed=2#top", "--passes", "2"])
    assert outcome.exit_code == 0, outcome.output
    asked, more = seen.pop()
    assert (more["name"], more["playing"], more["host"]) == ("gas", False, "127.0.0.1")
    assert asked.settings == mpsim.Settings(dt=0.005, method="grid", passes=2), "options count more"
    assert asked._replace(settings=link.read(ASKED).settings, seen={}) == link.read(ASKED)._replace(seen={})
    assert asked.seen == {"wait": "", "speed": "2"}


def test_an_address_of_a_running_view_alone_is_no_scene():
    outcome = CliRunner().invoke(command, ["http://127.0.0.1:8000/a-token/"])
    assert outcome.exit_code == 2
    assert "must have a scene behind a question mark" in outcome.output


@pytest.mark.parametrize(
    ("query", "said"),
    [
        ("dt=foo", "SCENE, a link: dt must be a number > 0 [time]; got 'foo'."),
        ("passes=0", "SCENE, a link: passes must be a whole number from 1 to 1000; got 0."),
        ("gravity=5", "SCENE, a link: gravity in a link must be two numbers"),
    ],
)
def test_a_command_names_no_option_for_what_stands_in_a_link(query, said):
    outcome = mpsim_command("view", f"?scene=gas&{query}")
    assert outcome.exit_code == 2
    assert said in outcome.stderr


def state_of(asked):
    """Digest of ten frames of what a link asks for, by the library alone."""
    with mpsim.Simulation(asked.given.redrawn(asked.seed), asked.settings) as sim:
        sim.change(**asked.changed)
        sim.run(frames=10)
        return sim.digest()


@pytest.mark.slow
def test_a_view_of_a_link_has_its_scene_seed_parameters_and_second_stage(capsys):
    asked = link.read(ASKED)
    with viewed(asked._replace(seen={"wait": ""}), name="gas", playing=False) as view:
        address = view.address.partition("?")
        assert address[2] == f"{ASKED}&wait="
        with Visitor(address[0]) as page:
            page.say("visible", value=True)
            page.say("step", frames=10)
            page.hear_until(lambda page: page.frame == 10)
            assert page.last["link"]["text"] == ASKED
            assert page.last["pair"]["second"] == "event"
            assert view._session._sim.digest() == state_of(asked)
            assert state_of(asked._replace(changed={"restitution": 0.8})) != state_of(asked), "negative control"


def test_a_running_view_begins_anew_with_another_scene_on_all_pages(capsys):
    options = {"name": "mine", "playing": False}
    with (
        viewed(gas(80, 0.2), mpsim.Settings(method="grid"), **options) as view,
        Visitor(view.address) as page,
        Visitor(view.address) as other,
    ):
        for each in (page, other):
            each.say("visible", value=True)
        page.hear_until(lambda page: page.frame == 0 and "link" in page.last)
        assert page.last["link"]["text"] is None, "it does not come with mpsim"
        page.say("open", link=ASKED)
        for each in (page, other):
            each.hear_until(lambda each: (each.last.get("link") or {}).get("text") == ASKED)
            each.hear_until(lambda each: each.phase == "paused" and len(each.picture.position) == 100)
            assert each.last["scene"]["name"] == "gas"
        page.say("change", name="dt", value=0.01, same=False)
        page.hear_until(lambda page: "dt=0.005" not in page.last["link"]["text"])
        page.say("reset")
        page.hear_until(lambda page: page.last["link"]["text"] == ASKED)


def test_a_wrong_link_ends_the_connection_that_sent_it_and_changes_nothing(capsys):
    with viewed(gas(80, 0.2), mpsim.Settings(method="grid"), playing=False) as view:
        with Visitor(view.address) as hostile:
            hostile.say("open", link="scene=/etc/passwd")
            with pytest.raises(Exception, match="scene of a link must be one of"):
                hostile.hear_for(10)
        with Visitor(view.address) as page:
            page.say("visible", value=True)
            page.hear_until(lambda page: page.phase == "paused" and page.frame == 0)
            assert len(page.picture.position) == 80


def test_a_page_can_ask_what_a_link_means(capsys):
    with viewed(gas(80, 0.2), mpsim.Settings(method="grid"), playing=False) as view:
        answer = fetch(view.address, path="link?wait&dt=5e-3&scene=gas")
        assert (answer.status, answer.body) == (200, b"scene=gas&dt=0.005")
        answer = fetch(view.address, path="link?scene=gas&count=1000000000")
        assert answer.status == 409
        assert b"a name in a link must be one of" in answer.body
        assert answer.getheader("Content-Type").startswith("text/plain")
        assert fetch(view.address.rstrip("/") + "x/", path="link?scene=gas").status == 404, "without the token"


@pytest.mark.parametrize("kind", ["a recording", "a simulation of a program"])
def test_what_is_no_scene_of_its_own_understands_a_link_and_does_not_follow_it(tmp_path, capsys, kind):
    """The page needs both to say which command to use: what was asked for, and that nothing that runs has a link."""
    scene = gas(80, 0.2)
    with mpsim.Simulation(scene, mpsim.Settings(method="grid")) as sim:
        if kind == "a recording":
            written(tmp_path / "run.xyz", scene, frames=2, every=1)
        source = mpsim.Trajectory(tmp_path / "run.xyz") if kind == "a recording" else sim
        with viewed(source, playing=False) as view, Visitor(view.address) as page:
            page.say("visible", value=True)
            page.hear_until(lambda v: v.frame == 0 and "link" in v.last)
            assert page.last["link"]["text"] is None
            assert bool(page.last["scene"].get("recording")) == (kind == "a recording")
            assert page.last["scene"]["can_reset"] == (kind == "a recording")
            answer = fetch(view.address, path="link?wait&method=grid&scene=dense")
            assert (answer.status, answer.body) == (200, b"scene=dense&method=grid")
            page.say("open", link="scene=dense")
            page.hear_until(lambda v: v.last["status"]["note"])
            assert (page.frame, page.last["scene"]["width"]) == (0, scene.width)


def test_settings_that_no_result_depends_on_are_in_no_link():
    settings = mpsim.Settings(method="parallel", workers=2)
    assert link.write(link.Link("gas", 0, settings, {}, None)) == "scene=gas&method=parallel"
    left = {each.name for each in dataclasses.fields(mpsim.Settings)} - set(link.SETTINGS)
    assert left == {"workers"}
