"""The server of a view: whom it answers, what it sends to whom and when, and what hostile visitors can do: nothing."""

import contextlib
import os
import random
import re
import signal
import socket
import sys
import threading
import time
import webbrowser
from urllib.parse import urlsplit

import pytest
from support.commands import mpsim_command
from support.processes import Script, assert_clean, assert_nothing_left_of, run_script
from support.scenes import gas, scene_of
from support.selection import long_but
from support.visitor import Visitor, digest_alone, fetch, kept, paused, viewed
from websockets.exceptions import ConnectionClosed, InvalidStatus

import mpsim

pytestmark = pytest.mark.plain

GRID = mpsim.Settings(method="grid")
SCENE = gas(20, 0.2)
ODD = "caf\udce9"  # a Latin-1 name, as Python reads it in a UTF-8 locale


@pytest.fixture(scope="module")
def view():
    """One for all visitors who must not be able to harm it: it still works in the end."""
    with viewed(SCENE, GRID, name="a gas") as found:
        with Visitor(found.address) as page:
            page.hear_until(lambda v: "hands" in v.last)  # its simulation has begun
        yield found
        with Visitor(found.address, visible=True) as page:
            page.say("play")
            frame = page.hear_until(lambda v: v.frame >= 0 and v.frame)
            page.hear_until(lambda v: v.frame > frame + 5)
            page.say("pause")
            page.hear_until(lambda v: v.phase == "paused")
            session = kept(found.address)
            assert session.digest == digest_alone(SCENE, GRID, session.frame), "and its bits are those of a run alone"
        assert not found.wait(0)


def still_runs(page, frames=5):
    frame = page.frame
    page.hear_until(lambda v: v.frame > frame + frames)
    return True


# --- what a page gets


def test_one_picture_is_in_flight_until_it_is_acknowledged(view):
    with Visitor(view.address, visible=True) as page:
        page.hear_until(lambda v: v.pictures == 2)
        while page.hear(5, ack=False) != "picture":
            pass
        serial, frame = page.picture.serial, page.frame
        page.hear_until(lambda v: v.last["gauges"]["frame"] > frame + 10, ack=False)
        assert page.picture.serial == serial, "it ran on, and was not shown"
        page.say("ack", serial=serial)
        page.hear_until(lambda v: v.picture.serial > serial)
        assert page.frame > frame + 10, "the latest, not the next one"
        page.say("ack", serial=4_000_000_000)
        with pytest.raises(ConnectionClosed, match="serial of an ack must be that of the last picture"):
            page.hear_for(60)


def test_nothing_runs_while_no_page_is_visible():
    with viewed(SCENE, GRID) as view, Visitor(view.address, visible=True) as page:
        page.hear_until(lambda v: v.frame > 3)
        page.say("visible", value=False)
        page.hear_for(0.3)
        frame, pictures, spent = kept(view.address).frame, page.pictures, time.process_time()
        page.hear_for(0.5)
        assert time.process_time() - spent < 0.1, "it costs nothing"
        assert (kept(view.address).frame, page.pictures) == (frame, pictures)
        page.say("visible", value=True)
        page.hear_until(lambda v: v.frame > frame)
        page.socket.close()
        time.sleep(0.3)
        frame = kept(view.address).frame
        time.sleep(0.3)
        assert kept(view.address).frame == frame, "a page that was closed sees nothing"


def test_several_pages_see_the_same_and_a_slow_one_holds_up_none(view):
    small = {"max_queue": 1, "close_timeout": 0.5}
    with Visitor(view.address, visible=True) as quick, Visitor(view.address, visible=True, **small) as slow:
        quick.hear_until(lambda v: v.pictures > 30)
        slow.hear_until(lambda v: v.pictures == 3)
        assert slow.frame > 10
        quick.say("pause")
        for each in (quick, slow):
            each.hear_until(lambda v: v.phase == "paused")
        frame = kept(view.address).frame
        for each in (quick, slow):
            each.hear_until(lambda v: v.frame == frame)
        quick.say("play")


def test_at_most_eight_pages_at_a_time(view):
    with contextlib.ExitStack() as stack:
        for _ in range(8):
            stack.enter_context(Visitor(view.address)).hear(20)
        with Visitor(view.address) as one_more, pytest.raises(ConnectionClosed) as closed:
            one_more.hear(20)
        told = closed.value.rcvd
        assert (told.code, told.reason) == (1013, "at most 8 pages at a time: close another one")


# --- whom it answers


