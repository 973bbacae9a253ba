"""What functions of measures and pictures say to arguments that lack, that are too many, or of another kind."""

import inspect
import warnings

import matplotlib as mpl
import numpy as np
import pytest

import mpsim
from mpsim import measure

pytestmark = pytest.mark.plain

mpl.use("Agg")
SCENE = mpsim.Scene.random(count=24, packing=0.3, radius=0.5, seed=1, boundary="periodic")
STATE = mpsim.State(SCENE.position, SCENE.velocity)

RIGHT = {
    "state": STATE, "states": STATE, "before": STATE, "after": STATE, "reference": STATE, "scene": SCENE, "bins": 6,
    "r_max": 3.0, "k_max": 4.0, "samples": np.arange(40.0), "values": np.arange(40.0), "series": np.arange(40.0),
}  # fmt: skip
"""A right value for each required argument of a measure of states, by name."""

OF_STATES = [
    name for name in measure.__all__
    if inspect.isfunction(getattr(measure, name)) and name != "to_freud"  # which takes seconds to import
    and {"state", "states", "before"} & set(inspect.signature(getattr(measure, name)).parameters)
]  # fmt: skip

ODD = [
    np.ones(24), np.ones((24, 2)), np.array(["a", "b"]), "word", None, True, -1, 1.5, np.nan, 10**400, 1j,
    [None], {}, SCENE, STATE, print, (1, 2, 3),
]  # fmt: skip
"""Values of all kinds: most are wrong for any argument."""


def needed_by(function):
    return [each.name for each in inspect.signature(function).parameters.values() if each.default is each.empty]


def is_refused(act):
    """Do what may be right; whatever is wrong must be answered by an error of mpsim."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", mpsim.OverlapWarning)
        try:
            found = act()
        except mpsim.MpsimError as error:
            return isinstance(error, mpsim.InputError)
    if hasattr(found, "close"):
        found.close()
    return False


@pytest.mark.parametrize("name", OF_STATES)
def test_whatever_is_given_to_a_measure_is_right_or_refused_in_a_sentence(name):
    function = getattr(measure, name)
    needed = needed_by(function)
    right = {each: RIGHT[each] for each in needed}
    function(**right)
    for left_out in needed:
        others = {each: value for each, value in right.items() if each != left_out}
        with pytest.raises(
            mpsim.InputError, match=rf"^{left_out} of {name} must be given; got none. Write {name}\({left_out}"
        ):
            function(**others)
    with pytest.raises(TypeError, match=rf"^{', '.join(needed)} of {name} must be given; got none"):  # as in Python
        function()
    with pytest.raises(mpsim.InputError, match=rf"{needed[0]} of {name} must be given once; got two"):
        function(*right.values(), **{needed[0]: STATE})
    many = [*right.values(), *[None] * 9]
    with pytest.raises(mpsim.InputError, match=rf"{name} must be given no more values|must be given with its name"):
        function(*many)
    refused = [
        is_refused(lambda each=each, odd=odd: function(**right | {each: odd}))
        for each in inspect.signature(function).parameters
        for odd in ODD
    ]
    assert sum(refused) > len(refused) / 3


def doors_of_pictures(folder):
    return {
        mpsim.draw: {"state": STATE, "scene": SCENE},
        mpsim.animate: {"scene": SCENE, "settings": mpsim.Settings(method="naive", dt=0.01), "path": f"{folder}/a.gif",
                        "frames": 1, "progress": False, "pixels": 64},
        mpsim.Trajectory: {"path": f"{folder}/a.xyz"},
        mpsim.Trajectory.write: {"path": f"{folder}/b.xyz", "every": 10},
    }  # fmt: skip


@pytest.mark.parametrize("index", range(4), ids=["draw", "animate", "Trajectory", "Trajectory.write"])
def test_whatever_is_given_to_a_picture_or_a_file_is_right_or_refused_in_a_sentence(index, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.xyz").write_text('1\nLattice="9 0 0 0 9 0 0 0 1" Properties=pos:R:3\n1 1 0\n')
    function, right = list(doors_of_pictures(tmp_path).items())[index]
    refused = [
        is_refused(lambda each=each, odd=odd: function(**right | {each: odd}))
        for each in inspect.signature(function).parameters
        for odd in ODD[::2]
        if (each, odd is None) != ("frames", True)  # which makes 200 pictures
        and not (function is mpsim.Trajectory.write and each == "path" and isinstance(odd, str))
    ]
    assert sum(refused) > len(refused) / 3


@pytest.mark.parametrize("word", [np.ones(24), {"speed"}])
def test_arrays_in_place_of_words_are_named(word, tmp_path):
    with pytest.raises(mpsim.InputError, match=r"colour must be one of 'speed'; got "):
        mpsim.animate(SCENE, path=tmp_path / "a.gif", colour=word)
    with pytest.raises(mpsim.InputError, match="method must be one of"):
        mpsim.Settings(method=word)
    with pytest.raises(mpsim.InputError, match="boundary must be"):
        mpsim.Scene.random(count=5, packing=0.1, radius=0.5, boundary=word)
