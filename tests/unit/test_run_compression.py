"""scripts/run_compression.py: a short table, and where it ends in the page."""

import re
import sys

import pytest
from support.scripts import fixture_of

script = fixture_of("run_compression")


@pytest.fixture
def page(tmp_path):
    found = tmp_path / "page.md"
    found.write_text("<!-- run_compression: table -->\n<!-- end -->\n")
    return found


def test_the_table_says_what_was_reached_and_where_discs_jammed(script, monkeypatch, page):
    monkeypatch.setattr(sys, "argv", ["run_compression.py", "--counts", "64", "--rates", "0.1", "--docs", str(page)])
    script.main()
    rows = re.findall(r"\| (\S.*?) \| 64 \| 0.1 \| (\S+) \| \S+ s \| (0\.\d{4}) \| \S+ s \|", page.read_text())
    assert [row[:2] for row in rows] == [("equal", "0.8"), ("1 : 1.4", "0.82")]
    assert all(0.8 < float(row[2]) < 0.9 for row in rows)
    assert "Made by `python" in page.read_text()


def test_discs_that_jam_are_told_from_those_that_do_not(script):
    scene = script.start(64, 0.5)
    assert script.compressed(scene, 0.7, 1.0)[0] is None
    assert 0.7 < script.compressed(scene, 0.9, 1.0)[0] < 0.9
