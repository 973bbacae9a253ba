"""What `event` cannot do exactly is refused by name, and a refusal changes nothing; how it stops and grows."""

import math
import warnings

import numpy as np
import pytest
from support.compare import assert_same_bits
from support.scenes import crowd, gas, lattice, simulate, state_after

import mpsim
from mpsim import InputError, Scene

SCENE = lattice(3, 3)


def with_acceleration():
    return Scene(width=9, height=9, position=[[2, 2], [6, 6]], velocity=np.zeros((2, 2)), radius=0.5,
                 acceleration=np.ones((2, 2)))  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scene", "settings", "words"),
    [
        (SCENE, {"law": "reflect"}, ["law='reflect'", "Leave it out", "method='grid'"]),
        (SCENE, {"precision": "float32"}, ["precision='float32'", "Leave it out", "method='grid'"]),
        (SCENE, {"unguarded": True}, ["unguarded=True", "Leave it out", "method='grid'"]),
        (with_acceleration(), {}, ["acceleration per disc", "Leave it out", "method='grid'"]),
        (crowd(9, 0.6), {}, ["do not overlap", "discs", "overlap by", "Move them apart", "method='grid'"]),
    ],
    ids=["reflect", "float32", "unguarded", "acceleration", "overlap"],
)
def test_a_scene_that_has_no_exact_solution_is_refused_by_name(scene, settings, words):
    with pytest.raises(InputError) as raised:
        simulate(scene, method="event", **settings)
    text = str(raised.value)
    assert "method='event'" in text
    for word in words:
        assert word in text, f"{word!r} is missing in {text!r}"
    # Negative control: the same scene without the setting, or with another solver, is taken.
    with simulate(scene, method="grid", **settings) as sim:
        sim.run(frames=1)


def test_a_velocity_beyond_what_can_be_squared_is_refused_with_its_disc():
    velocity = np.zeros((2, 2))
    velocity[1, 0] = 1e101
    scene = Scene(width=9, height=9, position=[[2, 2], [6, 6]], velocity=velocity, radius=0.5)
    with pytest.raises(InputError, match=r"velocity\[1\] must be below 1e100 .* got \[1e\+101, 0.0\]. Choose units"):
        simulate(scene, method="event", dt=1e-95)


def test_touching_discs_are_no_overlap():
    """A depth of rounding is taken, a depth that any measuring would find is not."""
    for gap, refused in ((0.0, False), (-1e-13, False), (-1e-9, True)):
        scene = Scene(width=9, height=9, position=[[2, 2], [3 + gap, 2]], velocity=[[1, 0], [0, 0]], radius=0.5)
        if refused:
            with pytest.raises(InputError, match="discs 0 and 1 overlap by 1e-09"):
                simulate(scene, method="event")
        else:
            with simulate(scene, method="event", dt=0.1) as sim:
                assert sim.run(frames=1).collisions == 1


def test_a_refused_disc_changes_nothing():
    """The scene is so dilute that one disc more would have other cells."""
    scene = Scene(width=40, height=40, position=[[2, 2], [30, 9.3]], velocity=[[1.3, 0.2], [-2, 1]], radius=0.5)
    many = 3 + 2 * np.stack(np.meshgrid(np.arange(9), np.arange(9)), axis=-1).reshape(-1, 2) + 5.0
    with simulate(scene, method="event", dt=1.7) as sim:
        sim.run(frames=20)
        many[-1] = sim.state.position[1] + [0.3, 0]
        with pytest.raises(InputError, match="do not overlap; discs 1 and 82"):
            sim.add(many, np.zeros((81, 2)))
        assert sim.count == 2
        found = sim.run(frames=300, measures=["pressure"]).measures["pressure"].value
        assert_same_bits(sim.state, state_after(scene, 320, method="event", dt=1.7), "after a refused growth")
    with simulate(scene, method="event", dt=1.7) as sim:
        sim.run(frames=20)
        assert found == pytest.approx(sim.run(frames=300, measures=["pressure"]).measures["pressure"].value, rel=1e-12)


def test_a_disc_added_inside_a_frame_keeps_the_counts_of_that_frame():
    """Two discs that never meet: what both walls got in the frame is known from their speeds."""

    def stop(done, of):
        raise KeyboardInterrupt

    scene = Scene(width=5, height=5000, position=[[2, 2]], velocity=[[1, 0]], radius=0.5)
    with simulate(scene, method="event", dt=1e5) as sim:
        with pytest.raises(KeyboardInterrupt):
            sim.run(frames=1, progress=stop)
        reached = sim.time
        assert 100 < reached < 9e4
        sim.add([2, 20], [0, 0])
        pressure = sim.run(frames=1, measures=["pressure"]).measures["pressure"].value
    assert pressure * 2 * (5 + 5000) == pytest.approx(2 / 4, rel=1e-3), "one disc to and fro in a free length of 4"


