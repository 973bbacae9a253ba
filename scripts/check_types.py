"""Whether every public name of mpsim has a complete type: pyright --verifytypes, on the package as it is installed.

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
from pathlib import Path
from typing import Any

TOP = Path(__file__).parents[1]

LEFT_OUT = ("mpsim.kernels.", "mpsim.cli.")
"""Kernels take whatever the compiler makes of their arguments: hints would say nothing that it heeds. Commands are
called by their words, not imported."""


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


def main() -> int:
    with tempfile.TemporaryDirectory() as folder:
        programs = install(Path(folder, "environment"))
        command = [sys.executable, "-m", "pyright", "--verifytypes", "mpsim", "--ignoreexternal", "--outputjson"]
        path = f"{programs}{os.pathsep}{os.environ['PATH']}"
        environment = os.environ | {"PATH": path, "VIRTUAL_ENV": str(programs.parent)}
        done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    number, missing = incomplete(json.loads(done.stdout))
    for each in missing:
        reasons = "; ".join(found["message"].splitlines()[0] for found in each["diagnostics"])
        print(f"{each['name']}: {reasons or 'its type holds one that is not complete'}")
    print(f"{number - len(missing)} of {number} public names have a complete type")
    return 0 if number and not missing else 1


if __name__ == "__main__":
    sys.exit(main())
