"""Files that editors mark, and mpsim imported from an archive."""

import subprocess
import sys
import zipfile
from pathlib import Path

import mpsim

SCENE = "schema = 1\nwidth = 10.0\nheight = 8.0\n[[discs]]\nposition = [[1.5, 2.5]]\nradius = 0.5\n"


def test_a_byte_order_mark_before_a_scene_or_a_session_is_no_part_of_it(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(SCENE, encoding="utf-8-sig")
    assert mpsim.Scene.load(path).position.tolist() == [[1.5, 2.5]]
    with mpsim.Simulation(mpsim.Scene.load(path), mpsim.Settings(method="grid", workers=1)) as sim:
        sim.journal.save(tmp_path / "session.toml")
    for each in tmp_path.glob("session*.toml"):
        each.write_bytes(b"\xef\xbb\xbf" + each.read_bytes())
    with mpsim.Simulation.replay(tmp_path / "session.toml") as again:
        assert again.count == 1


def test_named_scenes_are_there_when_mpsim_is_imported_from_an_archive(tmp_path):
    package = Path(mpsim.__file__).parent
    with zipfile.ZipFile(tmp_path / "m.zip", "w") as archive:
        for each in package.rglob("*"):
            if each.is_file() and "__pycache__" not in each.parts:
                archive.write(each, each.relative_to(package.parent))
    code = f"""import sys; sys.path.insert(0, {str(tmp_path / "m.zip")!r})
import mpsim, mpsim.scene.scenefile as files
assert "m.zip" in mpsim.__file__ and files.load("gas").comes_with_mpsim
print(mpsim.Scene.load("gas"), len(files.names()))"""
    ran = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, env={"NUMBA_DISABLE_JIT": "1"}
    )
    from mpsim.scene import scenefile  # noqa: PLC0415

    assert ran.stdout == f"{mpsim.Scene.load('gas')} {len(scenefile.names())}\n", ran.stderr
