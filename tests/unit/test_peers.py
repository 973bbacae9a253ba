"""scripts/run_peers.py: the yardsticks against a slow twin, tables of made-up times, and what is missing or fails.

The twin is the report's algorithm in plain Python. What drives each engine is in scripts/peers; those that are not
installed are skipped here, and are rows that say so there.
"""

import copy
import importlib
import math
import re
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from support.selection import long_but

import mpsim

TOP = Path(__file__).parents[2]


@pytest.fixture(scope="module", autouse=True)
def scripts():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(TOP / "scripts")
        yield


def peers(name):
    return importlib.import_module(f"peers.{name}")


@pytest.fixture(scope="module")
def start(scripts):
    scene = mpsim.Scene.random(count=40, packing=0.5, radius=0.5, seed=3)
    return peers("engine").Start(scene.width, scene.height, 0.5, scene.position, scene.velocity)


# --- the yardsticks


def bounced(place, speed, low, high):
    """A coordinate clamped between two walls, its velocity turned inward, and the impulse on each wall."""
    if place < low:
        return low, abs(speed), (2 * abs(speed) if speed < 0 else 0.0), 0.0
    if place > high:
        return high, -abs(speed), 0.0, (2 * abs(speed) if speed > 0 else 0.0)
    return place, speed, 0.0, 0.0


def collide(one, other, diameter):
    """Push two overlapping discs [x, y, vx, vy] apart and let them part by the elastic law."""
    x, y = other[0] - one[0], other[1] - one[1]
    distance = math.hypot(x, y)
    if not 0 < distance < diameter:
        return
    normal, half = (x / distance, y / distance), (diameter - distance) / 2
    approach = (other[2] - one[2]) * normal[0] + (other[3] - one[3]) * normal[1]
    for axis in range(2):
        one[axis] -= half * normal[axis]
        other[axis] += half * normal[axis]
        if approach < 0:
            one[2 + axis] += approach * normal[axis]
            other[2 + axis] -= approach * normal[axis]


def twin(start, dt, frames, around=(-1, 0, 1)):
    """Discs and impulses on the four walls after some frames; around: the order in which columns and rows are seen."""
    discs = [[*x, *v] for x, v in zip(start.position.tolist(), start.velocity.tolist(), strict=True)]
    sides, walls = (start.width, start.height), [0.0] * 4
    shape = [max(1, int(side / (2 * start.radius))) for side in sides]
    for _ in range(frames):
        cells = {}
        for i, disc in enumerate(discs):
            for axis in range(2):
                place = disc[axis] + disc[2 + axis] * dt
                found = bounced(place, disc[2 + axis], start.radius, sides[axis] - start.radius)
                disc[axis], disc[2 + axis] = found[:2]
                walls[2 * axis] += found[2]
                walls[2 * axis + 1] += found[3]
            cell = tuple(min(int(disc[axis] * shape[axis] / sides[axis]), shape[axis] - 1) for axis in range(2))
            cells.setdefault(cell, []).append(i)
        for column, row in sorted(cells):
            for a in cells[column, row]:
                for c in around:
                    for r in around:
                        for b in cells.get((column + c, row + r), ()):
                            if a != b:
                                collide(discs[a], discs[b], 2 * start.radius)
    return np.array(discs), np.array(walls)


def engine(name, start, **plan):
    entry = peers("registry").PEERS[name]
    missing = entry.why_missing()
    if missing:
        pytest.skip(f"{name}: {missing}")
    knob = entry.knobs[-1]
    chosen = peers("engine").Plan(**{"dt": 0.05, "precision": entry.precision, "counting": True, "knob": knob} | plan)
    return getattr(entry.load(), entry.engine)(start, chosen)


