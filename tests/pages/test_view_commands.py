"""What pages ask of a run: speed, reset, counts, a second stage, other random numbers; and the colours of a program."""

import time

import numpy as np
import pytest
from support.scenes import gas, scene_of, simulate
from support.visitor import FASTEST, KNEE, Visitor, digest_alone, kept, paused, viewed

import mpsim
from mpsim import measure

pytestmark = pytest.mark.plain

SCENE = gas(20, 0.4)
GRID = mpsim.Settings(method="grid", contact="push", dt=0.01)
EVENT = mpsim.Settings(method="event")
EXACT = mpsim.Settings(method="event", dt=0.01)


# --- one stage


def test_played_at_any_speed_a_run_has_the_bits_of_one_alone():
    with paused(SCENE, GRID) as page:
        page.say("play")
        for speed in (None, 3.0, 0.5):
            page.say("speed", value=speed)
            before = page.frame
            page.hear_until(lambda v, before=before: v.frame > before + 5)
        page.say("pause")
        page.hear_until(lambda v: v.phase == "paused")
        session = kept(page.view.address)
        assert session.frame > 20
        assert session.digest == digest_alone(SCENE, GRID, session.frame)
        page.say("reset")
        page.hear_until(lambda v: v.frame == 0)
        page.step_to(10)
        assert kept(page.view.address).digest == digest_alone(SCENE, GRID, 10)


def test_a_scene_with_a_time_between_pictures_begins_at_the_speed_that_shows_25_a_second():
    with paused(mpsim.Scene.load("gas")) as page, paused(SCENE, GRID) as other:
        assert (page.last["status"]["speed"], other.last["status"]["speed"]) == (5.0, 1.0)


def test_frames_do_not_come_faster_than_was_asked_for_nor_are_missed_ones_made_up_for():
    with paused(SCENE, GRID) as page:
        page.say("speed", value=0.05)  # 3 frames a second
        page.say("play")
        page.hear_until(lambda v: v.phase == "playing" and v.frame > 0)
        frame, begun = page.frame, time.monotonic()
        page.hear_for(1.2)
        page.hear_until(lambda v: v.frame > frame + 1)
        assert page.frame - frame <= 3 * (time.monotonic() - begun) + 2


def test_pages_are_told_the_dt_in_force():
    with paused(SCENE, GRID) as page:
        for name, values, dt in (("change", {"name": "dt", "value": 0.02, "same": False}, 0.02), ("undo", {}, 0.01)):
            page.say(name, **values)
            page.hear_until(lambda v, dt=dt: v.last["scene"]["dt"] == v.last["hands"]["dt"] == dt)


def test_gauges_are_the_numbers_of_the_library():
    with mpsim.Simulation(SCENE, GRID) as alone, paused(SCENE, GRID) as page:
        report = alone.run(frames=30)
        page.step_to(30)
        gauges, state = page.gauges_at(30), alone.state
    energy, start = measure.kinetic_energy(state, SCENE), mpsim.State(SCENE.position, SCENE.velocity)
    before = measure.kinetic_energy(start, SCENE)
    for name, value in {
        "time": alone.time, "discs": 20, "temperature": measure.temperature(state, SCENE), "energy": energy,
        "energy_drift": (energy - before) / max(energy, before), "collisions": report.collisions,
        "with_walls": False, "counting": False, "pressure": None, "energy_note": None,
    }.items():  # fmt: skip
        assert gauges[name] == value, name
    assert report.collisions > 3
    speeds = measure.speed_distribution(state, len(gauges["speeds"]["density"]))
    for name, expected in {"edges": speeds.edges, "density": speeds.value, "maxwell": speeds.maxwell}.items():
        assert gauges["speeds"][name] == expected.tolist()


def test_the_frame_rate_is_known_while_it_runs():
    with viewed(SCENE, GRID) as view, Visitor(view.address, visible=True) as page:
        page.hear_until(lambda v: v.last.get("gauges", {}).get("frames_per_second") and v.last["gauges"]["frame"] > 60)
        assert 0 < page.last["gauges"]["frames_per_second"] < 200


