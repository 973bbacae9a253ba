"""Whatever happens while a checkpoint is written, a whole one is found, and nothing else is lost."""

import errno
import os
import resource
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from support.checkpoints import WORDS, frame_in, saved, two
from support.scenes import lattice, simulate, zoo

import mpsim

pytestmark = pytest.mark.plain


def names(folder):
    return sorted(each.name for each in folder.iterdir())


# --- no room


@contextmanager
def largest_file(size):
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


def failing(number):
    def fail(*arguments, **options):
        raise OSError(number, os.strerror(number))

    return fail


def test_whatever_the_system_refuses_is_an_error_and_what_was_there_is_untouched(tmp_path):
    """A file that cannot grow, at any size; and in the end it is saved."""
    path = two(tmp_path / "run")
    before = path.read_bytes()
    with simulate(zoo(WORDS, count=5), method="grid") as sim:
        for size in range(0, 5000, 500):
            with largest_file(size), pytest.raises(mpsim.errors.OutputError, match="before is untouched") as full:
                sim.save(path)
            assert "File too large" in str(full.value)
            assert path.read_bytes() == before, size
        assert names(tmp_path) == ["run", "run.previous"]
        sim.run(frames=1)
        sim.save(path)
    assert (frame_in(path), frame_in(tmp_path / "run.previous")) == (1, 3)


def test_a_file_system_without_links_gets_a_copy(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "link", failing(errno.EPERM))
    path = two(tmp_path / "run")
    assert (frame_in(path), frame_in(tmp_path / "run.previous")) == (3, 2)


def test_no_checkpoint_is_written_that_could_not_be_read_again(tmp_path, monkeypatch):
    path = saved(tmp_path / "run", zoo("obstacles", count=5))
    before = path.read_bytes()
    monkeypatch.setattr("mpsim.engine.checkpoint.MOST_HEADER", 200)  # else it takes 67 MB of obstacles
    with pytest.raises(mpsim.errors.OutputError, match="must take at most 200 bytes of a checkpoint's header"):
        saved(path, zoo("obstacles", count=6))
    assert names(tmp_path) == ["run"]
    assert path.read_bytes() == before


# --- places


def test_a_checkpoint_replaces_nothing_but_a_checkpoint(tmp_path):
    """Known before the first frame; its `.previous` is protected too, and a folder or a pipe is no place at all."""
    thesis, mine = tmp_path / "thesis.tex", tmp_path / "mine.npz"
    np.savez(mine, header=np.zeros(3))
    (tmp_path / "run.previous").write_text("mine")
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    with simulate(lattice(4, 4), method="grid") as sim:
        for text in ("a year of work", "PK\x03\x04" + 60 * "x"):
            thesis.write_text(text)
            for deed in (sim.save, lambda path: sim.run(frames=1, checkpoint=path)):
                match = r"may replace only a checkpoint; .*thesis\.tex.* another kind.* Choose another name"
                with pytest.raises(mpsim.errors.OutputError, match=match):
                    deed(thesis)
            assert thesis.read_text() == text
        for path, rule in (
            (mine, "another kind"),
            (tmp_path / "run", r"run\.previous"),
            (tmp_path / "pipe", "must be a file; .*pipe"),
            (tmp_path / "folder", "must be a file; .*folder"),
            ("/", "must be a file; '/' is not"),
            (tmp_path / "nowhere" / "run", "needs a folder that exists.* Make .*nowhere"),
            (thesis / "run", r"needs a folder that exists.* '.*thesis\.tex' is a file: give another one"),
        ):
            for deed in (sim.save, lambda path: sim.run(frames=1, checkpoint=path)):
                with pytest.raises(mpsim.errors.OutputError, match=rule):
                    deed(path)
        with pytest.raises(mpsim.errors.OutputError, match="'/proc/run'"):  # new files are refused even to root there
            sim.save("/proc/run")
        for nonsense in (None, 3, "", "a\0b"):
            with pytest.raises(mpsim.InputError, match="must be a file name"):
                sim.save(nonsense)
        assert sim.frame == 0, "a run must be refused before it begins"
    assert (tmp_path / "run.previous").read_text() == "mine"


def test_an_empty_or_cut_checkpoint_may_be_replaced_and_pushes_out_none_that_is_whole(tmp_path):
    """One that is damaged inside ends as it should, so it becomes the previous one, after the new one stands."""
    path = two(tmp_path / "run")
    whole = path.read_bytes()
    inside = bytearray(whole)
    inside[whole.index(b"solver.position.npy") + 200] ^= 1  # behind some 170 bytes of headers
    for content, frames in ((b"", 4), (whole[:200], 5), (inside, 6)):
        path.write_bytes(content)
        saved(path, frames=frames)
        assert frame_in(path) == frames
        if content is not inside:
            assert frame_in(tmp_path / "run.previous") == 2
    with pytest.raises(mpsim.CheckpointError):
        frame_in(tmp_path / "run.previous")


def test_a_relative_path_means_where_the_run_began_and_a_link_leads_to_its_file(tmp_path, monkeypatch):
    """Users put checkpoints on a larger disk by a link; a run of no frames writes its checkpoint, too."""
    (tmp_path / "other").mkdir()
    monkeypatch.chdir(tmp_path)
    with simulate(lattice(4, 4), method="grid") as sim:
        sim.run(frames=0, checkpoint="begun")
        sim.run(frames=9, checkpoint="run", checkpoint_every=3, progress=lambda done, of: os.chdir(tmp_path / "other"))
    assert names(tmp_path) == ["begun", "other", "run", "run.previous"]
    monkeypatch.chdir(tmp_path)
    assert (frame_in("begun"), frame_in("run")) == (0, 9)
    (tmp_path / "link").symlink_to(tmp_path / "other" / "run")
    for frames in (2, 3):
        saved(tmp_path / "link", frames=frames)
    assert (tmp_path / "link").is_symlink()
    assert names(tmp_path / "other") == ["run", "run.previous"]
    assert frame_in(tmp_path / "link") == 3


def bytes_read():
    """What this process has read from files so far."""
    lines = Path("/proc/self/io").read_text().splitlines()
    return int(dict(line.split(": ") for line in lines)["rchar"])


def test_overwriting_a_checkpoint_does_not_read_the_one_that_is_there(tmp_path):
    read = []
    for _ in range(3):
        before = bytes_read()
        saved(tmp_path / "run", lattice(50, 50), frames=0)
        read.append(bytes_read() - before)
    size = (tmp_path / "run").stat().st_size
    assert size > 100_000
    assert max(read[1:]) < read[0] + size / 10
