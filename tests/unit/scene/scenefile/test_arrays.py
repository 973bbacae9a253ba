"""Arrays beside a scene file: wrong ones are named, and none can do harm."""

import os
import pickle

import numpy as np
import pytest
from support.scenefiles import HEAD

FILES = {
    "none.npy": (None, "must be a file that exists; got 'none.npy': no such file in "),
    "folder.npy": ("folder", "must be a file that exists; got 'folder.npy': a folder in "),
    "text.npy": (b"hello", "must be an array of real numbers as numpy.save writes it; text.npy is not ("),
    "empty.npy": (b"", "must be an array of real numbers as numpy.save writes it; empty.npy is not ("),
    "x.txt": (b"1,2", "must be numbers or the name of a .npy or .csv file; got 'x.txt'."),
    "ragged.csv": (
        b"x,y\n1,2\n3,4,5\n",
        "must have as many numbers in every row; line 3 of ragged.csv has 3, and line 2 has 2.",
    ),
    "words.csv": (b"1,2\n3,four\n", "must be numbers; line 2 of words.csv has 'four'."),
    "mixed.csv": (b"1,y\n3,4\n", "must be numbers; line 1 of mixed.csv has 'y'."),
    "bytes.csv": (b"\xff\xfe\x00", "must be a text file of numbers; bytes.csv is not ("),
    "nan.csv": (b"1,2\nnan,4\n", "must be finite; discs"),
    "wide.csv": (b"1,2,3\n", "must have shape (N, 2); got shape (1, 3). Reshape the array."),
    "column.csv": (b"1\n2\n", "must have shape (N, 2); got shape (2,). Reshape the array."),
}


@pytest.mark.parametrize("name", FILES)
def test_a_wrong_array_file_is_named(problems, tmp_path, name):
    content, expected = FILES[name]
    if content == "folder":
        (tmp_path / name).mkdir()
    elif content is not None:
        (tmp_path / name).write_bytes(content)
    (text,) = problems(HEAD + f"[[discs]]\nposition = '{name}'\nradius = 0.5\n")
    assert text.startswith(f"discs[0].position {expected}".replace("; discs", "; position"))


HOLDS = "must be an array of real numbers as numpy.save writes it; a.npy is not ('a.npy' holds "


@pytest.mark.parametrize(
    ("array", "expected"),
    [
        (np.zeros((3, 2), complex), HOLDS + "complex128). Save it anew."),
        (np.array([["a", "b"]]), HOLDS + "<U1). Save it anew."),
        (np.zeros((3, 2), bool), HOLDS + "bool). Save it anew."),
        (np.zeros(4), "must have shape (N, 2); got shape (4,). Reshape the array."),
        (np.full((2, 2), np.inf), "must be finite; position[0, 0] is inf (such values: 4). "),
    ],
)
def test_a_wrong_array_is_named(problems, tmp_path, array, expected):
    np.save(tmp_path / "a.npy", array)
    (text,) = problems(HEAD + "[[discs]]\nposition = 'a.npy'\nradius = 0.5\n")
    assert text.startswith(f"discs[0].position {expected}")


def test_a_header_that_promises_more_than_the_file_holds_is_refused(problems, tmp_path):
    np.save(tmp_path / "a.npy", np.zeros((2, 2)))
    content = (tmp_path / "a.npy").read_bytes().replace(b"(2, 2)", b"(10000000000000000, 2)")[:-16]
    (tmp_path / "a.npy").write_bytes(content)
    (text,) = problems(HEAD + "[[discs]]\nposition = 'a.npy'\nradius = 0.5\n")
    assert text.startswith("discs[0].position must be an array of real numbers as numpy.save writes it; a.npy is not (")


class Bomb:
    """Makes a file when it is unpickled."""

    def __reduce__(self):
        return os.mkdir, ("exploded",)


def test_no_file_can_run_code(problems, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    np.save(tmp_path / "a.npy", np.array([[Bomb(), 2]], dtype=object), allow_pickle=True)
    (tmp_path / "b.npy").write_bytes(pickle.dumps(Bomb()))
    for name in ("a", "b"):
        (text,) = problems(HEAD + f"[[discs]]\nposition = '{name}.npy'\nradius = 0.5\n")
        assert text.startswith("discs[0].position must be an array of real numbers as numpy.save writes it")
    assert not (tmp_path / "exploded").exists()
    np.load(tmp_path / "a.npy", allow_pickle=True)  # negative control: the file is a bomb
    assert (tmp_path / "exploded").exists()


def test_no_file_leads_out_of_its_folder(problems, tmp_path):
    outside = tmp_path.parent / f"{tmp_path.name}-outside.npy"
    np.save(outside, np.ones((1, 2)))
    (tmp_path / "link.npy").symlink_to(outside)
    for name in (f"../{outside.name}", str(outside), "link.npy", "sub/../../x.npy", "~/x.npy/../../../x.csv"):
        (text,) = problems(HEAD + f"[[discs]]\nposition = '{name}'\nradius = 0.5\n")
        assert text.startswith("discs[0].position must be a file in the folder of the scene file, or below; got")
    (text,) = problems(HEAD + '[[discs]]\nposition = "a\\u0000.npy"\nradius = 0.5\n')
    assert text.startswith("discs[0].position must be a file")
