"""The format of pictures and messages: what is packed comes back, and what is no message is refused."""

import json
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.viewing import packed, placed

import mpsim
from mpsim.viewer import wire
from mpsim.viewer.colours import ABSORBED, FASTEST, KNEE, SpeedScale

SCALE = SpeedScale(2.0, 6.0)


def header_of(width: float, height: float, **values) -> wire.Header:
    given = {"serial": 3, "frame": 2**40, "time": 1.25, "walls": (0.0, width, 0.0, height), **values}
    return wire.Header(**given, extent=(width, height), scale=SCALE)


def state_of(count: int, width: float, height: float, precision: str = "float64") -> mpsim.State:
    rng = np.random.default_rng(count)
    position = rng.random((count, 2)) * (width, height)
    return mpsim.State(position.astype(precision), rng.normal(size=(count, 2)).astype(precision))


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("count", [0, 1, 7, 1000])
def test_a_picture_comes_back_to_a_step_of_the_box(count, precision):
    state, header = state_of(count, 30.0, 2.0, precision), header_of(30.0, 2.0)
    message = packed(header, state)
    assert len(message) == 96 + 5 * count
    found = wire.unpack(message)
    assert found.header == header
    assert np.abs(found.position - state.position).max(initial=0) <= 0.5001 * 30.0 / 65535 + 2e-6
    speeds = np.hypot(*state.velocity.T)
    expected = np.interp(speeds, [0, SCALE.usual, SCALE.fastest], [0, KNEE, FASTEST])  # the slow twin
    assert np.abs(found.colour - expected).max(initial=0) <= 0.51


def test_bytes_are_where_the_format_says():
    """Written by hand, so that a change of both packing and unpacking is seen."""
    state = mpsim.State(np.array([[1.0, 0.5], [4.0, 0.0]]), np.array([[0.0, 2.0], [9.0, 0.0]]))
    header = wire.Header(258, 3, 0.5, (0.0, 3.5, 0.0, 1.0), (4.0, 1.0), SCALE)
    expected = b"MPSV" + bytes([1, 1, 0, 0]) + struct.pack("<IIQ", 258, 2, 3)
    expected += struct.pack("<9d", 0.5, 0.0, 3.5, 0.0, 1.0, 4.0, 1.0, 2.0, 6.0)
    expected += struct.pack("<4H", 16384, 32768, 65535, 0) + bytes([KNEE, FASTEST])
    assert bytes(packed(header, state)) == expected


def test_discs_beyond_the_box_are_shown_at_its_edge_and_absorbed_ones_not_at_all():
    state = mpsim.State(np.array([[-1.0, 5.0], [1.0, 1.0]]), np.zeros((2, 2)), present=np.array([True, False]))
    found = wire.unpack(packed(header_of(4.0, 4.0), state))
    assert found.position[0].tolist() == [0.0, 4.0]
    assert found.colour.tolist() == [0, ABSORBED]


def test_discs_beyond_a_periodic_border_are_shown_a_period_away():
    state = mpsim.State(np.array([[-1.0, 1.0], [4.5, 4.0], [2.0, -0.5]]), np.zeros((3, 2)))
    found = wire.unpack(packed(header_of(4.0, 4.0), state, periodic=(True, False)))
    assert np.abs(found.position - [[3.0, 1.0], [0.5, 4.0], [2.0, 0.0]]).max() < 1e-4
    other = wire.unpack(packed(header_of(4.0, 4.0), state, periodic=(False, True)))
    assert np.abs(other.position - [[0.0, 1.0], [4.0, 0.0], [2.0, 3.5]]).max() < 1e-4


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_a_picture_without_kernels_is_the_same(precision):
    state, header = state_of(200, 30.0, 2.0, precision), header_of(30.0, 2.0)
    plain = wire.pack(header, placed(state), plain=True)
    assert plain == packed(header, state)
    other = mpsim.State(state.position[::-1].copy(), state.velocity)
    assert plain != packed(header, other), "negative control"


