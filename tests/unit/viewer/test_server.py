"""The server of a view, tried by clients that keep its rules and by ones that do not."""

import contextlib
import json
import os
import random
import socket
import threading
import time
from urllib.parse import urlsplit

import numpy as np
import pytest
from support.scenes import gas
from support.viewing import Visitor, fetch, viewed
from websockets.exceptions import ConnectionClosed, InvalidStatus

import mpsim
from mpsim import measure
from mpsim.viewer import downloads, wire
from mpsim.viewer import server as server_module

GRID = mpsim.Settings(method="grid")
SCENE = gas(100, 0.3)


@pytest.fixture
def view(capsys):
    with viewed(SCENE, GRID, name="a gas") as found:
        yield found


def digest_after(frames: int) -> str:
    with mpsim.Simulation(SCENE, GRID) as alone:
        alone.run(frames=frames)
        return alone.digest()


def still_works(view) -> None:
    """A page of good manners gets pictures, and the bits are those of a run alone."""
    with Visitor(view.address) as visitor:
        visitor.say("visible", value=True)
        visitor.say("play")
        first = visitor.frame
        visitor.hear_until(lambda v: v.frame > max(first, 0) + 5)
        visitor.say("pause")
        visitor.hear_until(lambda v: v.phase == "paused")
        assert view._session.error is None
        assert view._session._sim.digest() == digest_after(view._session._sim.frame)


def test_a_page_sees_the_run(view):
    with Visitor(view.address) as visitor:
        visitor.hear_until(lambda v: "scene" in v.last)
        assert visitor.last["scene"]["name"] == "a gas"
        assert (visitor.last["scene"]["width"], visitor.last["scene"]["periodic"]) == (SCENE.width, [False, False])
        visitor.say("visible", value=True)
        visitor.hear_until(lambda v: v.frame > 20)
        visitor.say("pause")
        visitor.hear_until(lambda v: v.phase == "paused")
        frame = view._session._sim.frame
        visitor.hear_until(lambda v: v.frame == frame and v.last["gauges"]["frame"] == frame)
        state = view._session._sim.state
        assert np.abs(visitor.picture.position - state.position).max() <= 0.501 * SCENE.width / 65535
        assert visitor.last["gauges"]["temperature"] == measure.temperature(state, SCENE)
        assert visitor.radii.tolist() == [0.5]
        visitor.say("step", frames=3)
        visitor.hear_until(lambda v: v.frame == frame + 3)
        visitor.say("reset")
        visitor.hear_until(lambda v: v.frame == 0)
    still_works(view)


def test_one_picture_is_in_flight_until_it_is_acknowledged(view):
    with Visitor(view.address) as visitor:
        visitor.say("visible", value=True)
        visitor.hear_until(lambda v: v.pictures == 1)
        while visitor.hear(5, ack=False) != "picture":
            pass
        serial, frame = visitor.picture.header.serial, visitor.frame
        visitor.hear_for(1.0, ack=False)
        assert visitor.picture.header.serial == serial
        assert visitor.last["gauges"]["frame"] > frame + 10, "it ran on"
        visitor.say("ack", serial=serial)
        visitor.hear_until(lambda v: v.pictures > 2)
        assert visitor.frame > frame + 10, "the latest, not the next one"


def test_a_hidden_page_gets_no_pictures_and_nothing_runs(view):
    with Visitor(view.address) as visitor:
        visitor.say("visible", value=True)
        visitor.hear_until(lambda v: v.frame > 3)
        visitor.say("visible", value=False)
        visitor.hear_for(0.3)
        frame = view._session._sim.frame
        time.sleep(0.3)
        assert view._session._sim.frame == frame
        visitor.say("visible", value=True)
        visitor.hear_until(lambda v: v.frame > frame)


def test_a_closed_page_stops_the_run(view):
    with Visitor(view.address) as visitor:
        visitor.say("visible", value=True)
        visitor.hear_until(lambda v: v.frame > 3)
    time.sleep(0.3)
    frame = view._session._sim.frame
    time.sleep(0.3)
    assert view._session._sim.frame == frame
    still_works(view)


def test_several_pages_see_the_same_and_a_slow_one_holds_up_none(view):
    with Visitor(view.address) as quick, Visitor(view.address) as slow:
        for each in (quick, slow):
            each.say("visible", value=True)
        slow.hear_until(lambda v: v.radii is not None)
        quick.hear_until(lambda v: v.pictures > 30)
        slow.hear_until(lambda v: v.pictures == 1)
        slow.hear_until(lambda v: v.pictures == 3)
        assert slow.frame > 10
        quick.say("pause")
        for each in (quick, slow):
            each.hear_until(lambda v: v.phase == "paused")
            each.hear_until(lambda v: v.frame == view._session._sim.frame)


