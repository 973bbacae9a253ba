"""Where the bytes of a file of arrays stand: other readers find the same arrays, and no two processes share a page."""

import itertools
import zipfile
import zlib

import numpy as np
import pytest

from mpsim.core import archive_layout
from mpsim.core.archive import ArrayFile
from mpsim.core.archive_layout import PAGE, PIECE, around, laid_out, pieces_of
from mpsim.core.chunks import ChunkedArray
from mpsim.core.joint_file import write_at

RNG = np.random.default_rng(1)
ARRAYS = {
    "text": np.frombuffer(b"a header", np.uint8),
    "one": np.asarray(2.5),
    "none": np.zeros((0, 2)),
    "few": RNG.normal(size=(7, 3)).astype(np.float32),
    "many": RNG.normal(size=(2 * PIECE + 5, 2)).astype(np.float32),
    "flags": RNG.integers(0, 9, PIECE + 1).astype(np.int8),
    "just one piece": np.arange(PIECE),
    "last": np.arange(5),
}


def written(path, arrays):
    """The members of a file with all contents, each in a few parts."""
    members, sums = laid_out(arrays), {}
    with path.open("xb") as file:
        for member in members:
            content = arrays[member.name].tobytes()
            write_at(file.fileno(), content, member.begin)
            half = len(content) // 3
            sums[member.name] = [(zlib.crc32(part), len(part)) for part in (content[:half], content[half:])]
        for offset, part in around(members, sums):
            write_at(file.fileno(), part, offset)
    return members


def test_numpy_zipfile_and_our_own_reader_find_the_arrays(tmp_path):
    written(tmp_path / "arrays", ARRAYS)
    with zipfile.ZipFile(tmp_path / "arrays") as file:
        assert file.testzip() is None, "the sums are right"
        assert file.namelist() == [f"{name}.npy" for name in ARRAYS]
    found = np.load(tmp_path / "arrays", allow_pickle=False)
    with (tmp_path / "arrays").open("rb") as file, ArrayFile(file) as own:
        for name, array in ARRAYS.items():
            for other in (found[name], own.read(name), own.map(name)):
                assert (other.dtype, other.shape) == (array.dtype, array.shape)
                assert other.tobytes() == array.tobytes()


def test_a_wrong_sum_is_noticed(tmp_path, monkeypatch):
    """The control of the first test."""
    monkeypatch.setattr(archive_layout, "joined", lambda parts: 12345)
    written(tmp_path / "arrays", ARRAYS)
    with zipfile.ZipFile(tmp_path / "arrays") as file:
        assert file.testzip() == "text.npy"


def test_every_byte_belongs_to_one_part(tmp_path):
    members = laid_out(ARRAYS)
    for one, other in itertools.pairwise(members):
        assert one.end == other.start
    for member in members:
        assert member.begin == member.start + 30 + len(f"{member.name}.npy") + 20 + len(member.head)
    written(tmp_path / "arrays", ARRAYS)
    directory = sum(46 + len(f"{name}.npy") + 28 for name in ARRAYS)
    assert (tmp_path / "arrays").stat().st_size == members[-1].end + directory + 56 + 20 + 22


def test_pieces_of_an_array_of_several_begin_with_a_page():
    found = {member.name: member for member in laid_out(ARRAYS)}
    shared = [name for name, array in ARRAYS.items() if len(pieces_of(array.shape)) > 1]
    assert shared == ["many", "flags"]
    for name in shared:
        for first, _ in pieces_of(ARRAYS[name].shape):
            assert (found[name].begin + first * ARRAYS[name][0].nbytes) % PAGE == 0
    assert found["last"].begin % PAGE, "small ones take no more than they need"


@pytest.mark.parametrize("count", [2**28, 2**29])
def test_files_beyond_four_gigabytes(count, tmp_path):
    """Zeros that take no room on the disk, and an array behind them."""
    zeros = ChunkedArray(np.dtype(np.float64), (count, 2), lambda first, last: np.zeros((last - first, 2)))
    arrays = {"zeros": zeros, "last": np.arange(5)}
    first, last = members = laid_out(arrays)
    assert last.start > 2**32
    million = (zlib.crc32(bytes(2**20)), 2**20)
    sums = {"zeros": [million] * (first.nbytes // 2**20), "last": [(zlib.crc32(arrays["last"].tobytes()), 40)]}
    path = tmp_path / "arrays"
    with path.open("xb") as file:
        write_at(file.fileno(), arrays["last"].tobytes(), last.begin)
        for offset, part in around(members, sums):
            write_at(file.fileno(), part, offset)
    try:
        with path.open("rb") as file, ArrayFile(file) as own:
            assert own.read("last").tolist() == np.load(path)["last"].tolist() == [0, 1, 2, 3, 4]
            assert own.map("zeros").shape == (count, 2)
            assert own.map("zeros")[-1].tolist() == [0.0, 0.0]
        with zipfile.ZipFile(path) as file:
            assert next(info.file_size for info in file.infolist()) == first.nbytes + len(first.head)
    finally:
        path.unlink()
