"""Writes a scene file: small arrays in the file, large ones beside it, without losing a bit."""

import dataclasses
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO

from mpsim.core import atomic
from mpsim.errors import InputError, OutputError
from mpsim.features import NUMBERS, PER_DISC, VECTORS
from mpsim.features.edges import WALLED
from mpsim.scene.scene import Scene
from mpsim.scene.scenefile.limits import MOST_BYTES, MOST_TABLES
from mpsim.scene.scenefile.parts import PARTS
from mpsim.scene.scenefile.schema import SCHEMA
from mpsim.scene.scenefile.toml import Files, array_lines, pairs
from mpsim.scene.settings import Settings


def save(
    scene: Scene,
    path: str | os.PathLike[str],
    settings: Settings | None = None,
    title: str = "",
    text: str = "",
    look_for: str = "",
) -> None:
    """Write a scene file; `load` restores the same scene, bit for bit.

    Args:
        scene: its arrays are written, not the rules by which it was made (random places, lattices).
        path: ends in .toml; an existing file is replaced, a symbolic link refused. Arrays of more than 64 rows go to
            files beside it, named after it: gas.position.npy for gas.toml.
        settings: to recommend; None: those that the scene recommends.
        title, text, look_for: for people.

    Raises:
        InputError: if the path does not end in .toml.
        OutputError: if a file cannot be written; the scene file itself is then as it was.
    """
    target = Path(path)
    if target.suffix != ".toml":
        raise InputError(f"path of a scene file must end in .toml; got {os.fspath(path)!r}.")
    lines = [f"schema = {SCHEMA}", *_scene_lines(scene), ""]
    if title or text or look_for:
        about = {"title": title, "text": text, "look_for": look_for}
        lines += ["[about]", *pairs({name: words for name, words in about.items() if words or name == "title"}), ""]
    settings = scene.settings if settings is None else settings
    if settings is not None:
        defaults = Settings()
        chosen = dataclasses.asdict(settings)
        changed = {name: value for name, value in chosen.items() if value != getattr(defaults, name)}
        lines += ["[settings]", *pairs(changed), ""]
    discs, arrays = _disc_lines(scene, target)
    lines += discs
    for part in PARTS:
        lines += part.lines(scene, target, arrays)
    _demand_readable(target, lines)
    try:
        _write([(target, lambda file: file.write("\n".join(lines).encode())), *arrays])
    except (OSError, UnicodeEncodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise OutputError(
            f"path must be a place where files can be written; got {os.fspath(path)!r} ({reason}). Choose another."
        ) from None


def _scene_lines(scene: Scene) -> list[str]:
    values: dict[str, Any] = {"width": scene.width, "height": scene.height}
    if scene.boundary != WALLED:
        values["boundary"] = scene.boundary
    values |= {name: getattr(scene, name) for name in VECTORS}
    values |= {name: value for name, (default, _) in NUMBERS.items() if (value := getattr(scene, name)) != default}
    values["absorbing"] = scene.absorbing or None
    values |= {"duration": scene.duration, "picture_interval": scene.picture_interval}
    values["measures"] = scene.measures or None
    return pairs(values)


def _disc_lines(scene: Scene, target: Path) -> tuple[list[str], Files]:
    """The discs as one group, and the files of its arrays."""
    files: Files = []
    names = ("position", "velocity", *PER_DISC)
    arrays = {name: value for name in names if (value := getattr(scene, name)) is not None}
    return ["[[discs]]", *array_lines(arrays, target, "", files), ""], files


def _demand_readable(target: Path, lines: list[str]) -> None:
    """Refuse to write what `load` would refuse to read.

    Raises:
        OutputError: for a scene of very many features that differ in kind from one to the next.
    """
    length = sum(len(line) + 1 for line in lines)
    tables = max(lines.count(f"[[{part.argument}]]") for part in PARTS)
    advice = ", and ".join(part.advice for part in PARTS if part.advice)
    if length > MOST_BYTES or tables > MOST_TABLES:
        raise OutputError(
            f"a scene file must have at most {MOST_BYTES:,} bytes and {MOST_TABLES:,} tables of a kind; "
            f"{str(target)!r} would have {length:,} and {tables:,}. Let {advice}, which makes arrays of them; or keep "
            "the scene in Python."
        )


def _write(parts: list[tuple[Path, Callable[[BinaryIO], object]]]) -> None:
    """Every file is complete on the disk before the first is renamed; they are renamed last to first."""
    if parts:
        (path, write), *others = parts
        with atomic.atomic_write(path) as file:
            write(file)
            file.flush()
            os.fsync(file.fileno())
            _write(others)
