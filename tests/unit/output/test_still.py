"""`mpsim.draw`: what it shows of a state, a frame, a simulation and a scene, and what it refuses."""

from pathlib import Path

import matplotlib
import numpy as np
import pytest
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from support.scenes import gas, simulate

import mpsim
from mpsim.output import still
from mpsim.output.drawing import NO_VALUE
from mpsim.output.frames import Frame


def discs_in(figure):
    """The discs of a picture."""
    return figure.axes[0].collections[-1]


def centres(figure):
    """Where the discs of a picture are; images at periodic edges come after them."""
    return np.asarray(discs_in(figure).get_offsets())


def three(**features):
    """Three discs in a row, and their scene."""
    scene = mpsim.Scene(width=8, height=4, position=[[1, 2], [4, 2], [7, 2]], velocity=[[1, 0], [0, 2], [0, 0]],
                        radius=[0.5, 0.75, 0.25], **features)  # fmt: skip
    return mpsim.State(scene.position, scene.velocity, box=scene.box), scene


def test_discs_are_where_they_are_and_as_large_as_they_are():
    state, scene = three()
    figure = mpsim.draw(state, scene)
    assert centres(figure).tolist() == scene.position.tolist()
    assert (discs_in(figure).get_widths() == 2 * scene.radii).all()
    axes = figure.axes[0]
    assert (axes.get_xlim(), axes.get_ylim()) == ((0, 8), (0, 4))
    assert axes.get_title() == "3 discs"
    assert discs_in(figure).get_array().tolist() == [1, 2, 0]
    assert [each.get_ylabel() for each in figure.axes] == ["", "speed [length/time]"]


def test_what_was_absorbed_is_not_drawn_and_others_keep_their_numbers():
    state, scene = three(absorbing="left")
    state = mpsim.State(state.position, state.velocity, present=np.array([True, False, True]), box=state.box)
    figure = mpsim.draw(state, scene, colour=[10, 20, 30], labels=True)
    assert centres(figure).tolist() == [[1, 2], [7, 2]]
    assert discs_in(figure).get_array().tolist() == [10, 30]
    assert [text.get_text() for text in figure.axes[0].texts] == ["0", "2"]
    own = mpsim.draw(state, scene, labels=["a", "b", "c"])
    assert [text.get_text() for text in own.axes[0].texts] == ["a", "c"]


def test_an_array_of_ones_own_has_its_words_at_the_colour_bar():
    state, scene = three()
    figure = mpsim.draw(state, scene, colour=[1.0, np.nan, 100.0], colour_label="charge [e]", scale="log")
    assert figure.axes[1].get_ylabel() == "charge [e]"
    assert isinstance(discs_in(figure).norm, LogNorm)
    figure.draw_without_rendering()
    assert matplotlib.colors.to_hex(discs_in(figure).get_facecolor()[1]).upper() == NO_VALUE
    assert not isinstance(discs_in(mpsim.draw(state, scene, colour="radius")).norm, LogNorm)


def test_zero_on_a_logarithmic_scale_is_the_colour_of_its_lower_end():
    state, scene = three()
    colours = []
    for lowest in (0.0, 1.0):
        figure = mpsim.draw(state, scene, colour=[lowest, 1.0, 100.0], scale="log")
        figure.draw_without_rendering()
        colours.append(tuple(discs_in(figure).get_facecolor()[0]))
    assert colours[0] == colours[1]


def test_all_discs_can_have_one_colour():
    state, scene = three()
    figure = mpsim.draw(state, scene, colour="tab:red")
    assert len(figure.axes) == 1, "no colour bar"
    assert matplotlib.colors.same_color(discs_in(figure).get_facecolor()[0], "tab:red")
    assert len(mpsim.draw(state, scene, colour=None).axes) == 1


def test_a_simulation_is_drawn_with_discs_that_were_added_and_the_wall_where_it_is():
    scene = gas(10, 0.1, piston=mpsim.Piston("right", -1.0, 3.0))
    with simulate(scene, method="grid", dt=0.01) as sim:
        sim.add([[1.0, 1.0]], [[0.0, 0.0]])
        sim.run(frames=50)
        figure, state = mpsim.draw(sim), sim.state
    assert len(centres(figure)) == 11
    assert figure.axes[0].get_title() == "time 0.5, 11 discs"
    wall = figure.axes[0].patches[-1].get_bbox()
    assert (wall.x0, wall.x1) == (state.box[1], scene.width)
    assert wall.x0 == pytest.approx(scene.width - 0.5)
    with pytest.raises(mpsim.InputError, match=r"as many discs as the state; got 10 and 11.*use draw\(sim\)"):
        mpsim.draw(state, scene)


