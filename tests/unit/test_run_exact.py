"""scripts/run_exact.py and what it shares with the picture of a window: windows by hand beside one worker's run."""

import sys

import numpy as np
import pytest
from support.scripts import fixture_of

import mpsim

script = fixture_of("run_exact")
by_hand = fixture_of("exact_windows")
picture = fixture_of("window_picture")

DT, FRAMES, LENGTH = 0.125, 41, 0.25
SETTINGS = mpsim.Settings(dt=DT, method="event")


def gas(count=2000):
    return mpsim.Scene.lattice(count=count, packing=0.4, radius=0.5, temperature=1.0, seed=1)


@pytest.fixture
def tiled(by_hand):
    with by_hand.divided(2):
        sim = mpsim.Simulation(gas(), SETTINGS)
    with sim:
        sim.run(frames=FRAMES)
        yield sim


@pytest.fixture
def whole(by_hand):
    with by_hand.divided(1), mpsim.Simulation(gas(), SETTINGS) as sim:
        sim.run(frames=FRAMES)
        yield sim


@pytest.mark.long
def test_a_tile_that_is_the_whole_box_holds_what_one_worker_finds(by_hand, tiled, whole):
    tiles = by_hand.Tiles(tiled)
    truth, work = tiles.true(LENGTH), tiles.play(LENGTH, 20)
    report = whole.run(frames=round(LENGTH / DT))
    assert truth.here.all()
    np.testing.assert_array_equal(truth.position, whole.state.position)
    assert work.impacts == report.collisions > 500
    assert work.agreed


@pytest.mark.slow
def test_windows_by_hand_leave_the_simulation_as_it_is(by_hand, tiled, whole):
    tiles = by_hand.Tiles(tiled)
    tiles.play(LENGTH, 3)
    tiles.all_events(LENGTH, 10)
    tiles.of_tile(1, LENGTH, 10)
    tiles.true(LENGTH)
    for sim in (tiled, whole):
        sim.run(frames=20)
    assert tiled.digest() == whole.digest()
    assert by_hand.windows_of(tiled)[0] > 0
    assert by_hand.windows_of(whole).tolist() == [0, 0, 0]


@pytest.mark.slow
def test_own_discs_are_right_where_tiles_agree_and_wrong_where_the_halo_is_too_thin(by_hand, tiled):
    tiles = by_hand.Tiles(tiled)
    border = tiles.edges[0, 1, 0]
    length, cell = 2 * LENGTH, tiled.state.box[1] / tiles.cells[0]
    truth = tiles.true(length)
    own = truth.position[:, 0] < border * cell
    wide = tiles.of_tile(0, length, 15)
    assert tiles.play(length, 15).agreed
    assert not wide.differs(truth)[own].any()
    assert (wide.differs(truth) & wide.here).any(), "in the halo some are wrong"
    assert not tiles.play(length, 2).agreed
    assert tiles.of_tile(0, length, 2).differs(truth)[own].any()


def test_what_is_done_twice_is_counted(by_hand, tiled):
    tiles = by_hand.Tiles(tiled)
    own = tiles.play(LENGTH, 10).events
    found = [tiles.all_events(LENGTH, halo) for halo in (0, 5, 10, tiles.cells[0])]
    assert found[0] == pytest.approx(own, rel=0.05), "without a halo too, but with what is wrong then"
    assert found[2] / own - 1 == pytest.approx(2 * 10 / tiles.cells[0], rel=0.2)
    assert found == sorted(found)
    assert found[3] == 2 * own, "each tile plays the whole box"


def test_depths_of_what_is_wrong_lie_in_the_halo(picture):
    small = picture.gas_in_tiles(0.4, 62.0, 14.0)
    with small.sim:
        truth = small.tiles.true(small.once)
        for place in range(2):
            halo = small.depths(place, small.tiles.of_tile(place, small.once, 12), truth, 12)
            assert 0 < halo.max() < 12
            thin = small.depths(
                place, small.tiles.of_tile(place, 2 * small.once, 2), small.tiles.true(2 * small.once), 2
            )
            assert thin.max() > 2, "a halo of two cells is passed"


def columns(text):
    return [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines() if line.startswith("|")]


def run(script, monkeypatch, page, *words):
    monkeypatch.setattr(sys, "argv", ["run_exact.py", *words, "--page", str(page)])
    assert script.main() == 0
    return columns(page.read_text())[2:]


def test_the_table_of_halos_has_shares_that_fall_with_their_width(script, tmp_path, monkeypatch):
    monkeypatch.setattr(script, "HALOS", (2, 6, 20))
    monkeypatch.setattr(script, "LENGTHS", (0.5, 3.0))
    monkeypatch.setattr(script, "IN_WINDOWS", 12_000)
    rows = run(script, monkeypatch, tmp_path / "exact.md", "halos", "--discs", "3000")
    assert [row[1] for row in rows] == ["events simulated twice", "0.5", "3"]
    twice = [float(each.rstrip("%")) for each in rows[0][2:5]]
    assert 0 < twice[0] < twice[1] < twice[2] < 60
    assert rows[0][0] == "3,000 discs, 2 tiles, 4 windows"
    assert rows[1][2] == "100.0%", "two cells are too few"
    assert rows[1][4:] == ["0", rows[1][5]]
    assert rows[1][5] in ("6", "20")
    assert rows[2][3] == "100.0%", "six are too few for so long a window"


def test_the_cradle_of_the_tutorial_is_played_by_one_worker_and_has_one_digest(script, tmp_path, monkeypatch):
    rows = run(script, monkeypatch, tmp_path / "cradle.md", "cradle")
    assert rows[0][:4] == ["1 x 1", "0", "0", "0"]
    assert all(int(row[3]) >= 1 for row in rows[1:])
    assert len({row[4] for row in rows}) == 1


def test_a_page_without_a_cradle_is_refused(script, tmp_path):
    page = tmp_path / "page.md"
    page.write_text("```python\nother = 1\n```\n")
    with pytest.raises(ValueError, match=r"page\.md must have a block"):
        script.cradle_of(page)


def test_the_table_of_speeds_has_a_row_for_each_kind(script, tmp_path, monkeypatch):
    monkeypatch.setattr(script, "SECONDS", 0.01)
    rows = run(script, monkeypatch, tmp_path / "exact.md", "table", "--discs", "3000", "--workers", "2")
    assert [row[1] for row in rows] == ["undivided", "2 workers"]
    assert rows[0][4:] == ["0", "0", "0"]
    assert int(rows[1][4]) > 0, "windows"


def test_an_unknown_table_is_wrong_usage(script, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["run_exact.py", "halo"])
    with pytest.raises(SystemExit) as ended:
        script.main()
    assert ended.value.code == 2
    assert "no table is called halo" in capsys.readouterr().err
