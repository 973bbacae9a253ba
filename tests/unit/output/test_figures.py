"""Pictures of the benchmark."""

import numpy as np
import pytest

from mpsim.output import figures
from mpsim.studies.benchmark import REPORT_FIXED_MS, Timing


@pytest.fixture
def saved(monkeypatch):
    """The figures that were to be written."""
    found = []
    monkeypatch.setattr(figures, "save_figure", lambda figure, path: found.append(figure))
    return found


def timing(method, seconds, discs=100):
    return Timing(method, 2 if method == "parallel" else 1, discs, np.asarray(seconds), {}, "")


def test_the_first_frame_is_in_no_mean_and_slow_ones_are_counted(saved):
    times = [500e-6, *[1e-6] * 50, *[3e-6] * 50, 90e-6]
    figures.fixed({method: timing(method, times) for method in REPORT_FIXED_MS}, REPORT_FIXED_MS, None)
    (figure,) = saved
    assert len(figure.axes) == 3
    title = figure.axes[0].get_title(loc="left")
    mean = np.mean(times[1:])
    assert f"mean {mean * 1e6:.3g} µs; 1 frame slower, up to 90 µs" in title
    assert f"report's naive: mean 1.65 ms, {1.651e-3 / mean:,.0f} times as long" in title
    assert "frames 2 to 102 (the first one" in figure.axes[-1].get_xlabel()
    drawn = sum(bar.get_height() for bar in figure.axes[0].patches)
    assert drawn == 100, "all but the first and the slow one"


def test_frames_far_beyond_the_median_are_dots_of_their_own(saved):
    times = np.full(300, 2e-6)
    times[[100, 200]] = 40e-6
    figures.growth({"grid": timing("grid", times)}, REPORT_FIXED_MS, None)
    axes = saved[0].axes[0]
    dots, line = axes.lines
    assert dots.get_xdata().tolist() == [101, 201], "numbers of discs, one more after every frame"
    assert np.ptp(line.get_ydata()) == 0, "and do not move the median"
    assert axes.get_title() == "Growth from 1 disc to 300: one more after every frame"


def test_scaling_has_plain_numbers_bars_and_the_sizes_between_which_workers_begin_to_pay(saved):
    rng = np.random.default_rng(1)
    costs = {100: (10, 20), 1_000: (10, 12), 10_000: (10, 5), 100_000: (10, 5)}
    rows = [
        timing(method, discs * cost * 1e-9 * rng.uniform(0.9, 1.1, 99), discs)
        for discs, pair in costs.items()
        for method, cost in zip(("grid", "parallel"), pair, strict=True)
    ]
    figures.scaling(rows, 10_000, None)
    (figure,) = saved
    above, below = figure.axes
    figure.draw_without_rendering()
    assert {"100", "10,000", "100,000"} <= {each.get_text() for each in below.get_xticklabels()}
    assert {"5", "10", "20"} <= {each.get_text() for each in above.get_yticklabels()}
    assert len(above.containers) == 2, "with error bars"
    shaded = below.patches[0].get_bbox()
    assert (shaded.x0, shaded.x1) == (1_000, 10_000)
    assert below.texts[0].get_text().endswith("at 1,000 it is not")


def test_scaling_without_a_crossover_says_nothing_of_it(saved):
    rows = [timing(method, np.full(9, 1e-6), discs) for method in ("grid", "parallel") for discs in (100, 1_000)]
    figures.scaling(rows, None, None)
    assert not saved[0].axes[1].patches
    assert not saved[0].axes[1].texts