@pytest.mark.parametrize("name", ["cpp", "numba"])
def test_the_yardsticks_do_what_their_twin_does(name, start):
    run = engine(name, start, precision="float64")
    run.run(20)
    run.run(5)
    expected, walls = twin(start, 0.05, 25)
    assert np.abs(np.hstack(run.state()) - expected).max() < 1e-9
    np.testing.assert_allclose(run.walls(), walls, rtol=1e-9)
    run.close()


def test_the_twin_has_an_order(start):
    """The control: seen in another order, the same pairs give other discs."""
    assert np.abs(twin(start, 0.05, 25)[0] - twin(start, 0.05, 25, around=(1, 0, -1))[0]).max() > 1e-6


ENGINES = ("cpp", "numba", "numpy", "pymunk", "box2d", "rapier", "taichi", "warp", "lammps")


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # engines import what Python will drop
@pytest.mark.parametrize("name", long_but(ENGINES, *(each for each in ENGINES if each != "numba")))
def test_walls_gain_what_the_discs_lose(name, start):
    """The impulses from which pressures come, against the momentum of the discs: for each axis, left minus right."""
    run = engine(name, start, dt=0.01)
    run.run(100)
    before, walls = run.state()[1].sum(axis=0), run.walls()
    run.run(400)
    gained, walls = run.state()[1].sum(axis=0) - before, run.walls() - walls
    run.close()
    assert (walls > 5).all()
    tolerance = 0.02 * walls.max() if name == "lammps" else 1e-4 * walls.max()
    np.testing.assert_allclose(walls[::2] - walls[1::2], gained, atol=tolerance)
    assert (np.abs(walls[::2] - gained) > tolerance).all(), "the control: one wall alone is not what they lose"


def test_the_numpy_engine_finds_every_contact(start):
    run = engine("numpy", start, dt=0.2)
    run._move()
    one, other = run._pairs(run._sort())
    apart = run._position[:, None] - run._position[None]
    i, j = np.nonzero(np.triu((apart**2).sum(axis=2) < 1, 1))
    assert sorted(map(sorted, zip(one, other, strict=True))) == sorted(map(sorted, zip(i, j, strict=True)))
    assert len(one) > 5


# --- engines that are missing or fail


def test_a_look_at_the_quick_ones_and_a_row_for_one_that_is_missing(tmp_path, monkeypatch):
    registry, script = peers("registry"), importlib.import_module("run_peers")
    absent = replace(registry.PEERS["pymunk"], needs="no_such_engine")
    monkeypatch.setitem(registry.PEERS, "pymunk", absent)
    for name in ("cpp", "mpsim-push"):  # on two threads only under --long: each start of workers takes its time
        monkeypatch.setitem(registry.PEERS, name, replace(registry.PEERS[name], threads=(1,)))
    words = ["--quick", "--accurate", "0", "--counts", "60", "--peers", "cpp", "mpsim-push", "numpy", "pymunk"]
    page = tmp_path / "page.md"
    readme = (TOP / "README.md").read_text()
    assert script.main([*words, "--work", str(tmp_path), "--page", str(page)]) == 0
    text = page.read_text()
    assert "| pymunk | not installed: pip install pymunk |" in text
    assert re.search(r"\| mpsim, contact `push` \| [\d.,]+ \(", text)
    assert "A short run, for a look: not to be quoted." in text
    assert (tmp_path / "pictures" / "peers-frames.png").stat().st_size > 10_000
    assert (TOP / "README.md").read_text() == readme
    assert script.main(["--quick", "--again", "--work", str(tmp_path), "--page", str(page)]) == 0
    assert page.read_text() == text


@pytest.mark.long
def test_a_look_at_the_errors_too(tmp_path):
    script = importlib.import_module("run_peers")
    page = tmp_path / "page.md"
    assert script.main(["--quick", "--work", str(tmp_path), "--page", str(page)]) == 0
    assert re.search(r"\| mpsim, method `event` \| [\d.]+ \| none \| exact, 0\.0+\(\d\d\)% \|", page.read_text())


