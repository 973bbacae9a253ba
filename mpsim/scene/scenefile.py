"""Scene files: TOML that a person can read and write, checked as a whole.

A scene file holds the arguments of Scene by the same names, and may start discs by rule (random places, lattices,
thermal velocities). It is safe to read: nothing in it is executed, and it refers to no other files than .npy and .csv
in its own folder or below, which are logged and listed in `SceneFile.read`.

The table of a feature has the fields of its class as keys. So has a table for a field whose type is a class, or the
base of several: the keys decide which. A new feature, kind of obstacle or class of a field needs no entry here.
"""

import dataclasses
import errno
import io
import logging
import os
import re
import tomllib
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, partial
from importlib import resources
from itertools import groupby
from pathlib import Path
from typing import Any, BinaryIO, ClassVar, get_args, get_type_hints

import numpy as np
from numpy.typing import NDArray

from mpsim.core import checks, files
from mpsim.core.archive import REAL, read_array
from mpsim.errors import InputError, OutputError, SceneFileError, reason_of
from mpsim.features import FEATURES, NUMBERS, PER_DISC, VECTORS
from mpsim.features.capsules import of_discs
from mpsim.features.edges import WALLED, check_boundary, wraps_of
from mpsim.features.feature import MOST_VALUES, Feature, chosen, in_toml, pairs
from mpsim.features.obstacles import Obstacle, capsules_of, listed
from mpsim.scene import starts
from mpsim.scene.scene import FASTEST, LARGEST_COUNT, SLOWEST, Scene, room_at_start
from mpsim.scene.settings import Settings
from mpsim.scene.starts import LATTICES

logger: logging.Logger = logging.getLogger("mpsim")

SCHEMA = 1  # version of this format

# These bound what is processed item by item in Python; long arrays of numbers belong in .npy files.

MOST_BYTES = 2**20  # bytes of the scene file itself: about 20,000 lines

MOST_TABLES = 10_000
"""Tables of one kind: [[discs]], or those of a feature. One table may hold very many, as arrays."""

MOST_PARTS = 100
"""Dots of a line without a sign of a value between them. No key has more than two; a parser's time grows as their
square."""

MOST_PROBLEMS = 100  # problems of one file that are reported
MOST_ARRAY_BYTES = 2**33  # bytes of all array files of a scene together: enough for the largest scene
MOST_CSV = 2**23  # bytes of a .csv file, which is read as text
INLINE = 64  # number of rows up to which an array is saved in the scene file itself, where a person can read it

Numbers = NDArray[np.float64]

Files = list[tuple[Path, Callable[[BinaryIO], object]]]
"""Files to write, each with the function that writes it."""


# --- The keys of all tables


class _SettingsTable(Feature):
    """The table [settings], which is read as that of a feature."""

    argument = "settings"
    kinds: ClassVar[tuple[type[Any], ...]] = (Settings,)
    several = False
    examples: ClassVar[tuple[Any, ...]] = (Settings(),)


PARTS: dict[str, Feature] = {each.argument: each for each in (*FEATURES, _SettingsTable()) if each.kinds}
"""Arguments of Scene that are tables, of the fields of a class."""

LATTICE = ("places", "region", "spacing")
"""Keys of a table of many values at the sites of a lattice, in place of their position."""

OF_SCENE = [name for name in checks.names_of(Scene.__init__) if name not in ("position", "velocity", *PER_DISC)]
"""Arguments of Scene that are keys of the file itself, or of its tables."""

KEYS = {
    "": ["schema", "packing", *OF_SCENE, "about", "compressed", "discs"],
    "about": ["title", "text", "look_for"],
    "compressed": ["packing", "rate"],
    "discs": ["position", "velocity", *PER_DISC, "places", "count", "spacing", "region", "seed", "temperature"],
}
"""Keys of the file itself and of the tables that belong to no class."""


def keys_of(table: str) -> list[str]:
    """The keys of all kinds of a table, such as "piston".

    >>> keys_of("piston")
    ['wall', 'speed', 'stop', 'start', 'motion', 'surface_velocity']
    """
    if (part := PARTS.get(table)) is None:
        return KEYS.get(table, [])
    return [*dict.fromkeys(key for kind in part.kinds for key in _keys(kind, bool(part.several)))]


def _keys(kind: type[Any], many: bool = False) -> dict[str, bool]:
    """The keys of a table of a class, and whether each is needed. many: whether it may hold several values."""
    fields = sorted(dataclasses.fields(kind), key=lambda each: each.kw_only is True)
    keys = {each.name: each.default is dataclasses.MISSING for each in fields}
    if many and "position" in keys:
        keys |= dict.fromkeys(LATTICE, False)
    return keys


@cache
def _hints(kind: type[Any]) -> dict[str, Any]:
    return get_type_hints(kind)


# --- Files by name or path


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


_NAMED = resources.files("mpsim.scene") / "named"  # in an archive, if mpsim is imported from one
PACKAGED = Path(str(_NAMED))


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
    logger.info("mpsim: reading %s", path)
    reader = _Reader(label, path.parent)
    try:
        reader.read(_parsed(path, label))
        scene = reader.scene()
    except RecursionError:
        raise SceneFileError(label, ["the file must be TOML; got tables or lists nested too deeply."]) from None
    words = {key: reader.about.get(key, "") for key in KEYS["about"]}
    return SceneFile(path.stem, scene, **words, read=(path, *reader.arrays.read), compressed=reader.compressed)


