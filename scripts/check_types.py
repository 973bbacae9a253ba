"""Checks that every public name of mpsim has a complete type (pyright --verifytypes).

Also whether pyright refuses misspelt words, such as `Settings(method="gird")`.

python scripts/check_types.py          counts them, and names each that lacks one; exit code 1 unless none does

Pyright looks at installed packages only. So the package is copied into a virtual environment of its own, which sees
the dependencies of this one.
"""

import json
import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import venv
from collections.abc import Callable
from pathlib import Path
from typing import Any

TOP = Path(__file__).parents[1]

LEFT_OUT = ("mpsim.kernels.", "mpsim.cli.")
"""Kernels take whatever the compiler makes of their arguments: hints would say nothing that it heeds. Commands are
called by their words, not imported."""


MISSPELT = {
    'mpsim.Settings(method="gird")': True,
    'mpsim.Settings(law="elastisch")': True,
    'mpsim.Settings(metod="grid")': True,
    'mpsim.Scene.random(count=100, radius=0.5, packing=0.2, boundary="periodc")': True,
    'mpsim.Scene(width=9, height=9, position=[], velocity=[], radius=1, absorbing=["rigth"])': True,
    'mpsim.animate(mpsim.Scene.load("gas"), path="gas.gif", theme="drak")': True,
    'mpsim.Scene.random(count=9, radius=0.5, packing=0.2, boundary=("periodic", "walls"))': False,
    "mpsim.Scene.random(cout=100, radius=0.5, packing=0.2)": True,
    'mpsim.Settings(method="grid", law="elastic", contact="push", precision="float32", on_fast="substep")': False,
}
"""Lines of a program, and whether pyright must refuse them."""


def install(folder: Path) -> Path:
    """A virtual environment that holds mpsim; returns the folder of its programs."""
    context = venv.EnvBuilder(symlinks=True).ensure_directories(folder)
    venv.create(folder, symlinks=True)
    site = Path(sysconfig.get_path("purelib", vars={"base": str(folder)}))
    shutil.copytree(TOP / "mpsim", site / "mpsim", ignore=shutil.ignore_patterns("__pycache__"))
    (site / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    return Path(context.bin_path)


def incomplete(report: dict[str, Any]) -> tuple[int, list[dict[str, Any]]]:
    """Number of public names of the library, and those of them whose type is not complete."""
    symbols = [each for each in report["typeCompleteness"]["symbols"] if each["isExported"]]
    symbols = [each for each in symbols if not each["name"].startswith(LEFT_OUT)]
    return len(symbols), [each for each in symbols if not each["isTypeKnown"] or each["isTypeAmbiguous"]]


def misjudged(folder: Path, run: Callable[..., dict[str, Any]]) -> list[str]:
    """Lines of MISSPELT that pyright accepts though it must refuse them, or the other way round."""
    program = folder / "misspelt.py"
    program.write_text("\n".join(["import mpsim", *MISSPELT]))
    refused = {each["range"]["start"]["line"] for each in run(str(program))["generalDiagnostics"]}
    return [text for line, (text, wrong) in enumerate(MISSPELT.items(), start=1) if (line in refused) != wrong]


def main() -> int:
    with tempfile.TemporaryDirectory() as folder:
        programs = install(Path(folder, "environment"))
        path = f"{programs}{os.pathsep}{os.environ['PATH']}"
        environment = os.environ | {"PATH": path, "VIRTUAL_ENV": str(programs.parent)}

        def run(*words: str) -> dict[str, Any]:
            command = [sys.executable, "-m", "pyright", *words, "--outputjson"]
            done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
            return json.loads(done.stdout)

        number, missing = incomplete(run("--verifytypes", "mpsim", "--ignoreexternal"))
        wrong = misjudged(Path(folder), run)
    for each in missing:
        reasons = "; ".join(found["message"].splitlines()[0] for found in each["diagnostics"])
        print(f"{each['name']}: {reasons or 'its type holds one that is not complete'}")
    print(f"{number - len(missing)} of {number} public names have a complete type")
    for text in wrong:
        print(f"misjudged: {text}")
    print(f"{len(MISSPELT) - len(wrong)} of {len(MISSPELT)} lines with and without a misspelt word judged rightly")
    return 0 if number and not missing and not wrong else 1


if __name__ == "__main__":
    sys.exit(main())