def test_what_an_engine_does_wrong_is_a_sentence(tmp_path, start):
    client_file, registry = peers("client"), peers("registry")
    client = client_file.Client(registry.PEERS["numpy"], 1, tmp_path)
    with pytest.raises(client_file.FailedError, match=r"^RuntimeError: `prepare` comes first$"):
        client.ask("run", 60, frames=1)
    start.save(tmp_path / "start.npz")
    client.prepare(tmp_path / "start.npz", 0.01, 60)
    assert client.run(2, 60) > 0
    client._process.kill()
    with pytest.raises(client_file.FailedError, match=r"^its process ended with SIGKILL$"):
        client.run(2, 60)
    client.prepare(tmp_path / "start.npz", 0.01, 60)  # in a new process
    with pytest.raises(client_file.FailedError, match=r"^no answer to `run` within 0 s$"):
        client.run(100_000, 0.2)
    assert client.close() == 0


def test_no_compiler_is_a_sentence(monkeypatch):
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CXX", raising=False)
    missing = peers("registry").PEERS["cpp"].why_missing()
    assert missing == "no C++ compiler is on the path (g++, clang++, c++); install one, or set CXX"
    assert peers("registry").PEERS["rapier"].why_missing().startswith("Node is not on the path; install it, then npm")


# --- the arithmetic of the tables


def timing(*frame, count=1, frames=30):
    """Times of turns, given in ns per disc and frame."""
    return {"frames": frames, "steps": 1, "setup": 0.0, "frame": [ns * 1e-9 * count for ns in frame]}


def point(dt, pressure, drift=0.0, knob=0):
    return asdict(peers("accuracy").Point(dt, knob, pressure, 0.003, drift, 12))


@pytest.fixture
def record():
    cells = []
    for count in (10_000, 100_000, 1_000_000):
        times = {
            "cpp/1": timing(70, 80, 90, count=count),
            "mpsim-push/1": timing(10, 10, 10, count=count),
            "mpsim-push/2": timing(4, 5, 5, count=count),
            "pymunk/1": "left out: too long",
        }
        cells.append({"count": count, "packing": 0.4, "step": 0.02, "times": times})
    series = {
        "cpp": [{"points": [point(0.1, 1.2), point(0.02, 1.05), point(0.01, 1.008), point(0.005, 1.004)], "ended": ""}],
        "mpsim-push": [{"points": [point(0.05, 1.0), point(0.02, 1.003, 1e-7)], "ended": ""}],
        "pymunk": [
            {"points": [point(0.05, 1.005, knob=1), point(0.02, 1.05, knob=1)], "ended": "failed"},
            {"points": [point(0.05, 1.004, knob=10), point(0.02, 1.002, knob=10)], "ended": ""},
        ],
    }
    costs = {
        "cpp 0.01 0": timing(50, 50, count=10_000),
        "cpp 0.02 0": timing(60, 60, count=10_000),
        "mpsim-push 0.05 0": timing(10, 10, count=10_000),
        "pymunk 0.05 1": timing(400, 400, count=10_000),
        "pymunk 0.05 10": timing(500, 500, count=10_000),
        "mpsim-event 1 0": timing(1500, 1500, count=10_000),
    }
    names = ("cpp", "mpsim-push", "mpsim-event", "pymunk", "warp")
    found = {name: {"missing": "not installed" if name == "warp" else "", "version": ""} for name in names}
    kept = {"count": 1000, "cost_count": 10_000, "packing": 0.4, "steps": [0.1], "exact": point(1.0, 1.0)}
    accuracy = {**kept, "series": series, "costs": costs}
    machine = {"load_before": 0.1, "usable_cores": 2}
    return {"peers": found, "yardstick": "cpp", "cells": cells, "accuracy": accuracy, "machine": machine}