def test_the_page_is_served_with_the_headers_that_guard_it(view):
    for path, kind in (("", "text/html"), ("page.js", "text/javascript"), ("page.css", "text/css")):
        answer = fetch(view.address, path=path)
        assert (answer.status, answer.headers["Content-Type"]) == (200, f"{kind}; charset=utf-8")
        assert "default-src 'none'; script-src 'self'" in answer.headers["Content-Security-Policy"]
        for name, value in {
            "X-Content-Type-Options": "nosniff", "Referrer-Policy": "no-referrer", "X-Frame-Options": "DENY",
            "Cache-Control": "no-store", "Cross-Origin-Resource-Policy": "same-origin", "Server": None,
        }.items():  # fmt: skip
            assert answer.headers[name] == value
        assert len(answer.body) > 1000
    scripts = set(re.findall(rb'(?:from|import) "\./([\w.]+)"', fetch(view.address, path="page.js").body))
    assert len(scripts) > 5
    assert all(fetch(view.address, path=name.decode()).status == 200 for name in scripts)


def test_nothing_else_is_served(view):
    for path in ("../server.py", "..%2fserver.py", "page/../../server.py", "/etc/passwd", "index.html", "page.js/",
                 "page.js%00", "socket/", "PAGE.JS", "widget.js", "x" * 3000, "keep/", "keep/../session.zip",
                 "keep/session.toml", "keep//etc/passwd", "keep/film.mp4", f"keep/{'x' * 3000}"):  # fmt: skip
        assert fetch(view.address, path=path).status == 404, path
    for method in ("POST", "HEAD", "OPTIONS", "CONNECT"):
        with contextlib.suppress(OSError):
            assert fetch(view.address, method).status in (400, 405, 501)
    assert fetch(view.address, path="socket").status in (403, 400, 426)


def test_without_the_token_nothing_is_told(view):
    where = urlsplit(view.address)
    token = where.path.strip("/")
    assert len(token) == 32
    for path in ("/", "/x/", "/favicon.ico", f"/{'a' * 32}/", f"/{token}", f"/{token}x/", f"/{token.swapcase()}/",
                 f"/x/{token}/", f"//{token}/", f"/?{token}/", "/%7Bt%7D/", "/x/keep/session.zip"):  # fmt: skip
        answer = fetch(f"http://{where.netloc}{path}")
        assert (answer.status, b"Open the complete address" in answer.body) == (404, True), path


FORWARDED = ["localhost:9000", "LOCALHOST:9", "127.0.0.1:9000", "127.0.0.2:9000", "localhost", "127.0.0.1",
             "[::1]:9000", "192.168.0.7:9000", "[fe80::1]:9000"]  # fmt: skip
REBOUND = ["evil.example:9000", "evil.example", "127.0.0.1.evil.example", "localhost.evil.example:9000", "0.0.0.0:9000",
           "[::]:81", "x@127.0.0.1:81", "[::1%x]:9000", "[::1%25lo]:81", "::1:81", "[localhost]:81", "[127.0.0.1]:81",
           "[::1]x:81", "127.0.0.1:81:81", "127.0.0.1:", "127.0.0.1:x", "127.0.0.1:123456", "localhost.:81", ":81",
           "localhost,evil.example:81", "127.1:81", "2130706433:81", "0x7f.0.0.1:81"]  # fmt: skip


@pytest.mark.parametrize("host", ["127.0.0.1", "0.0.0.0"])
def test_it_is_asked_by_numbers_or_by_names_of_this_machine_from_its_own_page(host):
    """A forwarded port, as by `ssh -L 9000:host:8000`, changes host and port; token and origin are still demanded."""
    with viewed(SCENE, GRID, playing=False, host=host) as view:
        where = urlsplit(view.address)
        here = f"http://127.0.0.1:{where.port}{where.path}"
        assert where.hostname == (host if host == "127.0.0.1" else socket.gethostname().lower())

        def asking(name, **options):
            to_view = socket.create_connection(("127.0.0.1", where.port))
            return Visitor(f"http://{name}{where.path}", sock=to_view, **options)

        for name in FORWARDED:
            answer = fetch(here, Host=name)
            assert answer.status == 200, name
            assert f"ws://{name};" in answer.headers["Content-Security-Policy"]
            other = "y" if where.path[1] == "x" else "x"
            assert fetch(f"http://127.0.0.1:{where.port}/{other}{where.path[2:]}", Host=name).status == 404
            with asking(name.lower()) as page:
                page.hear_until(lambda v: v.phase == "paused")
        for origin in (None, "null", "http://evil.example", "http://127.0.0.1:90000", "https://127.0.0.1:9000"):
            with pytest.raises(InvalidStatus) as refused:
                asking("127.0.0.1:9000", origin=origin)
            assert refused.value.response.status_code == 403
        for name in REBOUND:
            answer = fetch(here, Host=name)
            assert answer.status == 421, name
            assert where.path.strip("/") not in answer.body.decode()
        assert b"with localhost in place of its host; where a port is forwarded, with that port" in answer.body
        with pytest.raises(InvalidStatus):
            asking("evil.example:9000")
        assert (fetch(here, Host=f"{socket.gethostname()}:9000").status == 200) is (host == "0.0.0.0")
        for hosts in (b"", b"Host: 127.0.0.1\r\nHost: 127.0.0.1\r\n", b"Host: localhost:\xef\xbc\x98\r\n"):
            with socket.create_connection(("127.0.0.1", where.port)) as raw:
                raw.sendall(b"GET " + where.path.encode() + b" HTTP/1.1\r\n" + hosts + b"\r\n")
                assert b" 421 " in raw.recv(100)