def of_groups(groups: Any, box: dict[str, float | None], arguments: dict[str, Any]) -> Scene:
    """The scene of `Scene.groups`: its discs are placed, and its errors named, as those of a scene file.

    Raises:
        SceneFileError: with all problems; a subclass of InputError.
    """
    reader = _Reader("Scene.groups", Path())
    if not isinstance(groups, Iterable) or isinstance(groups, Mapping):
        groups = [groups]
    groups = list(groups)
    if not all(isinstance(table, Mapping) and all(isinstance(key, str) for key in table) for table in groups):
        instead = "Write [{'position': [(3, 3)], 'radius': 0.5}]."
        raise checks.refusal("groups", "be a list of dictionaries, one for each", checks.brief(groups), instead)
    tables = [
        {name: np.asarray(each) if checks.dimensions(each) > 0 else each for name, each in dict(table).items()}
        for table in groups
    ]
    given = {name: value for name, value in box.items() if value is not None}
    reader.read({"schema": SCHEMA, "discs": tables, **given})
    reader.arguments = arguments | {"obstacles": listed(arguments.get("obstacles", ()))}
    return reader.scene()


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


_COMMENTS = re.compile(r"^[ \t]*#[^'\"\n]*$", re.MULTILINE)  # without quotation marks, which may end a text

_MANY_PARTS = re.compile(rf"(?:\.[^.=,\n\[\]{{}}]*+){{{MOST_PARTS},}}")  # in a long text, too


def _parsed(path: Path, label: str) -> dict[str, Any]:
    """The file as nested tables."""

    def problem(text: str) -> SceneFileError:
        return SceneFileError(label, [text])

    try:
        packaged = path.parent == PACKAGED
        text = (_NAMED / path.name).read_text("utf-8") if packaged else files.text(path, MOST_BYTES)
    except UnicodeDecodeError as error:
        raise problem(f"the file must be text in UTF-8; got byte {error.start} ({error.reason}).") from None
    except (OSError, ValueError) as error:
        got = f"{checks.brief(str(path))} ({reason_of(error)})"
        too_large = getattr(error, "errno", None) == errno.EFBIG
        instead = "Put long arrays into .npy files beside it, as Scene.save does." * too_large
        raise checks.refusal("scene", "be a file that can be read", got, instead) from None
    if _MANY_PARTS.search(_COMMENTS.sub("", text)):
        raise problem(f"keys must have at most {MOST_PARTS} parts with dots between them; got more.")
    try:
        tables = tomllib.loads(text)
    except ValueError as error:
        raise problem(f"the file must be TOML; got this error: {error!s:.200}.") from None
    for name in ("discs", *PARTS):
        if isinstance(listed := tables.get(name), list) and len(listed) > MOST_TABLES:
            got = f"{len(listed):,}. One may hold many: give arrays."
            raise problem(f"{name} must be at most {MOST_TABLES:,} tables; got {got}")
    version = tables.get("schema", SCHEMA)
    if type(version) is not int or version != SCHEMA:  # then nothing else can be judged
        got = f"{checks.brief(version)}. A newer mpsim may read it."
        raise problem(f"schema must be {SCHEMA}, which this mpsim reads; got {got}")
    return tables


# --- Reading: numbers, or the name of a file of them


class _ArrayFiles:
    """The array files of one scene file, in its folder or below; read: their paths, in the order of reading."""

    def __init__(self, folder: Path):
        self.read: list[Path] = []
        self._folder = folder
        self._bytes = 0

    def array(self, name: str, value: Any, shapes: tuple[tuple[int | None, ...], ...], meaning: str) -> Numbers:
        """Numbers, or those of a file, as a float64 array of one of the shapes (None: any length)."""
        if isinstance(value, np.ndarray):
            numbers = value
        else:
            numbers = self.content(name, value) if isinstance(value, str) else _numbers(name, value, meaning)
        fitting = [shape for shape in shapes if len(shape) == numbers.ndim]
        # An empty list has lost its axes: the shape of most axes is taken.
        return checks.finite_array(name, numbers, fitting[0] if fitting and numbers.size else shapes[-1], meaning)

    def content(self, name: str, path: str) -> NDArray[Any]:
        """The array in a .npy or .csv file.

        Raises:
            InputError: if there is none, or if it cannot be read without executing code.
        """
        full, shown = self._folder / path, checks.brief(path)
        if not _names_array_file(path):
            raise InputError(f"{name} must be numbers or the name of a .npy or .csv file; got {shown}.")
        try:
            inside = full.resolve().is_relative_to(self._folder.resolve())
        except (OSError, ValueError, RuntimeError):  # too long a name, a null byte, a loop of links
            inside = False
        if not inside or Path(path).is_absolute():
            raise InputError(
                f"{name} must be a file in the folder of the scene file, or below; got {shown}, which is not. "
                "Move the file there, or make the scene in Python."
            )
        logger.info("mpsim: reading %s", full)
        try:
            with files.opened(full) as file:
                length = os.fstat(file.fileno()).st_size
                self.read.append(full)
                self._bytes += length
                if self._bytes > MOST_ARRAY_BYTES:
                    raise InputError(
                        f"{name} must leave the array files of a scene at most {MOST_ARRAY_BYTES:,} bytes together; "
                        f"got {self._bytes:,} with {full.name}. Use fewer or smaller arrays."
                    )
                return _from_csv(name, full) if full.suffix.lower() == ".csv" else _from_npy(name, full, file, length)
        except (FileNotFoundError, IsADirectoryError) as error:
            what = "a folder" if isinstance(error, IsADirectoryError) else "no such file"
            raise InputError(f"{name} must be a file that exists; got {shown}: {what} in {self._folder}.") from None
        except OSError as error:
            raise InputError(f"{name} must be a file that can be read; got {shown} ({reason_of(error)}).") from None


