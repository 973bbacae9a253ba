"""Values as lines of TOML, large arrays as files beside it."""

import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from mpsim.scene.scenefile.arrays import is_small, text_of

Files = list[tuple[Path, Callable[[BinaryIO], object]]]
"""Files to write, each with the function that writes it."""


def array_lines(arrays: dict[str, Any], target: Path, prefix: str, files: Files) -> list[str]:
    """Arrays by name as lines of a table. Large ones become files beside the target, named by prefix and name."""
    lines: list[str] = []
    for name, value in arrays.items():
        numbers = np.asarray(value, dtype=np.float64)
        if is_small(numbers):
            lines.append(f"{name} = {text_of(numbers)}")
            continue
        file = target.with_name(f"{target.stem}.{prefix}{name}.npy")
        content = io.BytesIO()  # numpy itself does not say why a file on a disk cannot be written
        np.save(content, numbers.astype("<f8"), allow_pickle=False)
        files.append((file, lambda out, content=content: out.write(content.getbuffer())))
        lines.append(f"{name} = {text(file.name)}")
    return lines


def pairs(values: dict[str, Any]) -> list[str]:
    """A line for each value that is not None."""
    return [f"{name} = {text(value)}" for name, value in values.items() if value is not None]


def text(value: Any) -> str:
    """A value as TOML."""
    if isinstance(value, str):
        # JSON's escapes are valid in TOML, which requires one more.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, tuple | list | np.ndarray):
        return f"[{', '.join(map(text, value))}]"
    return repr(int(value)) if isinstance(value, int | np.integer) else repr(float(value))
