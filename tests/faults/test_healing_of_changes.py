"""A worker that dies after discs or parameters were changed: what was changed is there when the run has healed."""

import os
import random
import signal

import pytest
from support.internals import solver_of
from support.scenes import gas, simulate

from mpsim.engine import recovery

pytestmark = pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")  # 3.12: fork with threads

CHANGES = {
    40: lambda sim: sim.kick(range(0, 500, 5), (0.5, 0.25)),
    80: lambda sim: sim.remove([3, 44, 100]),
    120: lambda sim: sim.change(gravity=(0.0, -1.0), passes=2),
    160: lambda sim: sim.set(7, velocity=(1.0, 1.0)),
    200: lambda sim: sim.kick(8, (0.0, 2.0)),
}


class Changes:
    """Changes a run from within, each once; kills a worker just before or just after each change from a frame on."""

    every = 40

    def __init__(self, before=False, after=False, since=0):
        self.before, self.after, self.since, self.deaths, self.made = before, after, since, 0, set()

    def look(self, sim, collisions):
        kill = lambda: os.kill(random.choice(sim.pids), signal.SIGKILL)  # noqa: E731
        if sim.frame in CHANGES.keys() - self.made:
            kills = sim.frame >= self.since
            self.made.add(sim.frame)
            if self.before and kills:
                kill()
            CHANGES[sim.frame](sim)
            if self.after and kills:
                kill()
            self.deaths += kills * (self.before + self.after)


def session(changes, workers, **settings):
    settings |= {"on_worker_death": "restart", "start_method": "fork", "workers": workers}
    with simulate(gas(500, 0.4, seed=2), method="parallel", **settings) as sim:
        sim.run(frames=240, observe=changes)
        return sim.digest(), [change.what for change in sim.journal], sim.scene.gravity.tolist()


@pytest.mark.slow
@pytest.mark.parametrize("when", ["before", "after"])
def test_what_was_changed_in_a_run_is_there_after_a_death(when):
    changes = Changes(**{when: True})
    expected = session(Changes(), 1)
    assert session(changes, 3) == expected
    assert changes.deaths == 5
    assert expected[1] == ["kick", "remove", "change", "set", "kick"]


@pytest.mark.slow
def test_a_snapshot_from_before_the_change_would_be_noticed(monkeypatch):
    """The control: without the new snapshot the run goes back to before the change, which is lost."""
    expected = session(Changes(), 1)
    monkeypatch.setattr(recovery, "SNAPSHOT_SECONDS", 1e9)
    begin = recovery.RecoverySnapshots.__init__

    def forgetful(self, *arguments):
        begin(self, *arguments[:4])

    monkeypatch.setattr(recovery.RecoverySnapshots, "__init__", forgetful)
    assert session(Changes(after=True, since=200), 3)[0] != expected[0]


@pytest.mark.slow
def test_a_death_between_two_runs_is_healed_after_a_change():
    found = []
    for kills in (False, True):
        settings = {"on_worker_death": "restart", "start_method": "fork", "workers": 3 if kills else 1}
        with simulate(gas(500, 0.4, seed=2), method="parallel", **settings) as sim:
            for change in CHANGES.values():
                sim.run(frames=20)
                if kills:
                    os.kill(random.choice(sim.pids), signal.SIGKILL)
                change(sim)
                if kills:
                    os.kill(random.choice(sim.pids), signal.SIGKILL)
            sim.run(frames=20)
            found.append((sim.digest(), len(sim.journal), solver_of(sim).count))
    assert found[0] == found[1]