# --- hostile visitors: each ends its own connection


def closed_after(view, *messages):
    """Code and reason of the end of a connection that sends these messages."""
    with Visitor(view.address, visible=True) as page:
        with contextlib.suppress(ConnectionClosed):
            for message in messages:
                page.socket.send(message)
        with pytest.raises(ConnectionClosed) as closed:
            page.hear_for(60)
    assert closed.value.rcvd is not None
    return closed.value.rcvd.code, closed.value.rcvd.reason


def test_what_breaks_a_rule_is_told_which(view):
    with Visitor(view.address, visible=True) as polite:
        assert closed_after(view, "garbage")[1].startswith("a message must be JSON; got 'garbage' (une")
        assert closed_after(view, b"bytes") == (1003, "a page sends text, not bytes")
        assert closed_after(view, " " * 5000)[0] == 1009, "too long"
        flood = closed_after(view, *(['{"do": "pause"}'] * 1200))
        assert flood == (1008, "at most 200 messages a second are read; got more. Send fewer.")
        polite.say("play")
        assert still_runs(polite, 10)


def test_random_bytes_and_broken_frames_do_no_harm(view):
    where, rng = urlsplit(view.address), random.Random(0)
    starts = [b"", b"GET ", f"GET {where.path}socket HTTP/1.1\r\n".encode(), b"\x16\x03\x01",
              b"GET / HTTP/1.1\r\n" + b"A: b\r\n" * 500]  # fmt: skip
    for start in starts:
        with socket.create_connection((where.hostname, where.port)) as raw, contextlib.suppress(OSError):
            raw.sendall(start + rng.randbytes(rng.randrange(1, 5000)))
            raw.shutdown(socket.SHUT_WR)
            raw.settimeout(20)
            while raw.recv(1000):
                pass
    for noise in (b"\xff" * 20, b"\x81\x05hello", b"\x81\xff" + b"\xff" * 8, b"\x83\x80\0\0\0\0", os.urandom(200)):
        with Visitor(view.address) as page:
            page.hear(20)
            page.socket.socket.sendall(noise)
            with pytest.raises(ConnectionClosed):
                page.hear_for(60)


def test_visitors_who_read_nothing_or_are_cut_off_hold_up_nobody(view):
    with Visitor(view.address, visible=True, max_queue=1, close_timeout=0.5):
        for _ in range(20):
            with Visitor(view.address, visible=True) as page:
                page.socket.socket.shutdown(socket.SHUT_RDWR)
        with Visitor(view.address, visible=True) as page:  # as cut connections are no pages any more
            page.hear_until(lambda v: v.frame >= 0)
            assert still_runs(page)


# --- its beginning and its end


def test_closing_tells_the_pages_and_leaves_no_thread_and_no_port():
    threads = threading.active_count()
    with viewed(SCENE, GRID) as view, Visitor(view.address, visible=True) as page:
        page.say("speed", value=None)
        page.hear_until(lambda v: v.frame > 30)
        view.close()
        view.close()
        with pytest.raises(ConnectionClosed):
            page.hear_for(60)
    end = time.monotonic() + 20
    while threading.active_count() > threads and time.monotonic() < end:
        time.sleep(0.02)
    assert threading.active_count() <= threads
    where = urlsplit(view.address)
    with pytest.raises(OSError, match="refused"):
        socket.create_connection((where.hostname, where.port))


