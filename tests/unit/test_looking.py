"""Pictures of reports and runs, notebook displays, and animations by speed, worker and parity."""

import io
import re
import sys
import warnings

import numpy as np
import pytest
from PIL import Image
from support.scenes import gas, lattice, simulate

import mpsim
from mpsim.engine.workers.arrays import grid_for
from mpsim.kernels import layout
from mpsim.kernels.layout import PHASES
from mpsim.output.animation import Picture
from mpsim.output.drawing import STYLE
from mpsim.scene import scenefile
from mpsim.studies.cost import Cost
from mpsim.studies.deviations import Deviation
from mpsim.studies.tuned import Tuned

SAFE = {"0072B2", "D55E00", "009E73", "CC79A7", "E69F00", "56B4E9", "F0E442", "000000"}
"""The colours of Okabe & Ito."""


# --- reports


def test_a_report_is_drawn_with_a_bar_for_each_worker():
    with simulate(gas(200, 0.4), method="parallel", workers=2) as sim:
        report = sim.run(frames=20)
    above, below = report.plot().axes
    assert above.lines[0].get_ydata().tolist() == (report.frame_seconds * 1e6).tolist()
    assert above.get_title() == "20 frames by parallel, 2 workers"
    bars = {container.get_label(): [bar.get_width() for bar in container] for container in below.containers}
    assert bars.keys() == set(PHASES)
    for name in PHASES:
        assert bars[name] == pytest.approx(np.median(report.phase_seconds[name], axis=0) * 1e6)
    waiting = 100 * sum(bars["wait"]) / sum(map(sum, bars.values()))
    assert f"; {waiting:.0f} % of it is waiting for others" in below.get_xlabel()


def test_a_report_of_no_frames_is_drawn_too():
    with simulate(gas(20, 0.2), method="grid") as sim:
        assert len(sim.run(frames=0).plot().axes) == 2


@pytest.mark.parametrize(("method", "words"), [("naive", {"move", "pairs"}), ("event", {"events"})])
def test_a_method_without_columns_has_no_phases_called_after_them(method, words):
    with simulate(gas(50, 0.4), method=method) as sim:
        report = sim.run(frames=5)
    below = report.plot().axes[1]
    assert {container.get_label() for container in below.containers} == words
    assert "columns" not in report._repr_html_()


def test_the_time_of_a_single_frame_is_a_point():
    with simulate(gas(20, 0.2), method="grid") as sim:
        above = sim.run(frames=1).plot().axes[0]
    assert above.lines[0].get_marker() == "."


def test_a_report_in_a_notebook_is_a_small_table():
    with simulate(gas(20, 0.2), method="grid") as sim:
        text = sim.run(frames=10, measures=["temperature"])._repr_html_()
        empty = sim.run(frames=0)._repr_html_()
    assert text.startswith("<table>")
    for word in (
        "<th>method</th><td>grid, 1 worker</td>",
        "<td>median ",
        "even columns ",
        "<th>temperature</th><td>1 ",
    ):
        assert word in text
    assert len(text) < 2000
    assert "<th>frames</th><td>0</td>" in empty


def test_the_answer_of_tune_in_a_notebook_is_a_small_table():
    errors = {"overlap": Deviation(0.02, 0.001)}
    cost = Cost(10.0, 9.0, 11.0, 100.0, "grid", 1)
    tuned = Tuned(mpsim.Settings(dt=0.05), cost, errors, {"overlap": 0.05}, "event <exact>", (), 1.5)
    text = tuned._repr_html_()
    assert "<th>settings</th><td>auto impact dt=0.05</td>" in text
    assert "<th>overlap</th><td>0.0200(10), budget 0.05</td>" in text
    assert "event &lt;exact&gt;" in text


# --- scenes


@pytest.mark.parametrize("name", scenefile.names())
def test_a_scene_in_a_notebook_is_a_small_still(name):
    content = mpsim.Scene.load(name)._repr_png_()
    assert len(content) < 100_000
    with Image.open(io.BytesIO(content)) as picture:
        assert picture.format == "PNG"
        assert getattr(picture, "n_frames", 1) == 1
        assert 50 < min(picture.size) <= max(picture.size) < 400


def test_a_very_large_scene_is_a_small_still_as_well():
    count = 120_000
    rng = np.random.default_rng(1)
    scene = mpsim.Scene(
        width=500, height=500, position=1 + 498 * rng.random((count, 2)), velocity=np.ones((count, 2)), radius=0.5
    )
    assert len(scene._repr_png_()) < 100_000


def test_importing_mpsim_and_running_imports_no_matplotlib():
    from support.processes import assert_clean, run_script  # noqa: PLC0415

    script = """
        import sys, mpsim
        from support.scenes import gas, simulate

        with simulate(gas(5, 0.1), method="naive") as sim:
            report = sim.run(frames=3)
        with mpsim.Trajectory.write("a.xyz") as out:
            pass
        print(sorted({"matplotlib", "gsd", "PIL", "click"} & set(sys.modules)))
        report.plot()
        print("matplotlib" in sys.modules)
    """
    outcome = run_script(script)
    assert_clean(outcome)
    assert outcome.out == "[]\nTrue\n"


