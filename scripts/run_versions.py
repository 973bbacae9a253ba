"""Runs the tests of units and contracts on each version of Python, with oldest and newest dependencies.

python scripts/run_versions.py                                  every cell that is not under results/versions/ yet
python scripts/run_versions.py --docs docs/contributing.md      and the table there renewed
python scripts/run_versions.py 3.13-lowest --tests tests/doors/test_state.py          one cell, a few tests
python scripts/run_versions.py --long                           with the tests marked long
python scripts/run_versions.py --install                        only make the environments: can all be had together?

A cell is an environment of wheels, made by uv if that is on the path, which is quicker, or by pip: the lowest versions
are the bounds in pyproject.toml, the newest are what the installer chooses. Ends with 1 if something could not be
installed, a test failed, or digests differ that must not.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from packaging.requirements import Requirement
from pages import fill_page

TOP = Path(__file__).parents[1]
TESTS = ("tests/doors", "tests/contracts")
KINDS = ("lowest", "newest")

COMPANIONS = {"pyparsing": "<3.3"}
"""What the lowest versions need of packages that mpsim does not name: pyparsing 3.3 warns of names that Matplotlib 3.8
and 3.9 use, and the tests take warnings for errors."""

PEERS = "peers"
"""The extra of engines that mpsim is compared with, by scripts/run_peers.py alone: nothing here depends on them."""

SCENES = (
    "bare",
    "periodic",
    "sub-steps where fast",
    "everything",
    "everything rough",
    "everything exact",
    "stream exact",
)
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
    found = [Requirement(text) for text in texts]
    return [
        each
        for each in found
        if each.name != project()["name"] and (each.marker is None or each.marker.evaluate({"python_version": python}))
    ]


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


# --- environments


def interpreter(python: str) -> Path | None:
    """A Python of this version, from the path or from pyenv, that starts."""
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    on_path = shutil.which(f"python{python}")
    for path in [*([Path(on_path)] if on_path else []), *sorted(pyenv.glob(f"{python}.*/bin/python"))]:
        said = run([path, "-c", "import sys; print('%d.%d' % sys.version_info[:2])"])
        if said.returncode == 0 and said.stdout.strip() == python:
            return path
    return None


def environment(python: str, kind: str, made_from: Path, folder: Path) -> Path:
    """Interpreter of the cell's environment, made anew unless it is there and was made from the same bounds."""
    inside, mark, held = folder / "bin" / "python", folder / "made_from.txt", constraints(python, kind)
    wanted = "\n".join([str(made_from), *map(str, requirements(python)), *held, ""])
    if mark.exists() and mark.read_text() == wanted:
        return inside
    shutil.rmtree(folder, ignore_errors=True)
    must([made_from, "-m", "venv", folder])
    (folder / "constraints.txt").write_text("\n".join([*held, ""]))
    uv = shutil.which("uv")
    installer = [uv, "pip", "install", "--python", inside] if uv else [inside, "-m", "pip", "install"]
    must([*installer, "-q", "--only-binary", ":all:", "-c", folder / "constraints.txt", "-e", f"{TOP}[test]"])
    mark.write_text(wanted)
    return inside


def versions_in(python: Path, names: Iterable[str]) -> dict[str, str]:
    """Versions in an environment, that of Python first."""
    asked = (
        "import json, platform, sys; from importlib.metadata import version; "
        "print(json.dumps({'python': platform.python_version()} | {name: version(name) for name in sys.argv[1:]}))"
    )
    return json.loads(must([python, "-c", asked, *names]))


def run(command: list[Any], **options: Any) -> subprocess.CompletedProcess[str]:
    words = [str(word) for word in command]
    return subprocess.run(words, cwd=TOP, capture_output=True, text=True, check=False, **options)


def must(command: list[Any], **options: Any) -> str:
    """Output of a command that has to succeed."""
    done = run(command, **options)
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(map(str, command))}\n{done.stdout}{done.stderr}")
    return done.stdout


# --- one cell