@pytest.mark.slow
@pytest.mark.parametrize("pull", [1.0, 2.0**20])
def test_the_guard_of_a_disc_at_rest_scales_with_the_units(pull):
    """A ball dropped at rest: time in units 2^10 times smaller gives the same bits, guard included."""
    scene = Scene(width=9, height=9, position=[[4, 1.5]], velocity=[[0, 0]], radius=0.5, gravity=(0, -pull),
                  wall_restitution=0.5)  # fmt: skip
    with simulate(scene, method="event", dt=4.5 / math.sqrt(pull)) as sim:
        with pytest.warns(mpsim.errors.GuardWarning):
            report = sim.run(frames=1)
        height = sim.state.position[0, 1]
    unit = Scene(width=9, height=9, position=[[4, 1.5]], velocity=[[0, 0]], radius=0.5, gravity=(0, -1),
                 wall_restitution=0.5)  # fmt: skip
    with simulate(unit, method="event", dt=4.5) as sim:
        with pytest.warns(mpsim.errors.GuardWarning):
            expected = sim.run(frames=1)
        assert (report.guarded, height) == (expected.guarded, sim.state.position[0, 1])
    assert expected.guarded > 1000


@pytest.mark.parametrize(
    ("features", "settings", "word"),
    [
        ({}, {"law": "reflect"}, "reflect"),
        ({}, {"precision": "float32"}, "float32"),
        ({"acceleration": np.ones((10, 2))}, {}, "acceleration per disc"),
    ],
)
def test_what_cannot_be_exact_is_refused_by_name(features, settings, word):
    with pytest.raises(mpsim.InputError, match=word):
        simulate(
            gas(10, 0.2) if not features else mpsim.Scene.random(count=10, packing=0.2, radius=0.5, **features),
            method="event",
            **settings,
        )


def test_an_overlapping_start_of_the_exact_solver_names_the_worst_pair():
    position = [[1, 1], [1.9, 1], [5, 5], [5.5, 5]]
    scene = mpsim.Scene(width=8, height=8, position=position, velocity=np.zeros((4, 2)), radius=0.5)
    with pytest.raises(mpsim.InputError, match=r"discs 2 and 3 overlap by 0\.5"):
        simulate(scene, method="event")


def test_stopping_and_growing_the_exact_solver():
    scene = gas(50, 0.2)
    with simulate(scene, method="event") as whole, simulate(scene, method="event") as cut:
        whole.run(frames=300)
        for frames in (1, 2, 97, 200):
            cut.run(frames=frames)
        assert_same_bits(cut.state, whole.state, "cut into four runs")
        assert cut.time == whole.time == pytest.approx(3)
        before = cut.state.position[0]
        with pytest.raises(mpsim.InputError, match="overlap"):
            cut.add(before, [0, 0])
        assert cut.count == 50
        cut.run(frames=10)
        cut_again = cut.digest()
        whole.run(frames=10)
        assert whole.digest() == cut_again


@pytest.mark.slow
def test_a_loss_of_energy_that_would_never_end_is_guarded_and_said():
    position = [[0.5 + k, 0.5] for k in range(3)]
    position[0][0], position[2][0] = 0.5, 5.0
    position[1][0] = 2.5
    scene = mpsim.Scene(
        width=6, height=1.5, position=position, velocity=[[1, 0], [0, 0], [-1, 0]], radius=0.5, restitution=0.02
    )
    with simulate(scene, method="event", dt=1.0) as sim, pytest.warns(mpsim.errors.GuardWarning, match="guard"):
        report = sim.run(frames=20)
    assert report.guarded > 0


@pytest.mark.slow
def test_a_scene_at_rest_is_said_while_it_runs():
    """From the fifth on its frames take millions of bounces each; 10,000 would take ten minutes."""
    scene = mpsim.Scene(
        width=4, height=8, position=[[2, 3]], velocity=[[0, 0]], radius=0.5, gravity=(0, -1), wall_restitution=0.3
    )
    with simulate(scene, method="event", dt=1.0) as sim, warnings.catch_warnings():
        warnings.simplefilter("error", mpsim.errors.GuardWarning)
        sim.run(frames=2)  # it still bounces
        with pytest.raises(mpsim.errors.GuardWarning, match="come to rest"):
            sim.run(frames=10_000)
        assert sim.frame < 20


