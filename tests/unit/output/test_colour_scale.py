"""The scale of colours: percentiles of what is shown, and arrows for the rest."""

import numpy as np
import pytest
from support.scenes import gas, simulate

import mpsim
from mpsim.output import colour_scale
from mpsim.output.animation import MOST_PICTURES, Picture, pictures_of
from mpsim.output.colour_scale import ColourScale, scale_of, scale_of_run


def test_a_few_fast_discs_do_not_stretch_the_scale():
    speeds = np.r_[np.linspace(0, 1, 1000), 500.0]
    scale = scale_of(speeds)
    assert scale.high < 1.0
    assert scale.outside == "both"
    # Many of them do: they are what there is to see.
    assert scale_of(np.r_[np.linspace(0, 1, 1000), np.full(100, 500.0)]).high == 500


def test_a_scale_has_a_length_whatever_it_is_made_from():
    rest_but_one = scale_of([0.0] * 99 + [1.0])
    assert rest_but_one == ColourScale(0.0, 1.0, "neither")
    assert scale_of([]) == scale_of([0.0, 0.0]) == scale_of([np.nan]) == ColourScale(0.0, 1.0)
    assert scale_of([-2.0]) == ColourScale(-2.0, 0.0)


def test_the_scale_of_a_run_is_that_of_all_its_pictures():
    scene, settings = gas(30, 0.2), mpsim.Settings(method="grid", dt=0.01)
    seen = []
    with simulate(scene, method="grid", dt=0.01) as sim:
        for _ in range(4):
            seen.append(np.hypot(*sim.state.velocity.T))
            sim.run(frames=20)
    assert scale_of_run(scene, settings, 4, 20) == scale_of(np.concatenate(seen))
    assert scale_of_run(scene, settings, 4, 20) != scale_of(seen[0])


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
    with pytest.raises(mpsim.InputError, match=r"until must not come with frames; got until=3.0 and frames=4"):
        pictures_of(scene, settings, 4, None, until=3.0)
    with pytest.raises(mpsim.InputError, match="until must be"):
        pictures_of(scene, settings, None, None, until=-1.0)


def test_large_runs_are_sampled(monkeypatch):
    monkeypatch.setattr(colour_scale, "SAMPLE", 10)
    scene, settings = gas(30, 0.2), mpsim.Settings(method="grid", dt=0.01)
    speeds = np.hypot(*scene.velocity.T)
    assert scale_of_run(scene, settings, 1, 1) == scale_of(speeds[::3])
