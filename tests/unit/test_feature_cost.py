"""What scripts/feature_cost.py calls the arrays of a feature, and the scenes that it times."""

import importlib
from pathlib import Path

import pytest


@pytest.fixture(scope="module")
def script():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(Path(__file__).parents[2] / "scripts")
        return importlib.import_module("feature_cost")


def test_arrays_of_one_feature_count_once(script):
    assert script.families(["a.radius", "b.radius", "pegs.near", "pegs.index"]) == ("radius", "pegs")


def test_the_other_version_is_compared_with_this_checkout(script):
    assert (script.TOP / "mpsim" / "__init__.py").is_file()
