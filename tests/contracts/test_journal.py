"""A session with every kind of change has the same bits on any number of workers, resumed, and replayed."""

import contextlib
from functools import cache

import numba
import numpy as np
import pytest
from support.scenes import simulate
from support.selection import long_but
from support.sessions import METHODS, STEPS, play, stage
from support.tiles import always_tiled

import mpsim

pytestmark = [
    pytest.mark.plain,
    pytest.mark.filterwarnings("ignore::mpsim.errors.EmitterWarning"),
    pytest.mark.filterwarnings("ignore::mpsim.FastWarning"),
]

NAMES = list(STEPS)
KINDS = ["kick", "kick", "set", "change", "remove", "add", "change", "change", "change", "remove", "kick"]
DT, FRAMES = 0.025, 3  # length of a frame, and frames after each change

ALL = [
    "grid", "event as a whole",
    *(pytest.param(each, marks=pytest.mark.long) for each in ("naive", "parallel on 2", "event on tiles")),
]  # fmt: skip
"""Methods: on workers and tiles there is another compilation for each of three kinds of scene."""

SEVERAL = (1,) if numba.config.DISABLE_JIT else (2, 3)
"""Numbers of workers that a session goes on with, and is replayed by; in plain Python there is one."""


@pytest.fixture(autouse=True)
def tiles(request):
    """Tiles for the method that is played on them."""
    words = getattr(request.node, "callspec", None) and request.node.callspec.params.get("words")
    with always_tiled(2, 2, halo=3) if words == "event on tiles" else contextlib.nullcontext():
        yield


def begun(words, **more):
    """A simulation of the stage by a method."""
    return simulate(stage(), dt=DT, **METHODS[words] | more)


@cache
def alone(words):
    """A whole session on one worker: digest, discs, time, and journal."""
    tiled = always_tiled(2, 2, halo=3) if words == "event on tiles" else contextlib.nullcontext()
    with tiled, begun(words, workers=1) as sim:
        play(sim, frames=FRAMES)
        assert sim.count >= 62
        return sim.digest(), sim.count, sim.time, sim.journal


@pytest.mark.parametrize("words", ALL)
def test_a_journal_is_replayed_to_the_same_bits_from_its_file(words, tmp_path):
    digest, _, time, journal = alone(words)
    assert (journal.digest, len(journal)) == (digest, len(STEPS))
    with mpsim.Simulation.replay(journal.save(tmp_path / "session.toml"), workers=SEVERAL[-1]) as again:
        assert (again.digest(), again.time, again.frame) == (digest, time, journal.frame)
        assert [change.what for change in again.journal] == KINDS


@pytest.mark.parametrize("words", ALL)
@pytest.mark.parametrize("after", long_but((3, 5, 8), 5))
def test_a_session_that_is_saved_and_resumed_has_the_same_bits_and_is_replayed_from_memory(words, after, tmp_path):
    with begun(words) as sim:
        path = play(sim, NAMES[:after], FRAMES).save(tmp_path / "run")
    with mpsim.Simulation.resume(path, workers=SEVERAL[0] if "naive" not in words else None) as again:
        for name in NAMES[after:]:
            STEPS[name](again)
            again.run(frames=FRAMES)
        assert (again.digest(), again.count, again.time) == alone(words)[:3]
        assert [change.what for change in again.journal] == KINDS
        journal = again.journal
    with mpsim.Simulation.replay(journal) as third:
        assert third.digest() == journal.digest


@pytest.mark.long
def test_a_session_has_the_same_bits_on_workers_and_is_replayed_by_another_method_of_the_same_bits():
    digest, _, _, journal = alone("grid")
    for workers in (2, 3):
        with begun("grid", method="parallel", workers=workers) as sim:
            assert play(sim, frames=FRAMES).digest() == digest
    with mpsim.Simulation.replay(journal, method="parallel", workers=3) as again:
        assert again.digest() == digest
    with pytest.raises(mpsim.InputError, match="method must be that of the checkpoint"):
        mpsim.Simulation.replay(journal, method="event")


@pytest.mark.parametrize("left_out", NAMES[1::4])
def test_each_change_of_the_session_matters(left_out):
    """The control: without any one of them the digest is another one."""
    with begun("grid") as sim:
        play(sim, [name for name in NAMES if name != left_out], FRAMES)
        assert sim.digest() != alone("grid")[0]


@pytest.mark.slow
@pytest.mark.parametrize("words", long_but(["event as a whole", "parallel on 2"], "parallel on 2"))
def test_a_change_of_workers_changes_no_bit(words):
    found = []
    for change in (False, True):
        with begun(words) as sim:
            for workers in (1, *SEVERAL):
                if change:
                    sim.change(workers=workers)
                sim.run(frames=12)
                sim.kick(1, (0.1, 0.0))
            found.append(sim.digest())
            journal = sim.journal
        with mpsim.Simulation.replay(journal) as again:
            found.append(again.digest())
    assert len(set(found)) == 1


class Kicks:
    every = 10

    def observe(self, sim, collisions):
        if sim.frame in (10, 20):
            sim.kick(sim.frame, (0.5, 0.5))
            sim.remove(sim.frame + 1)


@pytest.mark.parametrize("method", ["grid", "event"])
def test_where_a_change_stands_between_two_frames_changes_no_bit(method):
    """In a callback of one long run, or between short ones."""
    with simulate(stage(), dt=DT, method=method) as sim, simulate(stage(), dt=DT, method=method) as other:
        sim.run(frames=30, observe=Kicks())
        for _ in range(2):
            other.run(frames=10)
            Kicks().observe(other, 0)
        other.run(frames=10)
        assert sim.digest() == other.digest()


@pytest.mark.parametrize("words", ["naive", "grid", "event as a whole"])
def test_what_is_not_changed_is_not_touched(words):
    """A kick of nothing changes no bit of a stepped method; the exact one predicts anew, to the same discs."""
    states = []
    for impulse in (None, (0.0, 0.0)):
        with begun(words) as sim:
            sim.run(frames=10)
            if impulse is not None:
                sim.kick([1, 2], impulse)
                sim.set(3, velocity=sim.state.velocity[3])
            sim.run(frames=10)
            states.append(sim.state)
    if "event" in words:
        assert np.abs(states[0].position - states[1].position).max() < 1e-9
    else:
        assert states[0].digest() == states[1].digest()
