"""Pictures of a state, a frame, a simulation, a scene and a report, animations, and what notebooks show of them."""

import base64
import dataclasses
import io
import shutil
import subprocess

import matplotlib
import numpy as np
import pytest
from IPython.core.formatters import DisplayFormatter
from matplotlib.colors import LogNorm, to_hex
from matplotlib.figure import Figure
from PIL import Image
from support.scenes import gas, scene_of, simulate

import mpsim

pytestmark = pytest.mark.plain

SAFE = {"0072b2", "d55e00", "009e73", "cc79a7", "e69f00", "56b4e9", "f0e442", "000000", "cccccc"}
"""The colours of Okabe and Ito, which colour-blind people can tell apart, and grey."""


def discs_in(figure):
    return figure.axes[0].collections[-1]


def centres(figure):
    """Where the discs of a picture are; images at periodic edges come after them."""
    return np.asarray(discs_in(figure).get_offsets())


def three(**features):
    """Three discs in a row, and their scene."""
    scene = scene_of([[1, 2], [4, 2], [7, 2]], [[1, 0], [0, 2], [0, 0]], 8, 4, radius=[0.5, 0.75, 0.25], **features)
    return mpsim.State(scene.position, scene.velocity, box=scene.box), scene


def test_discs_are_where_they_are_and_as_large_as_they_are():
    state, scene = three()
    figure = mpsim.draw(state, scene)
    assert centres(figure).tolist() == scene.position.tolist()
    assert (discs_in(figure).get_widths() == 2 * scene.radii).all()
    axes = figure.axes[0]
    assert (axes.get_xlim(), axes.get_ylim(), axes.get_title()) == ((0, 8), (0, 4), "3 discs")
    assert discs_in(figure).get_array().tolist() == [1, 2, 0]
    assert [each.get_ylabel() for each in figure.axes] == ["", "speed [length/time]"]
    by_radius = discs_in(mpsim.draw(state, scene, colour="radius"))
    assert by_radius.get_array().tolist() == [0.5, 0.75, 0.25]
    assert not isinstance(by_radius.norm, LogNorm)


def test_what_was_absorbed_is_not_drawn_and_others_keep_their_colours():
    state, scene = three(absorbing="left")
    state = mpsim.State(state.position, state.velocity, present=np.array([True, False, True]), box=state.box)
    figure = mpsim.draw(state, scene, colour=[10, 20, 30])
    assert centres(figure).tolist() == [[1, 2], [7, 2]]
    assert discs_in(figure).get_array().tolist() == [10, 30]


def test_an_array_of_ones_own_has_its_words_at_the_colour_bar_and_its_scale():
    figure = mpsim.draw(gas(4, 0.02), colour=[0.0, np.nan, 1.0, 100.0], colour_label="charge [e]", scale="log")
    assert figure.axes[1].get_ylabel() == "charge [e]"
    assert isinstance(discs_in(figure).norm, LogNorm)
    figure.draw_without_rendering()
    lowest, (red, green, blue, _) = discs_in(figure).get_facecolor()[:2]
    assert max(red, green, blue) - min(red, green, blue) < 0.1, "without a value: grey"
    assert lowest == pytest.approx(discs_in(figure).get_cmap()(0.0)), "zero is at the lower end of a logarithmic scale"
    figure = mpsim.draw(gas(4, 0.02), colour="tab:red")
    assert len(figure.axes) == 1, "no colour bar"
    assert matplotlib.colors.same_color(discs_in(figure).get_facecolor()[0], "tab:red")


def scale_of(values):
    """Ends of the colour bar, and where it has arrows."""
    figure = mpsim.draw(gas(len(values), 0.02), colour=values)
    return *discs_in(figure).get_clim(), discs_in(figure).colorbar.extend


def test_the_scale_is_by_percentiles_with_arrows_for_what_lies_outside():
    low, high, arrows = scale_of(np.r_[np.linspace(0, 1, 199), 500.0])
    assert (0 < low < 0.05, 0.95 < high < 1.0, arrows) == (True, True, "both"), "one does not stretch it"
    assert scale_of(np.r_[np.linspace(0, 1, 180), np.full(20, 500.0)])[1] == 500, "many do: there is to see"
    assert scale_of([0.0, 0.0]) == scale_of([np.nan]) == (0.0, 1.0, "neither")
    assert scale_of([-2.0])[:2] == (-2.0, 0.0)


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


