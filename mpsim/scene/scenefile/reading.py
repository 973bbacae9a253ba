"""Reads a scene file and reports all its problems at once; writes a scene without losing a bit."""

import dataclasses
import errno
import logging
import os
import re
import tomllib
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, BinaryIO

import pydantic

from mpsim.core import checks, files
from mpsim.errors import InputError, OutputError, SceneFileError, reason_of
from mpsim.features import FEATURES, NUMBERS, PER_DISC, VECTORS
from mpsim.features.edges import WALLED
from mpsim.scene.scene import Scene
from mpsim.scene.scenefile import schema
from mpsim.scene.scenefile.parts import (
    MOST_BYTES,
    MOST_PARTS,
    MOST_PROBLEMS,
    MOST_TABLES,
    PARTS,
    ArraySource,
    Files,
    array_lines,
    pairs,
)
from mpsim.scene.scenefile.schema import SCHEMA, ProblemsError, build
from mpsim.scene.settings import Settings

# --- Writes a scene file: small arrays in the file, large ones beside it, without losing a bit


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
        with files.atomic_write(path) as file:
            write(file)
            file.flush()
            os.fsync(file.fileno())
            _write(others)


# --- Reads a scene file by name or path, checks all of it, and reports all problems at once

logger: logging.Logger = logging.getLogger("mpsim")

_WHAT = "|".join([kind.__name__ for each in FEATURES for kind in each.kinds] + [each.argument for each in FEATURES])
_OF_WHAT = re.compile(rf"(?<=\w) of ((a|an|the) )?({_WHAT})(?= must)")
_KINDS = {kind for part in PARTS for kind, _, _ in part.tables} - {""}
_FIRST_WORD = re.compile(r"(?:\w+|'')(?=[ \[])")

_TEXTS = re.compile(
    r'"""(?:[^"\\]|\\.?|"(?!""))*+(?:"{3,5}|\Z)|'
    r"'''(?:[^']|'(?!''))*+(?:'{3,5}|\Z)|"
    r'"(?:[^"\\\n]|\\[^\n])*+"?|'
    r"'[^'\n]*+'?|#[^\n]++",
    re.DOTALL,
)
"""Texts and comments, which contain no keys. An unterminated text counts too: its end is searched for only once, not
from each quotation mark in it."""

_MANY_PARTS = re.compile(rf"(?:\.[^.=,\n\[\]{{}}]*+){{{MOST_PARTS},}}")

_TOO_DEEP = "the file must be TOML; got tables or lists nested too deeply."
_TOO_LARGE = "Put long arrays into .npy files beside it, as Scene.save does."

_NAMED = resources.files("mpsim.scene") / "named"  # in an archive, if mpsim is imported from one
PACKAGED = Path(str(_NAMED))


@dataclass(frozen=True)
class SceneFile:
    """A scene file that was read.

    Attributes:
        name: of the file, without .toml.
        scene: the scene.
        title, text, look_for: for people; "" without any.
        read: files that were read, the scene file first.
        compressed: packing and rate of its table [compressed]; None without one.
    """

    name: str
    scene: Scene
    title: str
    text: str
    look_for: str
    read: tuple[Path, ...]
    compressed: dict[str, float] | None

    @property
    def comes_with_mpsim(self) -> bool:
        """Whether it is a named scene."""
        return self.read[0].parent == PACKAGED

    @property
    def settings(self) -> Settings | None:
        """Those that the scene recommends; None without any."""
        return self.scene.settings


def names() -> tuple[str, ...]:
    """Names of the scenes that come with mpsim, in alphabetical order."""
    return tuple(sorted(path.name[:-5] for path in _NAMED.iterdir() if path.name.endswith(".toml")))


def titles() -> dict[str, str]:
    """Titles of the scenes that come with mpsim, by name; no scene is made."""
    return {name: tomllib.loads((_NAMED / f"{name}.toml").read_text())["about"]["title"] for name in names()}


def load(source: str | os.PathLike[str]) -> SceneFile:
    """Read a scene file.

    Args:
        source: the name of a scene that comes with mpsim, such as "gas", or a path that ends in .toml.

    Raises:
        InputError: if there is no such scene or file.
        SceneFileError: with all problems of the file; a subclass of InputError.

    >>> load("gas").scene.count
    100
    """
    path = _find(source)
    label = os.fspath(source) if path.parent != PACKAGED else f"scenes/{path.name}"
    tables = _parsed(path, label)
    arrays = ArraySource(path.parent)
    logger.info("mpsim: reading %s", path)
    try:
        table = schema.SceneTable.model_validate(tables, context=arrays)
        scene = build(table)
    except pydantic.ValidationError as error:
        raise SceneFileError(label, _sentences(error)) from None
    except ProblemsError as error:
        raise SceneFileError(label, _some([_at(key, text) for key, text in error.problems])) from None
    except RecursionError:
        raise SceneFileError(label, [_TOO_DEEP]) from None
    about = table.about or schema.About(title="")
    compressed = None if table.compressed is None else dict(table.compressed)
    return SceneFile(path.stem, scene, about.title, about.text, about.look_for, (path, *arrays.read), compressed)


def _find(source: Any) -> Path:
    """The path of a scene given by name or path."""
    if not isinstance(source, str | os.PathLike) or not isinstance(os.fspath(source), str):
        raise InputError(f"scene must be a name or a path to a .toml file; got {type(source).__name__}.")
    text = os.fspath(source)
    known = names()
    if text in known:
        return PACKAGED / f"{text}.toml"
    path = Path(text)
    if path.suffix != ".toml":
        near = checks.near(text, known)
        hint = f" Did you mean {near!r}?" if near else ""
        words = ", ".join(known)
        raise InputError(f"scene must be a path that ends in .toml or one of {words}; got {checks.brief(text)}.{hint}")
    return path