# --- the contact time of the guard


def dropped(**settings):
    """A ball dropped on the floor, until it is at rest."""
    scene = Scene(width=9, height=9, position=[[4, 1.5]], velocity=[[0, 0]], radius=0.5, gravity=(0, -1.0),
                  wall_restitution=0.5)  # fmt: skip
    with simulate(scene, method="event", dt=4.5, **settings) as sim, pytest.warns(mpsim.errors.GuardWarning):
        return sim.run(frames=1), sim.state.position[0, 1]


def test_a_disc_at_rest_hovers_in_bounces_of_the_contact_time_that_is_given():
    """It comes to rest after sqrt(2) (1 + 2 e / (1 - e)) = 4.243, and bounces for the rest of 4.5."""
    usual, _ = dropped()
    assert usual.contact_time == pytest.approx(1e-6 * 0.5 / math.sqrt(0.5), rel=1e-12)
    for contact_time in (1e-3, 1e-2):
        report, height = dropped(contact_time=contact_time)
        assert report.contact_time == contact_time
        bounces = (4.5 - 3 * math.sqrt(2)) / contact_time
        assert 0.8 * bounces < report.guarded < 2.2 * bounces + 3  # in each, once or twice
        assert 0.5 <= height <= 0.5 + contact_time**2 / 8 * (1 + 1e-9)
        assert report.guarded < usual.guarded / 100


@pytest.mark.slow
def test_the_guard_is_warned_of_once_in_a_simulation():
    scene = Scene(width=4, height=6, position=[[2, 0.5]], velocity=[[0, 0]], radius=0.5, gravity=(0, -1.0))
    with simulate(scene, method="event", dt=0.1, contact_time=0.01) as sim:
        with pytest.warns(mpsim.errors.GuardWarning, match="This is said once; report.guarded counts"):
            first = sim.run(frames=1)
        assert first.guarded > 1 < sim.run(frames=1).guarded, "and the second time there is no warning"


def test_a_contact_time_of_its_usual_length_changes_no_bit():
    usual, height = dropped()
    again, same = dropped(contact_time=usual.contact_time)
    assert (again.guarded, same) == (usual.guarded, height)


@pytest.mark.parametrize("value", [0, -1.0, math.inf, math.nan])
def test_a_contact_time_must_be_a_time(value):
    with pytest.raises(InputError, match=r"contact_time must be a finite number > 0 \[time\]; got"):
        mpsim.Settings(contact_time=value)


LONGEST = 2.0
"""Contact time in which gravity of 1 throws a disc of radius 0.5 as high as its radius."""


def resting(gravity=(0.0, -1.0)):
    return mpsim.Scene(width=4, height=6, position=[[2, 0.5]], velocity=[[0, 0]], radius=0.5, gravity=gravity)


@pytest.mark.slow
def test_a_contact_time_that_throws_discs_at_rest_higher_than_their_radius_is_refused():
    with simulate(resting(), method="event", dt=1.0, contact_time=LONGEST) as sim:
        with pytest.warns(mpsim.errors.GuardWarning):
            sim.run(frames=1)
        assert sim.state.position[0, 1] == pytest.approx(1.0, abs=0.01), "the control: thrown by its radius"
    message = (
        r"contact_time must be at most 2 in this scene: with a longer one, discs that should rest under gravity of 1 "
        r"bounce higher than their radius, 0\.5; got 2\.01\. Give a shorter one, such as 0\.01\."
    )
    with pytest.raises(InputError, match=message):
        simulate(resting(), method="event", contact_time=2.01)
    with (
        simulate(resting(gravity=(0.0, 0.0)), method="event", contact_time=2.01) as sim,
        pytest.raises(InputError, match=r"contact_time must be at most 1\.41 in this scene"),
    ):
        sim.change(gravity=(0.0, -2.0))


