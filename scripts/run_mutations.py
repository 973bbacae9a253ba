"""Plants faults in mpsim, one at a time, and says which of them the default tests catch.

python scripts/run_mutations.py draw             draw faults by seed, into tests/mutations.json
python scripts/run_mutations.py run              the last commit with each fault: a row of a table each
python scripts/run_mutations.py run --only 3 17
python scripts/run_mutations.py control          the last commit as it is, which must pass

A fault is one changed operator or constant, or one dropped statement, of the modules in FAMILIES, as in mutation
testing (DeMillo, Lipton and Sayward, Computer 11(4), 34, 1978). It is kept as the lines before and after, and is found
by these lines in any module, so that it stays when code moves; where the line itself changes, it has to be drawn anew.

The tests that its family is likely to fail run first, without compilation, and the whole default suite only where they
pass: what a part of the suite catches, the suite catches.
"""

import argparse
import ast
import json
import os
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
KEPT = ROOT / "tests/mutations.json"

MACHINE_CODE = Path(tempfile.gettempdir()) / "mpsim-mutations"
"""Where the machine code of the copies is kept: those whose fault is in no kernel share it."""

FAMILIES = {
    "contacts": [
        "kernels/frame/contacts",
        "kernels/frame/motion",
        "kernels/features/edges",
        "kernels/features/capsules",
    ],
    "laws": ["kernels/frame/laws", "kernels/features/friction", "kernels/geometry", "kernels/frame/motion"],
    "sort": ["kernels/frame/sorting"],
    "events": ["kernels/events/calendar", "kernels/events/cells", "kernels/events/impacts"],
    "windows": ["kernels/events/windows"],
    "checkpoint": ["engine/checkpoint", "core/archive"],
    "changes": ["engine/changes", "engine/journal"],
    "statistics": ["measure/statistics", "measure/registry", "measure/observables", "measure/correlations"],
    "readers": ["output/xyz", "output/gsd", "scene/scenefile"],
}
"""Modules in which faults are drawn, by subject."""

FIRST = {
    **{
        family: ["tests/contracts/test_golden.py", "tests/twins", "tests/contracts", "tests/physics"]
        for family in ("contacts", "laws", "sort", "events")
    },
    "windows": ["tests/twins/test_tiles_of_few.py", "tests/twins", "tests/contracts"],
    "checkpoint": ["tests/contracts/test_written_files.py", "tests/faults/test_checkpoints.py", "tests/contracts"],
    "changes": ["tests/doors/test_changes.py", "tests/contracts"],
    "statistics": ["tests/doors/test_averages.py", "tests/doors/test_correlations.py", "tests/physics", "tests/doors"],
    "readers": ["tests/doors/test_files.py", "tests/doors/test_trajectory.py", "tests/doors"],
}
"""Tests that run first, those that need no machine code, with kernels as plain Python: nothing is compiled."""

SWAPS = {
    ast.Lt: ("<", "<="), ast.LtE: ("<=", "<"), ast.Gt: (">", ">="), ast.GtE: (">=", ">"),
    ast.Eq: ("==", "!="), ast.NotEq: ("!=", "=="), ast.Is: ("is", "is not"), ast.IsNot: ("is not", "is"),
    ast.Add: ("+", "-"), ast.Sub: ("-", "+"), ast.Mult: ("*", "/"), ast.Div: ("/", "*"),
    ast.And: ("and", "or"), ast.Or: ("or", "and"),
}  # fmt: skip


class Fault(NamedTuple):
    """One change of a module: `before` is found once in the package, and becomes `after`."""

    family: str
    module: str
    line: int
    before: str
    after: str


class Source:
    """A module's text, in which nodes of its tree are replaced."""

    def __init__(self, text: str):
        self._bytes, self._starts = text.encode(), [0]
        for line in text.splitlines(keepends=True):
            self._starts.append(self._starts[-1] + len(line.encode()))

    def span(self, node: ast.expr | ast.stmt) -> tuple[int, int]:
        """Where a node begins and ends [bytes]."""
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        return self._starts[node.lineno - 1] + node.col_offset, self._starts[node.end_lineno - 1] + node.end_col_offset

    def replaced(self, start: int, end: int, new: str) -> str:
        """The text with other words between two places."""
        return (self._bytes[:start] + new.encode() + self._bytes[end:]).decode()

    def swapped(self, left: ast.expr, op: ast.AST, right: ast.expr) -> str | None:
        """The text with the operator between two operands exchanged for its opposite."""
        if type(op) not in SWAPS:
            return None
        old, new = SWAPS[type(op)]
        start, end = self.span(left)[1], self.span(right)[0]
        at = self._bytes[start:end].decode().find(old)
        return None if at < 0 else self.replaced(start + at, start + at + len(old), new)


def changed_texts(source: Source, node: ast.AST) -> Iterator[str | None]:
    """The module's text for each fault that can be planted at a node."""
    if isinstance(node, ast.Compare):
        lefts = [node.left, *node.comparators[:-1]]
        for left, op, right in zip(lefts, node.ops, node.comparators, strict=True):
            yield source.swapped(left, op, right)
    elif isinstance(node, ast.BinOp):
        yield source.swapped(node.left, node.op, node.right)
    elif isinstance(node, ast.BoolOp):
        yield source.swapped(node.values[0], node.op, node.values[1])
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not | ast.USub):
        yield source.replaced(source.span(node)[0], source.span(node.operand)[0], "")
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool | int | float):
        value = node.value
        new = (not value) if isinstance(value, bool) else value + 1 if isinstance(value, int) else 2 * value + 1.0
        yield source.replaced(*source.span(node), repr(new))
    elif isinstance(node, ast.AugAssign) or (isinstance(node, ast.Expr) and isinstance(node.value, ast.Call)):
        yield source.replaced(*source.span(node), "pass")


