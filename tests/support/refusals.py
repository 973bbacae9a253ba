"""What the text of a refusal must have, and arguments of a scene of which each test spoils one."""

import re

import pytest

import mpsim

GOOD = {"width": 8, "height": 6, "position": [[2, 2], [4, 3]], "velocity": [[1, 0], [0, 1]], "radius": 0.5}


def assert_refused(parts, act, *arguments, **named):
    """Require one exception of mpsim's own kind whose text has all parts and ends like a sentence."""
    with pytest.raises(mpsim.InputError) as caught:
        act(*arguments, **named)
    text = str(caught.value)
    assert isinstance(caught.value, ValueError)
    for part in parts:
        assert part in text, f"{part!r} is not in {text!r}"
    assert re.search(r"[.?]$", text), f"not a sentence: {text!r}"
    assert caught.value.__cause__ is None, "one exception, not a chain"
    return text