def _parsed(path: Path, label: str) -> dict[str, Any]:
    """The file as nested tables."""
    try:
        packaged = path.parent == PACKAGED
        text = (_NAMED / path.name).read_text("utf-8") if packaged else files.text(path, MOST_BYTES)
    except UnicodeDecodeError as error:
        raise SceneFileError(
            label, [f"the file must be text in UTF-8; got byte {error.start} ({error.reason})."]
        ) from None
    except (OSError, ValueError) as error:
        reason = reason_of(error)
        hint = "" if getattr(error, "errno", None) != errno.EFBIG else f" {_TOO_LARGE}"
        raise InputError(
            f"scene must be a file that can be read; got {checks.brief(str(path))} ({reason}).{hint}"
        ) from None
    if _MANY_PARTS.search(_TEXTS.sub("", text)):
        raise SceneFileError(label, [f"keys must have at most {MOST_PARTS} parts with dots between them; got more."])
    try:
        tables = tomllib.loads(text)
    except RecursionError:
        raise SceneFileError(label, [_TOO_DEEP]) from None
    except ValueError as error:
        raise SceneFileError(label, [f"the file must be TOML; got this error: {error!s:.200}."]) from None
    for name in ("discs", *(part.argument for part in PARTS if part.several)):
        listed = tables.get(name)
        if isinstance(listed, list) and len(listed) > MOST_TABLES:
            problem = (
                f"{name} must be at most {MOST_TABLES:,} tables; got {len(listed):,}. One may hold many: give arrays."
            )
            raise SceneFileError(label, [problem])
    version = tables.get("schema")
    if isinstance(version, int) and version != schema.SCHEMA:  # then nothing else can be judged
        problem = schema.version_problem(version)
        raise SceneFileError(label, [problem])
    return tables


def _sentences(error: pydantic.ValidationError) -> list[str]:
    """One sentence per problem, for the first MOST_PROBLEMS."""
    sentences: list[str] = []
    listed: set[str] = set()
    found = error.errors(include_url=False)
    for each in found[:MOST_PROBLEMS]:
        location = tuple(word for word in each["loc"] if word not in _KINDS)
        sentences.append(_at(_path(location), _sentence(location, each["type"], each.get("input"), each, listed)))
    return _some(sentences, len(found))


def _some(sentences: list[str], number: int = 0) -> list[str]:
    """The first MOST_PROBLEMS sentences, and how many more there are."""
    more = max(number, len(sentences)) - MOST_PROBLEMS
    return [*sentences[:MOST_PROBLEMS], f"and at least {more:,} more."] if more > 0 else sentences


def _sentence(location: tuple[int | str, ...], kind: str, value: Any, details: Any, listed: set[str]) -> str:
    """What is wrong at a place; listed: tables whose keys a sentence before has listed."""
    name = _path(location[-2:] if location and isinstance(location[-1], int) else location[-1:])
    match kind:
        case "extra_forbidden":
            hint = _hint(name, str(location[0]) if len(location) > 1 else "", details["loc"], listed)
            known = f"{name} must be a key of a scene file; this one is unknown, with the value"
            return f"{known} {checks.brief(value)}. {hint}"
        case "missing":
            example = f"schema = {schema.SCHEMA}" if name == "schema" else ""
            return f"{name} must be given; got nothing.{f' Write {example!r} at the top.' if example else ''}"
        case "list_type":
            return f"{name} must be a list of tables, [[{name}]] for each; got {checks.brief(value)}."
        case "model_type" | "model_attributes_type" | "dict_type":
            return f"{name} must be a table; got {checks.brief(value)}."
        case "value_error":
            return str(details["ctx"]["error"])
    return f"{name}: {details['msg']}; got {checks.brief(value)}."


def _hint(name: str, level: str, location: Iterable[int | str], listed: set[str]) -> str:
    """The key that was meant, or the kind of table that it belongs to, or all keys that there are, once for each level.

    location: the place as pydantic has it, with the kind of the table.
    """
    keys = _keys_of(level)
    if name in keys:
        tables = next(part.tables for part in PARTS if part.argument == level)
        others = " or ".join(title.partition(": ")[2] for _, title, table in tables if name in schema.keys_of(table))
        own = next(schema.keys_of(table) for kind, _, table in tables if kind in location)
        return f"It is a key of {others}; keys of this table: {', '.join(own)}."
    near = checks.near(name, keys)
    if near:
        return f"Did you mean {near!r}?"
    if level in listed:
        return "Keys there are those listed above."
    listed.add(level)
    return f"Keys there: {', '.join(keys)}."


def _keys_of(level: str) -> list[str]:
    """Keys of the tables of a level."""
    return list(dict.fromkeys(key for table in schema.LEVELS[level] for key in schema.keys_of(table)))


def _path(location: Iterable[int | str]) -> str:
    """A key path such as discs[0].radius."""
    text = ""
    for part in location:
        word = checks.shortened(str(part)) or "''"
        text += f"[{part}]" if isinstance(part, int) else f".{word}" if text else word
    return text


def _at(key: str, text: str) -> str:
    """A sentence that begins with the key path, which replaces a bare key at its beginning."""
    if not key:
        return text
    text = _OF_WHAT.sub("", text, count=1)  # the key path says of what
    first = _FIRST_WORD.match(text)
    word = first[0] if first else ""
    level, _, own = re.sub(r"\[\d+\]", "", key).partition(".")
    if text.startswith(key) or key == word:
        return text
    if word == (own or level):
        return key + text[len(word) :]
    if not own and level in schema.LEVELS and word in _keys_of(level):
        return f"{key}.{text}"
    return f"{key}: {text}"
