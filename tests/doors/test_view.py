"""What the live view survives: names that are not UTF-8, temporary files that are removed, ports that are forwarded."""

import glob
import json
import shutil
import socket
import tempfile
from urllib.parse import urlsplit

import pytest
from support.scenes import gas
from support.trajectories import written
from support.viewing import Visitor, fetch, viewed
from websockets.exceptions import InvalidStatus

import mpsim

SCENE, GRID = gas(20, 0.2), mpsim.Settings(method="grid")
ODD = "caf\udce9"  # a Latin-1 name, as Python reads it in a UTF-8 locale


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The folder for temporary files."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


@pytest.mark.parametrize("kind", ["scene", "recording"])
def test_a_name_that_is_not_utf8(kind, tmp_path, capsys):
    source, settings, shown = SCENE, GRID, "caf\\udce9"
    if kind == "recording":
        written(tmp_path / f"{ODD}.xyz", SCENE, frames=4)
        source, settings, shown = mpsim.Trajectory(tmp_path / f"{ODD}.xyz"), None, "caf\\udce9.xyz"
    options = {"name": ODD} if kind == "scene" else {}
    with viewed(source, settings, playing=False, **options) as view, Visitor(view.address) as visitor:
        visitor.say("visible", value=True)
        visitor.hear_until(lambda v: v.frame == 0 and "scene" in v.last)
        assert visitor.last["scene"]["name"] == shown
        if kind == "scene":
            visitor.hear_until(lambda v: v.phase == "paused")
            assert fetch(view.address, path="keep/scene.zip").status == 200
        assert not view.wait(0)


def test_a_page_may_send_half_a_character(capsys):
    """Its connection is closed, as for any text that is no JSON; the view lives on."""
    with viewed(SCENE, GRID, playing=False) as view:
        for text in (
            '{"do": "colour", "by": "\\udce9"}',
            '{"do": "\\ud800"}',
            '{"do": "open", "link": "scene=%ed%b3%a9"}',
        ):
            with Visitor(view.address) as visitor:
                visitor.socket.send(text)
                with pytest.raises(Exception, match="1008"):
                    visitor.hear_for(20)
        with Visitor(view.address) as visitor:
            visitor.hear_until(lambda v: v.phase == "paused")


def remove_folder(folder):
    found = glob.glob(str(folder / "mpsim-view-*"))
    assert found
    for each in found:
        shutil.rmtree(each)


def remove_files(folder):
    found = glob.glob(str(folder / "mpsim-view-*" / "*"))
    assert found
    for each in found:
        (folder / each).unlink()


@pytest.mark.parametrize("clean", [remove_folder, remove_files])
def test_a_cleaner_of_temporary_files_costs_only_the_moments_before(clean, folder, capsys):
    with viewed(SCENE, GRID, playing=False) as view, Visitor(view.address) as visitor:

        def remove(disc, left):
            visitor.say("remove", id=disc, same=False)
            visitor.hear_until(lambda v: v.last["gauges"]["discs"] == left)

        visitor.say("visible", value=True)
        visitor.hear_until(lambda v: v.phase == "paused" and {"hands", "gauges"} <= v.last.keys())
        visitor.say("snapshot")
        remove(3, 19)
        remove(4, 18)
        clean(folder)
        visitor.say("undo")
        visitor.hear_until(lambda v: v.last["hands"]["note"] is not None)
        assert "something has removed it" in visitor.last["hands"]["note"]
        remove(5, 17)
        visitor.say("undo")
        visitor.hear_until(lambda v: v.last["gauges"]["discs"] == 18)
        visitor.say("return")
        visitor.hear_until(lambda v: "something has removed it" in (v.last["status"]["note"] or ""))
        remove(6, 17)
        clean(folder)
        visitor.say("reset")
        visitor.hear_until(lambda v: v.last["gauges"]["discs"] == 20 and v.phase == "paused")
        remove(7, 19)
        visitor.say("undo")
        visitor.hear_until(lambda v: v.last["gauges"]["discs"] == 20)
    assert not list(folder.iterdir())


def test_without_a_folder_for_temporary_files_changes_are_refused(folder, monkeypatch, capsys):
    with viewed(SCENE, GRID, playing=False) as view, Visitor(view.address) as visitor:
        monkeypatch.setattr(tempfile, "tempdir", str(folder / "none"))
        visitor.say("remove", id=3, same=False)
        visitor.hear_until(lambda v: "undo needs a folder" in (v.last.get("hands", {}).get("note") or ""))
        assert not view.wait(0)


FORWARDED = ["localhost:9000", "127.0.0.1:9000", "localhost", "[::1]:9000", "192.168.0.7:9000"]
REBOUND = ["evil.example:9000", "evil.example", "[::1%x]:9000", "localhost.evil.example:9000", "0.0.0.0:9000"]