def test_radii_are_one_where_they_are_equal():
    header = header_of(4.0, 4.0)
    assert wire.unpack_radii(wire.pack_radii(np.full(9, 0.25), header)).tolist() == [0.25]
    assert wire.unpack_radii(wire.pack_radii(np.array([0.25, 0.5]), header)).tolist() == [0.25, 0.5]
    assert wire.unpack_radii(wire.pack_radii(np.zeros(0), header)).tolist() == []


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda good: good[:50], "must have at least 96 bytes; got 50"),
        (lambda good: b"", "must have at least 96 bytes; got 0"),
        (lambda good: b"MPSX" + good[4:], "must begin with b'MPSV', version 1"),
        (lambda good: good[:4] + b"\x02" + good[5:], "got b'MPSV', 2, 1 and 0"),
        (lambda good: good[:5] + b"\x02" + good[6:], "got b'MPSV', 1, 2 and 0"),
        (lambda good: good[:-1], "of 4 discs must have 116 bytes; got 115"),
        (lambda good: good + b"\x00", "of 4 discs must have 116 bytes; got 117"),
        (lambda good: good[:12] + b"\xff\xff\xff\xff" + good[16:], "of 4294967295 discs must have"),
    ],
)
def test_what_is_no_picture_is_refused(change, text):
    good = bytes(packed(header_of(4.0, 4.0), state_of(4, 4.0, 4.0)))
    wire.unpack(good)
    with pytest.raises(mpsim.InputError, match=text):
        wire.unpack(change(good))


@given(st.binary(max_size=300))
def test_any_other_bytes_are_refused_too(noise):
    for read in (wire.unpack, wire.unpack_radii):
        with pytest.raises(mpsim.InputError):
            read(noise)


ACTIONS = [
    ("ack", {"serial": 7}), ("visible", {"value": False}), ("play", {}), ("pause", {}), ("step", {"frames": 3}),
    ("speed", {"value": 0.01}), ("speed", {"value": None}), ("reset", {}), ("count", {"value": True}),
    ("colour", {"by": "worker"}),
    ("seek", {"index": 0}), ("follow", {"value": True}),
    ("hold", {"id": 3, "x": 0.5, "y": -1.0}), ("release", {"id": 3, "vx": 0.0, "vy": 1e3}),
    ("add", {"x": 1.0, "y": 2.0, "same": True}), ("remove", {"id": 0, "same": False}), ("undo", {}),
    ("stroke", {"places": [[1.0, 2.0]] * 100, "same": True}),
    ("wall", {"ax": 1.0, "ay": 2.0, "bx": 3.0, "by": -1e100}),
    ("change", {"name": "dt", "value": 0.25, "same": False}),
    ("change", {"name": "gravity", "value": [0.0, -1.0], "same": True}),
    ("change", {"name": "contact", "value": "push", "same": False}),
    ("change", {"name": "passes", "value": 2, "same": False}),
    ("pass", {}), ("grid", {}), ("snapshot", {}), ("return", {}), ("seed", {"value": 0}), ("stop_tuning", {}),
    ("beside", {"settings": None}), ("beside", {"settings": {"method": "event"}}),
    ("beside", {"settings": {"frames": 10, "passes": 2, "contact": "push", "precision": "float32"}}),
    ("tune", {"measure": "pressure", "budget": 0.02}),
]  # fmt: skip


def test_a_picture_says_of_which_stage_it_is():
    for stage in (0, 1):
        message = bytes(packed(header_of(4.0, 4.0, stage=stage), state_of(4, 4.0, 4.0)))
        assert (message[6], message[7], wire.unpack(message).header.stage) == (stage, 0, stage)
    with pytest.raises(mpsim.InputError, match="stage 0 or 1; got b'MPSV', 1, 1 and 2"):
        wire.unpack(message[:6] + b"\x02" + message[7:])


@pytest.mark.parametrize(("name", "values"), ACTIONS)
def test_each_deed_is_read(name, values):
    assert wire.read_action(json.dumps({"do": name, **values})) == wire.Action(name, values)


def test_each_deed_is_tried():
    elsewhere = {"open"}  # whose value is not what was sent: in test_link.py
    assert {name for name, _ in ACTIONS} == set(wire.ACTIONS) - elsewhere


