"""The scale of colours: percentiles of what is shown, and arrows for the rest."""

import numpy as np
import pytest
from support.scenes import gas, simulate

import mpsim
from mpsim.output import colour_scale
from mpsim.output.animation import MOST_PICTURES, pictures_of
from mpsim.output.colour_scale import ColourScale, percentile_scale, scale_of_run
from mpsim.output.moving_picture import Picture


def test_a_few_fast_discs_do_not_stretch_the_scale():
    speeds = np.r_[np.linspace(0, 1, 1000), 500.0]
    scale = percentile_scale(speeds)
    assert scale.high < 1.0
    assert scale.outside == "both"
    # Many of them do: they are what there is to see.
    assert percentile_scale(np.r_[np.linspace(0, 1, 1000), np.full(100, 500.0)]).high == 500


def test_a_scale_has_a_length_whatever_it_is_made_from():
    rest_but_one = percentile_scale([0.0] * 99 + [1.0])
    assert rest_but_one == ColourScale(0.0, 1.0, "neither")
    assert percentile_scale([]) == percentile_scale([0.0, 0.0]) == percentile_scale([np.nan]) == ColourScale(0.0, 1.0)
    assert percentile_scale([-2.0]) == ColourScale(-2.0, 0.0)


def test_the_scale_of_a_run_is_that_of_all_its_pictures():
    scene, settings = gas(30, 0.2), mpsim.Settings(method="grid", dt=0.01)
    seen = []
    with simulate(scene, method="grid", dt=0.01) as sim:
        for _ in range(4):
            seen.append(np.hypot(*sim.state.velocity.T))
            sim.run(frames=20)
    assert scale_of_run(scene, settings, 4, 20) == percentile_scale(np.concatenate(seen))
    assert scale_of_run(scene, settings, 4, 20) != percentile_scale(seen[0])


def test_the_colour_bar_has_arrows_only_for_what_lies_outside():
    with simulate(gas(30, 0.2), method="grid") as sim:
        for scale in (ColourScale(0.5, 1.0, "both"), ColourScale(0.5, 1.0, "neither")):
            picture = Picture(sim, 200, scale=scale)
            bar = picture._discs.colorbar
            assert bar is not None
            assert bar.extend == scale.outside
            assert picture._discs.get_clim() == (0.5, 1.0)


def test_until_is_the_time_of_the_last_picture():
    scene, settings = gas(5, 0.1), mpsim.Settings(dt=0.01)
    assert pictures_of(scene, settings, None, 10, until=3.0) == (31, 10)
    number, every = pictures_of(scene, settings, None, None, until=300.0)
    assert number <= MOST_PICTURES
    assert (number - 1) * every * 0.01 == pytest.approx(300, abs=every * 0.01)
    with pytest.raises(mpsim.InputError, match=r"frames must not come with until or seconds; got frames=4, until=3.0"):
        pictures_of(scene, settings, 4, None, until=3.0)
    with pytest.raises(mpsim.InputError, match="until must be"):
        pictures_of(scene, settings, None, None, until=-1.0)


def test_seconds_are_those_of_the_animation():
    scene, settings = gas(5, 0.1, duration=30.0), mpsim.Settings(dt=0.01)

    def lasting(rate=25, frames=None, every=None, until=None, **more):
        number, every = pictures_of(scene, settings, frames, every, until, rate=rate, **more)
        return number / rate, (number - 1) * every * settings.dt

    for seconds in (1.0, 4.0):
        length, end = lasting(seconds=seconds)
        assert 0.9 * seconds < length <= seconds
        assert end == pytest.approx(30, abs=1.3), "the whole duration"
    length, end = lasting(seconds=2.0, until=12.0)
    assert (1.8 < length <= 2.0, end) == (True, pytest.approx(12, abs=0.5))
    assert pictures_of(scene, settings, None, 7, seconds=2, rate=10) == (20, 7)
    assert pictures_of(scene, settings, None, None, until=0.1, seconds=9) == (11, 1), "there are no more frames"
    assert pictures_of(scene, settings, None, None, seconds=0.001) == (1, 3000)
    assert pictures_of(gas(5, 0.1), settings, None, None, seconds=3) == (75, 1), "a scene without a duration"


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"seconds": 0}, r"seconds must be a finite number > 0 \[s\]; got 0"),
        ({"seconds": float("inf")}, r"seconds must be a finite number > 0 \[s\]; got inf"),
        ({"seconds": "4"}, r"seconds must be a number > 0 \[s\]; got '4'"),
        ({"seconds": 1e9}, r"seconds must be at most 4000 with 25 pictures per second, 100,000 pictures; got 1e\+09"),
        ({"seconds": 4, "frames": 3}, r"frames must not come with until or seconds; got frames=3, seconds=4. Leave"),
        ({"seconds": 4, "until": 3.0, "every": 2}, r"every must not come with both until and seconds; got until=3.0"),
        ({"theme": "drak"}, r"theme must be one of 'light', 'dark'; got 'drak'. Did you mean 'dark'\?"),
        ({"scale": "logg"}, r"scale must be one of 'linear', 'log'; got 'logg'. Did you mean 'log'\?"),
        ({"scale": "log", "colour": None}, r"scale='log' must come with colour='speed'; got colour=None"),
        ({"pixels": 99}, r"pixels must be a whole number from 100 to 4000; got 99"),
        ({"pictures_per_second": 51}, r"pictures_per_second must be a whole number from 1 to 50; got 51"),
        ({"second": 4}, r"an argument of animate must be one of .*; got 'second'. Did you mean 'seconds'"),
    ],
)
def test_animations_refuse_what_makes_none(arguments, text, tmp_path):
    with pytest.raises(mpsim.InputError, match=text):
        mpsim.animate(gas(5, 0.1), None, tmp_path / "a.gif", **arguments)
    assert not (tmp_path / "a.gif").exists()


def test_large_runs_are_sampled(monkeypatch):
    monkeypatch.setattr(colour_scale, "SAMPLE", 10)
    scene, settings = gas(30, 0.2), mpsim.Settings(method="grid", dt=0.01)
    speeds = np.hypot(*scene.velocity.T)
    assert scale_of_run(scene, settings, 1, 1) == percentile_scale(speeds[::3])
