"""A session with every kind of change has the same bits on any number of workers, resumed, and replayed."""

import contextlib
from functools import cache

import numpy as np
import pytest
from support.scenes import simulate
from support.selection import long_but
from support.sessions import METHODS, STEPS, play, room, stage
from support.tiles import always_tiled

import mpsim
from mpsim.engine.journal import Journal

pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::mpsim.errors.EmitterWarning"),
    pytest.mark.filterwarnings("ignore::mpsim.FastWarning"),
]

NAMES = list(STEPS)
KINDS = ["kick", "kick", "set", "change", "remove", "add", "change", "change", "change", "remove", "kick"]
DT = 0.025

FAST = "grid", "event as a whole"
"""Methods that the default suite plays in every way: tiles are compiled anew for each of three kinds of scene."""


def begun(words, **more):
    """A simulation of the stage by a method."""
    return simulate(stage(), dt=DT, **METHODS[words], **more)


@pytest.fixture(autouse=True)
def tiles(request):
    """Tiles for the method that is played on them."""
    words = getattr(request.node, "callspec", None) and request.node.callspec.params.get("words")
    with always_tiled(2, 2, halo=3) if words == "event on tiles" else contextlib.nullcontext():
        yield


@cache
def alone(words):
    """Digest of a whole session on one worker, its discs and time."""
    tiled = always_tiled(2, 2, halo=3) if words == "event on tiles" else contextlib.nullcontext()
    with tiled, simulate(stage(), dt=DT, **(METHODS[words] | {"workers": 1})) as sim:
        assert ("tiles" in sim.array_names) == (words == "event on tiles")
        play(sim)
        return sim.digest(), sim.count, sim.time


@pytest.mark.slow
@pytest.mark.parametrize("words", long_but(METHODS, "grid"))
def test_a_session_has_the_same_bits_on_any_number_of_workers(words):
    digest, count, time = alone(words)
    assert count >= 62
    for workers in (2, 3):
        method = METHODS[words]["method"]
        settings = METHODS[words] | {"workers": workers, "method": "parallel" if method == "grid" else method}
        with simulate(stage(), dt=DT, **settings) as sim:
            play(sim)
            assert (sim.digest(), sim.count, sim.time) == (digest, count, time)


@pytest.mark.long
def test_the_exact_solver_as_a_whole_and_on_tiles_agree():
    assert alone("event as a whole") == alone("event on tiles")


@pytest.mark.parametrize("left_out", NAMES)
def test_each_change_of_the_session_matters(left_out):
    """The control: without any one of them the digest is another one."""
    names = [name for name in NAMES if name != left_out]
    with begun("grid") as sim:
        play(sim, names)
        assert sim.digest() != alone("grid")[0]


@pytest.mark.slow
@pytest.mark.parametrize("words", long_but(METHODS, *FAST))
@pytest.mark.parametrize("way", ["memory", "file"])
def test_a_journal_is_replayed_to_the_same_bits(words, way, tmp_path):
    with begun(words) as sim:
        play(sim)
        journal = sim.journal
    assert (journal.digest, len(journal)) == (alone(words)[0], len(STEPS))
    source = journal if way == "memory" else journal.save(tmp_path / "session.toml")
    for workers in (1, 2, 3):
        with mpsim.Simulation.replay(source, workers=workers) as again:
            assert (again.digest(), again.time, again.frame) == (journal.digest, sim.time, journal.frame)
            assert [change.what for change in again.journal] == [change.what for change in journal]


@pytest.mark.slow
def test_a_journal_is_replayed_by_another_method_of_the_same_bits():
    with begun("grid") as sim:
        journal = play(sim).journal
    for workers in (1, 2, 3):
        with mpsim.Simulation.replay(journal, method="parallel", workers=workers) as again:
            assert again.digest() == journal.digest
    with pytest.raises(mpsim.InputError, match="method must be that of the checkpoint"):
        mpsim.Simulation.replay(journal, method="event")


