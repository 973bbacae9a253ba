"""The pages of the docs as they are executed: their fenced blocks, by language, in order.

| block | what happens |
|---|---|
| python | with prompts a doctest, otherwise a program; the blocks of a page share their names |
| python that begins with `# name.py` | a file of that name, for the commands that follow |
| console | each line `$ command` is run, what follows is its output; `...` stands for anything |
| sh | each command is run and must succeed |
| toml | a scene file, which is checked and loaded; it is kept under the name in its first line, `# name.toml` |
| text | a drawing |

All run in one empty folder per page. A block is left out only if the line before it says why, and one that takes long
runs under --long:

    <!-- not run: needs a cluster -->
    <!-- long -->
"""

import doctest
import os
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

from mpsim.scene import scenefile

ROOT = Path(__file__).parents[2]
sys.path.append(str(ROOT / "scripts"))

from page_blocks import COMMAND, DRAWING, EXECUTED, Block, blocks_of  # noqa: E402, F401 - tests take them from here

PAGES = sorted([*ROOT.glob("*.md"), *(page for page in (ROOT / "docs").rglob("*.md") if "_build" not in page.parts)])


def run_blocks(name: str, blocks: Iterable[Block], long: bool = False) -> int:
    """Run blocks in the present folder; returns how many ran. A failure shows file, line, expected and got."""
    names: dict = {"__name__": "__main__"}
    ran = 0
    for block in blocks:
        if block.why or block.language == DRAWING or (block.long and not long):
            continue
        if block.language == "python":
            names = _python(name, block, names)
        elif block.language == "console":
            _console(name, block)
        elif block.language == "sh":
            _run(name, block, "set -e\n" + block.code)
        elif block.language == "toml":
            Path(block.file).write_text(block.code)
            scenefile.load(Path(block.file))
        else:
            raise AssertionError(f"{name}, line {block.line}: no way to run a block of {block.language!r}")
        ran += 1
    return ran


def _python(name: str, block: Block, names: dict) -> dict:
    if block.file is not None:
        Path(block.file).write_text(block.code)
        return names
    if ">>>" not in block.code:
        exec(compile("\n" * block.line + block.code, name, "exec"), names)
        return names
    test = doctest.DocTestParser().get_doctest(block.code, names, name, name, block.line)
    report: list[str] = []
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS)
    runner.run(test, out=report.append, clear_globs=False)
    assert not runner.failures, "".join(report)
    return test.globs


def _console(name: str, block: Block) -> None:
    commands = list(COMMAND.finditer(block.code))
    assert commands, f"{name}, line {block.line}: a console block needs a line `$ command`"
    for match in commands:
        got = _run(name, block, match["command"])
        assert doctest.OutputChecker().check_output(match["output"], got, doctest.ELLIPSIS), (
            f"{name}, line {block.line}: $ {match['command']}\nExpected:\n{match['output']}\nGot:\n{got}"
        )


def _run(name: str, block: Block, command: str) -> str:
    """Output and errors of a command, with the programs of this Python first, `.venv/bin/` being theirs."""
    programs = str(Path(sys.executable).parent)
    environment = os.environ | {
        "PATH": f"{programs}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]).rstrip(os.pathsep),
        "COLUMNS": "100",
    }
    command = command.replace(".venv/bin/", "")
    done = subprocess.run(
        ["bash", "-c", command],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
        timeout=150,
    )
    shows_failure = block.language == "console"
    assert shows_failure or done.returncode == 0, f"{name}, line {block.line}: {command}\n{done.stdout}"
    return done.stdout
