"""A report as a picture."""

import dataclasses

import numpy as np
import pytest
from IPython.core.formatters import DisplayFormatter
from support.scenes import gas, simulate

from mpsim.kernels.layout import PHASES
from mpsim.output.times import usual_phases


def test_a_report_is_drawn_with_a_bar_for_each_worker():
    with simulate(gas(200, 0.4), method="parallel", workers=2) as sim:
        report = sim.run(frames=20)
    above, below = report.plot().axes
    assert above.lines[0].get_ydata().tolist() == (report.frame_seconds * 1e6).tolist()
    assert above.get_title() == "20 frames by parallel, 2 workers"
    bars = {container.get_label(): [bar.get_width() for bar in container] for container in below.containers}
    assert bars.keys() == set(PHASES)
    low, high = np.quantile(report.frame_seconds, [0.25, 0.75]) * 1e6
    for worker in range(2):
        assert low <= sum(bars[name][worker] for name in PHASES) <= high, "they add up to a frame"
    waiting = 100 * sum(bars["wait"]) / sum(map(sum, bars.values()))
    assert f"; {waiting:.0f} % is waiting for others" in below.get_xlabel()


def test_a_frame_that_was_disturbed_is_in_no_bar_and_medians_of_phases_would_not_add_up():
    with simulate(gas(20, 0.2), method="grid") as sim:
        report = sim.run(frames=5)
    phases = {name: np.zeros((5, 1)) for name in PHASES}
    for name, seconds in zip(PHASES, ([4, 1, 1, 900, 1], [1, 4, 1, 1, 4], [1, 1, 4, 1, 1]), strict=False):
        phases[name][:, 0] = seconds
    seconds = sum(phases.values())[:, 0]
    report = dataclasses.replace(report, frame_seconds=seconds, phase_seconds=phases)
    found = usual_phases(report)
    assert sum(float(each[0]) for each in found.values()) == 6
    assert sum(float(np.median(each)) for each in phases.values()) != 6


def test_frames_before_auto_had_chosen_are_in_no_bar():
    """The bars of a run that began with two workers and went on with one still add up to a frame."""
    with simulate(gas(20, 0.2), method="grid") as sim:
        report = sim.run(frames=8)
    phases = {name: np.zeros((8, 2)) for name in PHASES}
    phases["move"][:3] = 50.0, 50.0  # microseconds, by two workers
    phases["move"][3:, 0] = 10.0
    phases = {name: each * 1e-6 for name, each in phases.items()}
    report = dataclasses.replace(report, frame_seconds=phases["move"][:, 0].copy(), phase_seconds=phases)
    below = report.plot().axes[1]
    (bars,) = below.containers
    assert [round(bar.get_width(), 6) for bar in bars] == [10.0]
    assert "mean of the middle half of the 5 frames by grid, 1 worker [µs]:\n10 µs" in below.get_xlabel()


def test_times_of_frames_are_written_without_powers():
    with simulate(gas(200, 0.4), method="grid") as sim:
        figure = sim.run(frames=20).plot()
    figure.draw_without_rendering()
    written = [text.get_text() for text in figure.axes[0].get_yticklabels(which="both")]
    assert any(written)
    assert not any("10^" in text for text in written)


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


def test_a_notebook_shows_it():
    with simulate(gas(20, 0.2), method="grid") as sim:
        data, _ = DisplayFormatter().format(sim.run(frames=2).plot())
    assert data["image/png"][:4] == b"\x89PNG"