def cell(python: str, kind: str, made_from: Path, given: argparse.Namespace) -> dict[str, Any]:
    """An environment, the digests of its kernels, and its tests."""
    started = time.monotonic()
    found: dict[str, Any] = {"python": python, "kind": kind, "constraints": constraints(python, kind), **asked(given)}
    found["commit"] = must(["git", "describe", "--always", "--dirty"]).strip()
    folder = given.environments / f"{python}-{kind}"
    try:
        inside = environment(python, kind, made_from, folder)
        found["versions"] = versions_in(inside, lower_bounds(python))
        if given.install:
            return found | {"exit_code": 0}
        # Machine code in a folder of its own: nothing that another environment has compiled is taken.
        variables = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
        variables["NUMBA_CACHE_DIR"] = str(folder / "kernels")
        support = variables | {"PYTHONPATH": str(TOP / "tests")}
        found["scenes"] = json.loads(must([inside, "-m", "support.goldens", *SCENES], env=support))
    except RuntimeError as error:
        return found | {"broken": str(error)[-4000:]}
    found |= tested(inside, variables, given.out / f"{python}-{kind}", given)
    return found | {"seconds": time.monotonic() - started}


def tested(inside: Path, variables: dict[str, str], out: Path, given: argparse.Namespace) -> dict[str, Any]:
    """How many tests passed, failed (by name) and were skipped; what they printed is kept beside."""
    report, log = (out.with_name(f"{out.name}.{ending}") for ending in ("xml", "log"))
    report.unlink(missing_ok=True)
    words = ["-p", "no:cacheprovider", "-n", given.processes, f"--junitxml={report}", *(["--long"] * given.long)]
    done = run([inside, "-m", "pytest", *given.tests, *words], env=variables)
    log.write_text(done.stdout + done.stderr)
    if not report.exists():
        return {"broken": (done.stdout + done.stderr)[-4000:]}
    cases = list(ElementTree.parse(report).iter("testcase"))
    failed = [f"{case.get('classname')}.{case.get('name')}" for case in cases if outcome(case) == "failed"]
    skipped = sum(outcome(case) == "skipped" for case in cases)
    passed = len(cases) - len(failed) - skipped
    return {"passed": passed, "failed": failed, "skipped": skipped, "exit_code": done.returncode}


def outcome(case: ElementTree.Element) -> str:
    ends = {part.tag for part in case}
    return "failed" if ends & {"failure", "error"} else "skipped" if "skipped" in ends else "passed"


def asked(given: argparse.Namespace) -> dict[str, Any]:
    return {"tests": [] if given.install else list(given.tests), "long": given.long}


def kept(file: Path, python: str, kind: str, given: argparse.Namespace) -> dict[str, Any] | None:
    """A cell of an earlier call, if it has asked the same of the same bounds."""
    if given.fresh or not file.exists():
        return None
    found = json.loads(file.read_text())
    same = found["constraints"] == constraints(python, kind) and all(found[k] == v for k, v in asked(given).items())
    return found if same and "broken" not in found else None


# --- all cells


def good(found: dict[str, Any]) -> bool:
    return "broken" not in found and found["exit_code"] == 0


def disagreements(cells: list[dict[str, Any]]) -> list[str]:
    """Scenes that end differently under one version of the compiler, against docs/determinism.md."""
    ends: dict[tuple[str, str], set[str]] = {}
    for found in cells:
        for name, digests in found.get("scenes", {}).items():
            ends.setdefault((name, found["versions"]["numba"]), set()).add(json.dumps(digests, sort_keys=True))
    return [f"{name} with Numba {numba}" for (name, numba), digests in ends.items() if len(digests) > 1]


