"""A real JupyterLab for tests of the widget: a server of its own, which keeps all its files in one folder."""

import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from support.browser import until

TOKEN = "of-this-test"


def write_notebook(path: Path, *cells: str) -> None:
    """A notebook of cells with code."""
    made = [
        {"cell_type": "code", "id": f"cell-{k}", "metadata": {}, "source": text, "outputs": [], "execution_count": None}
        for k, text in enumerate(cells)
    ]
    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    path.write_text(json.dumps({"cells": made, "metadata": {"kernelspec": kernel}, "nbformat": 4, "nbformat_minor": 5}))


@contextmanager
def jupyterlab(folder: Path) -> Iterator[str]:
    """Serves the notebooks of a folder; gives the address that notebooks are below."""
    pytest.importorskip("jupyterlab", reason="JupyterLab is left out: it is not installed (pip install jupyterlab)")
    own = {
        name: str(folder / ".jupyter" / name)
        for name in ("JUPYTER_CONFIG_DIR", "JUPYTER_DATA_DIR", "JUPYTER_RUNTIME_DIR", "IPYTHONDIR",
                     "JUPYTERLAB_SETTINGS_DIR", "JUPYTERLAB_WORKSPACES_DIR")
    }  # fmt: skip
    command = [sys.executable, "-m", "jupyterlab", "--no-browser", "--allow-root", "--ServerApp.port=0",
               f"--IdentityProvider.token={TOKEN}", f"--ServerApp.root_dir={folder}",
               "--LabApp.extension_manager=readonly"]  # fmt: skip
    log = folder / "server.log"
    with log.open("wb") as out:
        server = subprocess.Popen(command, env={**os.environ, **own}, stdout=out, stderr=out, cwd=folder)
    try:
        found = until(lambda: re.search(r"http://127\.0\.0\.1:\d+/", log.read_text()))
        yield f"{found[0]}lab/tree/{{}}?token={TOKEN}"
    finally:
        server.terminate()
        server.wait(60)


class Lab:
    """A notebook that is open in JupyterLab."""

    def __init__(self, opened: Any, address: str, size: tuple[int, int] = (1280, 1000)):
        self.page = opened.new_page(viewport={"width": size[0], "height": size[1]})
        self.page.goto(address)
        self.page.wait_for_selector(".jp-Cell .cm-content", timeout=60_000)
        until(lambda: "Idle" in self.page.inner_text("#jp-main-statusbar"))  # of the kernel

    def run(self, number: int) -> None:
        """Run a cell, without waiting for its end."""
        self.page.click(f".jp-Cell >> nth={number} >> .cm-content")
        self.page.keyboard.press("Control+Enter")

    def output(self, number: int) -> str:
        return self.page.inner_text(f".jp-Cell >> nth={number} >> .jp-Cell-outputArea")

    @property
    def frame(self) -> Any:
        """The frame of the view."""
        return self.page.wait_for_selector("iframe[title=mpsim]", timeout=60_000).content_frame()