def _names_array_file(text: str) -> bool:
    """Whether a text ends as the name of an array file does."""
    return Path(text).suffix.lower() in (".npy", ".csv")


def _from_npy(name: str, path: Path, file: BinaryIO, length: int) -> NDArray[Any]:
    try:
        return read_array(file, length, path.name, REAL)  # which refuses pickles, as they could execute code
    except ValueError as error:
        raise InputError(
            f"{name} must be real numbers as numpy.save writes them; {path.name} is not ({error!s:.200}). Save it anew."
        ) from None


def _from_csv(name: str, path: Path) -> Numbers:
    """One row per line, after an optional line of headings."""
    try:
        text = files.content(path, MOST_CSV).decode("utf-8-sig").splitlines()
        lines = [(number, line.split(",")) for number, line in enumerate(text, 1) if line.strip(" ,\t")]
        if lines and all(_number_in(each) is None and not each.strip(' "+-.')[:1].isdigit() for each in lines[0][1]):
            del lines[0]
        rows = [[_number_in(cell) for cell in cells] for _, cells in lines]
        for (number, cells), row in zip(lines, rows, strict=True):
            if None in row:
                raise ValueError(f"line {number} has {checks.brief(cells[row.index(None)])}")
            if len(row) != len(rows[0]):
                raise ValueError(f"line {number} has {len(row)}, and line {lines[0][0]} has {len(rows[0])}")
    except ValueError as error:  # of bytes that are no text, too
        raise InputError(
            f"{name} must be lines of numbers with commas between them, as many in each; {path.name} is not: {error}."
        ) from None
    numbers = np.array(rows or np.zeros((0, 1)), np.float64)
    return numbers[:, 0] if numbers.shape[1] == 1 else numbers


def _number_in(cell: str) -> float | None:
    """The number in a cell, perhaps in quotation marks; None if there is none."""
    text = cell.strip()
    try:
        return float(text[1:-1] if text[:1] == text[-1:] == '"' else text)
    except ValueError:
        return None


def _numbers(name: str, value: Any, meaning: str) -> Numbers:
    _demand_numbers(name, value)
    try:
        return np.array(value, dtype=np.float64)
    except ValueError:
        lengths = sorted({len(row) if isinstance(row, list) else 0 for row in value})
        raise InputError(
            f"{name} must be numbers of shape {meaning}; got rows of different lengths, {lengths[0]} to {lengths[-1]}."
        ) from None


def _demand_numbers(name: str, value: Any) -> None:
    """Refuse texts, truth values and dates in place of numbers: numpy would convert some of them."""
    if isinstance(value, list):
        for index, part in enumerate(value):
            if type(part) is not float:
                _demand_numbers(f"{name}[{index}]", part)
        return
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{name} must be a number; got {checks.brief(value)}.")
    try:
        float(value)
    except OverflowError:
        raise InputError(f"{name} must be finite in float64; got {checks.brief(value)}.") from None


# --- Reading: all that is wrong becomes one error

_OF_WHAT = re.compile(r"^(\w+(?:\[\d+\])?) of (?:an? |the )?\w+(?= must)")
_FIRST_WORD = re.compile(r"(?:\w+|'')(?=[ \[])")
_NUMBER = re.compile(r"\[\d+\]")


def _at(path: str, text: str, keys: Iterable[str]) -> str:
    """A sentence that begins with the key path, which replaces a bare key at its beginning.

    >>> _at("piston", "stop of a Piston must be > 0; got -1.", ["wall", "stop"])
    'piston.stop must be > 0; got -1.'
    """
    text = _OF_WHAT.sub(r"\1", text) if path else text  # the key path says of what
    first = _FIRST_WORD.match(text)
    word = first[0] if first else ""
    if text.startswith(path):
        return text
    if word == _NUMBER.sub("", path).rpartition(".")[2]:
        return path + text[len(word) :]
    return f"{path}.{text}" if word in keys else f"{path}: {text}"


