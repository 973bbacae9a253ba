"""Scene files that can be read, and those that cannot."""

import logging
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from support.scenefiles import HEAD

import mpsim


def test_what_is_read_is_logged(load, tmp_path, caplog):
    (tmp_path / "sub").mkdir()
    np.save(tmp_path / "sub" / "a.npy", np.ones((1, 2)))
    with caplog.at_level(logging.INFO, logger="mpsim"):
        load(HEAD + "[[discs]]\nposition = 'sub/a.npy'\nradius = 0.5\n")
    assert [Path(record.args[0]).name for record in caplog.records] == ["scene.toml", "a.npy"]


def test_an_unknown_name_is_answered_with_the_names():
    with pytest.raises(
        mpsim.InputError, match=r"scene must be a path that ends in \.toml or one of brownian, .*cradle"
    ):
        mpsim.Scene.load("nonsense")
    with pytest.raises(mpsim.InputError, match=r"got 'hoper'\. Did you mean 'hopper'\?"):
        mpsim.Scene.load("hoper")


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(mpsim.InputError, match=r"scene must be a file that can be read; got .*No such file"):
        mpsim.Scene.load(tmp_path / "none.toml")
    (tmp_path / "folder.toml").mkdir()
    with pytest.raises(mpsim.InputError, match=r"scene must be a file that can be read; got .*Is a directory"):
        mpsim.Scene.load(str(tmp_path / "folder.toml"))
    with pytest.raises(mpsim.InputError, match=r"scene must be a name or a path to a \.toml file; got int\."):
        mpsim.Scene.load(3)  # type: ignore[arg-type]
    with pytest.raises(mpsim.InputError, match="scene must be a file that can be read; got"):
        mpsim.Scene.load("a\0.toml")
    (tmp_path / "latin.toml").write_bytes(b"schema = 1 # \xe9")
    with pytest.raises(mpsim.errors.SceneFileError, match=r"the file must be text in UTF-8; got byte 13"):
        mpsim.Scene.load(tmp_path / "latin.toml")


def test_the_error_survives_a_pickle():
    error = mpsim.errors.SceneFileError("a.toml", ["one", "two"])
    again = pickle.loads(pickle.dumps(error))
    assert (str(again), again.problems) == ("2 problems in a scene file:\na.toml: one\na.toml: two", ("one", "two"))


def test_the_checker_is_loaded_only_where_a_file_is_read():
    code = (
        "import sys, mpsim; assert 'pydantic' not in sys.modules; "
        "mpsim.Scene.load('cradle'); assert 'pydantic' in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


@pytest.mark.parametrize("text", ["schema = 1\nschema = 1", "schema = ", "schema = 1" + "0" * 5000, "= 3", "[[discs]"])
def test_what_is_not_toml_is_refused(problems, text):
    (problem,) = problems(text)
    assert problem.startswith("the file must be TOML; got this error: ")
