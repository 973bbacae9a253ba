"""What scripts/feature_cost.py calls the arrays of a feature, and the scenes that it times."""

from support.scripts import fixture_of

from mpsim.features import FEATURES

script = fixture_of("feature_cost")


def test_arrays_of_one_feature_count_once(script):
    assert script.families(["a.radius", "b.radius", "pegs.near", "pegs.index"]) == ("radius", "pegs")


def test_the_other_version_is_compared_with_this_checkout(script):
    assert (script.TOP / "mpsim" / "__init__.py").is_file()


def test_the_scenes_follow_from_the_list_of_features(script, monkeypatch):
    monkeypatch.setattr(script, "SPREADS", ())
    scenes = script.scenes()
    timed = [each for each in FEATURES if each.cost_examples(10.0, 1.4)]
    assert {each.argument for each in FEATURES} - {each.argument for each in timed} == {"emitters"}
    for feature in timed:
        assert feature.is_in(scenes["all together"]) == (feature.argument not in script.APART), feature.argument
        for name in feature.cost_examples(10.0, 1.4):
            assert [each.argument for each in FEATURES if each.is_in(scenes[name])] == [feature.argument]
    monkeypatch.setattr(script, "FEATURES", ())
    assert set(script.scenes()) == {"bare", "periodic", "one giant", "all together"}