class _Reader:
    """Reads one file.

    Attributes:
        arrays: files of arrays that were read.
        about, compressed: these tables.
        groups: the tables of discs.
        box: width and height, or packing.
        arguments: of Scene, except box and discs.
    """

    def __init__(self, label: str, folder: Path):
        self.arrays = _ArrayFiles(folder)
        self.about: dict[str, str] = {}
        self.compressed: dict[str, float] | None = None
        self.groups: list[dict[str, Any]] = []
        self.box: dict[str, float] = {}
        self.arguments: dict[str, Any] = {}
        self._label = label
        self._sentences: list[str] = []  # about the first MOST_PROBLEMS
        self._problems = 0

    def _add(self, path: str, text: str, keys: Iterable[str] | None = None) -> None:
        """Add a problem. keys: those of the table at the path; None: those of a table by that name."""
        sentence = _at(path, text, keys_of(_NUMBER.sub("", path)) if keys is None else keys)
        if sentence not in self._sentences:
            self._problems += 1
            self._sentences += [sentence] if self._problems <= MOST_PROBLEMS else []

    def _tried(self, path: str, act: Callable[..., Any], *arguments: Any) -> Any:
        """The result of `act`; None if it refuses its arguments, which is a problem at the path."""
        try:
            return act(*arguments)
        except InputError as error:
            self._add(path, str(error))
            return None

    def _demand_no_problem(self) -> None:
        """Refuse the file if something is wrong: then each argument that is no table is tried as well."""
        if self._problems:
            for name, value in self.arguments.items():
                if name not in PARTS:
                    self._tried(name, partial(Scene, **_BARE, **{name: value}))
            more = self._problems - MOST_PROBLEMS
            raise SceneFileError(self._label, self._sentences + [f"and at least {more:,} more."] * (more > 0))

    # --- tables, of which every key is checked

    def read(self, tables: dict[str, Any]) -> None:
        """Check all tables of a file."""
        tables = self._known("", tables, dict.fromkeys(KEYS[""], False) | {"schema": True})
        for name, unit in (("width", "[length]"), ("height", "[length]"), ("packing", "(a fraction of the area)")):
            if name in tables:
                self.box[name] = self._tried(name, checks.positive, name, tables[name], unit)
        if "about" in tables:
            in_quotes = partial(checks.text, kind="a text in quotation marks")
            self.about = self._by_rule("about", tables["about"], dict.fromkeys(KEYS["about"], in_quotes), ("title",))
        if "compressed" in tables:
            rules = {
                "packing": partial(checks.positive, unit="(a fraction of the area)"),
                "rate": partial(checks.between, low=SLOWEST, high=FASTEST),
            }
            self.compressed = {"rate": 0.01} | self._by_rule("compressed", tables["compressed"], rules, ("packing",))
        self.groups = [self._group(path, table) for path, table in self._listed_tables("discs", tables)]
        for name in [name for name in OF_SCENE if name in tables and name not in self.box]:
            if name in PARTS:
                self.arguments[name] = self._part(PARTS[name], tables)
            else:
                self.arguments[name] = self._tried(name, self._value, name, name, tables[name], str)
        if not self._problems and sorted(self.box) not in (["packing"], ["height", "width"]):
            values = ", ".join(f"{name}={self.box.get(name)!r}" for name in ("packing", "width", "height"))
            self._add("", f"the box must be given either by packing or by width and height; got {values}.")
        self._demand_no_problem()

    def _known(self, path: str, table: Any, keys: dict[str, bool]) -> dict[str, Any]:
        """The entries of a table that it may have; others, and those that it needs and lacks, are problems."""
        if not isinstance(table, dict):
            self._add(path, f"{path.rpartition('.')[2]} must be a table; got {checks.brief(table)}.")
            return {}
        before = f"{path}." if path else ""
        unknown = [name for name in table if name not in keys]
        for name in unknown:
            meant = checks.near(name, keys) if self._problems < MOST_PROBLEMS else None
            there = f"Keys there: {', '.join(keys)}." if name == unknown[0] else "Leave it out, too."
            hint = f"Did you mean {meant!r}?" if meant else there
            self._add(
                before + (checks.shortened(name) or "''"),
                f"{checks.shortened(name) or repr(name)} must be a key of a scene file; this one is unknown, with the "
                f"value {checks.brief(table[name])}. {hint}",
            )
        for name in [name for name, needed in keys.items() if needed and name not in table]:
            hint = f" Write 'schema = {SCHEMA}' at the top." if name == "schema" else ""
            self._add(before + name, f"{name} must be given; got nothing.{hint}")
        return {name: value for name, value in table.items() if name in keys}

    def _listed_tables(self, name: str, tables: dict[str, Any]) -> list[tuple[str, Any]]:
        """The tables of a list, each with its path."""
        listed = tables.get(name, [])
        if isinstance(listed, list):
            return [(f"{name}[{index}]", table) for index, table in enumerate(listed)]
        self._add(name, f"{name} must be a list of tables, [[{name}]] for each; got {checks.brief(listed)}.")
        return []

    def _by_rule(self, path: str, table: Any, rules: dict[str, Any], needed: Iterable[str]) -> dict[str, Any]:
        """The values of a table, each checked by the rule of its key."""
        known = self._known(path, table, {name: name in needed for name in rules})
        return {name: self._tried(f"{path}.{name}", rules[name], name, value) for name, value in known.items()}

    def _group(self, path: str, table: Any) -> dict[str, Any]:
        """A table of discs, the keys of which fit together."""
        vectors = partial(self.arrays.array, shapes=((2,), (None, 2)), meaning="(2,) or (N, 2)")
        rules: dict[str, Any] = {
            "position": partial(self.arrays.array, shapes=((None, 2),), meaning="(N, 2)"),
            "velocity": vectors,
            **{name: vectors if each.components else self._per_disc for name, each in PER_DISC.items()},
            "places": partial(checks.choice, allowed=("random", *LATTICES)),
            "count": partial(checks.whole, low=0, high=LARGEST_COUNT, remedy="Give a number in this range."),
            "spacing": partial(checks.positive, unit="[length]"),
            "region": self._region,
            "seed": partial(checks.whole, low=0, high=2**63 - 1, remedy="Any whole number will do."),
            "temperature": partial(checks.non_negative, unit="[mass length^2/time^2]"),
        }
        before = self._problems
        group = self._by_rule(path, table, rules, [name for name, each in PER_DISC.items() if each.default is None])
        if self._problems == before:
            self._tried(path, _demand_consistent, group)
        return group

    def _per_disc(self, name: str, value: Any) -> float | Numbers:
        """A number for all discs or one each, > 0 if it has a unit."""
        numbers = self.arrays.array(name, value, ((), (None,)), "() or (N,)")
        found = numbers if numbers.ndim else float(numbers)
        if unit := PER_DISC[name].unit:
            checks.one_or_each(name, found, numbers.size, unit)  # equal ones stay an array
        return found

    def _region(self, name: str, value: Any) -> starts.Region | Obstacle:
        region = value if isinstance(value, Obstacle) else self.arrays.array(name, value, ((4,),), "(4,)")
        return starts.check_region(name, region)

    # --- tables of a class

    def _part(self, part: Feature, tables: dict[str, Any]) -> Any:
        """The value of an argument that is a table, or a list of tables of one or more values each."""
        name = part.argument
        if not part.several and not (part.several is None and isinstance(tables[name], list)):
            _, make = self._table(name, tables[name], part.kinds, part)
            return next(iter(make()), None)
        found: list[Callable[[], list[Any]]] = []
        total = 0
        for path, table in self._listed_tables(name, tables):
            count, make = self._table(path, table, part.kinds, part)
            found.append(make)
            total += count
            if total > MOST_VALUES:  # none is made before
                self._add(name, f"{name} must be at most {MOST_VALUES:,}; got {total:,} or more. Use fewer.")
                return []
        return [value for make in found for value in make()]

    def _table(
        self, path: str, table: Any, kinds: tuple[Any, ...], part: Feature | None = None
    ) -> tuple[int, Callable[[], list[Any]]]:
        """The number of values of a table, and what makes them: of the class that it names, or that fits its keys best.

        part: the feature of the table; None of a table in another one.
        """
        many, before = part is not None and bool(part.several), self._problems
        words = table if isinstance(table, dict) else {}
        kind = _kind_of(words, kinds, many)
        keys = _keys(kind, many) | ({"kind": False} if len(kinds) > 1 else {})
        if "kind" in keys and words.get("kind", kind.__name__) != kind.__name__:
            names = " or ".join(each.__name__ for each in kinds)
            self._add(path, f"kind must be {names}; got {checks.brief(words['kind'])}. Use one of these.", ["kind"])
        if many and "places" in words and "position" in keys:
            keys |= dict.fromkeys(LATTICE, True) | {"position": False}
        values = {
            name: self._tried(f"{path}.{name}", self._value, f"{path}.{name}", name, value, _hints(kind).get(name))
            for name, value in self._known(path, table, keys).items()
            if name != "kind"
        }
        examples: list[Any] = [] if part is None else [each for each in part.examples if type(each) is kind]
        if self._problems == before:
            columns = self._tried(path, _columns, values, examples[0]) if many and examples else {}
            if columns is not None:
                count = len(next(iter(columns.values()))) if columns else 1
                return count, partial(self._make, path, kind, examples, values, columns)
        fields = _keys(kind).keys()
        self._name_refused(path, kind, examples, {name: each for name, each in values.items() if name in fields})
        return 0, list

    def _value(self, path: str, name: str, value: Any, hint: Any) -> Any:
        """The value of a key: an array of a file, numbers, a value of another class, or what its class will check."""
        if isinstance(value, dict):
            classes: list[Any] = [each for each in (hint, *get_args(hint)) if dataclasses.is_dataclass(each)]
            kinds = tuple(kind for each in classes for kind in each.__subclasses__() or [each])
            _, make = self._table(path, value, kinds) if kinds else (1, lambda: [value])
            return next(iter(make()), None)
        if name == "region":
            return self._region(name, value)
        if isinstance(value, str) and hint is not str and _names_array_file(value):
            return self.arrays.content(name, value)
        if isinstance(value, list) and not any(isinstance(each, str) for each in value):
            _demand_numbers(name, value)
        return value

    def _make(
        self, path: str, kind: Any, examples: list[Any], common: dict[str, Any], columns: dict[str, list[Any]]
    ) -> list[Any]:
        """The values of a table; [] if one of them is refused."""
        made: list[Any] = []
        for row in zip(*columns.values(), strict=True) if columns else [()]:
            values = common | dict(zip(columns, row, strict=True))
            try:
                made.append(kind(**values))
            except InputError as error:
                at = dict.fromkeys(columns, f"[{len(made)}]")
                if not self._name_refused(path, kind, examples, values, at):
                    self._add(path, str(error), _keys(kind))
                return []
        return made

    def _name_refused(
        self, path: str, kind: Any, examples: list[Any], values: dict[str, Any], at: dict[str, str] | None = None
    ) -> bool:
        """Name each value that its class refuses in all examples, whose other values are valid; whether any is."""
        before = self._problems
        for name, value in values.items():
            errors: list[str] = []
            for example in examples:
                try:
                    kind(**vars(example) | {name: value})
                except InputError as error:
                    errors.append(str(error))
            if errors and len(errors) == len(examples):
                own = next((text for text in errors if text.startswith(name)), errors[0])
                self._add(f"{path}.{name}{(at or {}).get(name, '')}", own)
        return self._problems > before

    # --- the scene

    def scene(self) -> Scene:
        """The scene of the file, compressed if it says so.

        Raises:
            SceneFileError: with all that does not fit together.
        """
        scene = self._drawn()
        if self.compressed is not None:
            logger.info("mpsim: compressing %r to packing %g", scene, self.compressed["packing"])
            scene = self._tried("compressed", partial(scene.compressed, **self.compressed))
            self._demand_no_problem()
        return scene

    def _drawn(self, variation: int | None = None) -> Scene:
        """The scene as it is before it is compressed. variation: with other random numbers than those of the file."""
        self._sentences, self._problems = [], 0
        boundary = self._tried("boundary", check_boundary, self.arguments.get("boundary", WALLED))
        sides = None if boundary is None else self._sides(boundary)
        room = self._room(sides or (1.0, 1.0), boundary or WALLED)
        taken, total = [capsules_of(tuple(self.arguments.get("obstacles", ())), 0.0)], 0
        groups: list[dict[str, Any]] = []
        for index, group in enumerate(self.groups):
            path, count = f"discs[{index}]", total + group.get("count", 0)
            if count > LARGEST_COUNT:
                self._add(path, f"all discs must be at most {LARGEST_COUNT:,}; got {count:,} or more. Use fewer.")
                break
            if sides is not None or "position" in group:
                groups.append(self._tried(path, _placed, group, room, taken, variation))
                total += len(taken[-1])
        self._demand_no_problem()
        assert sides is not None
        box = {"width": sides[0], "height": sides[1]}
        try:
            scene = Scene(**box, **_joined(groups), **self.arguments)
        except InputError as error:
            self._name_all(box, groups)
            if not self._problems:
                self._add("", str(error))
            self._demand_no_problem()
            raise
        if any(group.get("places") == "random" or group.get("temperature") for group in self.groups):
            scene._redraw = self._drawn
        return scene

    def _room(self, sides: tuple[float, float], boundary: tuple[str, str]) -> starts.Room:
        """The box in which the groups are placed; a piston that is wrong is named later, with all else."""
        largest = max((float(np.max(group["radius"], initial=0.0)) for group in self.groups), default=0.0)
        with suppress(InputError):
            return room_at_start(sides, boundary, largest, self.arguments.get("piston"))
        return starts.Room(sides, wraps_of(boundary))

    def _sides(self, boundary: tuple[str, str]) -> tuple[float, float] | None:
        """Width and height, with `packing` computed from the discs; None if they cannot be computed."""
        if "packing" not in self.box:
            return self.box["width"], self.box["height"]
        area, largest, before = 0.0, 0.0, self._problems
        for index, group in enumerate(self.groups):
            count = len(group["position"]) if "position" in group else group.get("count")
            if count is None:
                self._add(f"discs[{index}]", "count must be given where packing makes the box; got none.")
                continue
            area += self._tried(f"discs[{index}]", starts.area_of_discs, group["radius"], count) or 0.0
            largest = max(largest, float(np.max(group["radius"], initial=0.0)))
        if not area and self._problems == before:
            self._add("packing", "packing needs discs to make a box for; got none. Give width and height.")
        if self._problems > before:
            return None
        side = self._tried("packing", starts.side_for, self.box["packing"], area, largest, boundary)
        return None if side is None else (side, side)

    def _name_all(self, box: dict[str, float], groups: list[dict[str, Any]]) -> None:
        """Name what is wrong in a scene that was refused: each part is tried in the box by itself."""
        bare = {**box, **_joined([]), "boundary": self.arguments.get("boundary", WALLED)}
        every = _joined(groups)
        # An emitter may take radius and mass from the discs.
        common = {name: every[name] for name in ("radius", "mass") if name in every and not np.ndim(every[name])}
        for index, group in enumerate(groups):
            self._tried(f"discs[{index}]", partial(Scene, **bare | _joined([group])))
        edges = {"absorbing": self.arguments.get("absorbing", ())}
        if self._tried("absorbing", partial(Scene, **bare | edges)) is not None:
            bare |= edges
        for name, value in self.arguments.items():
            own = common if name in PARTS and PARTS[name].adds_discs else {}
            self._tried(name, partial(Scene, **bare | own | {name: value}))


