"""A second stage keeps to the time of the first one and has every change made by hand there, and goes back with it."""

import numpy as np
import pytest
from support.scenes import gas, simulate

import mpsim
from mpsim.viewer.pair import SNAPSHOT, Pair, in_step

SCENE = gas(50, 0.2)
EVENT = mpsim.Settings(method="event")
GRID = mpsim.Settings(method="grid", contact="push", dt=0.01)


class Two:
    """Both stages."""

    def __init__(self, beside=EVENT, scene=SCENE, **settings):
        self.first = simulate(scene, **{"method": "grid", "dt": 0.01, **settings})
        self.pair = Pair(scene, beside, self.first.settings.dt)

    @property
    def second(self):
        return self.pair.sim

    def run(self, frames):
        self.pair.follow(self.first, self.first.run(frames=frames))
        assert self.second.time == pytest.approx(self.first.time, rel=1e-12)

    def take(self):
        self.pair.take(self.first, self.first.journal)

    def distance(self):
        return float(np.abs(self.first.state.position - self.second.state.position).max())

    def close(self):
        self.first.close()
        self.pair.close()


@pytest.fixture
def two():
    made = []

    def begin(*given, **settings):
        made.append(Two(*given, **settings))
        return made[-1]

    yield begin
    for each in made:
        each.close()


def test_both_have_the_bits_of_a_run_alone(two):
    t = two()
    for frames in (1, 7, 12):
        t.run(frames)
    for sim, settings in ((t.first, GRID), (t.second, mpsim.Settings(method="event", dt=0.01))):
        with mpsim.Simulation(SCENE, settings) as alone:
            alone.run(frames=20)
            assert alone.digest() == sim.digest()
    assert t.first.time == t.second.time
    assert t.pair.follow(t.first, t.first.run(frames=0)) == 0.0, "it is there already"


def test_equal_settings_never_part(two):
    t = two(GRID)
    t.run(50)
    t.first.kick(3, (2.0, 0.0))
    t.take()
    t.run(50)
    assert t.first.digest() == t.second.digest()
    assert t.pair.comparison.read(t.first.state, t.second.state, t.first.time)["distance"] == 0.0


def test_a_finer_second_stage_runs_several_frames_in_one(two):
    t = two(mpsim.Settings(method="grid", contact="push", dt=0.0025))
    t.run(10)
    assert t.second.frame == 40


@pytest.mark.parametrize(
    "change",
    [
        ("set", {"ids": [3], "velocity": (1.5, -2.0)}),
        ("kick", {"ids": [3, 4], "impulse": (0.5, 0.25)}),
        ("remove", {"ids": [7]}),
    ],
    ids=lambda change: change[0],
)
def test_changes_by_hand_reach_the_second_stage_at_the_same_time(two, change):
    t = two()
    t.run(6)
    name, values = change
    getattr(t.first, name)(**values)
    t.take()
    t.run(4)
    theirs = t.second.journal.changes
    assert [(each.frame, each.time, each.what) for each in theirs] == [(6, t.first.journal.changes[0].time, name)]
    with mpsim.Simulation(SCENE, mpsim.Settings(method="event", dt=0.01)) as alone:
        alone.run(frames=6)
        without = alone.digest()
        getattr(alone, name)(**values)
        alone.run(frames=4)
        assert alone.digest() == t.second.digest() != without
    assert t.distance() < 0.05
    t.take()
    assert len(t.second.journal) == 1, "a change was made twice"


def test_a_disc_that_is_added_is_on_both_stages(two):
    t = two()
    t.run(3)
    place = free_place(t.first, t.second)
    t.first.add(place, (0.0, 0.0))
    t.take()
    t.run(3)
    assert t.first.count == t.second.count == 51
    assert np.allclose(t.second.state.position[50], place)


def test_a_disc_without_room_on_the_second_stage_ends_the_pair(two):
    t = two()
    t.run(3)
    t.first.set(0, position=free_place(t.first, t.second))
    occupied = t.second.state.position[0]
    t.first.add(occupied, (0.0, 0.0))
    t.pair._taken = 1  # as if the second stage had not had the first change
    with pytest.raises(mpsim.InputError, match=r"there was no room for one that was added: .* Reset restarts both"):
        t.take()