def test_at_most_eight_pages_at_a_time(view):
    with contextlib.ExitStack() as stack:
        visitors = [stack.enter_context(Visitor(view.address)) for _ in range(server_module.MOST_PAGES)]
        for visitor in visitors:
            visitor.hear(10)
        with Visitor(view.address) as one_more, pytest.raises(ConnectionClosed) as closed:
            one_more.hear(10)
        assert closed.value.rcvd.code == 1013
        assert closed.value.rcvd.reason == "at most 8 pages at a time: close another one"
    still_works(view)


# --- what is answered by HTTP


def test_the_page_is_served_with_the_headers_that_guard_it(view):
    for path, kind in (("", "text/html"), ("page.js", "text/javascript"), ("page.css", "text/css")):
        answer = fetch(view.address, path=path)
        assert (answer.status, answer.headers["Content-Type"]) == (200, f"{kind}; charset=utf-8")
        assert "default-src 'none'; script-src 'self'" in answer.headers["Content-Security-Policy"]
        assert answer.headers["X-Content-Type-Options"] == "nosniff"
        assert answer.headers["Referrer-Policy"] == "no-referrer"
        assert answer.headers["X-Frame-Options"] == "DENY"
        assert "Server" not in answer.headers
        assert len(answer.body) > 1000


@pytest.mark.parametrize(
    "path",
    ["../server.py", "..%2fserver.py", "page/../../server.py", "/etc/passwd", "index.html", "page.js/", "page.js%00",
     "socket/", "PAGE.JS", "x" * 3000],
)  # fmt: skip
def test_nothing_else_is_served(view, path):
    assert fetch(view.address, path=path).status == 404
    still_works(view)


def test_without_token_or_by_another_name_nothing_is_told(view):
    where = urlsplit(view.address)
    for path in ("/", "/x/", "/favicon.ico", f"/{'a' * 32}/"):
        answer = fetch(f"http://{where.netloc}{path}")
        assert answer.status == 404
        assert b"Open the complete address" in answer.body
    for host in ("evil.example", f"evil.example:{where.port}", "127.0.0.1.evil.example"):
        assert fetch(view.address, Host=host).status == 421
    for method in ("POST", "HEAD", "OPTIONS", "CONNECT"):
        with contextlib.suppress(OSError):
            assert fetch(view.address, method).status in (400, 405, 501)
    assert fetch(view.address, path="socket").status in (403, 400, 426)
    still_works(view)


@pytest.mark.parametrize("options", [{"origin": None}, {"origin": "null"}, {"origin": "http://evil.example"}])
def test_the_page_of_another_site_cannot_connect(view, options):
    with pytest.raises(InvalidStatus) as refused:
        Visitor(view.address, **options)
    assert refused.value.response.status_code == 403
    still_works(view)


def test_nor_can_one_that_lets_its_name_point_here(view):
    where = urlsplit(view.address)
    evil = f"evil.example:{where.port}"
    with socket.create_connection((where.hostname, where.port)) as raw:
        raw.sendall(
            f"GET {where.path}socket HTTP/1.1\r\nHost: {evil}\r\nOrigin: http://{evil}\r\nUpgrade: websocket\r\n"
            "Connection: Upgrade\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
            "Sec-WebSocket-Version: 13\r\n\r\n".encode()
        )
        assert raw.recv(100).startswith(b"HTTP/1.1 421 ")
    still_works(view)


# --- hostile connections: each ends itself, and nothing else


def hear_to_the_end(visitor) -> None:
    """Take messages until the connection ends, which raises; or until it should have ended."""
    end = time.monotonic() + 30
    while time.monotonic() < end:
        visitor.hear(10)


def closed_after(view, *messages) -> tuple[int, str]:
    """Code and reason of the end of a connection that sends these messages."""

    def talk(visitor):
        visitor.say("visible", value=True)
        for message in messages:
            visitor.socket.send(message)
        hear_to_the_end(visitor)

    with Visitor(view.address) as visitor, pytest.raises(ConnectionClosed) as closed:
        talk(visitor)
    assert closed.value.rcvd is not None
    return closed.value.rcvd.code, closed.value.rcvd.reason


