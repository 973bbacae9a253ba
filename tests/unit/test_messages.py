"""The texts of errors, warnings and all else that mpsim says are pinned: none changes by accident.

messages.txt has them, sorted. After a text was changed on purpose:

    python -m pytest tests/unit/test_messages.py --renew
"""

import difflib
import warnings
from pathlib import Path

import numpy as np
import pytest
from support.messages import matches, messages, sources
from support.scenes import crowd, simulate

import mpsim

FILE = Path(__file__).parent / "messages.txt"
PACKAGE = Path(mpsim.__file__).parent


def test_every_text_is_the_pinned_one(request):
    found = messages(sources(PACKAGE))
    if request.config.getoption("--renew"):
        FILE.write_text("\n".join(found) + "\n")
    pinned = FILE.read_text().splitlines()
    changed = [line for line in difflib.unified_diff(pinned, found, lineterm="", n=0) if line[:1] in "+-"]
    assert found == pinned, "on purpose? see the top of this file:\n" + "\n".join(changed[2:])


def errors_at_work():
    """Errors and warnings of all kinds of places, by the class and the text that a caller gets."""
    rest = np.zeros((2, 2))
    acts = [
        lambda: mpsim.Settings(dt=-1),
        lambda: mpsim.Settings(method="gird"),
        lambda: mpsim.Scene(width=4, height=4, position=[[1, 1], [9, 9]], velocity=rest, radius=0.5),
        lambda: mpsim.Scene(width=4, height=4, position=[[1, np.nan]], velocity=[[0, 0]], radius=0.5),
        lambda: mpsim.Piston("left", -1, 2),
        lambda: mpsim.Polyline([(0, 0)]),
        lambda: mpsim.Emitter((1, 1), (1, 0)),
        lambda: mpsim.Scene.load("gass"),
        lambda: mpsim.State(rest, rest, image=rest),
        lambda: mpsim.Trajectory("run.txt"),
        lambda: mpsim.Simulation.resume("no-such-file.mpsim"),
        lambda: simulate(crowd(9, 0.6), method="event"),
        lambda: simulate(crowd(9, 0.6), method="event", law="reflect"),
        lambda: mpsim.Simulation(crowd(9, 0.6), mpsim.Settings(method="naive")).close(),
    ]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for act in acts:
            with pytest.raises((mpsim.MpsimError, Warning)) as caught:
                act()
            yield caught.value


def test_what_is_said_at_work_is_among_the_pinned_texts():
    """The collector misses nothing of these: each text, whole, comes from a template that says more than {}."""
    pinned = [line for line in FILE.read_text().splitlines() if len(line.partition(": ")[2].replace("{}", "")) > 8]
    for error in errors_at_work():
        assert any(matches(line, str(error)) for line in pinned), f"{type(error).__name__}: {error}"


SOURCE = '''
"""A docstring is no text that is said."""

class OwnError(ValueError):
    """Another one."""

def refuse(name, value, low):
    """And another one."""
    if low:
        raise OwnError(f"{name} must be {'at least' if low else 'at most'} 1; "
                       f"got {value:g}. Choose another.")
    text = f"{name} is rather large"
    warnings.warn("this is a warning", UserWarning, stacklevel=2)
    return mpsim.OwnError(text)
'''

TEXTS = [
    "OwnError: {} must be {at least|at most} 1; got {}. Choose another.",
    "UserWarning: this is a warning",
    "text: {} is rather large",
]


def test_the_collector_finds_texts_wherever_they_are_made():
    assert messages([SOURCE]) == TEXTS
    first, second = SOURCE.split("def refuse")
    assert messages([f"def refuse{second}", first]) == TEXTS, "another module, another order"


@pytest.mark.parametrize(
    ("before", "after"),
    [("rather", "very"), ("at most", "no more than"), ("ValueError", "object"), ("UserWarning", "FutureWarning"),
     ("Choose another", "Choose"), ("this is", "here is")],
)  # fmt: skip
def test_any_change_of_a_text_or_its_class_is_seen(before, after):
    assert messages([SOURCE.replace(before, after)]) != TEXTS


def test_one_word_of_the_package_that_changes_is_seen():
    changed = [
        text.replace("must be one of", "has to be one of") for text in sources(PACKAGE) if "must be one of" in text
    ]
    assert set(messages(changed)) - set(FILE.read_text().splitlines())
