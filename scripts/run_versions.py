"""Runs the tests of doors and contracts on each version of Python, with oldest and newest dependencies.

python scripts/run_versions.py                                  all cells
python scripts/run_versions.py --docs docs/contributing.md      and the table there renewed
python scripts/run_versions.py 3.13-lowest --tests tests/doors/test_state.py          one cell, a few tests
python scripts/run_versions.py --long                           with the tests marked long

A cell is an environment of wheels, made by uv, which finds the Pythons: the lowest versions are the bounds in
pyproject.toml, the newest are what uv chooses. Ends with 1 if something could not be installed, a test failed, or
digests differ that must not. What the tests print is kept under results/versions/.
"""

import json
import os
import re
import subprocess
import sys
import tempfile
import time
import tomllib
from functools import cache
from pathlib import Path
from typing import Any

import harness
from harness import TOP, fill_page, parser_of
from packaging.requirements import Requirement

OUT = TOP / "results" / "versions"
TESTS = ("tests/doors", "tests/contracts")
KINDS = ("lowest", "newest")

COMPANIONS = {"pyparsing": "<3.3"}
"""What the lowest versions need of packages that mpsim does not name: pyparsing 3.3 warns of names that Matplotlib 3.8
and 3.9 use, and the tests take warnings for errors."""

PEERS = "peers"
"""The extra of engines that mpsim is compared with, by scripts/run_peers.py alone: nothing here depends on them."""

SCENES = (
    "bare", "periodic", "sub-steps where fast", "everything", "everything rough", "everything exact", "stream exact",
)  # fmt: skip
"""Scenes of tests/support/goldens.py whose digests are compared."""


# --- what pyproject.toml says


@cache
def project() -> dict[str, Any]:
    return tomllib.loads((TOP / "pyproject.toml").read_text())["project"]


def pythons() -> list[str]:
    """Versions of Python that mpsim names."""
    last = [line.split(" :: ")[-1] for line in project()["classifiers"] if "Python :: 3." in line]
    return sorted(last, key=lambda version: int(version.split(".")[1]))


def requirements(python: str, extras: bool = True) -> list[Requirement]:
    """What mpsim depends on under a version of Python."""
    texts = list(project()["dependencies"])
    if extras:
        texts += [text for name, extra in project()["optional-dependencies"].items() if name != PEERS for text in extra]
    found = [each for each in map(Requirement, texts) if each.name != project()["name"]]
    return [each for each in found if each.marker is None or each.marker.evaluate({"python_version": python})]


def lower_bounds(python: str, extras: bool = True) -> dict[str, str]:
    """Lower bounds by name, each stated once."""
    found: dict[str, str] = {}
    for each in requirements(python, extras):
        floors = [clause.version for clause in each.specifier if clause.operator == ">="]
        if len(floors) != 1 or each.name in found:
            raise ValueError(f"pyproject.toml must have one lower bound of {each.name} for Python {python}")
        found[each.name] = floors[0]
    return found


def constraints(python: str, kind: str) -> list[str]:
    """What the installer is held to."""
    if kind == "newest":
        return []
    fixed = [f"{name}=={version}" for name, version in lower_bounds(python).items()]
    return fixed + [name + clause for name, clause in COMPANIONS.items()]


# --- cells


def output_of(command: list[Any], **options: Any) -> str:
    """What a command prints, which has to succeed."""
    return subprocess.run(command, cwd=TOP, capture_output=True, text=True, check=True, **options).stdout