@pytest.mark.slow
def test_a_wall_is_on_both_stages_and_ends_the_pair_where_a_disc_is_in_the_way(two):
    t = two()
    t.run(3)
    place = free_place(t.first, t.second)
    t.first.add_wall([place, place + np.array([0.1, 0.0])])
    t.take()
    t.run(20)
    assert t.first.scene.obstacles == t.second.scene.obstacles != ()
    assert t.distance() < 0.05
    t.first.remove(0)
    t.first.add_wall([t.second.state.position[0], t.second.state.position[0] + [0.1, 0.0]])
    t.pair._taken = 2  # as if the second stage had not had the removal
    with pytest.raises(mpsim.InputError, match=r"a wall must be clear of all discs; got disc 0 .* Reset restarts both"):
        t.take()


def test_what_the_second_stage_refuses_is_skipped_and_counted(two):
    t = two()
    t.run(3)
    t.first.set(0, position=t.second.state.position[1] + [0.2, 0.0])  # the exact solver refuses an overlap
    t.take()
    assert (t.pair.skipped, len(t.second.journal)) == (1, 0)
    t.run(2)


def test_settings_stay_with_the_first_stage_and_parameters_reach_both(two):
    t = two()
    t.first.change(passes=2, contact="push", restitution=1.0)
    t.take()
    assert [dict(each.values) for each in t.second.journal] == [{"restitution": 1.0}]


@pytest.mark.parametrize(
    ("beside", "frames"), [(EVENT, 1), (mpsim.Settings(method="grid", contact="push", dt=0.005), 4)]
)
def test_both_stay_in_step_when_dt_is_changed(two, beside, frames):
    t = two(beside)
    t.run(5)
    t.first.change(dt=0.02)
    t.take()
    before = t.second.frame
    t.run(5)
    assert (t.second.frame - before, t.second.settings.dt) == (5 * frames, 0.02 / frames)
    t.first.change(dt=0.013)
    t.take()
    t.run(3)
    assert t.first.time == pytest.approx(0.05 + 0.1 + 0.039)


def test_the_second_stage_goes_back_with_the_first(two):
    t = two()
    t.run(5)
    t.pair.mark(1)
    digest, told = t.second.digest(), t.pair.comparison.second.collisions
    t.first.kick(3, (2.0, 0.0))
    t.take()
    t.run(20)
    t.pair.mark(2)
    t.first.kick(4, (2.0, 0.0))
    t.take()
    t.run(5)
    assert t.second.digest() != digest
    t.pair.back(2)
    assert (t.second.frame, len(t.second.journal)) == (25, 1)
    t.pair.back(1)
    assert (t.second.digest(), t.second.frame, len(t.second.journal)) == (digest, 5, 0)
    assert t.pair.comparison.second.collisions == told
    with pytest.raises(mpsim.InputError, match="going back needs a remembered moment"):
        t.pair.back(3)


def test_moments_are_kept_as_the_first_stage_says_and_the_snapshot(two):
    t = two()
    for number in (SNAPSHOT, 1, 2, 3):
        t.pair.mark(number)
        t.run(1)
    t.pair.forget_all_but([1, 3])
    assert set(t.pair.bytes_of_moments) == {SNAPSHOT, 1, 3}
    with pytest.raises(mpsim.InputError, match="remembered moment"):
        t.pair.back(2)
    for number, frame in ((3, 3), (1, 1), (SNAPSHOT, 0), (SNAPSHOT, 0)):
        t.pair.back(number)
        assert t.second.frame == frame


def test_a_moment_that_cannot_be_kept_leaves_the_one_before(two, tmp_path, monkeypatch):
    t = two()
    t.pair.mark(SNAPSHOT)
    before = t.second.digest()
    t.run(2)

    def full(sim, path):
        path.write_bytes(b"half of it")
        raise mpsim.errors.OutputError("no space left")

    monkeypatch.setattr(mpsim.Simulation, "save", full)
    with pytest.raises(mpsim.errors.OutputError):
        t.pair.mark(SNAPSHOT)
    t.pair.back(SNAPSHOT)
    assert t.second.digest() == before


@pytest.mark.parametrize("dt", [0.02, 0.003, 0.0101])
def test_a_time_step_that_does_not_fit_is_refused(dt):
    with pytest.raises(mpsim.InputError, match=r"dt of a second stage must be that of the first one, 0.01"):
        in_step(mpsim.Settings(dt=dt), 0.01)


def free_place(*sims):
    """A place for a disc, clear of all others of some simulations."""
    rng, places = np.random.default_rng(1), np.concatenate([sim.state.position for sim in sims])
    while True:
        place = 0.5 + rng.random(2) * (SCENE.width - 1)
        if np.hypot(*(places - place).T).min() > 1.05:
            return place
