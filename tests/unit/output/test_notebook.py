"""Scenes, reports and answers in a notebook; nothing is printed, and Matplotlib is imported for pictures only."""

import dataclasses
import io
import sys
import warnings

import numpy as np
import pytest
from PIL import Image
from support.scenes import gas, simulate

import mpsim
from mpsim.scene import scenefile
from mpsim.studies.cost import Cost
from mpsim.studies.deviations import Deviation
from mpsim.studies.tuned import Tuned


def test_a_report_in_a_notebook_is_a_small_table():
    with simulate(gas(20, 0.2), method="grid") as sim:
        text = sim.run(frames=10, measures=["temperature"])._repr_html_()
        report = sim.run(frames=10)
        empty = sim.run(frames=0)._repr_html_()
    assert "compiling" not in report._repr_html_()
    cold = dataclasses.replace(report, compile_seconds=6.25)
    assert "<th>compiling before</th><td>6.2 s</td>" in cold._repr_html_()
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


@pytest.mark.slow
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


def test_nothing_is_printed(tmp_path, capsys):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mpsim.animate(gas(5, 0.1), mpsim.Settings(method="grid"), tmp_path / "a.gif", 2, pixels=100)
    assert capsys.readouterr() == ("", "")
    assert sys.stdout is not None
