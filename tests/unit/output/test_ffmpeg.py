"""Where ffmpeg is found, and what is said if it is nowhere."""

import sys

import pytest

from mpsim.errors import OutputError
from mpsim.output import ffmpeg


def test_the_one_of_the_system_comes_first(tmp_path, monkeypatch):
    own = tmp_path / "ffmpeg"
    own.write_text("#!/bin/sh\n")
    own.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert ffmpeg.executable("wait") == str(own)


def test_then_the_one_of_the_package(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    assert "ffmpeg" in ffmpeg.executable("wait")


def test_without_either_it_says_how_to_have_one(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(OutputError, match=r"pip install 'mpsim\[film\]'`, or install ffmpeg, or write 'a.gif'"):
        ffmpeg.executable("write 'a.gif'")