_BARE: dict[str, Any] = {"width": 1.0, "height": 1.0, "position": (), "velocity": (), "radius": 0.1}
"""Arguments of a scene in which any value of an argument that is no table can be tried."""


def _kind_of(table: dict[str, Any], kinds: tuple[type[Any], ...], many: bool) -> type[Any]:
    """The class that a table is of; many: whether it may hold several values."""
    named = [each for each in kinds if each.__name__ == table.get("kind")]
    return max(named or kinds, key=lambda each: _fit(_keys(each, many), table))


def _fit(keys: dict[str, bool], table: dict[str, Any]) -> int:
    """Number of keys of a table that are known, less that of those that it lacks."""
    return sum(name in keys for name in table) - sum(needed and name not in table for name, needed in keys.items())


def _demand_consistent(group: dict[str, Any]) -> None:
    """Refuse keys of a group of discs that do not go together."""
    places, by_place = group.get("places"), "position" in group
    if by_place == (places is not None):
        raise InputError(f"discs must have either position or places; got {'both' if by_place else 'neither'}.")
    if "velocity" in group and "temperature" in group:
        raise InputError("discs must have velocity or temperature, not both; got both.")
    needless = [name for name in ("count", "spacing", "region") if name in group]
    if by_place and needless:
        raise InputError(f"{needless[0]} goes with places, but these discs have positions. Leave it out.")
    if places == "random" and "count" not in group:
        raise InputError("count must be given for places = 'random'; got none.")
    if places == "random" and "spacing" in group:
        raise InputError("spacing belongs to a lattice; got it for places = 'random'. Leave it out.")
    if places in LATTICES and not {"count", "spacing"} & group.keys():
        raise InputError(f"count or spacing must be given for places = {places!r}; got neither.")


