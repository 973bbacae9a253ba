"""Files of results: which claim no starts, and which are refused."""

import json

import pytest
from support.scenes import gas

import mpsim
from mpsim import Settings, tradeoff
from mpsim.output import tables

COARSE, FINE = Settings(dt=0.1, method="grid"), Settings(dt=0.02, method="grid")


def test_trajectories_do_not_claim_the_starts_of_averages(quick):
    """Short runs begin with states along one run of the scene."""
    along = "states along one run of the scene"
    for measures, starts in (
        (["pressure"], "other starts of the same kind"),
        (["trajectory", "missed_collisions"], along),
        (["overlap", "trajectory"], f"other starts of the same kind (trajectory: over {along})"),
    ):
        found = tradeoff(gas(20, 0.3), [COARSE], until=2, replicas=2, measures=measures)
        assert json.loads(found.to_json())["starts"] == starts
        assert f"averages over {starts};" in tables.title(found)
    tuned = mpsim.tune(gas(20, 0.3), {"trajectory": 1.0}, until=2, candidates=[Settings(method="grid")], replicas=2)
    assert f"averages over {along}" in str(tuned)
    assert along in tuned._repr_html_()
    assert "kind" not in str(tuned)


def test_the_file_of_another_scene_or_another_length_or_a_damaged_one_is_refused(tmp_path, quick):
    path = tmp_path / "kept.json"
    tradeoff(gas(20, 0.3), [COARSE], until=2, replicas=2, path=path)
    for scene, until in ((gas(20, 0.3, seed=1), 2), (gas(20, 0.3), 3)):
        with pytest.raises(mpsim.InputError, match=r"same scene and the same lengths of runs; .*kept.json is of"):
            tradeoff(scene, [COARSE], until=until, replicas=2, path=path)
    for text in ("", "{", "[]", '{"title": 1}', path.read_text()[:-20]):
        (tmp_path / "bad.json").write_text(text)
        with pytest.raises(mpsim.InputError, match=r"bad.json cannot be read as one \("):
            tradeoff(gas(20, 0.3), [COARSE], until=2, path=tmp_path / "bad.json")
    assert sorted(each.name for each in tmp_path.iterdir()) == ["bad.json", "kept.json"]
