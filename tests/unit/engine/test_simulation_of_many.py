"""Scenes of up to a million obstacles or emitters start, and are saved, in a time that grows with their number.

Growth of looks is counted, not timed.
"""

import numpy as np
import pytest
from support.many import chain, emitters, pegs, pegs_and_emitters, simulated
from support.seconds import quickest
from support.selection import long_but

import mpsim

LONGEST = 2e-5
"""Seconds of processor time per obstacle or emitter, from the scene to the end of the first frame."""


CHECKPOINT = 8e-5
"""Seconds of processor time per emitter, to write it into a checkpoint and to read it."""


def test_looks_at_emitters_grow_with_their_number(monkeypatch):
    def looks(count):
        arguments, reads = emitters(count), [0]

        def counting(self, name):
            reads[0] += 1
            return object.__getattribute__(self, name)

        with monkeypatch.context() as patch:
            patch.setattr(mpsim.Emitter, "__getattribute__", counting)
            simulated(arguments).close()
        return reads[0]

    few, many = looks(100), looks(400)
    assert 0 < few < many < 6 * few, "linear would be 4, quadratic 16"


SCENES = [(make, count) for make in (pegs, chain, emitters) for count in (10_000, 100_000, 1_000_000)]


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize(("make", "count"), long_but(SCENES, *(scene for scene in SCENES if scene[1] < 100_000)))
def test_scene_and_first_frame_of_very_many_take_seconds(make, count, figures):
    with simulated(make(4)) as sim:
        sim.run(frames=1)  # its kernels are loaded
    arguments = make(count)

    def first_frame():
        with simulated(arguments) as sim:
            sim.run(frames=1)
            assert (sim.count, sim.frame) == (count, 1)

    seconds = quickest(first_frame, LONGEST * count)
    assert seconds < LONGEST * count
    what = f"{count:,} {make.__name__}, as many discs: from Scene(...) to the end of frame 1"
    figures.note("R22", "grid", what, f"{LONGEST * count:g} s at most", f"{seconds:.2f} s")


@pytest.mark.slow
@pytest.mark.parametrize("count", [20_000, pytest.param(100_000, marks=pytest.mark.long)])
def test_a_checkpoint_of_many_emitters_is_written_and_read_in_seconds(count, tmp_path, figures):
    def written_and_read():
        path = sim.save(tmp_path / "run")
        with mpsim.Simulation.resume(path) as again:
            assert again.scene.emitters == sim.scene.emitters

    with simulated({**emitters(count), "position": np.ones((1, 2))}) as sim:
        seconds = quickest(written_and_read, CHECKPOINT * count)
    assert seconds < CHECKPOINT * count
    what = f"a checkpoint of {count:,} emitters, written and read"
    figures.note("R22", "grid", what, f"{CHECKPOINT * count:g} s at most", f"{seconds:.2f} s")


CROWDS = {"free": ((10.0, 0.0), 4e-4), "into obstacles": ((150.0, 150.0), 2.5e-3)}
"""Velocity of discs that enter, and seconds of processor time that each may take."""


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::mpsim.FastWarning")  # a flight inside a frame is exact at any speed
@pytest.mark.timeout(300)
@pytest.mark.parametrize("how", long_but(CROWDS, "free"))
@pytest.mark.parametrize("emitters", [1000, pytest.param(10_000, marks=pytest.mark.long)])
def test_many_discs_enter_among_very_many_obstacles_in_seconds(how, emitters, figures):
    velocity, each = CROWDS[how]
    longest = 2 + each * emitters  # two seconds for the scene, and the grid in which they look
    with simulated(pegs_and_emitters(100, 1, velocity)) as sim:
        sim.run(frames=1)  # its kernels are loaded
    arguments = pegs_and_emitters(100_000, emitters, velocity)

    def first_frame():
        with simulated(arguments) as sim:
            sim.run(frames=1)
            assert sim.count == emitters

    seconds = quickest(first_frame, longest)
    assert seconds < longest
    what = f"100,000 pegs, {emitters:,} emitters: to the end of frame 1, in which all discs enter and fly {how}"
    figures.note("R22", "grid", what, f"{longest:g} s at most", f"{seconds:.2f} s")