def test_entries_are_medians_with_quartiles_and_ratios_of_the_same_turn(record):
    rows, reasons = peers("tables").rows_of_frames(record, 0.4, 0.02)
    assert rows[2] == "| the report's algorithm in C++ | " + " | ".join(["80 (75-85) 1x"] * 3) + " |"
    assert rows[4].startswith("| mpsim, contact `push` | 10 (10-10) 8x |")
    assert rows[5].startswith("| mpsim, contact `push`, 2 workers | 5 (4.5-5) 17.5x |")  # of 17.5, 16 and 18
    assert rows[-1] == "| Warp, CPU | not installed | | |"
    assert reasons[-3] == "pymunk, 10,000 discs: left out: too long"
    assert len({row.count("|") for row in rows}) == 1


def test_times_of_the_first_moments_alone_are_marked(record):
    record["cells"][0]["times"]["mpsim-push/1"] = timing(10, 10, 10, count=10_000, frames=8)
    rows, _ = peers("tables").rows_of_frames(record, 0.4, 0.02)
    assert rows[4].startswith("| mpsim, contact `push` | 10 (10-10) 8x early | 10 (10-10) 8x |")


def test_marks_are_reached_or_not(record):
    rows = peers("tables").marks_section(record)
    assert (
        "| speed of one process relative to the yardstick, 10,000 | ≥ 6 | 8 (7.5-8.5) | yes | - | not measured |"
        in rows
    )
    assert "| time per disc, 1,000,000 discs relative to 100,000 | ≤ 1.2 | 1 (1-1) | yes | - | not measured |" in rows
    assert (
        "| speed of two workers relative to one process, 10,000 | ≥ 1.9 | 2 (2-2.25) | yes | - | not measured |" in rows
    )
    slow = copy.deepcopy(record)
    slow["cells"][2]["times"]["mpsim-push/1"] = timing(20, 20, 20, count=1_000_000)
    rows = peers("tables").marks_section(slow)
    assert (
        "| speed of one process relative to the yardstick, 1,000,000 | ≥ 7 | 4 (3.75-4.25) | no | - | not measured |"
        in rows
    )
    assert "| time per disc, 1,000,000 discs relative to 100,000 | ≤ 1.2 | 2 (2-2) | no | - | not measured |" in rows
    assert "no compiler was found" in peers("tables").marks_section(record | {"yardstick": "numba"})[0]


def test_costs_are_those_of_the_longest_step_within_the_limit_with_all_shorter_ones(record):
    rows = "\n".join(peers("tables").accuracy_rows(record))
    cpp = "| 5 | 0.01 | +0.80(42)% | +0.0e+00 | 3 | 0.02 | +5.00(42)% | +0.0e+00 |"
    assert f"| the report's algorithm in C++ {cpp}" in rows
    assert "| mpsim, contact `push` | 0.2 | 0.05 | +0.00(42)% | +0.0e+00 | 0.2 |" in rows
    # With 1 iteration the shorter step is worse, so the longer one's 0.5 % is luck; within 10 % it is the cheaper.
    assert "| pymunk | 10 | 0.05, 10 iterations | +0.40(42)% | +0.0e+00 | 8 | 0.05, 1 iteration |" in rows
    assert "| mpsim, method `event` | 1.5 | none | exact, 0.00(30)% | +0.0e+00 | 1.5 |" in rows
    assert "| Warp, CPU | not installed |" in rows
    record["accuracy"]["costs"]["cpp 0.01 0"] = "a sentence"
    rows = "\n".join(peers("tables").accuracy_rows(record))
    assert "| the report's algorithm in C++ | reached at v·dt = 0.01; its frames: a sentence | | | | 3 |" in rows
    record["accuracy"]["series"]["cpp"][0]["points"] = [point(0.02, 1.05)]
    rows = "\n".join(peers("tables").accuracy_rows(record))
    assert "| the report's algorithm in C++ | not reached: +5.00(42)% at v·dt = 0.02 | | | | 3 |" in rows