def test_an_elastic_gas_has_no_contact_time():
    with simulate(SCENE, method="event", contact_time=0.1) as sim:
        assert sim.run(frames=1).contact_time == 0.0
        digest = sim.digest()
    with simulate(SCENE, method="event") as sim:
        sim.run(frames=1)
        assert sim.digest() == digest


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:discs seem to have come to rest")  # which a slow machine says before
@pytest.mark.parametrize("restitution", [0.0, 0.5])
def test_a_collapse_without_end_at_one_instant_names_what_ends_it(restitution):
    """A disc runs into a gap between a wall and the end of an obstacle which is just as wide as itself."""

    def gap(room):
        end = mpsim.Polyline([[1 + room, 12], [7, 10.1]], thickness=0.0)
        return Scene(width=15, height=14, position=[[0.6, 9]], velocity=[[-0.1, 1]], radius=0.5, obstacles=end,
                     wall_restitution=restitution)  # fmt: skip

    sticky = "" if restitution else ", a restitution above 0"
    text = (
        r"disc 0 collided without end at one instant of frame \d\. .* contact time of the guard is 4.98e-07\. Give "
        rf"a longer one, such as contact_time=0.01{sticky} or the discs more room, or use method='grid'"
    )
    with simulate(gap(0.0), method="event", dt=1.0) as sim, pytest.raises(mpsim.errors.StalledError, match=text):
        sim.run(frames=20)
    with simulate(gap(0.01), method="event", dt=1.0) as sim:  # the control: more room
        assert sim.run(frames=20).frames == 20
        assert sim.state.position[0, 1] > 12


@pytest.mark.slow
def test_a_jammed_crystal_without_losses_is_told_to_make_room_and_nothing_else():
    """No contact time and no restitution helps it: no collision takes energy."""
    place, velocity = (
        np.array([[0.5, 0.5], [0.5, 1.5], [1.5, 0.5], [1.5, 1.5]]),
        np.array([[1, 2], [-2, 1], [0, 1], [1, 0]]),
    )

    def crystal(room):
        return Scene(width=2 + room, height=2 + room, position=place, velocity=velocity, radius=0.5)

    text = r"no collision takes energy\. Give the discs more room \(a larger box or a smaller radius\), or use method="
    with (
        simulate(crystal(0.0), method="event", dt=0.1) as sim,
        pytest.raises(mpsim.errors.StalledError, match=text) as caught,
    ):
        sim.run(frames=2)
    assert "contact" not in str(caught.value)
    assert "restitution" not in str(caught.value)
    for method, room in (("event", 0.01), ("grid", 0.0)):  # what it advises helps
        with simulate(crystal(room), method=method, dt=0.1) as sim:
            assert sim.run(frames=2).frames == 2


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::mpsim.errors.GuardWarning")
def test_a_heap_without_any_restitution_is_a_model_with_a_contact_time():
    """As before: whatever the contact time, its discs collided without end at one instant."""
    scene = Scene.random(count=30, packing=0.5, radius=0.5, seed=1, restitution=0, wall_restitution=0, gravity=(0, -1))
    left = []
    for contact_time in (0.1, 0.02, 0.006):
        with simulate(scene, method="event", dt=1.0, contact_time=contact_time) as sim:
            report = sim.run(frames=30)
            left.append(mpsim.measure.kinetic_energy(sim.state, scene) / 30)  # which is the energy of the start
        assert (report.contact_time, report.guarded > 1000) == (contact_time, True)
    assert 0.1 > left[0] > 10 * left[1] > 100 * left[2] > 0, "the shorter, the more it is at rest"


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::mpsim.errors.GuardWarning")
@pytest.mark.parametrize(
    "losses",
    [
        pytest.param({"restitution": 0.0}, marks=pytest.mark.long, id="of discs"),
        pytest.param({"wall_restitution": 0.0}, id="of a surface"),
    ],
)
def test_what_meets_without_any_restitution_parts_by_a_rounding(losses):
    """As before: rounding left such discs approaching, and an impact was too small to change that: a stall."""
    slanted = mpsim.Polyline([[2, 3], [6, 7.3], [9, 6]], thickness=0.3)
    scene = Scene.random(
        count=40, width=15, height=14, radius=0.5, temperature=1.0, seed=1, obstacles=slanted, **losses
    )
    with simulate(scene, method="event", dt=1.0) as sim:
        report = sim.run(frames=20)
        energy = mpsim.measure.kinetic_energy(sim.state, scene)
    assert report.collisions > 100
    assert 0.01 < energy / mpsim.measure.kinetic_energy(mpsim.State(scene.position, scene.velocity), scene) < 0.5


def test_a_contact_time_is_kept_in_a_checkpoint(tmp_path):
    scene = gas(20, 0.3)
    with simulate(scene, method="event", contact_time=0.125) as sim:
        sim.save(tmp_path / "run")
    with mpsim.Simulation.resume(tmp_path / "run") as sim:
        assert sim.settings.contact_time == 0.125