def test_a_frame_needs_no_scene_but_shows_obstacles_with_one():
    state, scene = three(obstacles=[mpsim.FixedDisc((2.5, 2), 0.2)])
    known = {"time": 1.5, "velocity": state.velocity, "radius": scene.radii, "ids": np.array([5, 6, 9])}
    frame = Frame(3, (8.0, 4.0), (0.0, 0.0), (True, False), state.position, Path("a.xyz"), known)
    alone = mpsim.draw(frame, labels=True)
    assert [text.get_text() for text in alone.axes[0].texts] == ["5", "6", "9"]
    assert len(centres(alone)) == 6, "with images beyond the periodic border"
    assert alone.axes[0].get_title() == "time 1.5, 3 discs"
    assert len(mpsim.draw(frame, scene).axes[0].collections) == len(alone.axes[0].collections) + 1


def test_axes_of_ones_own_are_drawn_into():
    figure = Figure()
    left, right = figure.subplots(1, 2)
    assert mpsim.draw(gas(5, 0.1), ax=right) is figure
    assert not left.collections
    assert right.collections


def test_a_picture_has_the_shape_of_the_box():
    tall = mpsim.Scene(width=2, height=20, position=[[1, 1]], velocity=[[0, 0]], radius=0.5)
    flat = mpsim.Scene(width=20, height=2, position=[[1, 1]], velocity=[[0, 0]], radius=0.5)
    for scene, wide in ((tall, False), (flat, True)):
        figure = mpsim.draw(scene)
        width, height = figure.get_size_inches()
        assert (width > height) == wide
        figure.draw_without_rendering()
        room, inside = figure.bbox, [axes.get_tightbbox() for axes in figure.axes]
        assert all(room.x0 <= each.x0 and each.x1 <= room.x1 for each in inside), "nothing is cut off"
        assert all(room.y0 <= each.y0 and each.y1 <= room.y1 for each in inside)


def test_very_many_discs_are_drawn_in_part_and_it_says_so(monkeypatch):
    monkeypatch.setattr(still, "MOST_DISCS", 20)
    figure = mpsim.draw(gas(50, 0.1))
    assert (len(centres(figure)), figure.axes[0].get_title()) == (17, "17 of 50 discs")


def test_a_notebook_shows_it():
    from IPython.core.formatters import DisplayFormatter  # noqa: PLC0415

    formatter = DisplayFormatter()
    data, _ = formatter.format(mpsim.draw(gas(5, 0.1)))
    assert data["image/png"][:4] == b"\x89PNG"
    assert "image/png" not in formatter.format(Figure())[0], "a plain figure is not shown"


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"colour": "sped"}, r"colour must be one of 'speed', 'radius', 'mass', 'spin'; got 'sped'. Did you mean"),
        ({"colour": [1, 2]}, r"colour must be one of .*, or an array of 3 numbers, one for each disc; got \[1, 2\]"),
        ({"colour": ["a", "b", "c"]}, r"an array of 3 numbers, one for each disc; got"),
        ({"colour": "spin"}, r"colour must not be 'spin' of smooth discs"),
        ({"scale": "logarithmic"}, r"scale must be one of 'linear', 'log'; got 'logarithmic'"),
        ({"labels": ["a"]}, r"labels must be True, or 3 texts or numbers, one for each disc; got 1"),
        ({"labels": "abc"}, r"labels must be True, or 3 texts or numbers, one for each disc; got 'abc'"),
        ({"labels": 3}, r"labels must be True, or 3 texts"),
        ({"ax": 1}, r"ax must be an Axes of matplotlib; got int"),
        ({"color": "speed"}, r"an argument of draw must be one of .*; got 'color'. Did you mean 'colour'"),
    ],
)
def test_what_cannot_be_drawn_is_refused(arguments, text):
    state, scene = three()
    with pytest.raises(mpsim.InputError, match=text):
        mpsim.draw(state, scene, **arguments)


def test_what_is_no_picture_of_discs_is_refused(monkeypatch):
    state, scene = three()
    with pytest.raises(mpsim.InputError, match=r"scene must be given with a State, which has no radii; got <State: 3"):
        mpsim.draw(state)
    with pytest.raises(mpsim.InputError, match=r"state must be a State, a frame .*; got ndarray. Use sim.state"):
        mpsim.draw(state.position, scene)
    with pytest.raises(mpsim.InputError, match=r"scene must be an mpsim.Scene; got str"):
        mpsim.draw(state, "gas")
    with pytest.raises(mpsim.InputError, match=r"scene must be left out with a Scene, which has its own"):
        mpsim.draw(scene, scene)
    monkeypatch.setattr(still, "MOST_LABELS", 2)
    with pytest.raises(mpsim.InputError, match=r"labels must be for at most 2 discs; got 3"):
        mpsim.draw(scene, labels=True)
