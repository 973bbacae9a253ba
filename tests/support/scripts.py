"""Scripts of the project as modules."""

import importlib
from typing import Any

import pytest

from support.script_server import PACKAGE_PARENT


def fixture_of(name: str) -> Any:
    """A fixture of a module of tests: a script, imported as its neighbours in its folder import it."""

    @pytest.fixture(scope="module")
    def script():
        with pytest.MonkeyPatch.context() as patch:
            patch.syspath_prepend(PACKAGE_PARENT / "scripts")
            return importlib.import_module(name)

    return script
