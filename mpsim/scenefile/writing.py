"""From a scene to a scene file: small arrays in the file, large ones beside it, every bit kept."""

import dataclasses
import functools
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from mpsim import atomic
from mpsim.errors import InputError, OutputError
from mpsim.features import Emitter, FixedDisc
from mpsim.scene import Scene
from mpsim.scenefile.arrays import is_small, text_of
from mpsim.scenefile.schema import SCHEMA
from mpsim.settings import Settings


def save(
    scene: Scene,
    path: str | os.PathLike[str],
    settings: Settings | None = None,
    title: str = "",
    text: str = "",
    look_for: str = "",
) -> None:
    """Write a scene file; `load` gives the same scene, bit for bit.

    Args:
        scene: what is written. How it was made (random places, lattices) is not: its arrays are.
        path: ends in .toml; an existing file is replaced, a symbolic link refused. Arrays of more than 64 rows go to
            files beside it, named like it: gas.position.npy of gas.toml.
        settings: to recommend.
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
        lines += ["[about]", *_pairs({name: words for name, words in about.items() if words or name == "title"}), ""]
    if settings is not None:
        defaults = Settings()
        chosen = dataclasses.asdict(settings)
        changed = {name: value for name, value in chosen.items() if value != getattr(defaults, name)}
        lines += ["[settings]", *_pairs(changed), ""]
    discs, arrays = _disc_lines(scene, target)
    lines += [*discs, *_feature_lines(scene)]
    try:
        _write([(target, lambda file: file.write("\n".join(lines).encode())), *arrays])
    except (OSError, UnicodeEncodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise OutputError(
            f"path must be a place where files can be written; got {os.fspath(path)!r} ({reason}). Choose another."
        ) from None


def _scene_lines(scene: Scene) -> list[str]:
    values: dict[str, Any] = {"width": scene.width, "height": scene.height}
    if scene.boundary != ("walls", "walls"):
        values["boundary"] = scene.boundary
    values["gravity"] = scene.gravity
    values |= {name: getattr(scene, name) for name in ("restitution", "wall_restitution") if getattr(scene, name) != 1}
    values["absorbing"] = scene.absorbing or None
    values["duration"] = scene.duration
    return _pairs(values)


def _disc_lines(scene: Scene, target: Path) -> tuple[list[str], list[tuple[Path, Callable[[BinaryIO], object]]]]:
    """The discs as one group, and the files of its arrays."""
    lines: list[str] = ["[[discs]]"]
    files: list[tuple[Path, Callable[[BinaryIO], object]]] = []
    for name in ("position", "velocity", "radius", "mass", "acceleration"):
        value = getattr(scene, name)
        if value is None:
            continue
        numbers = np.asarray(value, dtype=np.float64)
        if is_small(numbers):
            lines.append(f"{name} = {text_of(numbers)}")
            continue
        file = target.with_name(f"{target.stem}.{name}.npy")
        files.append((file, functools.partial(np.save, arr=numbers.astype("<f8"), allow_pickle=False)))
        lines.append(f"{name} = {_text(file.name)}")
    return [*lines, ""], files


def _feature_lines(scene: Scene) -> list[str]:
    lines: list[str] = []
    for obstacle in scene.obstacles:
        values = _fields(obstacle)
        if not isinstance(obstacle, FixedDisc) and obstacle.thickness == 0:
            del values["thickness"]
        lines += ["[[obstacles]]", *_pairs(values), ""]
    for emitter in scene.emitters:
        lines += ["[[emitters]]", *_pairs(_fields(emitter)), ""]
    if scene.piston is not None:
        lines += ["[piston]", *_pairs(_fields(scene.piston)), ""]
    return lines


def _fields(feature: FixedDisc | Emitter | Any) -> dict[str, Any]:
    return {field.name: getattr(feature, field.name) for field in dataclasses.fields(feature)}


def _pairs(values: dict[str, Any]) -> list[str]:
    return [f"{name} = {_text(value)}" for name, value in values.items() if value is not None]


def _text(value: Any) -> str:
    """A value as TOML."""
    if isinstance(value, str):
        # JSON's escapes are TOML's, but for one character that TOML wants escaped too.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, tuple | list | np.ndarray):
        return f"[{', '.join(map(_text, value))}]"
    return repr(int(value)) if isinstance(value, int | np.integer) else repr(float(value))


def _write(files: list[tuple[Path, Callable[[BinaryIO], object]]]) -> None:
    """All or nothing: every file is complete on the disk before one takes its name, the last one first."""
    if files:
        (path, write), *others = files
        with atomic.atomic_write(path) as file:
            write(file)
            file.flush()
            os.fsync(file.fileno())
            _write(others)