def _columns(common: dict[str, Any], example: Any) -> dict[str, list[Any]]:
    """The keys of a table that hold a value for each of many, taken from those that are common to all."""
    columns: dict[str, list[Any]] = {}
    if "places" in common:
        common["position"] = _sites(common)
    elif needless := [name for name in LATTICE if name in common]:
        raise InputError(f"{needless[0]} goes with places, but these have positions. Leave it out.")
    for name in [*common]:
        if checks.dimensions(common[name]) == np.ndim(getattr(example, name)) + 1:
            listed, hint = common.pop(name), _hints(type(example))[name]
            columns[name] = listed.tolist() if isinstance(listed, np.ndarray) else listed
            if int in (hint, *get_args(hint)):  # arrays of files hold whole numbers as floats
                columns[name] = [
                    int(each) if isinstance(each, float) and each.is_integer() else each for each in columns[name]
                ]
    first = next(iter(_keys(type(example))))  # such as position
    count = len(columns.get(first, [None]))
    if wrong := [name for name, column in columns.items() if len(column) != count]:
        raise InputError(
            f"{wrong[0]} must be one for all or {count}, as {first} has; got {len(columns[wrong[0]])}. Give as many."
        )
    return columns


def _sites(values: dict[str, Any]) -> Numbers:
    """Sites of the lattice that a table describes, whose keys are taken from its values."""
    if "position" in values:
        raise InputError("position must be left out where places are given; got both.")
    kind, region, spacing = (values.pop(name) for name in LATTICE)
    sites = starts.lattice_sites(
        checks.choice("places", kind, LATTICES), region, checks.positive("spacing", spacing, "[length]")
    )
    if len(sites) > MOST_VALUES:
        raise InputError(
            f"spacing must leave at most {MOST_VALUES:,} obstacles in the region; got {len(sites):,}. Use a larger one."
        )
    return sites