def test_a_journal_that_lacks_a_change_is_replayed_to_other_bits(tmp_path):
    """The control: the digest in the file is that of the session, not of what is replayed."""
    with begun("grid") as sim:
        path = play(sim).journal.save(tmp_path / "session.toml")
    text = path.read_text()
    kick = text.index("[[change]]")
    path.write_text(text[:kick] + text[text.index("[[change]]", kick + 1) :])
    journal = Journal.load(path)
    assert len(journal) == len(STEPS) - 1
    with mpsim.Simulation.replay(journal) as again:
        assert again.digest() != journal.digest


@pytest.mark.parametrize("words", long_but(METHODS, *FAST))
@pytest.mark.parametrize("after", [3, 5, 8])
def test_a_session_that_is_saved_and_resumed_has_the_same_bits(words, after, tmp_path):
    with begun(words) as sim:
        path = play(sim, NAMES[:after]).save(tmp_path / "run")
    with mpsim.Simulation.resume(path, workers=2 if "naive" not in words else None) as again:
        for name in NAMES[after:]:
            STEPS[name](again)
            again.run(frames=9)
        assert (again.digest(), again.count, again.time) == alone(words)
        assert [change.what for change in again.journal] == KINDS
        journal = again.journal
    with mpsim.Simulation.replay(journal) as third:
        assert third.digest() == journal.digest


@pytest.mark.slow
@pytest.mark.parametrize("words", long_but(METHODS, "grid"))
def test_walls_have_the_same_bits_on_any_number_of_workers_resumed_and_replayed(words, tmp_path):
    found, scene = [], room()
    for workers in (1, 2, 3):
        method = METHODS[words]["method"]
        settings = METHODS[words] | {"workers": workers, "method": "parallel" if method == "grid" else method}
        with simulate(scene, dt=DT, **settings) as sim:
            for y in (5.0, 4.0):
                sim.run(frames=9)
                sim.add_wall([(2.0, scene.height - y), (7.0, scene.height - 2.0)], thickness=0.2)
            sim.run(frames=1)
            path = sim.save(tmp_path / f"run{workers}")
            sim.run(frames=90)
            found.append(sim.digest())
            journal = sim.journal
    with mpsim.Simulation.resume(path, workers=2 if "naive" not in words else None) as again:
        again.run(frames=90)
        found += [again.digest(), mpsim.Simulation.replay(again.journal.save(tmp_path / "session.toml")).digest()]
    assert set(found) == {journal.digest}
    with simulate(scene, dt=DT, **METHODS[words]) as control:
        control.run(frames=109)
        assert control.digest() != journal.digest, "discs have met the walls"


@pytest.mark.parametrize("words", long_but(METHODS, *FAST))
def test_a_change_of_workers_changes_no_bit(words):
    found = []
    for change in (False, True):
        with begun(words) as sim:
            for workers in (1, 2, 3):
                if change:
                    sim.change(workers=workers)
                sim.run(frames=12)
                sim.kick(1, (0.1, 0.0))
            found.append(sim.digest())
            journal = sim.journal
        with mpsim.Simulation.replay(journal) as again:
            found.append(again.digest())
    assert len(set(found)) == 1


def test_where_a_change_stands_between_two_frames_changes_no_bit():
    """In a callback of one long run, or between short ones."""

    class Kicks:
        every = 10

        def look(self, sim, collisions):
            if sim.frame in (10, 20):
                sim.kick(sim.frame, (0.5, 0.5))
                sim.remove(sim.frame + 1)

    digests = []
    for method in ("grid", "event"):
        with simulate(stage(), dt=DT, method=method) as sim:
            sim.run(frames=30, observe=Kicks())
            digests.append(sim.digest())
        with simulate(stage(), dt=DT, method=method) as sim:
            for frame in (10, 20):
                sim.run(frames=10)
                sim.kick(frame, (0.5, 0.5))
                sim.remove(frame + 1)
            sim.run(frames=10)
            digests.append(sim.digest())
    assert digests[0] == digests[1]
    assert digests[2] == digests[3]


def test_what_is_not_changed_is_not_touched():
    """A kick of nothing changes no bit of a stepped method; the exact one predicts anew, to the same discs."""
    for words in METHODS:
        states = []
        for impulse in (None, (0.0, 0.0)):
            with simulate(stage(), dt=DT, **METHODS[words]) as sim:
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