HOSTILE = [
    "", "{", "null", "[]", "7", '"play"', "{}", '{"do": null}', '{"do": 1}', '{"do": ["play"]}',
    '{"do": {"do": "play"}}', '{"do": "__class__"}', '{"do": "Play"}', '{"do": "play", "now": 1}', '{"do": "step"}',
    '{"do": "step", "frames": 0}',
    '{"do": "step", "frames": 1e3}', '{"do": "step", "frames": true}',
    '{"do": "step", "frames": 99999999999999999999}',
    '{"do": "speed", "value": NaN}', '{"do": "speed", "value": 1e999}', '{"do": "speed", "value": -1}',
    '{"do": "speed", "value": "1"}', '{"do": "speed", "value": 0}', '{"do": "ack", "serial": -1}',
    '{"do": "ack", "serial": 1.0}',
    '{"do": "visible", "value": 1}', '{"do": "visible", "value": null}', "[" * 3000, '{"do":' * 600, " " * 5000,
    '{"do": "hold", "id": 1, "x": 0}', '{"do": "hold", "id": -1, "x": 0, "y": 0}',
    '{"do": "hold", "id": 1.5, "x": 0, "y": 0}', '{"do": "hold", "id": 4294967296, "x": 0, "y": 0}',
    '{"do": "hold", "id": 1, "x": "0", "y": 0}', '{"do": "hold", "id": 1, "x": 1e300, "y": 0}',
    '{"do": "hold", "id": 1, "x": null, "y": 0}', '{"do": "release", "id": 1, "vx": [1], "vy": 0}',
    '{"do": "add", "x": 0, "y": 0, "same": 1}', '{"do": "add", "x": 0, "y": 0, "same": true, "radius": 1e9}',
    '{"do": "wall", "ax": 0, "ay": 0, "bx": 1}', '{"do": "wall", "ax": 0, "ay": 0, "bx": 1, "by": 1e101}',
    '{"do": "wall", "ax": 0, "ay": 0, "bx": [1], "by": 1}',
    '{"do": "remove", "id": [0, 1], "same": false}', '{"do": "undo", "times": 9}',
    '{"do": "change", "name": "precision", "value": "float32", "same": false}',
    '{"do": "change", "name": "__class__", "value": 1, "same": false}',
    '{"do": "change", "name": ["dt"], "value": 1, "same": false}',
    '{"do": "change", "name": "dt", "value": "import os", "same": false}',
    '{"do": "change", "name": "dt", "value": {"dt": 1}, "same": false}',
    '{"do": "change", "name": "dt", "value": true, "same": false}',
    '{"do": "change", "name": "passes", "value": 99999999999, "same": false}',
    '{"do": "change", "name": "gravity", "value": [1, 2, 3], "same": false}',
    '{"do": "change", "name": "gravity", "value": [1, "2"], "same": false}',
    '{"do": "keep", "what": "session.zip"}',
    '{"do": "searching"}', '{"do": "found", "settings": {}}', '{"do": "seed", "value": -1}',
    '{"do": "seed", "value": 0.5}',
    '{"do": "open"}', '{"do": "open", "link": null}', '{"do": "open", "link": {}}', '{"do": "open", "link": "../gas"}',
    '{"do": "beside"}', '{"do": "beside", "settings": "event"}', '{"do": "beside", "settings": {"workers": 900}}',
    '{"do": "beside", "settings": {"method": ["event"]}}', '{"do": "beside", "settings": {"frames": 101}}',
    '{"do": "beside", "settings": {"passes": true}}', '{"do": "tune", "measure": "__class__", "budget": 1}',
    '{"do": "tune", "measure": "pressure", "budget": 0}', '{"do": "tune", "measure": "pressure", "budget": -1}',
    '{"do": "tune", "measure": "pressure", "budget": NaN}', '{"do": "tune", "measure": "pressure", "budget": "0.1"}',
    '{"do": "play"}{"do": "play"}', '\x00', '{"do": "\\ud800"}', '{"do": "../../etc/passwd"}',
]  # fmt: skip
"""Messages that no page sends."""


@pytest.mark.parametrize("message", HOSTILE, ids=lambda text: text[:30])
def test_what_is_no_deed_is_refused(message):
    with pytest.raises(mpsim.InputError):
        wire.read_action(message)


WORDS = st.sampled_from(["do", "value", "frames", "serial", "play", "speed"])
ANY = st.recursive(
    st.none() | st.booleans() | st.floats() | WORDS,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(WORDS, inner, max_size=3),
)


@given(ANY)
def test_any_other_json_is_a_deed_or_refused(message):
    try:
        action = wire.read_action(json.dumps(message))
    except mpsim.InputError:
        return
    assert action.name in wire.ACTIONS
    assert set(action.values) == set(wire.ACTIONS[action.name])


def test_numbers_that_are_none_are_null_for_a_page():
    assert json.loads(wire.text_of("gauges", {"a": float("inf"), "b": np.array([1.0, np.nan])})) == {
        "type": "gauges", "a": None, "b": [1.0, None],
    }  # fmt: skip
