"""The style of pictures."""

import re

from mpsim.output.drawing import STYLE

SAFE = {"0072B2", "D55E00", "009E73", "CC79A7", "E69F00", "56B4E9", "F0E442", "000000"}
"""The colours of Okabe & Ito."""


def test_the_style_has_only_colours_that_colour_blind_people_can_tell_apart():
    cycle = re.search(r"prop_cycle: .*\[(.*)\]", STYLE.read_text())
    assert set(re.findall(r"[0-9A-F]{6}", cycle[1])) <= SAFE
    from mpsim.output import moving_picture, times  # noqa: PLC0415

    assert {colour.lstrip("#") for colour in moving_picture.CATEGORIES} <= SAFE
    assert {colour.lstrip("#") for colour in times.PHASE_COLOURS.values()} - SAFE == {"CCCCCC"}