@pytest.mark.parametrize("host", ["127.0.0.1", "0.0.0.0"])
def test_a_forwarded_port(host, capsys):
    """As by `ssh -L 9000:host:8000`: the browser's host and port are others. Token and origin are still demanded."""
    with viewed(SCENE, GRID, playing=False, host=host) as view:
        where = urlsplit(view.address)
        here = f"http://127.0.0.1:{where.port}{where.path}"

        def asking(name, **options):
            to_view = socket.create_connection(("127.0.0.1", where.port))
            return Visitor(f"http://{name}{where.path}", sock=to_view, **options)

        for name in FORWARDED:
            answer = fetch(here, Host=name)
            assert answer.status == 200
            assert f"ws://{name};" in answer.headers["Content-Security-Policy"]
            assert fetch(f"http://127.0.0.1:{where.port}/x{where.path[2:]}", Host=name).status == 404
            with asking(name) as visitor:
                visitor.hear_until(lambda v: v.phase == "paused")
            for origin in ("http://evil.example", f"http://{name}0", f"https://{name}", "null"):
                with pytest.raises(InvalidStatus):
                    asking(name, origin=origin)
        for name in REBOUND:
            answer = fetch(here, Host=name)
            assert answer.status == 421
            assert where.path.strip("/") not in answer.body.decode()
            assert (
                "with localhost in place of its host; where a port is forwarded, with that port" in answer.body.decode()
            )
            with pytest.raises(InvalidStatus):
                asking(name)
        assert (fetch(here, Host=f"{socket.gethostname()}:9000").status == 200) is (host == "0.0.0.0")


def test_a_view_may_be_started_again(capsys):
    with viewed(SCENE, GRID, playing=False) as view:
        view.start(browser=False)
        with Visitor(view.address) as visitor:
            visitor.hear_until(lambda v: v.phase == "paused")
            assert json.dumps(visitor.last)


EQUAL = {"count": 30, "packing": 0.2, "radius": 0.5, "seed": 1}
MAXWELL = {
    "a gas": ({}, {}, None),
    "a gas under gravity": ({"gravity": (0, -1)}, {}, None),
    "a gas between warm walls": ({"thermal_walls": mpsim.ThermalWalls(left=1, right=1)}, {}, None),
    "a heat flow": ({"thermal_walls": mpsim.ThermalWalls(left=1, right=2)}, {}, "the walls differ in temperature"),
    "grains": ({"restitution": 0.9}, {}, "contacts take energy"),
    "heated grains": (
        {"restitution": 0.9, "thermostat": mpsim.Thermostat(temperature=1, rate=1)}, {}, "contacts take energy"
    ),
    "rough discs": ({"friction": 0.3}, {}, "contacts take energy"),
    "lossy walls": ({"wall_restitution": 0.9}, {}, "contacts take energy"),
    "an endless fall": (
        {"gravity": (0, -1), "boundary": "periodic"}, {}, "discs fall through a periodic edge"
    ),
    "the report's law": ({}, {"law": "reflect"}, "law reflect keeps the speed of each disc"),
    "two masses": ({"mass": [1.0] * 15 + [2.0] * 15}, {}, "the discs differ in mass"),
    "few discs": ({"count": 19}, {}, "fewer than 20 discs"),
}  # fmt: skip


@pytest.mark.parametrize("words", MAXWELL)
def test_maxwells_curve_is_drawn_where_speeds_come_to_it(words, capsys, compiled_when_run):
    scene, settings, reason = MAXWELL[words]
    scene = mpsim.Scene.random(**EQUAL | scene)
    with (
        viewed(scene, mpsim.Settings(**{"method": "grid"} | settings), playing=False) as view,
        Visitor(view.address) as visitor,
    ):
        visitor.say("visible", value=True)
        visitor.hear_until(lambda v: "gauges" in v.last)
        speeds = visitor.last["gauges"]["speeds"]
    assert speeds["note"] == (reason and f"no Maxwell curve: {reason}")
    assert (speeds["maxwell"] is None) is (reason is not None)


@pytest.mark.parametrize(
    "close", [lambda live: live.close(), lambda live: live.widget.close()], ids=["here", "by the notebook"]
)
def test_a_closed_view_in_a_cell_says_so(close):
    """A cell that is run again, or `Widget.close_all`: a traceback took the place of the page."""
    live = mpsim.live(SCENE, name="gas")
    assert "application/vnd.jupyter.widget-view+json" in live._repr_mimebundle_()[0], "the control"
    close(live)
    assert live._repr_mimebundle_() == {"text/plain": "<Live: 'gas'> is closed; mpsim.live shows another."}
    live.close()