REASONS = {
    "gravity": ({"gravity": (0, -1)}, {}, None, None),
    "losses": ({"restitution": 0.9}, {}, "contacts take energy", "contacts take energy"),
    "rough discs": ({"friction": 0.3}, {}, "contacts take energy", "contacts take energy"),
    "heated grains": (
        {"restitution": 0.9, "thermostat": mpsim.Thermostat(temperature=1, rate=1)}, {},
        "a thermostat heats or cools", "contacts take energy",
    ),
    "a piston": ({"piston": mpsim.Piston("right", -0.1, 8.0)}, {}, "a wall moves", None),
    "an exit": ({"absorbing": "right"}, {}, "discs leave", None),
    "warm walls": ({"thermal_walls": mpsim.ThermalWalls(left=1, right=1)}, {}, "a thermostat heats or cools", None),
    "a heat flow": (
        {"thermal_walls": mpsim.ThermalWalls(left=1, right=2)}, {}, "a thermostat heats or cools",
        "the walls differ in temperature",
    ),
    "an endless fall": ({"gravity": (0, -1), "boundary": "periodic"}, {}, *2 * ["discs fall through a periodic edge"]),
    "the report's law": ({}, {"law": "reflect", "contact": "push"}, None, "law reflect keeps the speed of each disc"),
    "two masses": ({"mass": tuple([1.0] * 10 + [2.0] * 10)}, {}, None, "the discs differ in mass"),
    "few discs": ({"count": 19}, {}, None, "fewer than 20 discs"),
}  # fmt: skip


@pytest.mark.parametrize("words", REASONS)
def test_it_says_why_energy_changes_and_where_no_maxwell_curve_is_expected(words):
    features, settings, energy, maxwell = REASONS[words]
    scene = gas(**{"count": 20, "packing": 0.2, **features})
    with paused(scene, mpsim.Settings(**{"method": "grid"} | settings)) as page:
        gauges = page.gauges_at(0)
        assert gauges["energy_note"] == energy
        assert gauges["speeds"]["note"] == (maxwell and f"no Maxwell curve: {maxwell}")
        assert (gauges["speeds"]["maxwell"] is None) is (maxwell is not None)


def test_pressure_and_overlap_are_counted_when_they_are_asked_for_and_change_no_bit():
    with mpsim.Simulation(SCENE, GRID) as alone, paused(SCENE, GRID) as page:
        expected = alone.run(frames=30, measures=["pressure", "largest_overlap"]).measures
        page.say("count", value=True)
        page.step_to(30)
        gauges = page.gauges_at(30)
        assert gauges["pressure"] == pytest.approx(expected["pressure"].value, rel=1e-9)
        assert gauges["largest_overlap"] == expected["largest_overlap"].value > 0
        assert kept(page.view.address).digest == alone.digest()
        page.say("count", value=False)
        page.step_to(31)
        assert page.gauges_at(31)["pressure"] is None


def test_there_is_no_pressure_before_frames_and_a_collision_are_counted_nor_under_losses():
    rest = mpsim.Scene(width=9, height=9, position=[[4, 4]], velocity=[[1, 0]], radius=0.5)
    with paused(rest, GRID) as page:
        page.say("count", value=True)
        page.step_to(40)
        assert (page.gauges_at(40)["pressure"], page.last["gauges"]["collisions"]) == (None, 0)
    with paused(gas(20, 0.4, restitution=0.9, boundary="periodic"), GRID) as page:
        page.say("count", value=True)
        page.step_to(20)
        page.hear_until(lambda v: "losses" in (v.last["gauges"]["pressure_note"] or ""))
        assert page.last["gauges"]["pressure"] is None


FEW = mpsim.Scene(width=4, height=3, position=[[1, 1], [3, 1], [2, 2]], velocity=[[5, 1], [-4, 2], [1, -6]], radius=0.4)


def counted(frames):
    """Collisions by the library, with walls too."""
    log = mpsim.Collisions()
    with mpsim.Simulation(FEW, GRID) as sim:
        sim.run(frames=frames, observe=log)
    return len(log.table)


def test_collisions_are_those_since_the_start_and_go_back_with_the_run():
    with paused(FEW, GRID) as page:
        numbers = {}
        for frame in (7, 20, 40):
            page.step_to(frame)
            numbers[frame] = page.gauges_at(frame)["collisions"]
            assert numbers[frame] == counted(frame) > 0
        assert page.last["gauges"]["with_walls"] is True
        assert len(set(numbers.values())) == 3
        page.do("change", name="restitution", value=0.5, same=False)
        page.step_to(60)
        assert page.gauges_at(60)["collisions"] > numbers[40]
        page.do("undo")
        assert page.gauges_at(40)["collisions"] == numbers[40]
        page.step_to(60)
        assert page.gauges_at(60)["collisions"] == counted(60), "it goes on from there"
        page.say("reset")
        assert page.gauges_at(0)["collisions"] == 0


