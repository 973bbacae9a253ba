"""A report as a picture."""

import numpy as np
import pytest
from support.scenes import gas, simulate

from mpsim.kernels.layout import PHASES


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
