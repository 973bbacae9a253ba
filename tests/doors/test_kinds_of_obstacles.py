"""Every kind of obstacle goes through every door, seventy at once; one that a door does not know is refused by name."""

import re

import pytest
from support.processes import assert_clean, run_script

import mpsim

SCRIPT = """
import dataclasses, numpy, mpsim
from pathlib import Path
from mpsim.features.obstacles import OBSTACLES
from mpsim.viewer import keep
from support.twins import Twin

@dataclasses.dataclass(frozen=True)
class Probe:
    position: tuple
    radius: float

    def capsules(self):
        return [(*self.position, *self.position, self.radius)]

HERE = [(2.0 * (k % 10) + 0.5, 2.0 * (k // 10) + 0.5) for k in range(70)]
EXAMPLES = {
    mpsim.FixedDisc: [mpsim.FixedDisc(place, 0.25) for place in HERE],
    mpsim.Polyline: [mpsim.Polyline([(x, y), (x + 0.5, y + 0.25)], 0.25 * (x > 9)) for x, y in HERE],
}
assert {*EXAMPLES} == {*OBSTACLES.kinds}, "a kind of obstacle without an example here"

def scene_of(obstacles):
    return mpsim.Scene(width=20, height=15, radius=0.25, position=[[1.5, 1.5], [7.5, 3.25]],
                       velocity=[[-1.5, -1.25], [0.25, 1]], obstacles=obstacles)

def kept(sim):
    text = keep.program(sim, "").content.decode()
    exec(compile(text, "program.py", "exec"), {})  # it compares digests
    return text

folder = Path(__file__).parent
for kind, obstacles in EXAMPLES.items():
    scene = scene_of(obstacles)
    scene.save(folder / "seventy.toml")
    again = mpsim.Scene.load(folder / "seventy.toml")
    assert again.obstacles == scene.obstacles and {type(each) for each in again.obstacles} == {kind}
    assert mpsim.draw(scene).axes
    for method in ("grid", "event"):
        with mpsim.Simulation(again, mpsim.Settings(method=method, dt=1 / 64, workers=1)) as sim:
            sim.run(frames=60)
            sim.save(folder / "run.mpsim")
            with mpsim.Simulation.resume(folder / "run.mpsim") as resumed:
                assert resumed.scene.obstacles == scene.obstacles and resumed.digest() == sim.digest()
            assert f"mpsim.{kind.__name__}(" in kept(sim)
            last = sim.state
            assert (numpy.sign(last.velocity) != numpy.sign(scene.velocity)).any(), "nothing has met an obstacle"
    twin = Twin(scene, method="grid", contact="impact", dt=1 / 128)
    twin.run(120)
    assert numpy.abs(twin.state.position - last.position).max() < 0.1

# A kind that only the feature knows.
OBSTACLES.kinds, mpsim.Probe = (*OBSTACLES.kinds, Probe), Probe
scene = scene_of([Probe(place, 0.25) for place in HERE])
scene.save(folder / "probes.toml")
assert mpsim.draw(scene).axes
settings = mpsim.Settings(method="grid", dt=1 / 64, workers=1)
with mpsim.Simulation(scene, settings) as sim, mpsim.Simulation(scene_of(EXAMPLES[mpsim.FixedDisc]), settings) as pegs:
    for each in (sim, pegs):
        each.run(frames=60)
    assert sim.digest() == pegs.digest()
    sim.save(folder / "run.mpsim")
    with mpsim.Simulation.resume(folder / "run.mpsim") as resumed:
        assert {type(each) for each in resumed.scene.obstacles} == {Probe}
    assert "mpsim.Probe(position=" in kept(sim)
try:
    mpsim.Simulation(scene, mpsim.Settings(method="event"))
except mpsim.InputError as error:
    assert "method='event' cannot do a Probe" in str(error)
else:
    raise AssertionError("event takes a kind that it does not know")
try:
    Twin(scene, method="grid")
except AssertionError as error:
    assert "the twin does not know a Probe" in str(error)
else:
    raise SystemExit("the twin takes a kind that it does not know")
"""


def test_every_kind_goes_through_every_door():
    assert_clean(run_script(SCRIPT, env={"NUMBA_DISABLE_JIT": "1", "PYTHONWARNINGS": "ignore"}, flags=(), bound=120))


def test_what_is_no_obstacle_is_refused_by_the_kinds_that_are():
    with pytest.raises(mpsim.InputError, match=re.escape("obstacles[0] must be an mpsim.FixedDisc or mpsim.Polyline")):
        mpsim.Scene(width=2, height=2, radius=0.5, position=[[1, 1]], velocity=[[0, 0]], obstacles=[None])


@pytest.mark.parametrize(
    ("table", "words"),
    [
        (
            "position = [1, 1]\nradius = 0.5\nspacing = 1.0",
            "It is a key of discs on a lattice; keys of this table: posi",
        ),
        (
            "points = [[1, 1], [2, 2]]\nradius = 0.5",
            "It is a key of a disc or discs on a lattice; keys of this table: po",
        ),
        ("position = [1, 1]\nradius = 0.5\nlength = 1.0", "Did you mean 'lengths'?"),
    ],
)
def test_a_key_of_another_kind_of_obstacle_is_not_answered_with_itself(tmp_path, table, words):
    path = tmp_path / "scene.toml"
    path.write_text(f"schema = 1\nwidth = 9\nheight = 9\n\n[[obstacles]]\n{table}\n")
    with pytest.raises(mpsim.InputError, match=re.escape(words)):
        mpsim.Scene.load(path)