# --- colours


def test_own_values_are_on_a_scale_by_percentiles_and_are_read_again_for_each_picture():
    values = np.random.default_rng(1).normal(size=200)
    values[:2] = -1e6, 1e6
    with mpsim.Simulation(gas(200, 0.2), GRID) as sim, paused(sim, colour=values) as page:
        page.step_to(1)
        expected = np.interp(values, np.percentile(values, (0, 2, 98, 100)), (0, FASTEST - KNEE, KNEE, FASTEST))
        assert np.abs(page.picture.colour - expected).max() <= 1
        assert np.ptp(page.picture.colour[2:].astype(int)) > 150, "two values of a million darken no others"
        assert page.last["colours"]["values"] == np.percentile(values, (0, 2, 98, 100)).tolist()
        values[:] = np.nan  # by the program, in place
        values[:3] = 1.0, 2.0, 3.0
        page.step_to(2)
        assert page.picture.colour[:4].tolist() == [0, 127, FASTEST, 127]
        values[:] = 7.0
        page.step_to(3)
        assert set(page.picture.colour.tolist()) == {127}


# --- a simulation of a program


def test_a_simulation_of_the_program_is_shown_and_stays_its_own():
    with mpsim.Simulation(SCENE, mpsim.Settings(method="naive")) as sim:
        sim.run(frames=5)
        with paused(sim) as page:
            assert (page.frame, page.last["scene"]["can_reset"]) == (5, False)
            sim.run(frames=7)
            page.hear_until(lambda v: v.frame == 12)
            assert page.gauges_at(12)["collisions"] is None, "not known of what ran before"
            for name, values in (("reset", {}), ("seed", {"value": 1}), ("beside", {"settings": None})):
                assert page.refused(name, **values).startswith(f"{name} needs a scene to start from")
            for name, values in (("seek", {"index": 3}), ("follow", {"value": True})):
                assert f"a simulation cannot {name}" in page.refused(name, **values)
            page.do("remove", id=5, same=False)
            assert not sim.state.present[5]
            assert "belongs to a program" in page.do("undo")["note"]
            assert not sim.state.present[5]
            sim.close()
            page.hear_until(lambda v: v.phase == "over")
            assert "was closed" in page.last["status"]["note"]
            page.say("play")
            assert not page.view.wait(0)


def test_a_run_that_fails_pauses_with_the_reason_and_can_be_reset():
    scene = scene_of([[2, 2], [3, 2]], [[6, 0], [0, 0]], 9, 4, radius=[0.5, 0.05], mass=[1.0, 1.0])
    with paused(scene, mpsim.Settings(method="grid", on_fast="error")) as page:
        page.say("play")
        page.hear_until(lambda v: v.phase == "paused" and v.last["status"]["note"])
        assert "disc 1 moves" in page.last["status"]["note"]
        page.hear_until(lambda v: v.last["gauges"]["frame"] > 0 and v.last["gauges"]["collisions"] is None)
        page.say("reset")
        page.hear_until(lambda v: v.frame == 0 and v.last["status"]["note"] is None)
        assert not page.view.wait(0)


# --- two stages


def test_two_stages_are_at_one_time_and_their_numbers_are_those_of_both():
    coarse = mpsim.Settings(method="grid", contact="push", dt=0.04)
    fine = mpsim.Settings(method="event", dt=0.04)
    with simulate(SCENE, **vars(coarse)) as one, mpsim.Simulation(SCENE, fine) as other:
        reports = one.run(frames=20), other.run(frames=20)
        expected = measure.trajectory_error(one.state, other.state, SCENE)
        digest, place = one.digest(), other.state.position
    with paused(SCENE, coarse, beside=EVENT) as page:
        page.step_to(20)
        page.hear_until(lambda v: v.last["pair"].get("time") == pytest.approx(0.8))
        pair = page.last["pair"]
        assert (pair["first"], pair["second"], pair["exact"]) == ("grid push dt=0.04", "event", True)
        assert pair["distance"] == pytest.approx(expected.rms, rel=1e-9)
        counts = [each.collisions for each in reports]
        assert (pair["collisions"], pair["missed"]) == (counts, counts[1] - counts[0])
        assert pair["missed_fraction"] == pytest.approx((counts[1] - counts[0]) / counts[1])
        assert pair["cost_ratio"] > 0
        assert kept(page.view.address).digest == digest, "the second stage changes no bit of the first"
        assert np.abs(page.stages[1].position - place).max() < 1e-3