def test_garbage_is_refused_with_a_reason(view):
    with Visitor(view.address) as polite:
        polite.say("visible", value=True)
        code, reason = closed_after(view, "garbage")
        assert (code, reason[:42]) == (1008, "a message must be JSON; got 'garbage' (une")
        assert closed_after(view, '{"do": "explode"}')[1].startswith("do of a message must be one of 'ack', 'visible'")
        assert closed_after(view, '{"do": "speed", "value": 1e9}')[0] == 1008
        assert closed_after(view, "[" * 4000)[0] == 1008
        assert closed_after(view, b"bytes") == (1003, "a page sends text, not bytes")
        assert closed_after(view, '{"do": "ack", "serial": 4000000000}')[1].startswith("serial of an ack must be")
        assert closed_after(view, "x" * 5000)[0] == 1009, "too long"
        assert closed_after(view, "x" * 5_000_000)[0] == 1009
        before = polite.frame
        polite.hear_until(lambda v: v.frame > before + 10)
    still_works(view)


def test_a_flood_ends_its_connection(view):
    code, reason = closed_after(view, *(['{"do": "pause"}'] * 2000))
    assert (code, reason) == (1008, "at most 200 messages a second are read; got more. Send fewer.")
    still_works(view)


def test_random_bytes_to_the_port_do_no_harm(view):
    where, rng = urlsplit(view.address), random.Random(0)
    starts = [
        b"",
        b"GET ",
        f"GET {where.path}socket HTTP/1.1\r\n".encode(),
        b"\x16\x03\x01",
        b"GET / HTTP/1.1\r\n" + b"A: b\r\n" * 500,
    ]
    for start in starts:
        for _ in range(4):
            with socket.create_connection((where.hostname, where.port)) as raw, contextlib.suppress(OSError):
                raw.sendall(start + rng.randbytes(rng.randrange(1, 5000)))
                raw.shutdown(socket.SHUT_WR)
                raw.settimeout(10)
                while raw.recv(1000):
                    pass
    still_works(view)


def test_frames_that_break_the_protocol_end_their_connection(view):
    for noise in (b"\xff" * 20, b"\x81\x05hello", b"\x81\xff" + b"\xff" * 8, b"\x83\x80\0\0\0\0", os.urandom(200)):
        with Visitor(view.address) as visitor:
            visitor.hear(10)
            visitor.socket.socket.sendall(noise)
            with pytest.raises(ConnectionClosed):
                hear_to_the_end(visitor)
    still_works(view)


def test_a_client_that_reads_nothing_holds_up_nobody(view):
    with Visitor(view.address, max_queue=1, close_timeout=0.5) as deaf:
        deaf.say("visible", value=True)
        still_works(view)


def test_connections_that_are_cut_leave_nothing(view):
    for _ in range(20):
        with Visitor(view.address) as visitor:
            visitor.say("visible", value=True)
            visitor.socket.socket.shutdown(socket.SHUT_RDWR)
    deadline = time.monotonic() + 10
    while view._server._clients and time.monotonic() < deadline:
        time.sleep(0.02)
    assert not view._server._clients
    assert view._session._watching == 0
    still_works(view)


def test_closing_while_it_runs_ends_all_and_pages_are_told(capsys):
    threads = threading.active_count()
    with viewed(SCENE, mpsim.Settings(method="parallel", workers=2)) as view, Visitor(view.address) as visitor:
        visitor.say("visible", value=True)
        visitor.say("speed", value=None)
        visitor.hear_until(lambda v: v.frame > 100)
        started = time.monotonic()
        view.close()
        assert time.monotonic() - started < 5
        with pytest.raises(ConnectionClosed):
            hear_to_the_end(visitor)
    deadline = time.monotonic() + 5
    while threading.active_count() > threads and time.monotonic() < deadline:
        time.sleep(0.02)
    assert threading.active_count() <= threads
    where = urlsplit(view.address)
    with pytest.raises(OSError, match="refused"):
        socket.create_connection((where.hostname, where.port))


def test_a_port_that_is_taken_and_a_host_of_others_are_named():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(
            mpsim.errors.ResourceError, match=rf"a free port; got '127.0.0.1' and {port} \(Address already in use\)\. "
        ):
            mpsim.view(SCENE, port=port, wait=False)
    with pytest.raises(mpsim.errors.ResourceError, match=r"got '203.0.113.7' \(Cannot assign requested address\)\. "):
        mpsim.view(SCENE, host="203.0.113.7", wait=False)