# --- animations


def test_columns_are_those_that_the_workers_are_given():
    scene = lattice(12, 5)
    with simulate(scene, method="parallel", workers=3, dt=1e-6) as sim:
        columns = grid_for(60, scene.width, scene.height, 1.0, "float64").columns
        expected = (scene.position[:, 0] / scene.width * columns).astype(int)
        for _ in range(3):  # the first frame finds the discs unsorted
            column, owner, _ = sim.columns()
            sim.run(frames=1)
            team = sim._solver._block.arrays["team"]
            assert column.tolist() == expected.tolist()
            for worker in range(3):
                first, last = team[worker, layout.FIRST_COLUMN], team[worker, layout.LAST_COLUMN]
                assert set(column[owner == worker]) <= set(range(first, last))
    assert np.bincount(owner).min() >= 10, "sorted, they are dealt evenly, in whole columns"
    with simulate(scene, method="grid") as sim:
        assert set(sim.columns().owner.tolist()) == {0}


@pytest.mark.parametrize("method", ["naive", "event"])
def test_a_method_without_columns_has_no_colours_for_them(method, tmp_path):
    text = rf"'grid' and 'parallel'; this run is by '{method}'. Use Settings"
    with simulate(gas(5, 0.1), method=method) as sim, pytest.raises(mpsim.InputError, match=text):
        sim.columns()
    with pytest.raises(mpsim.InputError, match="columns are there only in methods that sort discs"):
        mpsim.animate(gas(5, 0.1), mpsim.Settings(method=method), tmp_path / "a.gif", 2, colour="parity")
    assert not (tmp_path / "a.gif").exists()


def shown(colour, **settings):
    """Colours of the discs of a lattice in a picture, one for each disc."""
    with simulate(lattice(6, 4), method="grid", dt=1e-6, **settings) as sim:
        picture = Picture(sim, 200, colour)
        picture.update()
        picture.figure.draw_without_rendering()
        return [tuple(each) for each in picture._discs.get_facecolor()], sim.columns()


def test_parity_shows_even_and_odd_columns_in_two_colours():
    colours, (column, _, _) = shown("parity")
    even, odd = ({c for c, k in zip(colours, column, strict=True) if k % 2 == parity} for parity in (0, 1))
    assert (len(even), len(odd), len(even | odd)) == (1, 1, 2)


def test_workers_have_a_colour_each():
    with simulate(lattice(9, 4), method="parallel", workers=3) as sim:
        picture = Picture(sim, 200, "worker")
        picture.update()
        picture.figure.draw_without_rendering()
        colours = [tuple(each) for each in picture._discs.get_facecolor()]
        owner = sim.columns().owner
    assert len(set(zip(colours, owner.tolist(), strict=True))) == len(set(colours)) == 3
    assert [text.get_text() for text in picture.figure.axes[1].get_yticklabels()] == ["0", "1", "2"]


def test_without_a_colour_all_discs_look_alike_and_by_speed_they_do_not():
    assert len(set(shown(None)[0])) == 1
    assert len(set(shown("speed")[0])) > 5


def test_an_unknown_colour_is_refused(tmp_path):
    with pytest.raises(mpsim.InputError, match=r"must be one of 'speed', 'worker', 'parity'; got 'sped'. Did you"):
        mpsim.animate(gas(5, 0.1), None, tmp_path / "a.gif", 2, colour="sped")


def test_progress_of_an_animation_can_be_watched(tmp_path):
    seen = []
    settings = mpsim.Settings(method="grid")
    mpsim.animate(gas(5, 0.1), settings, tmp_path / "a.gif", 3, pixels=100, progress=lambda *now: seen.append(now))
    assert seen == [(1, 3), (2, 3), (3, 3)]


def test_the_style_has_only_colours_that_colour_blind_people_can_tell_apart():
    cycle = re.search(r"prop_cycle: .*\[(.*)\]", STYLE.read_text())
    assert set(re.findall(r"[0-9A-F]{6}", cycle[1])) <= SAFE
    from mpsim.output import animation, times  # noqa: PLC0415

    assert {colour.lstrip("#") for colour in animation.CATEGORIES} <= SAFE
    assert {colour.lstrip("#") for colour in times.PHASE_COLOURS.values()} - SAFE == {"CCCCCC"}


def test_nothing_is_printed(tmp_path, capsys):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mpsim.animate(gas(5, 0.1), mpsim.Settings(method="grid"), tmp_path / "a.gif", 2, pixels=100)
    assert capsys.readouterr() == ("", "")
    assert sys.stdout is not None