def test_the_address_is_printed_and_the_browser_opened_where_there_is_one(monkeypatch, capsys):
    opened = []
    monkeypatch.setattr(webbrowser, "open", opened.append)
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"):
        monkeypatch.delenv(name, raising=False)
    with mpsim.view(SCENE, playing=False, wait=False) as view:
        assert f"The live view is at {view.address}\n" in capsys.readouterr().out
        assert repr(view) == f"<View: {view.address}>"
        view.start(browser=False)  # again: it goes on as it is
        with Visitor(view.address) as page:
            page.hear_until(lambda v: v.phase == "paused")
    assert opened == []
    monkeypatch.setenv("DISPLAY", ":0")
    with mpsim.view(SCENE, wait=False, browser=False) as other:
        assert opened == []
        assert urlsplit(other.address).path != urlsplit(view.address).path, "each has a token of its own"
    with mpsim.view(SCENE, wait=False) as view:
        assert opened == [view.address]
    assert re.fullmatch(r"http://127\.0\.0\.1:\d+/[\w-]{32}/", view.address)


def test_a_name_that_is_not_utf8_is_shown_with_an_escape():
    with paused(SCENE, GRID, name=ODD) as page:
        assert page.last["scene"]["name"] == "caf\\udce9"
        assert fetch(page.view.address, path="keep/session.zip").status == 200


def test_what_cannot_start_ends_the_view_with_its_error_and_says_so_on_the_page():
    wrong = mpsim.Settings(method="event", law="reflect")
    with viewed(SCENE, wrong) as view, Visitor(view.address) as page:
        page.hear_until(lambda v: v.phase == "over")
        assert "reflect" in page.last["status"]["note"]
        with pytest.raises(mpsim.InputError, match="reflect"):
            view.wait(60)
    with pytest.raises(mpsim.InputError, match="reflect"):
        mpsim.view(SCENE, wrong, browser=False)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"source": "gas"}, r"a view shows an mpsim.Scene, an .* or an mpsim.Trajectory; got str. Use mpsim.Scene"),
        ({"settings": {"dt": 1}}, r"settings must be mpsim.Settings; got dict. Use Settings\(dt="),
        ({"host": 7}, r"host must be a name or an address; got 7. Use '127.0.0.1'"),
        ({"port": 70000}, r"port must be a whole number from 0 to 65535; got 70000. 0 takes one"),
        ({"playing": None}, r"playing must be True or False; got None"),
        ({"colour": [1.0, 2.0]}, r"colour must be an array of 20 numbers, one for each disc; got \[1.0, 2.0\]"),
        ({"beside": "event"}, r"beside must be mpsim.Settings; got str. Use Settings\(method='event'"),
        ({"settings": mpsim.Settings(method="mpi")}, r"one process, as a view does; got 'mpi'"),
    ],
)
def test_what_is_wrong_is_named_before_anything_is_open(arguments, text):
    before = len(os.listdir("/proc/self/fd"))
    with pytest.raises((mpsim.InputError, TypeError), match=text):
        mpsim.view(**{"source": SCENE, "wait": False, **arguments})
    assert len(os.listdir("/proc/self/fd")) <= before


def test_a_simulation_brings_its_own_settings_and_has_no_second_stage():
    with mpsim.Simulation(SCENE, GRID) as sim:
        with pytest.raises(mpsim.InputError, match="settings can be given only with a scene; got it with a simul"):
            mpsim.view(sim, GRID, wait=False)
        with pytest.raises(mpsim.InputError, match="beside can be given only with a scene; got it with a simul"):
            mpsim.view(sim, beside=GRID, wait=False)


def test_a_port_that_is_taken_and_a_host_of_others_are_named():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(
            mpsim.errors.ResourceError, match=rf"a free port; got '127.0.0.1' and {port} \(Address already in use\)\. "
        ):
            mpsim.view(SCENE, port=port, wait=False)
    with pytest.raises(mpsim.errors.ResourceError, match=r"got '203.0.113.7' \(Cannot assign requested address\)\. "):
        mpsim.view(SCENE, host="203.0.113.7", wait=False)


def test_without_websockets_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "websockets.asyncio.server", None)
    with pytest.raises(
        mpsim.errors.OutputError, match=r"a live view needs the package websockets, .* `pip install 'mpsim\[view\]'`"
    ):
        mpsim.view(SCENE)
    failed = mpsim_command("view", "gas")
    assert failed.exit_code == 1
    assert "pip install 'mpsim[view]'" in failed.stderr


# --- views in programs and commands of their own: what they print, what ends them, what they leave

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
    scene_of([[2, 2]], [[1, 0]], 9, 9, obstacles=[mpsim.FixedDisc((6, 6), 0.5)]).save(scene)
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
