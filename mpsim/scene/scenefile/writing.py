"""From a scene to a scene file: small arrays in the file, large ones beside it, every bit kept."""

import dataclasses
import functools
import json
import os
from collections.abc import Callable
from itertools import chain, groupby
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from mpsim.core import atomic
from mpsim.core.errors import InputError, OutputError
from mpsim.features.obstacles import FixedDisc
from mpsim.scene.scene import Scene
from mpsim.scene.scenefile.arrays import INLINE, is_small, text_of
from mpsim.scene.scenefile.limits import MOST_BYTES, MOST_TABLES
from mpsim.scene.scenefile.schema import SCHEMA
from mpsim.scene.settings import Settings

Files = list[tuple[Path, Callable[[BinaryIO], object]]]
"""Files to write, each with what writes it."""


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
    lines += [*discs, *_obstacle_lines(scene, target, arrays), *_emitter_lines(scene, target, arrays)]
    if scene.piston is not None:
        lines += ["[piston]", *_pairs(vars(scene.piston)), ""]
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
    if scene.boundary != ("walls", "walls"):
        values["boundary"] = scene.boundary
    values["gravity"] = scene.gravity
    values |= {name: getattr(scene, name) for name in ("restitution", "wall_restitution") if getattr(scene, name) != 1}
    values["absorbing"] = scene.absorbing or None
    values["duration"] = scene.duration
    return _pairs(values)


def _disc_lines(scene: Scene, target: Path) -> tuple[list[str], Files]:
    """The discs as one group, and the files of its arrays."""
    files: Files = []
    names = ("position", "velocity", "radius", "mass", "acceleration")
    arrays = {name: value for name in names if (value := getattr(scene, name)) is not None}
    return ["[[discs]]", *_array_lines(arrays, target, "", files), ""], files


def _array_lines(arrays: dict[str, Any], target: Path, prefix: str, files: Files) -> list[str]:
    """Arrays by name as lines of a table. Large ones become files beside the target, named by their prefix and name."""
    lines: list[str] = []
    for name, value in arrays.items():
        numbers = np.asarray(value, dtype=np.float64)
        if is_small(numbers):
            lines.append(f"{name} = {text_of(numbers)}")
            continue
        file = target.with_name(f"{target.stem}.{prefix}{name}.npy")
        files.append((file, functools.partial(np.save, arr=numbers.astype("<f8"), allow_pickle=False)))
        lines.append(f"{name} = {_text(file.name)}")
    return lines


def _obstacle_lines(scene: Scene, target: Path, files: Files) -> list[str]:
    """A table for each obstacle; one for many discs, or many Polylines, that follow each other."""
    lines: list[str] = []
    for kind, group in groupby(scene.obstacles, type):
        alike = list(group)
        if len(alike) > INLINE:
            arrays = _discs_together(alike) if kind is FixedDisc else _lines_together(alike)
            lines += ["[[obstacles]]", *_array_lines(arrays, target, f"obstacles-{len(files)}.", files), ""]
            continue
        for obstacle in alike:
            values = dict(vars(obstacle))
            if values.get("thickness") == 0:
                del values["thickness"]
            points = {name: values.pop(name) for name in ("points",) if len(values.get(name, ())) > INLINE}
            lines += ["[[obstacles]]", *_array_lines(points, target, f"obstacles-{len(files)}.", files)]
            lines += [*_pairs(values), ""]
    return lines


def _discs_together(discs: list[Any]) -> dict[str, Any]:
    """Arrays of a table of many FixedDiscs."""
    return {name: [getattr(each, name) for each in discs] for name in ("position", "radius")}


def _lines_together(polylines: list[Any]) -> dict[str, Any]:
    """Arrays of a table of many Polylines."""
    points = list(chain.from_iterable(each.points for each in polylines))
    arrays: dict[str, Any] = {"points": points, "lengths": [len(each.points) for each in polylines]}
    if any(each.thickness for each in polylines):
        arrays["thickness"] = [each.thickness for each in polylines]
    return arrays


def _emitter_lines(scene: Scene, target: Path, files: Files) -> list[str]:
    """A table for each emitter; one for many that follow each other and have values for the same keys."""
    lines: list[str] = []
    for names, group in groupby(
        scene.emitters, lambda each: [name for name, value in vars(each).items() if value is not None]
    ):
        alike = list(group)
        if len(alike) > INLINE:
            arrays = {name: [getattr(each, name) for each in alike] for name in names}
            lines += ["[[emitters]]", *_array_lines(arrays, target, f"emitters-{len(files)}.", files), ""]
            continue
        for emitter in alike:
            lines += ["[[emitters]]", *_pairs(vars(emitter)), ""]
    return lines


def _demand_readable(target: Path, lines: list[str]) -> None:
    """Refuse to write what `load` would refuse to read.

    Raises:
        OutputError: for a scene of very many obstacles or emitters that differ in kind from one to the next.
    """
    length = sum(len(line) + 1 for line in lines)
    tables = max(lines.count("[[obstacles]]"), lines.count("[[emitters]]"))
    if length > MOST_BYTES or tables > MOST_TABLES:
        raise OutputError(
            f"a scene file must have at most {MOST_BYTES:,} bytes and {MOST_TABLES:,} tables of a kind; "
            f"{str(target)!r} would have {length:,} and {tables:,}. Let discs follow discs and lines follow "
            "lines among the obstacles, and emitters those with the same keys, which makes arrays of them; or keep the "
            "scene in Python."
        )


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