def _placed(group: dict[str, Any], room: starts.Room, taken: list[Numbers], variation: int | None) -> dict[str, Any]:
    """One group of discs as arguments of Scene; to `taken`, capsules in the box, it is added as capsules."""
    seed, kind, region = group.get("seed", 0), group.get("places"), group.get("region")
    radius, count, position = group["radius"], group.get("count"), group.get("position")
    rng = np.random.default_rng(seed if variation is None else [seed, variation])
    if kind in LATTICES:
        margin = float(np.max(radius, initial=0.0))
        x_low, x_high, y_low, y_high = room.walls or (0.0, room.size[0], 0.0, room.size[1])
        x_low, y_low = x_low + margin, y_low + margin
        within = (x_low, y_low, max(x_high - margin, x_low), max(y_high - margin, y_low))
        position = starts.lattice_sites(kind, region or within, group.get("spacing"), count)
    count = len(position) if position is not None else group["count"]
    own = {name: _each(name, group[name], count) for name in ("velocity", *PER_DISC) if name in group}
    if position is None:
        room = room._replace(capsules=np.concatenate(taken))
        position = starts.random_places(radius, count, room, region, rng)
    if "temperature" in group:
        own["velocity"] = starts.thermal_velocities(count, group["temperature"], group.get("mass"), rng)
    taken.append(of_discs(position, radius))
    return {"position": position, "velocity": np.zeros((count, 2)), **own}


def _each(name: str, value: Any, count: int) -> float | Numbers:
    """The values of the discs of a group: a number for all, or one each; vectors as rows."""
    vector = name not in PER_DISC or PER_DISC[name].components
    if np.ndim(value) == (1 if vector else 0):
        return np.tile(value, (count, 1)) if vector else value
    if len(value) != count:
        what = "row" if vector else "number"
        raise InputError(f"{name} must be one {what} or {count}, one per disc; got {len(value)}.")
    return value


def _joined(groups: list[dict[str, Any]]) -> dict[str, Any]:
    """The arguments of all groups as those of one."""
    joined: dict[str, Any] = {"position": np.empty((0, 2)), "velocity": np.empty((0, 2)), "radius": np.empty(0)}
    if len(groups) < 2:
        return groups[0] if groups else joined
    counts = [len(group["position"]) for group in groups]
    for name in dict.fromkeys(name for group in groups for name in group):
        default = PER_DISC[name].default if name in PER_DISC else None
        values: list[Any] = [group.get(name, default) for group in groups]
        if not any(map(np.ndim, values)) and len(set(values)) == 1:
            joined[name] = values[0]  # one number for all, which emitters may then use
        else:
            shape = max(values, key=np.ndim).shape[1:] if any(map(np.ndim, values)) else ()
            each = [np.broadcast_to(value, (count, *shape)) for value, count in zip(values, counts, strict=True)]
            joined[name] = np.concatenate(each)
    return joined


