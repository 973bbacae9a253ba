"""scripts/run_stability.py: what it keeps of a run, and draws again. The trials themselves are in unit/studies."""

import gzip
import sys

from support.scripts import fixture_of

from mpsim.studies import stability

script = fixture_of("run_stability")


def called(script, monkeypatch, *words):
    monkeypatch.setattr(sys, "argv", ["run_stability.py", *map(str, words)])
    return script.main()


def test_the_outcomes_beside_the_page_are_those_of_the_run(script, monkeypatch, tmp_path, capsys):
    found = [stability.Outcome("masses", value, "event") for value in (1e-3, 1e-6, 1e-9)]
    monkeypatch.setattr(script.stability, "run_trials", lambda *_: found)
    page, out, again = tmp_path / "page.md", tmp_path / "out", tmp_path / "again"
    page.write_text("<!-- run_stability: counts -->\n<!-- end -->\n")
    assert called(script, monkeypatch, "--only", "masses", "--out", out, "--docs", page) == 0
    assert "| 3 |" in page.read_text()
    kept = tmp_path / "page" / "outcomes.json.gz"
    assert stability.from_json(gzip.decompress(kept.read_bytes()).decode()) == found
    assert called(script, monkeypatch, "--draw", kept, "--out", again) == 0
    assert (again / "masses.png").read_bytes() == (tmp_path / "page" / "masses.png").read_bytes()


def test_a_forbidden_outcome_is_an_exit_code(script, monkeypatch, tmp_path, capsys):
    lost = [stability.Outcome("masses", 1e-3, "event", kind) for kind in ("correct", stability.FORBIDDEN[0])]
    monkeypatch.setattr(script.stability, "run_trials", lambda *_: lost)
    assert called(script, monkeypatch, "--only", "masses", "--out", tmp_path) == 1