def test_a_frame_needs_no_scene_but_shows_obstacles_with_one(tmp_path):
    (tmp_path / "a.xyz").write_text(
        '3\nLattice="8 0 0 0 4 0 0 0 1" Time=1.5 pbc="T F F" Properties=pos:R:3:radius:R:1:velo:R:3:id:I:1\n'
        "1 2 0 0.5 1 0 0 5\n4 2 0 0.75 0 2 0 6\n7 2 0 0.25 0 0 0 9\n"
    )
    (frame,) = mpsim.Trajectory(tmp_path / "a.xyz")
    _, scene = three(obstacles=[mpsim.FixedDisc((2.5, 2), 0.2)])
    alone = mpsim.draw(frame)
    assert len(centres(alone)) == 6, "with images beyond the periodic border"
    assert alone.axes[0].get_title() == "time 1.5, 3 discs"
    assert len(mpsim.draw(frame, scene).axes[0].collections) == len(alone.axes[0].collections) + 1


def test_axes_of_ones_own_are_drawn_into_and_a_picture_has_the_shape_of_the_box():
    figure = Figure()
    left, right = figure.subplots(1, 2)
    assert mpsim.draw(gas(5, 0.1), ax=right) is figure
    assert not left.collections
    assert right.collections
    for width, height in ((2, 20), (20, 2)):
        scene = mpsim.Scene(width=width, height=height, position=[[1, 1]], velocity=[[0, 0]], radius=0.5)
        figure = mpsim.draw(scene)
        assert (figure.get_size_inches()[0] > figure.get_size_inches()[1]) == (width > height)
        figure.draw_without_rendering()
        room, inside = figure.bbox, [axes.get_tightbbox() for axes in figure.axes]
        assert all(room.x0 <= each.x0 and each.x1 <= room.x1 for each in inside), "nothing is cut off"
        assert all(room.y0 <= each.y0 and each.y1 <= room.y1 for each in inside)


def test_very_many_discs_are_drawn_in_part_and_it_says_so():
    place = np.stack(np.divmod(np.arange(50_001), 250), axis=1) + 0.5
    scene = mpsim.Scene(width=202, height=250, position=place, velocity=np.ones((50_001, 2)), radius=0.5)
    figure = mpsim.draw(scene)
    assert (len(centres(figure)), figure.axes[0].get_title()) == (25_001, "25,001 of 50,001 discs")
    assert len(scene._repr_png_()) < 100_000


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"colour": "sped"}, r"colour must be one of 'speed', 'radius', 'mass', 'spin'; got 'sped'. Did you mean"),
        ({"colour": [1, 2]}, r"colour must be one of .*, or an array of 3 numbers, one for each disc; got \[1, 2\]"),
        ({"colour": "spin"}, r"colour must not be 'spin' of smooth discs"),
        ({"scene": None}, r"scene must be given with a State, which has no radii; got <State: 3"),
        ({"state": np.zeros((3, 2))}, r"state must be a State, a frame .*; got ndarray. Use sim.state"),
        ({"state": gas(5, 0.1)}, r"scene must be left out with a Scene, which has its own"),
    ],
)
def test_what_cannot_be_drawn_is_refused(arguments, text):
    state, scene = three()
    with pytest.raises(mpsim.InputError, match=text):
        mpsim.draw(**{"state": state, "scene": scene, **arguments})


# --- in notebooks


def test_a_notebook_shows_pictures_and_scenes_as_small_stills():
    assert "image/png" not in DisplayFormatter().format(Figure())[0], "a plain figure is not shown"
    for name in ("gas", "rough-hopper"):
        content = mpsim.Scene.load(name)._repr_png_()
        assert len(content) < 100_000
        with Image.open(io.BytesIO(content)) as picture:
            assert (picture.format, getattr(picture, "n_frames", 1)) == ("PNG", 1)
            assert 50 < min(picture.size) <= max(picture.size) < 400


# --- a report


@pytest.fixture(scope="module")
def report():
    with simulate(gas(8, 0.4), method="grid") as sim:
        return sim.run(frames=20)


def test_a_report_is_drawn_with_a_bar_for_each_worker_that_adds_up_to_a_usual_frame(report):
    times = np.full((2, 20, 5), 1200)
    times[:, 3] = 2 * 10**8  # a frame that was disturbed is in no bar
    seconds = times[0].sum(axis=1) * 1e-9
    above, below = dataclasses.replace(report, times=times, workers=2, method="parallel").plot().axes
    assert above.lines[0].get_ydata() == pytest.approx(seconds * 1e6)
    assert above.get_title() == "20 frames by parallel, 2 workers"
    bars = {each.get_label(): [bar.get_width() for bar in each] for each in below.containers}
    for worker in range(2):
        assert sum(bars[name][worker] for name in bars) == pytest.approx(6.0)
    colours = {to_hex(bar.get_facecolor()).lstrip("#") for each in below.containers for bar in each}
    assert colours <= SAFE
    assert "; 20 % is waiting for others" in below.get_xlabel()