def test_the_schema_has_no_action_that_the_server_forgets(view):
    """Each action of the wire is done by server or session."""
    values = {"ack": None, "visible": {"value": True}, "step": {"frames": 1}, "speed": {"value": 2.0},
              "count": {"value": False}, "colour": {"by": "column"},
              "hold": {"id": 1, "x": 7.0, "y": 7.0}, "release": {"id": 1, "vx": 0, "vy": 0},
              "add": {"x": 1, "y": 1, "same": False}, "stroke": {"places": [[1, 9]], "same": False},
              "remove": {"id": 2, "same": False},
              "change": {"name": "passes", "value": 2, "same": False}, "seed": {"value": 3},
              "wall": {"ax": 1.0, "ay": 0.0, "bx": 1.0, "by": 0.1},  # too short: refused
              "beside": {"settings": {"frames": 2}},
              "open": {"link": "scene=gas&seed=2"}, "tune": {"measure": "overlap", "budget": 0.1}}  # fmt: skip
    with Visitor(view.address) as visitor:
        for name in wire.ACTIONS:
            if name not in ("ack", "seek", "follow"):  # the latter are of recordings
                visitor.socket.send(json.dumps({"do": name, **(values.get(name) or {})}))
        visitor.say("speed", value=3.0)  # when this is done, all before it are
        visitor.hear_until(lambda v: v.frame >= 0 and v.last["status"]["speed"] == 3.0)
        assert visitor.last["status"]["note"] is None


# --- what is done by hand, and kept


def test_what_is_refused_by_hand_reaches_the_page_and_ends_nothing(view):
    with Visitor(view.address) as visitor:
        visitor.say("visible", value=True)
        visitor.hear_until(lambda v: v.frame > 3 and "hands" in v.last)
        visitor.say("hold", id=10**6, x=1.0, y=1.0)
        visitor.hear_until(lambda v: "id must be the number of a disc" in (v.last["hands"]["note"] or ""))
        visitor.say("change", name="dt", value=-1.0, same=False)
        visitor.hear_until(lambda v: "dt must be from 0.001 to 0.1 here" in (v.last["hands"]["note"] or ""))
        frame = visitor.frame
        visitor.hear_until(lambda v: v.frame > frame + 5)
        assert visitor.phase == "playing"
    still_works(view)


def test_a_deed_that_the_schema_refuses_ends_its_connection_alone(view):
    with Visitor(view.address) as visitor:
        visitor.say("hold", id=1, x="nowhere", y=0.0)
        with pytest.raises(ConnectionClosed) as closed:
            visitor.hear_until(lambda v: False)
        assert closed.value.rcvd.code == 1008
    still_works(view)


def test_files_to_keep_need_the_token_and_a_name_that_there_is(view):
    with Visitor(view.address) as visitor:
        visitor.say("visible", value=True)
        visitor.hear_until(lambda v: v.frame > 3)
    for name, begin in (("session.zip", b"PK"), ("scene.zip", b"PK"), ("program.py", b'"""'), ("film.gif", b"GIF8")):
        answer = fetch(view.address, path=f"keep/{name}")
        assert (answer.status, answer.body[: len(begin)]) == (200, begin)
    for name in ("", "../session.zip", "session.toml", "/etc/passwd", "scene.zip/..", "x" * 3000):
        assert fetch(view.address, path=f"keep/{name}").status == 404
    where = urlsplit(view.address)
    assert fetch(f"http://{where.netloc}/", path="keep/session.zip").status == 404
    assert fetch(view.address, path="keep/session.zip", Host="evil.example").status == 421
    still_works(view)


def test_a_film_that_nobody_waits_for_any_more_still_counts_until_it_is_drawn(view, monkeypatch):
    drawing, free = threading.Event(), threading.Event()

    def slow(pictures, scene=None):
        drawing.set()
        assert free.wait(60)
        return b"GIF8"

    monkeypatch.setitem(downloads.FILMS, "film.gif", (slow, "image/gif"))
    monkeypatch.setattr(downloads, "MOST", 1)
    monkeypatch.setattr(downloads, "SECONDS", 0.2)
    assert fetch(view.address, path="keep/film.gif").status == 503
    assert drawing.is_set()
    try:
        answer = fetch(view.address, path="keep/session.zip")
        assert (answer.status, answer.body[:7]) == (503, b"At most")
    finally:
        free.set()
    monkeypatch.setattr(downloads, "SECONDS", 60)
    end = time.monotonic() + 60
    while fetch(view.address, path="keep/film.gif").status != 200:
        assert time.monotonic() < end
    still_works(view)


def test_files_to_keep_are_made_few_at_a_time(view, monkeypatch):
    monkeypatch.setattr(downloads, "MOST", 0)
    answer = fetch(view.address, path="keep/session.zip")
    assert (answer.status, answer.body[:7]) == (503, b"At most")
    still_works(view)