def sites(tree: ast.AST) -> Iterator[ast.AST]:
    """Nodes that run: not types, docstrings, decorators, or the words of errors."""
    for name, value in ast.iter_fields(tree):
        if name in ("annotation", "returns", "decorator_list") or isinstance(tree, ast.Raise | ast.Assert | ast.Import):
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST):
                yield child
                yield from sites(child)


def faults_of(family: str, module: str) -> list[Fault]:
    """All faults that can be planted in a module, in the order of its lines."""
    text = (ROOT / "mpsim" / f"{module}.py").read_text()
    source, found = Source(text), []
    for node in sites(ast.parse(text)):
        for new in changed_texts(source, node):
            if new is None:
                continue
            try:
                ast.parse(new)
            except SyntaxError:
                continue
            found.append(cut(family, module, text, new))
    return found


def cut(family: str, module: str, old: str, new: str) -> Fault:
    """The lines in which two texts differ, and as many above as make them unique in their module."""
    before, after = old.splitlines(keepends=True), new.splitlines(keepends=True)
    first = next(i for i, (a, b) in enumerate(zip(before, after, strict=False)) if a != b)
    same = 0
    while same < min(len(before), len(after)) - first and before[-1 - same] == after[-1 - same]:
        same += 1
    end, end_after = len(before) - same, len(after) - same
    start = first
    while start > 0 and old.count("".join(before[start:end])) > 1:
        start -= 1
    return Fault(family, module, first + 1, "".join(before[start:end]), "".join(after[start:end_after]))


def draw(seed: int, count: int) -> list[Fault]:
    """Faults in equal numbers from each family, drawn from all that can be planted."""
    rng, drawn = random.Random(seed), []
    for number, (family, modules) in enumerate(FAMILIES.items()):
        pool = sorted({fault for module in modules for fault in faults_of(family, module)})
        share = count * (number + 1) // len(FAMILIES) - count * number // len(FAMILIES)
        drawn += rng.sample(pool, share)
    return drawn


def plant(fault: Fault, tree: Path) -> None:
    """Plant a fault in a copy of the project."""
    places = [path for path in sorted((tree / "mpsim").rglob("*.py")) if fault.before in path.read_text()]
    named = [path for path in places if path == tree / "mpsim" / f"{fault.module}.py"]
    place = (named or places or [None])[0]
    if place is None or place.read_text().count(fault.before) != 1:
        raise SystemExit(f"the lines of a fault of {fault.module} are there {len(places)} times: draw it anew")
    place.write_text(place.read_text().replace(fault.before, fault.after))


def outcome_of(fault: Fault | None, limit: float) -> str:
    """What the tests of the last commit say of a fault, or of none."""
    with tempfile.TemporaryDirectory(prefix="mpsim-mutation-") as folder:
        tree = Path(folder) / "tree"
        subprocess.run(["git", "clone", "--quiet", "--shared", ROOT, tree], check=True)
        if fault is not None:
            plant(fault, tree)
        first = [] if fault is None else FIRST[fault.family]
        return next((words for part in [*first, ""] if (words := _failed(tree, part, limit))), "missed")


def _failed(tree: Path, first: str, limit: float) -> str:
    """The first test that fails in a copy of the project, of a file or folder, or of the whole suite; "" for none."""
    environment = {**os.environ, "PYTHONPATH": str(tree), "NUMBA_CACHE_DIR": str(MACHINE_CODE)}
    command = [sys.executable, "-m", "pytest", "-x", "-p", "no:cacheprovider"]
    if first:
        environment["NUMBA_DISABLE_JIT"] = "1"
        command += ["-n", "0", "-m", "not compiled", first]
    try:
        done = subprocess.run(
            command, cwd=tree, env=environment, capture_output=True, text=True, timeout=limit, check=False
        )
    except subprocess.TimeoutExpired:
        return "hangs"
    words = [line for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return "" if done.returncode in (0, 5) else words[0].split(" - ")[0] if words else f"exit code {done.returncode}"


def main() -> None:
    """Draw faults, or run the tests with each of them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("act", choices=["draw", "run", "control"])
    parser.add_argument("--seed", type=int, default=20261126)
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--only", type=int, nargs="+", help="numbers of faults")
    parser.add_argument("--limit", type=float, default=900.0, help="seconds after which tests hang")
    options = parser.parse_args()
    if options.act == "draw":
        KEPT.write_text(json.dumps([fault._asdict() for fault in draw(options.seed, options.count)], indent=1) + "\n")
    elif options.act == "control":
        print(outcome_of(None, options.limit))
    else:
        faults = [Fault(**each) for each in json.loads(KEPT.read_text())]
        if options.only and not 0 <= min(options.only) <= max(options.only) < len(faults):
            parser.error(f"--only must be numbers from 0 to {len(faults) - 1}; got {options.only}")
        for number in options.only or range(len(faults)):
            fault, begin = faults[number], time.monotonic()
            words = outcome_of(fault, options.limit)
            where = f"{fault.module}:{fault.line}"
            print(f"| {number} | {fault.family} | {where} | {words} | {time.monotonic() - begin:.0f} s |", flush=True)


if __name__ == "__main__":
    main()