@pytest.mark.parametrize(("method", "words"), [("naive", {"move", "pairs"}), ("event", {"events"})])
def test_a_method_without_columns_has_no_phases_called_after_them(method, words):
    with simulate(gas(8, 0.4), method=method) as sim:
        found, none = sim.run(frames=1), sim.run(frames=0)
    above, below = found.plot().axes
    assert {each.get_label() for each in below.containers} == words
    assert above.lines[0].get_marker() == ".", "the time of a single frame is a point"
    assert len(none.plot().axes) == 2


def test_times_of_frames_are_written_without_powers_and_shown_in_a_notebook(report):
    figure = report.plot()
    figure.draw_without_rendering()
    texts = [text.get_text() for text in figure.axes[0].get_yticklabels(which="both")]
    assert any(texts)
    assert not any("10^" in text for text in texts)
    assert DisplayFormatter().format(figure)[0]["image/png"][:4] == b"\x89PNG"


# --- animations

GRID = mpsim.Settings(method="grid", dt=0.01)
PAIR = mpsim.Scene(width=8, height=8, position=[[2, 4], [6, 1]], velocity=[[1, 0], [0, 0]], radius=1.0)
SMALL = {"pixels": 100, "progress": False}


def frames_of(path):
    with Image.open(path) as film:
        found = []
        for index in range(film.n_frames):
            film.seek(index)
            found.append(np.asarray(film.convert("RGB"), int))
        return found


def middle_of_upper_disc(frame):
    """Its x in pixels: discs are the coloured things, and the other one is below."""
    return np.argwhere((frame.max(axis=2) - frame.min(axis=2) > 60)[: 2 * len(frame) // 3])[:, 1].mean()


def test_pictures_follow_the_run_and_share_their_colours(tmp_path):
    path = mpsim.animate(PAIR, GRID, tmp_path / "a.gif", 3, every=100, pictures_per_second=20, colour=None, pixels=200)
    assert path == tmp_path / "a.gif"
    frames = frames_of(path)
    with Image.open(path) as film:
        assert (film.n_frames, film.info["duration"]) == (3, 50)
    places = [middle_of_upper_disc(frame) for frame in frames]
    assert np.diff(places) == pytest.approx(np.diff(places)[0], abs=0.5), "one unit of length to the right in each"
    assert 200 / 8 - 1 < np.diff(places)[0] < 200 / 8 + 4
    again = mpsim.animate(PAIR, GRID, tmp_path / "a.gif", 1, **SMALL)
    assert len(frames_of(again)) == 1, "an existing file is replaced"


def test_the_scale_of_speeds_is_that_of_all_pictures(tmp_path):
    """A disc that falls gets faster: in the first picture the same speed has a colour of the whole run."""
    falling = scene_of([[2, 18], [1, 0.5]], width=4, height=20, gravity=(0, -1))
    first, last = frames_of(mpsim.animate(falling, GRID, tmp_path / "a.gif", 2, every=200, **SMALL))
    colours = {tuple(each) for each in first.reshape(-1, 3)}
    assert {tuple(each) for each in last.reshape(-1, 3)} - colours, "the fast disc has another colour"


def place_of_wall(image):
    """The x of what is between two walls at 1 and 7, and the middles of these in pixels."""
    dark = np.flatnonzero((np.abs(image - 0x44).max(axis=2) < 12).sum(axis=0) > len(image) / 4)
    left, middle, right = (each.mean() for each in np.split(dark, np.flatnonzero(np.diff(dark) > 1) + 1))
    return 1 + 6 * (middle - left) / (right - left), (left, right)


@pytest.mark.parametrize("moving", [True, False])
def test_pictures_show_a_wall_where_it_is_at_their_time(moving, tmp_path):
    motion = mpsim.Translation((1.5, 0), stop=3.0, start=0.5) if moving else None
    walls = [mpsim.Polyline([(x, 0.5), (x, 7.5)], 0.4, motion=motion if x == 2 else None) for x in (1, 2, 7)]
    scene = mpsim.Scene(width=8, height=8, position=[(6, 4)], velocity=[(0, 1)], radius=0.2, obstacles=walls)
    figures, times = [], [0.0, 1.5, 3.0]
    with mpsim.Simulation(scene, GRID) as sim, mpsim.Trajectory.write(tmp_path / "a.xyz", every=150) as frames:
        for time in times:
            sim.run(until=time, observe=frames)
            figures.append(mpsim.draw(sim, colour=None))
    figures += [mpsim.draw(each, scene, colour=None) for each in mpsim.Trajectory(tmp_path / "a.xyz")]
    for number, figure in enumerate(figures):
        figure.savefig(tmp_path / f"{number}.png")
    film = mpsim.animate(scene, GRID, tmp_path / "a.gif", 3, every=150, colour=None, pixels=400, progress=False)
    images = [frames_of(tmp_path / f"{number}.png")[0] for number in range(6)] + frames_of(film)
    found, fixed = zip(*map(place_of_wall, images), strict=True)
    assert found == pytest.approx([2 + (min(max(t - 0.5, 0) * 1.5, 3) if moving else 0) for t in times] * 3, abs=0.04)
    assert np.ptp(np.reshape(fixed, (3, 3, 2)), axis=1).max() < 0.5, "what is fixed does not move"


def test_a_dark_picture_is_dark_and_its_words_are_light(tmp_path):
    for theme, dark in (("light", False), ("dark", True)):
        (frame,) = frames_of(mpsim.animate(PAIR, GRID, tmp_path / "a.gif", 1, theme=theme, **SMALL))
        assert (frame[0, 0].max() < 60) == dark
        assert ((frame.min(axis=2) > 200).mean() < 0.5) == dark


def pictures(tmp_path, scene, **arguments):
    path = mpsim.animate(scene, GRID, tmp_path / "a.gif", pixels=100, colour=None, progress=False, **arguments)
    return len(frames_of(path))


def test_until_and_frames_say_how_many_pictures_there_are(tmp_path):
    assert pictures(tmp_path, PAIR, until=0.2, every=10) == 3
    assert pictures(tmp_path, PAIR, until=0.04, frames=225) == 5, "there are no more frames"
    lasting = scene_of([[2, 4]], [[1, 0]], 8, 8, radius=1.0, duration=0.3, picture_interval=0.1)
    assert pictures(tmp_path, lasting) == 4, "as many as the duration of the scene needs"
    assert pictures(tmp_path, lasting, until=0.2) == 3
    assert 4 <= pictures(tmp_path, lasting, frames=5, until=1.0) <= 5


def test_progress_can_be_watched_and_nothing_is_printed(tmp_path, capsys):
    seen = []
    mpsim.animate(PAIR, GRID, tmp_path / "a.gif", 2, pixels=100, progress=lambda *now: seen.append(now))
    mpsim.animate(PAIR, GRID, tmp_path / "a.gif", 1, pixels=100)
    assert seen == [(1, 2), (2, 2)]
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"frames": 4, "until": 3.0, "every": 2}, r"every must not come with both frames and until; got 2. Leave one"),
        ({"until": 3000.0, "every": 1}, r"until must be at most 999.99 with every=1, 100,000 pictures; got 3000"),
        ({"scale": "log", "colour": None}, r"scale='log' must come with colour='speed'; got colour=None"),
        ({"pictures_per_second": 51}, r"pictures_per_second must be a whole number from 1 to 50; got 51"),
        ({"path": "a.png"}, r"must end in .gif or .mp4; got 'a.png'. Use a.gif. One picture is made by mpsim.draw"),
        ({"path": ""}, r"animate must be given a path; got ''. Write path='animation.gif'."),
        ({"settings": "a.gif"}, r"settings must be mpsim.Settings or None; got 'a.gif'. Write path='a.gif'."),
    ],
)
def test_animations_refuse_what_makes_none(arguments, text, tmp_path):
    with pytest.raises(mpsim.InputError, match=text):
        mpsim.animate(**{"scene": PAIR, "settings": None, "path": tmp_path / "a.gif", **arguments})
    assert not (tmp_path / "a.gif").exists()
    with pytest.raises(mpsim.errors.OutputError, match="an animation must be a file in a folder that exists"):
        mpsim.animate(PAIR, None, tmp_path / "none" / "a.gif")


