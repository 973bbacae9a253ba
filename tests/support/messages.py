"""Every text that a program can say: templates of its errors and warnings, and its other sentences, from its source.

A template has {} for what is filled in, and {this|that} for words that are chosen between. Where a text stands, in
which module and line, makes no difference.
"""

import ast
import builtins
import json
import re
from collections.abc import Iterable, Iterator
from pathlib import Path

FEWEST_SPACES = 2
"""A sentence has three words or more; shorter strings are names, units and the like."""

_EXCEPTIONS = {name for name, value in vars(builtins).items() if isinstance(value, type)} | {
    "UsageError", "ClickException", "BadParameter"
}  # fmt: skip
_FIELD = re.compile(r"\{([^{}]*)\}")


def messages(sources: Iterable[str]) -> list[str]:
    """The texts in some sources, sorted, each once: "InputError: dt must be ...", and "text: ..." for the others."""
    trees = [ast.parse(source) for source in sources]
    kinds = _exceptions(trees)
    said = {line for tree in trees for line in _said(tree, kinds)}
    known = {line.partition(": ")[2] for line in said}
    others = {text for tree in trees for text in _sentences(tree)} - known
    return sorted(map(_one_line, said | {f"text: {text}" for text in others}))


def sources(package: Path) -> list[str]:
    """The sources of a package."""
    return [path.read_text() for path in sorted(package.rglob("*.py"))]


def matches(template: str, text: str) -> bool:
    """Whether a text can come from a line of `messages`."""
    plain = json.loads(f'"{template.partition(": ")[2]}"')
    parts = [".*" if index % 2 else re.escape(part) for index, part in enumerate(_FIELD.split(plain))]
    return re.fullmatch("".join(parts), text, re.DOTALL) is not None


def _one_line(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)[1:-1]


def _exceptions(trees: list[ast.Module]) -> set[str]:
    """Names of exceptions: those of Python and click, and what the sources derive from them."""
    bases = {
        node.name: [_name(base) for base in node.bases]
        for tree in trees
        for node in ast.walk(tree)
        if isinstance(node, ast.ClassDef)
    }
    known = {name for name in _EXCEPTIONS if issubclass(getattr(builtins, name, Exception), BaseException)}
    while more := {name for name, parents in bases.items() if known & set(parents)} - known:
        known |= more
    return known


def _said(tree: ast.Module, kinds: set[str]) -> Iterator[str]:
    """Errors and warnings whose text stands where they are made."""
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        kind, texts = _name(node.func), [text for argument in node.args if (text := _template(argument))]
        if kind == "warn" and len(node.args) > 1:
            kind = _name(node.args[1])
        if kind in kinds and not kind.startswith("_"):  # whose texts end in others
            yield from (f"{kind}: {text}" for text in texts)


def _sentences(tree: ast.Module) -> Iterator[str]:
    """All strings of three words or more but docstrings."""
    skipped: set[int] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            skipped.add(id(node.value))
        if isinstance(node, ast.JoinedStr):  # its constants are parts of its template
            skipped |= {id(part) for part in node.values}
        text = None if id(node) in skipped else _template(node)
        if text and text.strip().count(" ") >= FEWEST_SPACES:
            yield text


def _template(node: ast.AST) -> str | None:
    """The text of a string or of a formatted one; None for what is none."""
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, str) else None
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        left, right = _template(node.left), _template(node.right)
        return None if left is None and right is None else f"{left or '{}'}{right or '{}'}"
    if not isinstance(node, ast.JoinedStr):
        return None
    parts = [
        f"{{{'|'.join(_choices(part.value))}}}" if isinstance(part, ast.FormattedValue) else _template(part) or ""
        for part in node.values
    ]
    return "".join(parts)


def _choices(node: ast.AST) -> list[str]:
    """The words that a field chooses between, if it does."""
    if not isinstance(node, ast.IfExp):
        return []
    branches = [[text] if (text := _template(each)) else _choices(each) for each in (node.body, node.orelse)]
    return [_FIELD.sub("()", text) for branch in branches for text in branch]


def _name(node: ast.AST) -> str:
    """The last word of a name such as click.UsageError."""
    return node.attr if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""
