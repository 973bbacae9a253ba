"""Scene files written to a folder of the test and read."""

import pytest

import mpsim
from mpsim.scene import scenefile


@pytest.fixture
def load(tmp_path):
    """Load a scene file of this text."""

    def load_text(text: str) -> scenefile.SceneFile:
        path = tmp_path / "scene.toml"
        path.write_text(text)
        return scenefile.load(path)

    return load_text


@pytest.fixture
def problems(tmp_path):
    """All that is wrong in a scene file of this text."""

    def problems_of(text: str) -> list[str]:
        path = tmp_path / "scene.toml"
        path.write_text(text)
        with pytest.raises(mpsim.errors.SceneFileError) as caught:
            scenefile.load(path)
        assert caught.value.file.endswith("scene.toml")
        for problem in caught.value.problems:
            assert f"{caught.value.file}: {problem}" in str(caught.value)
        return list(caught.value.problems)

    return problems_of
