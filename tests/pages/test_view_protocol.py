"""Frames and messages between a view and its pages: where each byte is, what each message holds, what is refused."""

import json
import random
import struct

import numpy as np
import pytest
from support.scenes import gas, scene_of
from support.visitor import ABSORBED, FASTEST, HEADER, KNEE, STEPS, Visitor, paused, viewed
from websockets.exceptions import ConnectionClosed

import mpsim

pytestmark = pytest.mark.plain

GRID = mpsim.Settings(method="grid")
EVENT = mpsim.Settings(method="event")
GAS = gas(20, 0.2)


def test_bytes_of_a_picture_are_where_the_format_says():
    scene = scene_of([[1.0, 0.5], [3.5, 1.5]], [[0.0, 2.0], [9.0, 0.0]], 4, 2, radius=[0.5, 0.25])
    with paused(scene, GRID) as page:
        radii, picture = page.raw[:2]
    usual = float(np.quantile([2.0, 9.0], 0.98))
    fastest = FASTEST / KNEE * usual  # the scale is as steep above the 98th percentile as below it, at least
    numbers = struct.pack("<9d", 0.0, 0.0, 4.0, 0.0, 2.0, 4.0, 2.0, usual, fastest)
    places = struct.pack("<4H", 16384, 16384, 57343, 49151)
    colours = bytes([round(KNEE * 2 / usual), round(KNEE + (FASTEST - KNEE) * (9 - usual) / (fastest - usual))])
    assert picture == b"MPSV" + bytes([1, 1, 0, 0]) + struct.pack("<IIQ", 1, 2, 0) + numbers + places + colours
    assert radii[:24] == b"MPSV" + bytes([1, 2, 0, 0]) + struct.pack("<IIQ", 0, 2, 0)
    assert radii[HEADER.size :] == struct.pack("<2f", 0.5, 0.25)


def test_pictures_of_a_run_show_its_state():
    piston = mpsim.Piston("right", -1.0, 6.0)
    scene = mpsim.Scene(
        width=9, height=4, radius=0.25, position=[[x, y] for x in (0.5, 2.5, 4.5) for y in (0.5, 1.5, 3.5)],
        velocity=np.linspace(-2, 2, 18).reshape(9, 2), piston=piston, absorbing="left",
    )  # fmt: skip
    with mpsim.Simulation(scene, GRID) as sim, paused(sim) as page:
        assert page.radii[0].tolist() == [0.25], "one for all that are equal"
        sim.run(frames=100)
        page.hear_until(lambda v: v.frame == 100)
        picture, state = page.picture, sim.state
        page.say("step", frames=3)
        page.hear_until(lambda v: v.frame == 103)
        assert (page.picture.time, page.last["gauges"]["type"]) == (sim.time, "gauges")
    here = state.present
    assert 0 < here.sum() < 9, "some have left"
    assert (picture.walls, picture.extent, picture.time) == (state.box, (9.0, 4.0), 1.0)
    assert np.abs(picture.position - state.position)[here].max() <= 0.5001 * 9 / STEPS, "rounded"
    assert (picture.colour == ABSORBED).tolist() == (~here).tolist()
    expected = np.interp(np.hypot(*state.velocity.T), [0, *picture.scale], [0, KNEE, FASTEST])
    assert np.abs(picture.colour - expected)[here].max() <= 0.51
    assert np.ptp(expected[here]) > 50, "the control"


def test_discs_across_a_periodic_border_are_shown_a_period_away():
    scene = scene_of([[0.1, 3.0], [2.0, 5.9]], [[-2, 0], [0, 2]], 4, 6, radius=0.25, boundary="periodic")
    with mpsim.Simulation(scene, GRID) as sim, paused(sim) as page:
        sim.run(frames=20)
        page.hear_until(lambda v: v.frame == 20)
        assert page.last["scene"]["periodic"] == [True, True]
        assert np.abs(page.picture.position - [[3.7, 3.0], [2.0, 0.3]]).max() < 1e-3


