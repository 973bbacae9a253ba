"""Every kind of obstacle goes through every door, seventy at once; one that a door does not know is refused by name."""

import dataclasses
import re

import numpy as np
import pytest
from support.twins import Twin

import mpsim
from mpsim.features.obstacles import OBSTACLES, Obstacle
from mpsim.viewer import export

pytestmark = [pytest.mark.plain, pytest.mark.filterwarnings("ignore")]


@dataclasses.dataclass(frozen=True, repr=False)
class Probe(Obstacle):
    """A kind that only its feature knows."""

    position: tuple
    radius: float

    def __post_init__(self):
        super().__post_init__()
        object.__setattr__(self, "position", tuple(self.position))

    def capsules(self):
        return [(*self.position, *self.position, self.radius)]


HERE = [(2.0 * (k % 10) + 0.5, 2.0 * (k // 10) + 0.5) for k in range(70)]
EXAMPLES = {
    mpsim.FixedDisc: [mpsim.FixedDisc(place, 0.25) for place in HERE],
    mpsim.Polyline: [mpsim.Polyline([(x, y), (x + 0.5, y + 0.25)], 0.25 * (x > 9)) for x, y in HERE],
}
HOW = {"method": "grid", "dt": 1 / 32, "workers": 1}


def scene_of(obstacles):
    return mpsim.Scene(width=20, height=15, radius=0.25, position=[[1.5, 1.5], [7.5, 3.25]],
                       velocity=[[-1.5, -1.25], [0.25, 1]], obstacles=obstacles)  # fmt: skip


def run_resumed_and_kept(scene, folder, **settings):
    """The last state, which a checkpoint has too, and a program that the view writes, which compares digests itself."""
    with mpsim.Simulation(scene, mpsim.Settings(**settings)) as sim:
        sim.run(frames=20)
        with mpsim.Simulation.resume(sim.save(folder / "run.mpsim")) as resumed:
            assert (resumed.scene.obstacles, resumed.digest()) == (scene.obstacles, sim.digest())
        text = export.program(sim, "").content.decode()
        exec(compile(text, "program.py", "exec"), {})
        assert f"mpsim.{type(scene.obstacles[0]).__name__}(" in text
        return sim.state


def test_every_kind_goes_through_every_door(tmp_path):
    assert {*EXAMPLES} == {*OBSTACLES.kinds}, "a kind of obstacle without an example here"
    for kind, obstacles in EXAMPLES.items():
        scene = scene_of(obstacles)
        scene.save(tmp_path / f"{kind.__name__}.toml")
        again = mpsim.Scene.load(tmp_path / f"{kind.__name__}.toml")
        assert again.obstacles == scene.obstacles
        assert {type(each) for each in again.obstacles} == {kind}
        assert mpsim.draw(scene).axes
        twin = Twin(scene, method="grid", contact="impact", dt=1 / 32)
        twin.run(20)
        for method in ("grid", "event"):
            last = run_resumed_and_kept(again, tmp_path, **HOW | {"method": method})
            assert (last.velocity != scene.velocity).any(), "nothing has met an obstacle"
            assert np.abs(twin.state.position - last.position).max() < 0.1


def test_a_kind_that_only_its_feature_knows_is_kept_or_refused_by_name(tmp_path, monkeypatch):
    monkeypatch.setattr(OBSTACLES, "kinds", (*OBSTACLES.kinds, Probe))  # as a new kind would be declared
    monkeypatch.setattr(mpsim, "Probe", Probe, raising=False)
    scene = scene_of([Probe(place, 0.25) for place in HERE])
    scene.save(tmp_path / "probes.toml")
    assert mpsim.draw(scene).axes
    last = run_resumed_and_kept(scene, tmp_path, **HOW)
    with mpsim.Simulation(scene_of(EXAMPLES[mpsim.FixedDisc]), mpsim.Settings(**HOW)) as pegs:
        pegs.run(frames=20)
        assert pegs.state.digest() == last.digest()
    with pytest.raises(mpsim.InputError, match="method='event' cannot do a Probe"):
        mpsim.Simulation(scene, mpsim.Settings(method="event"))
    with pytest.raises(AssertionError, match="the twin does not know a Probe"):
        Twin(scene, method="grid")


def test_what_is_no_obstacle_is_refused_by_the_kinds_that_are():
    with pytest.raises(mpsim.InputError, match=re.escape("obstacles[0] must be an mpsim.FixedDisc or mpsim.Polyline")):
        mpsim.Scene(width=2, height=2, radius=0.5, position=[[1, 1]], velocity=[[0, 0]], obstacles=[None])


@pytest.mark.parametrize(
    ("table", "words"),
    [
        (
            "position = [1, 1]\nradius = 0.5\nspacing = 1.0",
            "It is a key of discs on a lattice; keys of this table: pos",
        ),
        (
            "points = [[1, 1], [2, 2]]\nradius = 0.5",
            "It is a key of a disc or discs on a lattice; keys of this table: ",
        ),
        ("position = [1, 1]\nradius = 0.5\nlength = 1.0", "Did you mean 'lengths'?"),
    ],
)
def test_a_key_of_another_kind_of_obstacle_is_not_answered_with_itself(tmp_path, table, words):
    path = tmp_path / "scene.toml"
    path.write_text(f"schema = 1\nwidth = 9\nheight = 9\n\n[[obstacles]]\n{table}\n")
    with pytest.raises(mpsim.InputError, match=re.escape(words)):
        mpsim.Scene.load(path)
