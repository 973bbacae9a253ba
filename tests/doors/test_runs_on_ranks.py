"""Commands on the ranks of MPI: the folder of a run is that of one process, and goes on from one to the other."""

import json

import numpy as np
import pytest
from support.commands import library_digest, mpsim_command
from support.ranks import on_ranks

from mpsim.output.recorder import COLUMNS, read_table

pytestmark = pytest.mark.slow

ALIKE = ("trajectory.xyz", "trajectory.gsd", "measures.csv", "final.npz", "final.png")
"""Files that are the same to the byte. Others hold times, or name the method."""

MEASURED = ("--every", "4", "--measure", "pressure", "--quiet")


def ran_on(number, *words):
    """What a command on so many ranks prints."""
    done = on_ranks(number, *map(str, words), program="mpsim")
    assert (done.code, done.err) == (0, ""), done.err
    return done.out


def record_of(out):
    return json.loads((out / "run.json").read_text())


def recorded(out):
    """What run.json says of a run, but for its times and what names the method."""
    record = record_of(out)
    del record["settings"]["method"]
    differing = ("method", "workers", "block_bytes", "waiting")
    for part in record["parts"]:
        for name in [name for name in part if name in differing or name.endswith("_seconds")]:
            del part[name]
    return record


def contents(out, names=ALIKE):
    return {name: (out / name).read_bytes() for name in names if (out / name).exists()}


@pytest.mark.parametrize(
    ("number", "scene", "kind"),
    [(2, "gas", "xyz"), *(pytest.param(*each, marks=pytest.mark.long) for each in ((3, "hopper", "gsd"),))],
)
def test_a_folder_of_ranks_is_that_of_one_process(number, scene, kind, tmp_path):
    of_one, of_ranks = tmp_path / "one", tmp_path / "ranks"
    words = ("run", scene, "--frames", 30, *MEASURED, "--format", kind)
    told = mpsim_command(*words, "--method", "grid", "--out", of_one).stdout
    told_on_ranks = ran_on(number, *words, "--method", "mpi", "--out", of_ranks)
    assert {path.name for path in of_ranks.iterdir()} == {path.name for path in of_one.iterdir()}
    assert contents(of_ranks) == contents(of_one)
    assert recorded(of_ranks) == recorded(of_one)
    assert told_on_ranks.count("digest ") == 1
    assert told_on_ranks.splitlines()[-3:-1] == told.splitlines()[-3:-1], "the measure and the digest"
    heads = [(out / "timings.csv").read_text().partition("\n")[0].split(",") for out in (of_ranks, of_one)]
    assert len(heads[0]) - 2 == number * (len(heads[1]) - 2), "columns of each rank"


@pytest.mark.parametrize("number", [2, pytest.param(3, marks=pytest.mark.long)])
def test_a_run_goes_from_ranks_to_one_process_and_back(number, tmp_path):
    whole, out = tmp_path / "whole", tmp_path / "parts"
    mpsim_command("run", "gas", "--method", "grid", "--frames", 48, *MEASURED, "--out", whole)
    ran_on(2, "run", "gas", "--method", "mpi", "--frames", 16, *MEASURED, "--out", out)
    alone = mpsim_command("resume", out, "--frames", 16, "--method", "grid", "--quiet")
    assert alone.exit_code == 0, alone.stderr
    assert record_of(out)["parts"][-1]["method"] == "grid"
    ran_on(number, "resume", out, "--frames", 16, "--method", "mpi", "--json")
    assert record_of(out)["parts"][-1]["method"] == "mpi"
    names = ("trajectory.xyz", "final.npz", "final.png")
    assert contents(out, names) == contents(whole, names)
    here, there = read_table(out / "measures.csv"), read_table(whole / "measures.csv")
    for name in set(COLUMNS) - {"collision_rate"}:  # which after a resume is of fewer frames
        assert np.array_equal(here[name], there[name]), name
    on_one_rank = mpsim_command("resume", out, "--frames", 2, "--quiet")
    assert f"digest {library_digest(50)}\n" in on_one_rank.stdout, on_one_rank.stderr
