"""Each script of the project runs once, at its smallest size, and prints or writes what it is for."""

import json
import os
import re
import subprocess
import sys

import pytest
from support.pages import ROOT

pytestmark = [pytest.mark.compiled, pytest.mark.slow, pytest.mark.timeout(660)]


def run(name, *words, code=0, folder=None, **env):
    """What a script prints; its exit code must be the expected one."""
    command = [sys.executable, "-W", "ignore", ROOT / "scripts" / f"{name}.py", *map(str, words)]
    variables = os.environ | {"PYTHONPATH": str(ROOT), "COLUMNS": "160"} | env
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, timeout=600, env=variables, cwd=folder or ROOT
    )
    assert done.returncode == code, f"{done.stdout}\n{done.stderr}"
    return done.stdout + done.stderr


def rows_of(page):
    lines = [line for line in page.read_text().splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines]


def test_run_bench_times_and_draws(tmp_path):
    assert "grid" in run("run_bench", "--quick", "--only", "fixed", "--out", tmp_path)
    assert json.loads((tmp_path / "bench.json").read_text())["fixed"]["grid"]["frames"] == 100
    assert (tmp_path / "fixed.png").stat().st_size > 10_000


@pytest.mark.long
def test_run_validation_compares_two_discs_with_what_is_known(tmp_path):
    run("run_validation", "--quick", "--only", "two", "--out", tmp_path / "kept.json")
    rows = json.loads((tmp_path / "kept.json").read_text())["two"]["rows"]
    assert rows
    for row in rows:
        expected, found = row["expected"], row["found"]
        assert found["value"] == pytest.approx(expected["value"], rel=0.2)


@pytest.mark.long
def test_run_peers_has_a_row_for_the_yardstick_and_one_for_an_engine_that_is_missing(tmp_path):
    page, readme = tmp_path / "page.md", (ROOT / "README.md").read_text()
    words = ["--quick", "--accurate", "0", "--counts", "60", "--peers", "mpsim-push", "numpy", "cpp", "pymunk"]
    run("run_peers", *words, "--work", tmp_path, "--page", page)
    text, row = page.read_text(), r"\| mpsim, contact `push` \| [\d.,]+ "
    assert re.search(row, text)
    assert re.search(rf"{row}/ [\d.,]+ / [\d.,]+ ", (tmp_path / "game.md").read_text())
    assert "A short run, for a look: not to be quoted." in text
    assert (ROOT / "README.md").read_text() == readme
    assert re.search(r"\| pymunk \| (not installed: pip install pymunk|[\d.,]+ )", text)


def test_the_readme_claims_what_the_page_of_peers_says():
    """Or quotes nothing of it, as long as the page is of a busy machine."""
    readme, page = (ROOT / "README.md").read_text(), (ROOT / "docs" / "peers.md").read_text()
    said = " ".join(re.search(r"<!-- run_peers: claim -->\n(.*?)<!-- end -->", readme, re.DOTALL)[1].split())
    claimed = re.search(r"^mpsim takes (.*?)\.\n\n", page, re.MULTILINE | re.DOTALL)
    assert ("peers" in said) == (claimed is not None)
    assert claimed is None or said == f"{' '.join(claimed[1].split())} ([peers](docs/peers.md))."


@pytest.mark.long
def test_run_scaling_says_what_it_cannot_measure():
    assert "--discs" in run("run_scaling", "--discs", "3", "--workers", "4", code=2)


@pytest.mark.long
def test_the_longer_scripts_write_their_tables(tmp_path):
    page = tmp_path / "exact.md"
    run("run_exact", "--discs", "3000", "--workers", "2", "--page", page)
    rows = rows_of(page)[2:]
    assert [row[1] for row in rows] == ["undivided", "2 workers"]
    assert rows[0][4:] == ["0", "0"]
    page = tmp_path / "scaling.md"
    run("run_scaling", "--discs", "600", "--workers", "2", "--page", page)
    assert {"600"} <= {row[0] for row in rows_of(page)}
    page = tmp_path / "ranks.md"
    run("run_ranks", "--discs", "3000", "--page", page)
    assert len(rows_of(page)) > 3
