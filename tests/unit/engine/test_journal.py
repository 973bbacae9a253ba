"""The journal of a simulation: what it holds, and session files that are none."""

from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest
from support.scenes import gas, simulate

import mpsim
from mpsim.engine.journal import Journal


def test_a_session_file_that_is_none_is_refused_by_name(tmp_path):
    with simulate(gas(20, 0.2)) as sim:
        sim.kick(1, (0.5, 0))
        path = sim.journal.save(tmp_path / "session.toml")
    text = path.read_text()
    for old, new, said in (
        ("format = 1", "format = 9", "its format is 9"),
        ("frame = 0", "frame = -1", "frames must be whole numbers"),
        ('what = "kick"', 'what = "close"', "must have a time and be one of"),
        ('scene = "session', 'scene = "../session', "its scene must be a file beside it"),
        ("ids = [1]", "ids = [77]", "change 0 of a journal.*ids must be numbers of discs"),
        ("ids = [1]", "ids = [1]\nsecret = 3", "change 0 of a journal.*secret"),
        ("time = 0.0", "time = 0.125", "an interrupt had left that run inside a frame"),
        ("[settings]", "more = 1\n[settings]", "it has the key 'more'"),
        ("format", "= =", "must be a file that Journal.save has written"),
    ):
        path.write_text(text.replace(old, new))
        with pytest.raises(mpsim.InputError, match=said):
            mpsim.Simulation.replay(path)
    for wrong in ("[1, 2]", '"kick"'):
        path.write_text(text[: text.index("[[change]]")].replace("[settings]", f"change = {wrong}\n[settings]"))
        with pytest.raises(mpsim.InputError, match="its changes must be tables"):
            Journal.load(path)
    path.write_text(text)
    with mpsim.Simulation.replay(path) as again:  # the control
        assert len(again.journal) == 1
    with pytest.raises(mpsim.InputError, match=r"must end in \.toml"):
        Journal.load(tmp_path / "session.json")
    with pytest.raises(mpsim.InputError, match=r"must end in \.toml"):
        sim_journal_save_elsewhere(tmp_path)


def sim_journal_save_elsewhere(folder):
    with simulate(gas(20, 0.2)) as sim:
        sim.journal.save(folder / "session")


def test_a_journal_holds_plain_numbers(tmp_path):
    with simulate(gas(20, 0.2)) as sim:
        sim.change(dt=Fraction(1, 40), gravity=(Decimal("0.5"), np.float32(0)), passes=np.int8(2))
        sim.run(frames=5)
        sim.change(gravity=np.zeros(2))
        sim.run(frames=5)
        journal = sim.journal
        checkpoint = sim.save(tmp_path / "run")
    assert journal.changes[0].values == {"dt": 0.025, "gravity": [0.5, 0.0], "passes": 2}
    with mpsim.Simulation.replay(journal.save(tmp_path / "session.toml")) as again:
        assert again.digest() == journal.digest
    with mpsim.Simulation.resume(checkpoint) as again:
        assert again.journal.changes == journal.changes


def test_a_journal_is_replayed_up_to_a_frame():
    with simulate(gas(20, 0.2)) as sim:
        digests = []
        for _ in range(3):
            sim.kick(1, (0.5, 0))
            digests.append(sim.digest())
            sim.run(frames=4)
        journal = sim.journal
    with mpsim.Simulation.replay(journal, frame=4) as again:
        assert (again.frame, again.digest(), len(again.journal)) == (4, digests[1], 2)
    with pytest.raises(mpsim.InputError, match="frame must be a whole number from 0 to 12"):
        mpsim.Simulation.replay(journal, frame=13)