def test_the_claim_is_of_the_record(record):
    assert peers("tables").claim(record) == (
        "10 ns per disc and frame on one core and 5 ns on two (100,000 discs, steps of 0.02 diameters), "
        "about 8 times as fast as the "
        "report's algorithm in C++ on one core; a pressure to 1 % costs about 50 times less than with pymunk, the next "
        "best engine"
    )
    assert peers("tables").claim(record | {"cells": []}) == ""


def test_nothing_is_claimed_from_a_busy_machine(record):
    tables = peers("tables")
    assert not tables.is_busy(record)
    loaded = record | {"machine": {"load_before": 1.5, "usable_cores": 2}}
    assert tables.is_busy(loaded)
    assert tables.claim(loaded) == ""
    record["cells"][1]["times"]["cpp/1"] = timing(60, 80, 110, count=100_000)
    assert tables.is_busy(record)
    assert tables.claim(record) == ""


def test_drift_is_the_rate_that_would_do_it():
    drift = peers("accuracy").drift_per_time
    assert drift(2.0, 2.0, 5.0) == 0
    assert (1 + drift(2.0, 1.0, 5.0)) ** 5 == pytest.approx(0.5)


def test_steps_grow_shorter_until_two_in_turn_are_good_or_the_engine_fails():
    accuracy, failed = peers("accuracy"), peers("client").FailedError
    exact = accuracy.Point(1, 0, 1.0, 0, 0, 12)

    def ask(dt):
        if dt < 0.003:
            raise failed("a sentence")
        return accuracy.Point(dt, 0, 1 + dt * scale, 0, 0, 12)

    scale = 0.3
    assert [each.dt for each in accuracy.series(ask, accuracy.STEPS, exact)[0]] == [0.1, 0.05, 0.02, 0.01]
    scale = 30
    points, ended = accuracy.series(ask, accuracy.STEPS, exact)
    assert (points[-1].dt, ended) == (0.005, "a sentence")
    assert accuracy.longest(points, exact, 0.01) is None


def test_what_will_not_fit_its_budget_is_left_out():
    turns = peers("turns")
    known, effort = turns.Known(), turns.Effort(budget=10)
    for known.count, setup in ((1_000, 2.0), (10_000, 2.9)):
        assert known.too_long("pymunk/1", effort) == ""
        known.add("pymunk/1", turns.Timing(1, 1, setup))
    known.count = 50_000
    assert known.too_long("pymunk/1", effort) == ""
    known.count = 1_000_000
    assert known.too_long("pymunk/1", effort) == "left out: 1,000,000 discs would take 102 s to set up; limit 10 s"


# --- the page that is there


def test_the_readme_says_what_the_page_says():
    """Or quotes nothing of it, as long as the page is of a busy machine."""
    readme, page = (TOP / "README.md").read_text(), (TOP / "docs" / "peers.md").read_text()
    said = " ".join(re.search(r"<!-- run_peers: claim -->\n(.*?)<!-- end -->", readme, re.DOTALL)[1].split())
    claimed = re.search(r"^mpsim takes (.*?)\.\n\n", page, re.MULTILINE | re.DOTALL)
    assert (claimed is None) == (peers("page").BUSY in page)
    assert ("peers" in said) == (claimed is not None)
    assert claimed is None or said == f"{' '.join(claimed[1].split())} ([peers](docs/peers.md))."


def test_the_page_has_a_row_for_every_engine():
    page = (TOP / "docs" / "peers.md").read_text()
    absent = [entry.title for entry in peers("registry").PEERS.values() if f"| {entry.title} |" not in page]
    assert absent == []


def test_the_packages_of_the_extra_are_those_that_the_rows_name():
    run_versions, registry = importlib.import_module("run_versions"), peers("registry")
    extra = {re.split(r"[><=;]", line)[0] for line in run_versions.project()["optional-dependencies"]["peers"]}
    named = {word for entry in registry.PEERS.values() for word in entry.package.split()}
    assert named - {"numpy", peers("with_rapier").PACKAGE} == extra
