"""The widget in a real JupyterLab: shown, played, dragged, scrolled away, shown twice; its kernel killed."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from support.browser import browser, until
from support.processes import blocks_of, descendants_of, is_gone

pytestmark = pytest.mark.long  # a server, a kernel and a browser: half a minute

SHOW = """import mpsim
scene = mpsim.Scene.random(count=100, packing=0.3, radius=0.5, seed=0)
sim = mpsim.Simulation(scene, mpsim.Settings(method="grid"))
live = mpsim.live(sim, name="a gas")
live"""
COMPARE = """with mpsim.Simulation(scene, mpsim.Settings(method="grid")) as alone:
    alone.run(frames=sim.frame)
    print("frame", sim.frame, alone.digest() == sim.digest())"""
BUSY = """import time
begun = sim.frame
time.sleep(2)
print("frames while it was busy:", sim.frame - begun)"""
CHANGED = 'print("changes", len(sim.journal))'
AGAIN = "live"
CLOSE = 'live.close(); sim.close(); print("closed")'


@pytest.fixture
def lab(tmp_path):
    write_notebook(tmp_path / "a.ipynb", SHOW, COMPARE, BUSY, CHANGED, AGAIN, CLOSE)
    with jupyterlab(tmp_path) as address, browser() as opened:
        yield Lab(opened, address.format("a.ipynb"), size=(1280, 1800))


def shown(frame) -> int:
    return int(frame.get_attribute("#stage", "data-frame") or -1)


def assert_files_are_downloaded(page, frame):
    frame.click("#keep summary")
    for button, begin in (("#keep-session", b"PK"), ("#keep-film", b"GIF8")):
        with page.expect_download() as found:
            frame.click(button)
        assert Path(found.value.path()).read_bytes().startswith(begin)
    assert frame.inner_text("#keep-note").startswith("a_gas-")


def assert_keys_belong_to_the_page(lab, frame):
    """While it has the focus, a is the tool that adds discs; in the notebook it is a new cell."""
    cells = lab.page.locator(".jp-Cell").count()
    frame.focus("#stage")
    lab.page.keyboard.press("a")
    until(lambda: frame.get_attribute("#tool-add", "aria-pressed") == "true")
    lab.page.keyboard.press("x")
    until(lambda: frame.get_attribute("#tool-remove", "aria-pressed") == "true")
    assert lab.page.locator(".jp-Cell").count() == cells


def test_the_widget_in_jupyterlab(lab):
    complaints = []
    lab.page.on("pageerror", lambda error: complaints.append(str(error)))
    lab.run(0)
    frame = lab.frame
    until(lambda: shown(frame) > 10)
    assert frame.inner_text("#name") == "a gas"
    assert not frame.is_visible("#keep-address")
    # paused: the bits are those of a run alone, and the page shows the frame of the simulation
    frame.click("#play")
    until(lambda: frame.inner_text("#phase") == "paused")
    lab.run(1)
    found = until(lambda: "frame" in lab.output(1) and lab.output(1)).split()
    assert found[2] == "True"
    assert shown(frame) == int(found[1])
    assert_files_are_downloaded(lab.page, frame)
    assert_keys_belong_to_the_page(lab, frame)
    # a disc is removed by hand
    frame.focus("#stage")
    for key in ("h", "k", "Enter", "Shift+ArrowRight"):
        lab.page.keyboard.press(key)
    time.sleep(1)
    lab.run(3)
    assert int(until(lambda: "changes" in lab.output(3) and lab.output(3)).split()[1]) >= 1
    # it goes on while another cell runs
    frame.click("#play")
    until(lambda: frame.inner_text("#phase") == "playing")
    before = shown(frame)
    lab.run(2)
    until(lambda: "[*]" in lab.page.inner_text(".jp-Cell >> nth=2"))
    until(lambda: shown(frame) > before + 20, 10)
    assert int(until(lambda: "busy:" in lab.output(2) and lab.output(2)).split()[-1]) > 20
    # shown twice: both show the same run
    lab.run(4)
    until(lambda: lab.page.locator("iframe[title=mpsim]").count() == 2)
    second = lab.page.query_selector_all("iframe[title=mpsim]")[1].content_frame()
    until(lambda: shown(second) > 10)
    second.click("#play")
    until(lambda: frame.inner_text("#phase") == second.inner_text("#phase") == "paused")
    # scrolled away it rests, though it plays
    second.click("#play")
    until(lambda: frame.inner_text("#phase") == "playing")
    lab.page.set_viewport_size({"width": 1280, "height": 200})
    time.sleep(1)
    before = shown(second)
    time.sleep(0.5)
    assert shown(second) == before
    lab.page.set_viewport_size({"width": 1280, "height": 1800})
    until(lambda: shown(second) > before)
    lab.run(5)
    until(lambda: "closed" in lab.output(5))
    assert complaints == []


WORKERS = (
    SHOW.replace('method="grid"', 'method="parallel", workers=2')
    + """
import os
print("process", os.getpid())"""
)


def test_a_killed_kernel_leaves_nothing_and_its_page_says_so(tmp_path):
    write_notebook(tmp_path / "a.ipynb", WORKERS, AGAIN)
    with jupyterlab(tmp_path) as address, browser() as opened:
        lab = Lab(opened, address.format("a.ipynb"))
        lab.run(0)
        process = int(until(lambda: "process" in lab.output(0) and lab.output(0)).split()[-1])
        lab.run(1)
        frame = lab.frame
        until(lambda: shown(frame) > 10)
        workers = descendants_of(process)
        assert workers
        assert blocks_of(process)
        os.kill(process, signal.SIGKILL)
        until(lambda: not blocks_of(process) and all(map(is_gone, workers)), 10)
        until(lambda: frame.inner_text("#notice").startswith("Python does not answer"), 60)
        assert frame.inner_text("#phase") == "connecting"


# --- a server of its own, which keeps all its files in one folder

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