# --- Writing: small arrays in the file, large ones beside it, without losing a bit


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
    target = files.ending_as("scene.toml", path, "a scene file")
    lines = [f"schema = {SCHEMA}", *_scene_lines(scene), ""]
    if title or text or look_for:
        about = {"title": title, "text": text, "look_for": look_for}
        lines += ["[about]", *pairs({name: words for name, words in about.items() if words or name == "title"}), ""]
    settings = scene.settings if settings is None else settings
    if settings is not None:
        lines += ["[settings]", *pairs(chosen(settings)), ""]
    arrays: Files = []
    of_discs = ("position", "velocity", *PER_DISC)
    discs = {name: value for name in of_discs if (value := getattr(scene, name)) is not None}
    lines += ["[[discs]]", *_array_lines(discs, target, "", arrays), ""]
    tables = 0
    for feature in sorted((each for each in FEATURES if each.kinds), key=lambda each: not each.several):
        # without what is left of those that were removed while the scene ran
        there = [each for each in feature.of(scene) if isinstance(each, feature.kinds)] if feature.several else []
        own = _table_lines(feature, there, target, arrays)
        tables = max(tables, own.count(f"[[{feature.argument}]]"))
        lines += own
        if not feature.several and feature.is_in(scene):
            value, name = feature.of(scene), feature.argument
            each_of = [(name, value)] if not isinstance(value, tuple) else [(f"[{name}]", each) for each in value]
            for head, each in each_of:
                lines += [f"[{head}]", *pairs(chosen(each)), ""]
    length = sum(len(line) + 1 for line in lines)
    if length > MOST_BYTES or tables > MOST_TABLES:
        raise OutputError(
            f"a scene file must have at most {MOST_BYTES:,} bytes and {MOST_TABLES:,} tables of a kind; "
            f"{str(target)!r} would have {length:,} and {tables:,}. Let obstacles, and emitters, of one kind and with "
            "the same keys follow each other, which makes arrays of them; or keep the scene in Python."
        )
    with files.writable("path", path, "be a place that can be written", "Choose another."):
        _write([(target, lambda file: file.write("\n".join(lines).encode())), *arrays])


def _scene_lines(scene: Scene) -> list[str]:
    usual = {"boundary": WALLED, **NUMBERS, "absorbing": (), "measures": ()}
    names = ("width", "height", "boundary", *VECTORS, *NUMBERS, "absorbing", "duration", "picture_interval", "measures")
    values = {name: getattr(scene, name) for name in names}
    return pairs({name: value for name, value in values.items() if name not in usual or value != usual[name]})


def _table_lines(feature: Feature, values: Iterable[Any], target: Path, arrays: Files) -> list[str]:
    """Values of a feature as tables, many alike as one table of arrays; the files of these are appended."""
    lines: list[str] = []
    examples = {type(each) for each in feature.examples}
    for (kind, *_), group in groupby(values, _likeness):
        alike = list(group)
        if kind not in feature.kinds:
            rule = f"each be a {' or '.join(each.__name__ for each in feature.kinds)} itself"
            raise checks.refusal(f"{feature.argument} of a scene file", rule, f"a {kind.__name__}", "Use one of these.")
        many = len(alike) > INLINE and kind in examples and not hasattr(alike[0], "points")  # of any number
        for some in [alike] if many else [[each] for each in alike]:
            columns, common = dict[str, Any](), dict[str, Any]()
            for name in dict.fromkeys(name for each in some for name in chosen(each)):
                column: list[Any] = [getattr(each, name) for each in some]
                if many and not _is_one(column[0]):
                    columns[name] = column
                elif isinstance(column[0], tuple) and len(column[0]) > INLINE:
                    columns[name] = column[0]
                else:
                    common[name] = column[0]
            if _kind_of(columns | common, feature.kinds, True) is not kind:
                common["kind"] = kind.__name__
            prefix = f"{feature.argument}-{len(arrays)}."
            lines += [f"[[{feature.argument}]]", *_array_lines(columns, target, prefix, arrays), *pairs(common), ""]
    return lines


def _likeness(value: Any) -> tuple[Any, ...]:
    """What values have in common that can be in one table: their class, the keys, and values of `_is_one`."""
    values = vars(value)
    keys = tuple(name for name, each in values.items() if each is not None)
    return type(value), keys, [each for each in values.values() if _is_one(each)]


def _is_one(value: Any) -> bool:
    """Whether a value is the same for all in a table: a truth value, or of another class."""
    return isinstance(value, bool) or dataclasses.is_dataclass(value)


def _array_lines(arrays: dict[str, Any], target: Path, prefix: str, files: Files) -> list[str]:
    """Arrays by name as lines of a table. Large ones become files beside the target, named by prefix and name."""
    lines: list[str] = []
    for name, value in arrays.items():
        numbers = np.asarray(value, dtype=np.float64)
        if numbers.ndim == 0 or len(numbers) <= INLINE:
            rows = numbers.tolist()
            one_line = numbers.ndim < 2 or len(rows) < 2
            lines.append(f"{name} = {in_toml(rows)}" if one_line else f"{name} = [")
            lines += [] if one_line else [*(f"    {in_toml(row)}," for row in rows), "]"]
            continue
        file = target.with_name(f"{target.stem}.{prefix}{name}.npy")
        content = io.BytesIO()  # numpy itself does not say why a file on a disk cannot be written
        np.save(content, numbers.astype("<f8"), allow_pickle=False)
        files.append((file, lambda out, content=content: out.write(content.getbuffer())))
        lines.append(f"{name} = {in_toml(file.name)}")
    return lines


def _write(parts: Files) -> None:
    """Every file is complete on the disk before the first is renamed; they are renamed last to first."""
    if parts:
        (path, write), *others = parts
        with files.atomic_write(path) as file:
            write(file)
            file.flush()
            os.fsync(file.fileno())
            _write(others)
