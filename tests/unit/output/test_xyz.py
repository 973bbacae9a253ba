"""The text of an XYZ frame."""

import math
from pathlib import Path

import numpy as np
import pytest

from mpsim.output import xyz
from mpsim.output.frames import Frame, differs


def frame(count, **others):
    """A frame of so many discs with numbers of all sizes."""
    rng = np.random.default_rng(1)
    place, velocity = rng.random((count, 2)), rng.normal(size=(count, 2)) * 10.0 ** rng.integers(-300, 300, (count, 2))
    known = {"time": 0.1, "velocity": velocity, "radius": np.full(count, 0.5), "mass": np.ones(count)}
    return Frame(7, (1.0, 2.0), (0.0, 0.0), (False, False), place, Path(), known | {"ids": np.arange(count)} | others)


def lines_of(written):
    """The lines of its discs, as lists of words."""
    return [line.split() for line in b"".join(map(bytes, xyz.text_of(written))).decode().splitlines()[2:]]


def slow_line(written, index):
    """What the line of a disc must hold, number by number."""
    x, y, vx, vy = map(float, (*written.position[index], *written.velocity[index]))
    mass = float(written.mass[index])
    numbers = [x, y, 0.0, float(written.radius[index]), mass, mass, vx, vy, 0.0, mass * vx, mass * vy, 0.0]
    return ["X", *map(repr, numbers), repr(int(written.ids[index]))]


@pytest.mark.parametrize("count", [1, 2, 300])
@pytest.mark.parametrize("equal", [True, False])
def test_each_line_holds_the_numbers_of_its_disc(count, equal, monkeypatch):
    monkeypatch.setattr(xyz, "PART", 128)
    sizes = {} if equal else {"radius": np.linspace(0.1, 0.5, count), "mass": np.linspace(1, 3, count)}
    written = frame(count, **sizes)
    lines = lines_of(written)
    assert len(lines) == count
    for index, line in enumerate(lines):
        words = slow_line(written, index)
        assert [word if word == "X" else float(word) for word in line] == [
            word if word == "X" else float(word) for word in words
        ]
        assert "." not in line[-1], "a disc's number is a whole one"


def test_zeros_of_both_signs_in_one_column_are_kept():
    written = frame(3, velocity=np.array([[0.0, -0.0], [-0.0, -0.0], [0.0, -0.0]]))
    assert [line[7:9] for line in lines_of(written)] == [["0.0", "-0.0"], ["-0.0", "-0.0"], ["0.0", "-0.0"]]


def test_a_momentum_beyond_float64_is_written_as_such():
    masses = np.array([1e300, 1.0])
    written = frame(2, mass=masses, velocity=np.array([[1e10, -1e10], [1.0, 2.0]]))
    with np.errstate(over="ignore"):
        momenta = [line[10:12] for line in lines_of(written)]
    assert momenta == [["inf", "-inf"], ["1.0", "2.0"]]
    assert math.isinf(float(momenta[0][0]))


def test_a_file_of_several_parts_is_read_back(tmp_path, monkeypatch):
    monkeypatch.setattr(xyz, "PART", 7)
    written = frame(50)
    writer = xyz.XyzWriter(tmp_path / "a.xyz", "w")
    writer.write(written)
    writer.close()
    assert differs(written, xyz.XyzReader(tmp_path / "a.xyz").read(0)) is None