def cell(python: str, kind: str, tests: list[str]) -> dict[str, Any]:
    """Versions in a new environment, the digests of its kernels, and the numbers of its tests by outcome."""
    with tempfile.TemporaryDirectory() as folder:
        inside, held = Path(folder, "bin", "python"), Path(folder, "constraints.txt")
        output_of(["uv", "venv", "--clear", "--python", python, folder])
        held.write_text("\n".join([*constraints(python, kind), ""]))
        install = ["uv", "pip", "install", "-q", "--python", inside, "--only-binary", ":all:", "-c", held]
        output_of([*install, "-e", f"{TOP}[test]"])
        listed = json.loads(output_of(["uv", "pip", "list", "--python", inside, "--format", "json"]))
        versions = {each["name"]: each["version"] for each in listed}
        versions["python"] = output_of([inside, "-V"]).split()[1]
        # Machine code in a folder of its own: nothing that another environment has compiled is taken.
        variables = os.environ | {"NUMBA_CACHE_DIR": f"{folder}/kernels", "PYTHONPATH": str(TOP / "tests")}
        digests = output_of([inside, "-m", "support.goldens", *SCENES], env=variables)
        started = time.monotonic()
        command = [inside, "-m", "pytest", "-p", "no:cacheprovider", "-n", "2", *tests]
        done = subprocess.run(command, cwd=TOP, capture_output=True, text=True, check=False, env=variables)
        seconds = time.monotonic() - started
    (OUT / f"{python}-{kind}.log").write_text(done.stdout + done.stderr)
    numbers = {name: int(number) for number, name in re.findall(r"(\d+) (passed|failed|skipped|error)", done.stdout)}
    kept = {"kind": kind, "versions": versions, "digests": digests, "seconds": seconds, "code": done.returncode}
    return kept | numbers


def disagree(cells: list[dict[str, Any]]) -> bool:
    """Whether scenes end differently under one version of the compiler, against docs/determinism.md."""
    ends = {(found["versions"]["numba"], found["digests"]) for found in cells}
    return len(ends) > len({numba for numba, _ in ends})


def table(cells: list[dict[str, Any]], tests: list[str]) -> str:
    """All cells as a table in Markdown, and what they come to."""
    names = list(lower_bounds(pythons()[0], extras=False))
    head = ["Python", "", *names, "passed", "failed", "skipped", "minutes", "digests"]
    rows = []
    marks = list(dict.fromkeys(found["digests"] for found in cells))
    for found in cells:
        versions = [found["versions"][name] for name in ("python", *names)]
        numbers = [found.get(name, 0) for name in ("passed", "failed", "skipped")]
        ends = [f"{found['seconds'] / 60:.1f}", "ABCDEFGHIJKL"[marks.index(found["digests"])]]
        rows.append([versions[0], found["kind"], *versions[1:], *numbers, *ends])
    said = (
        f"Tests: `{' '.join(tests)}`, at commit {harness.commit()}. Digests of {len(SCENES)} scenes, with and without "
        "features: the same letter means the same bits."
    )
    if len(marks) == 1:
        said += " All are the same, whatever the version of the compiler. This is a finding, not a promise."
    if disagree(cells):
        said += " **Digests differ that must not.**"
    return f"{harness.table(head, rows)}\n\n{said}"


def main() -> int:
    every = [f"{python}-{kind}" for python in pythons() for kind in KINDS]
    parser = parser_of(__doc__)
    parser.add_argument("cells", nargs="*", default=every, help=f"of {', '.join(every)}; default: all")
    parser.add_argument("--tests", nargs="+", default=list(TESTS))
    parser.add_argument("--long", action="store_true", help="also the tests marked long")
    parser.add_argument("--docs", type=Path, help="page whose table is renewed")
    given = parser.parse_args()
    if unknown := set(given.cells) - set(every):
        parser.error(f"no such cell: {', '.join(sorted(unknown))}. Choose from {', '.join(every)}.")
    OUT.mkdir(parents=True, exist_ok=True)
    tests = [*given.tests, *(["--long"] * given.long)]
    cells: list[dict[str, Any]] = []
    for name in given.cells:
        print(f"{name} ...", flush=True)
        try:
            python, kind = name.split("-")
            cells.append(cell(python, kind, tests))
        except subprocess.CalledProcessError as error:
            sys.exit(f"{error}\n{error.stdout}{error.stderr}")
    text = table(cells, tests)
    print(text)
    if given.docs is not None:
        fill_page(given.docs, {"table": text})
    return int(disagree(cells) or any(found["code"] for found in cells))


if __name__ == "__main__":
    sys.exit(main())