def table(cells: list[dict[str, Any]], missing: list[str]) -> str:
    """All cells as a table in Markdown, and what they come to."""
    names = list(lower_bounds(pythons()[0], extras=False))
    head = ["Python", "", *names, "passed", "failed", "skipped", "minutes", "digests"]
    lines = [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
    marks: dict[str, str] = {}
    for found in cells:
        if "broken" in found:
            cause = found["broken"].strip().splitlines()[-1]
            lines.append(f"| {found['python']} | {found['kind']} | does not run: {cause} |" + " |" * (len(head) - 3))
            continue
        versions = [found["versions"][name] for name in ("python", *names)]
        row = [versions[0], found["kind"], *versions[1:], *results(found, marks)]
        lines.append(f"| {' | '.join(map(str, row))} |")
    lines += ["", summary(cells, missing, len(marks))]
    return "\n".join(lines)


def results(found: dict[str, Any], marks: dict[str, str]) -> list[Any]:
    """The last columns of a cell; marks are letters by the digests of the scenes, and renewed."""
    if not found["tests"]:
        return ["-"] * 5
    scenes = json.dumps(found["scenes"], sort_keys=True)
    mark = marks.setdefault(scenes, "ABCDEFGHIJKL"[len(marks)])
    return [found["passed"], len(found["failed"]), found["skipped"], f"{found['seconds'] / 60:.1f}", mark]


def summary(cells: list[dict[str, Any]], missing: list[str], marks: int) -> str:
    tests = sorted({" ".join([*found["tests"], *(["--long"] * found["long"])]) for found in cells if found["tests"]})
    commits = sorted({found["commit"] for found in cells if found["tests"]})
    named = f"Tests: {'; '.join(f'`{each}`' for each in tests)}, at commit {', '.join(commits)}."
    said = [named if tests else "Installed; no tests were run."]
    if marks:
        said.append(f"Digests of {len(SCENES)} scenes, with and without features: the same letter means the same bits.")
    if cells and marks == 1:
        said.append("All are the same, whatever the version of the compiler. This is a finding, not a promise.")
    if differing := disagreements(cells):
        said.append(f"**Digests differ that must not**: {'; '.join(differing)}.")
    if missing:
        said.append(f"Not found on this machine: Python {', '.join(missing)}.")
    return " ".join(said)


def main() -> int:
    given = arguments()
    given.out.mkdir(parents=True, exist_ok=True)
    found = {python: interpreter(python) for python in pythons()}
    missing = [python for python, path in found.items() if path is None]
    cells = []
    for python, kind in ((python, kind) for python in pythons() for kind in KINDS):
        file, made_from = given.out / f"{python}-{kind}.json", found[python]
        result = kept(file, python, kind, given)
        if result is None and made_from is not None and (not given.cells or f"{python}-{kind}" in given.cells):
            print(f"{python}, {kind} ...", flush=True)
            result = cell(python, kind, made_from, given)
            file.write_text(json.dumps(result, indent=1))
            print(result.get("broken") or "\n".join(f"failed: {name}" for name in result.get("failed", [])))
        cells += [result] if result else []
    text = table(cells, missing)
    print(text)
    if given.docs is not None:
        fill_page(given.docs, "run_versions", {"table": text}, {})
    return 0 if all(map(good, cells)) and not disagreements(cells) else 1


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    every = [f"{python}-{kind}" for python in pythons() for kind in KINDS]
    parser.add_argument("cells", nargs="*", help=f"of {', '.join(every)}; default: all")
    parser.add_argument("--tests", nargs="+", default=list(TESTS))
    parser.add_argument("--long", action="store_true", help="also the tests marked long")
    parser.add_argument("--install", action="store_true", help="only make the environments")
    parser.add_argument("--processes", type=int, default=2, help="in which the tests run")
    parser.add_argument("--fresh", action="store_true", help="run what earlier calls have kept as well")
    parser.add_argument("--environments", type=Path, default=Path(tempfile.gettempdir()) / "mpsim-versions")
    parser.add_argument("--out", type=Path, default=TOP / "results" / "versions")
    parser.add_argument("--docs", type=Path, help="page whose table is renewed")
    given = parser.parse_args()
    if unknown := set(given.cells) - set(every):
        parser.error(f"no such cell: {', '.join(sorted(unknown))}. Choose from {', '.join(every)}.")
    return given


if __name__ == "__main__":
    sys.exit(main())
