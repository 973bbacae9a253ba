"""Animations by speed, worker and parity."""

import base64

import numpy as np
import pytest
from IPython.core.formatters import DisplayFormatter
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from support.scenes import gas, lattice, simulate

import mpsim
from mpsim.engine.workers.arrays import grid_for
from mpsim.output import animation, moving_picture
from mpsim.output.colour_scale import percentile_scale
from mpsim.output.drawing import DARK, LIGHT
from mpsim.output.moving_picture import Picture, kept, moment_of


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
                first, last = team[worker].first_column, team[worker].last_column
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


def test_an_animation_needs_a_path_and_finds_it_in_the_place_of_the_settings(tmp_path):
    for given, text in (
        (("a.gif",), r"settings must be mpsim.Settings or None; got 'a.gif'. Write path='a.gif'."),
        ((tmp_path / "a.gif",), r"Write path='.*a.gif'."),
        ((), r"animate must be given a path; got ''. Write path='animation.gif'."),
        ((None, None), r"animate must be given a path; got None."),
        ((None, 3), r"animate must be given a path; got 3."),
    ):
        with pytest.raises(mpsim.InputError, match=text):
            mpsim.animate(gas(5, 0.1), *given)
    written = mpsim.animate(gas(5, 0.1), path=tmp_path / "a.gif", frames=1, pixels=100, progress=False)
    assert written == tmp_path / "a.gif"


def test_progress_of_an_animation_can_be_watched(tmp_path):
    seen = []
    settings = mpsim.Settings(method="grid")
    mpsim.animate(gas(5, 0.1), settings, tmp_path / "a.gif", 3, pixels=100, progress=lambda *now: seen.append(now))
    assert seen == [(1, 3), (2, 3), (3, 3)]


def test_a_scene_is_simulated_once_and_the_scale_is_that_of_all_pictures(tmp_path, monkeypatch):
    made, shown = [], []
    simulation, show = animation.Simulation, Picture.show
    monkeypatch.setattr(animation, "Simulation", lambda *given: made.append(given) or simulation(*given))
    monkeypatch.setattr(Picture, "show", lambda self, moment: shown.append((self, moment)) or show(self, moment))
    scene, settings = gas(30, 0.2), mpsim.Settings(method="grid", dt=0.01)
    mpsim.animate(scene, settings, tmp_path / "a.gif", 4, every=20, pixels=100, progress=False)
    assert len(made) == 1
    picture, moments = shown[0][0], [moment for _, moment in shown]
    with simulation(scene, settings) as sim:
        for number, moment in enumerate(moments):
            assert moment.time == pytest.approx(0.2 * number)
            assert (moment.position == sim.state.position.astype(np.float32)).all()
            sim.run(frames=20)
    assert picture._discs.get_clim() == percentile_scale(np.concatenate([moment.values for moment in moments]))[:2]


def test_moments_are_kept_in_a_file_where_they_are_large(monkeypatch):
    with simulate(gas(30, 0.2), method="grid") as sim:
        moment = moment_of(sim, "speed")
    for most in (moving_picture.IN_MEMORY, 10):
        monkeypatch.setattr(moving_picture, "IN_MEMORY", most)
        with kept(moment._replace(time=float(time)) for time in range(3)) as again:
            found = list(again)
        assert [each.time for each in found] == [0, 1, 2]
        assert all((each.values == moment.values).all() and each.walls == moment.walls for each in found)


def test_a_dark_picture_is_dark_and_its_words_are_light():
    with simulate(gas(5, 0.1), method="grid") as sim:
        for theme, dark in ((LIGHT, False), (DARK, True)):
            picture = Picture(sim, 100, theme=theme)
            picture.update()
            canvas = FigureCanvasAgg(picture.figure)
            canvas.draw()
            assert (int(np.asarray(canvas.buffer_rgba())[0, 0, 0]) < 60) == dark
            assert (sum(to_rgb(picture._title.get_color())) > 2) == dark


def test_a_notebook_shows_an_animation(tmp_path, monkeypatch):
    path = mpsim.animate(gas(5, 0.1), mpsim.Settings(method="grid"), tmp_path / "a.gif", 2, pixels=100, progress=False)
    formatter = DisplayFormatter()
    text = formatter.format(path)[0]["text/html"]
    assert base64.b64decode(text.split("base64,")[1].split('"')[0]) == path.read_bytes()
    assert "text/html" not in formatter.format(path.with_suffix(".gone"))[0]
    monkeypatch.setattr(animation, "MOST_SHOWN", 10)
    assert "text/html" not in formatter.format(path)[0], "too large for the output of a cell"