@pytest.mark.slow
def test_equal_stages_differ_by_nothing_and_others_part_for_good():
    with paused(SCENE, GRID, beside=GRID) as page:
        page.step_to(20)
        page.hear_until(lambda v: v.last["pair"].get("time") == pytest.approx(0.2))
        pair = page.last["pair"]
        assert pair["collisions"][0] == pair["collisions"][1] > 0
        assert (pair["missed"], pair["distance"], pair["pressure_difference"]) == (0, 0.0, 0.0)
    crude = mpsim.Settings(method="grid", contact="push", dt=0.08)
    with paused(gas(12, 0.6), crude, beside=EVENT) as page:
        page.say("speed", value=None)
        page.say("play")
        page.hear_until(lambda v: v.last.get("pair", {}).get("parted"))
        pair = page.last["pair"]
        assert 0 < pair["parted"] <= pair["time"]
        assert (pair["distance"], pair["missed"]) == (None, None), "which mean nothing any more"
        assert pair["missed_fraction"] is not None


def test_a_page_has_a_second_stage_begin_and_end_and_one_that_does_not_fit_is_told():
    with paused(SCENE, GRID) as page:
        page.step_to(5)
        assert page.last["pair"]["second"] is None
        page.say("beside", settings="frames=2")
        page.hear_until(lambda v: v.last["pair"]["second"] == "grid push dt=0.005" and v.frame == 0)
        page.step_to(3)
        assert page.stages[1].frame == 6
        page.say("beside", settings=None)
        page.hear_until(lambda v: v.last["pair"]["second"] is None)
    with paused(SCENE, GRID, beside=mpsim.Settings(dt=0.003)) as page:
        assert page.last["pair"]["note"].startswith("dt of a second stage must be that of the first one, 0.01, or a ")
        page.step_to(2)


def test_changes_by_hand_and_undo_reach_both_stages():
    with paused(SCENE, GRID, beside=mpsim.Settings(method="grid", contact="push", dt=0.005)) as page:
        page.step_to(3)
        page.do("remove", id=7, same=False)
        page.do("change", name="restitution", value=0.5, same=False)
        page.do("change", name="passes", value=2, same=False)  # stays with the first one
        page.step_to(6)
        with simulate(SCENE, method="grid", dt=0.005) as second:
            second.run(frames=6)
            without = second.state.position
            second.remove(7)
            second.change(restitution=0.5)
            second.run(frames=6)
            assert np.abs(page.stages[1].position - second.state.position)[np.arange(20) != 7].max() < 1e-3
        assert page.stages[1].colour[7] == 255
        assert (page.last["pair"]["first"], page.last["pair"]["second"]) == (
            "grid push x2 dt=0.01",
            "grid push dt=0.005",
        )
        page.do("change", name="dt", value=0.02, same=False)
        page.step_to(8)
        assert page.stages[1].frame == 12 + 2 * 4, "both stay in step"
        for _ in range(4):
            page.do("undo")
        page.hear_until(lambda v: v.frame == 3 and v.stages[1].frame == 6)
        assert np.abs(page.stages[1].position - without).max() < 1e-3


def test_what_the_second_stage_has_no_room_for_is_skipped():
    scene = mpsim.Scene(width=9, height=9, position=[[2, 2], [6, 6]], velocity=[[1, 0], [0, 0]], radius=0.5)
    with paused(scene, GRID, beside=EVENT) as page:
        page.do("hold", id=0, x=5.5, y=6.0)
        page.do("release", id=0, vx=0.0, vy=0.0)
        page.step_to(1)
        page.hear_until(lambda v: v.last["pair"]["skipped"] > 0)


def test_other_random_numbers_and_back_to_the_scene():
    with paused(SCENE, GRID) as page:
        for seed, scene in ((5, SCENE.redrawn(5)), (0, SCENE)):
            page.say("seed", value=seed)
            page.hear_until(lambda v, seed=seed: v.last["scene"]["seed"] == seed)
            with mpsim.Simulation(scene, GRID) as again:
                assert kept(page.view.address).digest == again.digest()
    bare = mpsim.Scene(width=9, height=9, position=[[2, 2]], velocity=[[1, 0]], radius=0.5)
    with paused(bare, GRID) as page:
        assert not page.last["scene"]["can_redraw"]