def test_a_notebook_shows_an_animation(tmp_path):
    path = mpsim.animate(PAIR, GRID, tmp_path / "a.gif", 1, **SMALL)
    formatter = DisplayFormatter()
    text = formatter.format(path)[0]["text/html"]
    assert base64.b64decode(text.split("base64,")[1].split('"')[0]) == path.read_bytes()
    assert "text/html" not in formatter.format(path.with_suffix(".gone"))[0]
    with path.open("ab") as file:
        file.truncate(20_000_001)
    assert "text/html" not in formatter.format(path)[0], "too large for the output of a cell"


@pytest.mark.slow
def test_mp4_is_written_by_an_ffmpeg_of_the_system_or_of_the_package(tmp_path, monkeypatch):
    pytest.importorskip("imageio_ffmpeg", reason="the extra film is not installed")
    import imageio_ffmpeg  # noqa: PLC0415

    program = shutil.which("ffmpeg") or imageio_ffmpeg.get_ffmpeg_exe()
    written = mpsim.animate(PAIR, GRID, tmp_path / "a.mp4", 5, every=10, **SMALL)
    counted = subprocess.run(
        [program, "-i", str(written), "-f", "null", "-"], capture_output=True, text=True, check=True
    )
    assert "frame=    5" in counted.stderr
    monkeypatch.setenv("PATH", str(tmp_path))
    assert mpsim.animate(PAIR, GRID, tmp_path / "b.mp4", 1, **SMALL).stat().st_size > 1000