def test_radii_are_sent_again_where_discs_change():
    scene = mpsim.Scene(width=9, height=9, position=[[2, 2], [2, 6]], velocity=np.zeros((2, 2)), radius=[0.5, 0.75])
    with mpsim.Simulation(scene, GRID) as sim, paused(sim) as page:
        sim.add((6, 6), (0, 0), radius=0.25)
        page.hear_until(lambda v: len(v.picture.colour) == 3)
        assert page.radii[0].tolist() == [0.5, 0.75, 0.25]
        sent = len(page.raw)
        page.say("step", frames=2)
        page.hear_until(lambda v: v.frame == 2)
        assert {message[5] for message in page.raw[sent:]} == {1}, "the same radii are not sent again"


def test_both_stages_of_a_picture_come_together():
    with paused(GAS, GRID, beside=EVENT) as page:
        page.step_to(7)
        first, second = page.stages
        assert (first.stage, second.stage) == (0, 1)
        assert first[1:6] == second[1:6], "serial, frame, time, walls, extent"
        assert page.radii[1].tolist() == [0.5]
        _, *stages = [message[6] for message in page.raw if message[5] == 1]
        assert stages == [1, 0] * (len(stages) // 2), "after the start the first one, which is acknowledged, comes last"


MESSAGES = {
    "scene": "version name width height periodic theme method dt can_reset can_redraw seed",
    "obstacles": "capsules numbers filled colours",
    "status": "phase speed note",
    "gauges": "frame time discs temperature energy energy_drift energy_note speeds counting pressure pressure_error "
    "largest_overlap pressure_note collisions with_walls frames_per_second",
    "hands": "held undo note notes dt parameters",
    "link": "text",
    "colours": "values",
    "pair": "first second exact note skipped lyapunov_time agree_until time distance parted collisions "
    "missed missed_fraction pressure pressure_difference difference_error cost_ratio",
}


def test_each_message_has_its_fields():
    with paused(GAS, GRID, beside=EVENT, name="a gas") as page:
        page.step_to(3)
        page.hear_until(lambda v: {*MESSAGES} <= v.last.keys() and "distance" in v.last["pair"])
        for kind, fields in MESSAGES.items():
            assert set(page.last[kind]) == {"type", *fields.split()}, kind
        assert page.last["scene"] == {
            "type": "scene", "version": 1, "name": "a gas", "width": GAS.width, "height": GAS.height,
            "periodic": [False, False], "method": "grid", "dt": 0.01, "can_reset": True, "can_redraw": True, "seed": 0,
            "theme": {"ground": "#ffffff", "behind": "#9aa3ad"},
        }  # fmt: skip
        assert page.last["obstacles"] == {"type": "obstacles"} | {key: [] for key in MESSAGES["obstacles"].split()}
        assert page.last["status"] == {"type": "status", "phase": "paused", "speed": 1.0, "note": None}
        assert set(page.last["gauges"]["speeds"]) == {"edges", "density", "maxwell", "note"}


def test_numbers_that_are_none_are_null():
    none = np.zeros((0, 2))
    with paused(mpsim.Scene(width=4, height=4, position=none, velocity=none, radius=0.5), GRID) as page:
        gauges = page.gauges_at(0)
        numbers = [gauges[name] for name in ("discs", "temperature", "energy_drift", "speeds")]
        assert numbers == [0, None, None, None]
        assert page.picture.position.shape == (0, 2)


# --- what pages say

ACTIONS = [
    ("visible", {"value": True}), ("pause", {}), ("play", {}), ("step", {"frames": 1}), ("speed", {"value": 0.01}),
    ("speed", {"value": None}), ("reset", {}), ("count", {"value": True}), ("count", {"value": False}),
    ("seed", {"value": 3}), ("seed", {"value": 0}),
    ("beside", {"settings": "frames=2,passes=2,contact=push,precision=float32"}),
    ("beside", {"settings": "event"}), ("beside", {"settings": None}),
    ("hold", {"id": 1, "x": 7.0, "y": -1e100}), ("release", {"id": 1, "vx": 0, "vy": 1e3}),
    ("add", {"x": 1.0, "y": 1, "same": False}),
    ("remove", {"id": 2, "same": False}), ("wall", {"ax": 1.0, "ay": 0.0, "bx": 1.0, "by": 2.0}),
    ("move_wall", {"id": 0, "dx": 0.5, "dy": 0.0}), ("remove_wall", {"id": 1, "same": False}),
    ("change", {"name": "dt", "value": 0.02, "same": False}), ("change", {"name": "passes", "value": 2, "same": True}),
    ("change", {"name": "gravity", "value": [0.0, -1.0], "same": False}),
    ("undo", {}),
    ("seek", {"index": 0}), ("follow", {"value": True}),
]  # fmt: skip


def test_every_action_is_taken_and_what_cannot_be_done_ends_nothing():
    with paused(GAS, GRID) as page:
        for name, values in ACTIONS:
            page.say(name, **values)
        page.settle()
        page.say("pause")
        page.hear_until(lambda v: v.phase == "paused")
        assert not page.view.wait(0), "it has not ended"
    with viewed(GAS, GRID, playing=False) as view, Visitor(view.address) as page:
        page.socket.send('{"do": "explode"}')
        with pytest.raises(ConnectionClosed) as closed:
            page.hear_for(60)
    assert closed.value.rcvd.reason.partition("one of ")[2].startswith("'ack', 'visible', ")


HOSTILE = [
    "", "{", "null", "[]", '"play"', "{}", '{"do": null}', '{"do": ["play"]}', '{"do": "__class__"}', '{"do": "Play"}',
    '{"do": "play", "now": 1}', '{"do": "step"}', '{"do": "step", "frames": 10001}', '{"do": "step", "frames": 1e3}',
    '{"do": "step", "frames": true}', '{"do": "step", "frames": 99999999999999999999}', '{"do": "speed", "value": NaN}',
    '{"do": "speed", "value": 1e999}', '{"do": "speed", "value": "1"}', '{"do": "ack", "serial": -1}',
    '{"do": "visible", "value": 1}', "[" * 3000, '{"do":' * 600, '{"do": "hold", "id": 1, "x": 0}',
    '{"do": "hold", "id": 4294967296, "x": 0, "y": 0}', '{"do": "hold", "id": 1, "x": 1e300, "y": 0}',
    '{"do": "release", "id": 1, "vx": [1], "vy": 0}', '{"do": "add", "x": 0, "y": 0, "same": 1}',
    '{"do": "move_wall", "id": 0.5, "dx": 1, "dy": 1}', '{"do": "remove_wall", "id": -1, "same": false}',
    '{"do": "wall", "ax": 0, "ay": 0, "bx": 1, "by": 1e101}', '{"do": "remove", "id": [0, 1], "same": false}',
    '{"do": "change", "name": "precision", "value": "float32", "same": false}',
    '{"do": "change", "name": "dt", "value": "import os", "same": false}',
    '{"do": "change", "name": "dt", "value": {"dt": 1}, "same": false}',
    '{"do": "change", "name": "gravity", "value": [1, "2"], "same": false}',
    '{"do": "keep", "what": "session.zip"}', '{"do": "found", "settings": {}}', '{"do": "seed", "value": 0.5}',
    '{"do": "beside", "settings": {"workers": 900}}', '{"do": "beside", "settings": ["event"]}',
    '{"do": "play"}{"do": "play"}', "\x00", '{"do": "\\ud800"}',
]  # fmt: skip
"""Messages that no page sends."""


def any_json(rng, depth=3):
    """Some JSON, often like an action."""
    words = ["do", "value", "frames", "serial", "id", "x", "y", "same", "step", "speed", "hold"]
    choice = rng.randrange(7 if depth else 4)
    if choice < 4:
        return rng.choice([None, True, -1, 0.5, 10**30, rng.choice(words)])
    if choice < 5:
        return [any_json(rng, depth - 1) for _ in range(rng.randrange(3))]
    return {rng.choice(words): any_json(rng, depth - 1) for _ in range(rng.randrange(1, 4))}


def test_what_is_no_action_ends_its_connection_with_a_reason_and_nothing_else():
    rng = random.Random(1)
    noise = [json.dumps(any_json(rng)) for _ in range(15)]
    with paused(GAS, GRID) as polite:
        for message in [*HOSTILE, *noise]:
            with Visitor(polite.view.address) as page:
                page.socket.send(message)
                with pytest.raises(ConnectionClosed) as closed:
                    page.hear_for(60)
            assert closed.value.rcvd.code == 1008, message
            assert 10 < len(closed.value.rcvd.reason.encode()) <= 123, message
        polite.step_to(2)
        assert not polite.view.wait(0)
    assert " must " in closed.value.rcvd.reason
