"""Features in scene files, and the rules of keys: Python arguments, arrays from files, sizes."""

import csv
import io
import json
import logging
import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import chain, groupby
from pathlib import Path
from typing import Annotated, Any, BinaryIO, ClassVar

import numpy as np
import pydantic
from numpy.typing import NDArray
from pydantic import Discriminator, Field, PlainValidator, PrivateAttr, Tag, ValidationInfo, model_validator

from mpsim.core import checks, files
from mpsim.core.archive import REAL, read_array
from mpsim.core.machine import garbage_collection_paused
from mpsim.errors import InputError, is_of_the_system
from mpsim.features import FEATURES
from mpsim.features.emitters import LARGEST_EMITTERS, Emitter
from mpsim.features.feature import Feature
from mpsim.features.obstacles import (
    LARGEST_OBSTACLES,
    OBSTACLES,
    FixedDisc,
    Obstacle,
    Polyline,
    capsules_of,
    check_lines,
    fixed_discs,
    polylines,
)
from mpsim.scene.scene import Scene
from mpsim.scene.starts import LATTICES, lattice_sites

# --- Largest scene file and arrays that are read
#
# They bound what is processed item by item in Python; long arrays of numbers belong in .npy files.

MOST_BYTES = 2**20
"""Bytes of the scene file itself: about 20,000 lines."""

MOST_TABLES = 10_000
"""Tables of one kind: [[discs]], or those of a feature. One table may hold very many, as arrays."""

MOST_PARTS = 16
"""Parts of a dotted key. No key of a scene file has more than two; a parser's time grows with their square."""

MOST_PROBLEMS = 100
"""Problems of one file that are reported."""

MOST_ARRAY_BYTES = 2**33
"""Bytes of all array files of a scene together: enough for the largest scene."""

MOST_CSV = 2**23
"""Bytes of a .csv file, which is read cell by cell."""


# --- Arrays of a scene file: numbers in the file itself, or a .npy or .csv file beside it

logger: logging.Logger = logging.getLogger("mpsim")

INLINE = 64
"""Number of rows up to which an array is saved in the scene file itself, where a person can read it."""


@dataclass
class ArraySource:
    """Where the arrays of a scene file may come from.

    Attributes:
        folder: that of the scene file; arrays lie in it or below.
        read: array files read so far.
        length: size of all of them [bytes].
        emitters: number of emitters in the tables checked so far.
    """

    folder: Path
    read: list[Path] = field(default_factory=list)
    length: int = 0
    emitters: int = 0

    def note(self, name: str, path: Path, length: int) -> None:
        """Add an array file, if all of them together are not too large."""
        self.read.append(path)
        self.length += length
        if self.length > MOST_ARRAY_BYTES:
            raise InputError(
                f"{name} must leave the array files of a scene at most {MOST_ARRAY_BYTES:,} bytes together; got "
                f"{self.length:,} with {path.name}. Use fewer or smaller arrays."
            )


def array(
    name: str, value: Any, shapes: tuple[tuple[int | None, ...], ...], meaning: str, source: ArraySource
) -> NDArray[np.float64]:
    """Numbers, or those of a file given by name, as a float64 array of one of the shapes (None: any length).

    Raises:
        InputError: naming the rule and the value received.
    """
    if isinstance(value, str):
        numbers = from_file(name, value, source)
    else:
        demand_numbers(name, value)
        numbers = _array_of(name, value, meaning)
    fitting = [shape for shape in shapes if len(shape) == numbers.ndim]
    # An empty list has lost its axes: the shape of most axes is taken.
    return checks.finite_array(name, numbers, fitting[0] if fitting and numbers.size else shapes[-1], meaning)


def from_file(name: str, path: str, source: ArraySource) -> NDArray[Any]:
    """The array in a .npy or .csv file in the scene file's folder or below.

    Raises:
        InputError: if there is none, or if it cannot be read without executing code.
    """
    full, shown = source.folder / path, checks.brief(path)
    suffix = full.suffix.lower()
    if suffix not in (".npy", ".csv"):
        raise InputError(f"{name} must be numbers or the name of a .npy or .csv file; got {shown}.")
    try:
        inside = full.resolve().is_relative_to(source.folder.resolve())
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
            source.note(name, full, length)
            return _from_npy(name, full.name, file, length) if suffix == ".npy" else _from_csv(name, full)
    except FileNotFoundError:
        raise InputError(f"{name} must be a file that exists; got {shown}: no such file in {source.folder}.") from None
    except IsADirectoryError:
        raise InputError(f"{name} must be a file that exists; got {shown}: a folder in {source.folder}.") from None
    except OSError as error:
        if not is_of_the_system(error):
            raise
        raise InputError(f"{name} must be a file that can be read; got {shown} ({error.strerror}).") from None


def _from_npy(name: str, label: str, file: BinaryIO, length: int) -> NDArray[Any]:
    try:
        return read_array(file, length, label, REAL)  # which refuses pickles, as they could execute code
    except ValueError as error:
        raise InputError(
            f"{name} must be an array of real numbers as numpy.save writes it; {label} is not ({error!s:.200}). "
            "Save it anew."
        ) from None


@garbage_collection_paused()
def _from_csv(name: str, path: Path) -> NDArray[np.float64]:
    """One row per line, after an optional line of headings."""
    try:
        text = io.StringIO(files.content(path, MOST_CSV).decode("utf-8-sig"), newline="")
        lines = [(number, row) for number, row in enumerate(csv.reader(text), 1) if any(map(str.strip, row))]
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{name} must be a text file of numbers; {path.name} is not ({error}).") from None
    if lines and not any(_is_number(cell) for cell in lines[0][1]):
        del lines[0]
    width = len(lines[0][1]) if lines else 0
    for number, row in lines:
        if len(row) != width:
            raise InputError(
                f"{name} must have as many numbers in every row; line {number} of {path.name} has {len(row)}, and "
                f"line {lines[0][0]} has {width}."
            )
    try:
        numbers = np.fromiter((float(cell) for _, row in lines for cell in row), np.float64)
    except ValueError:
        number, cell = next((number, cell) for number, row in lines for cell in row if not _is_number(cell))
        raise InputError(f"{name} must be numbers; line {number} of {path.name} has {checks.brief(cell)}.") from None
    return numbers if width == 1 else numbers.reshape(-1, width) if width else numbers


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def demand_numbers(name: str, value: Any) -> None:
    """Refuse texts, truth values and dates in place of numbers: numpy would convert some of them."""
    if isinstance(value, list):
        for index, part in enumerate(value):
            demand_numbers(f"{name}[{index}]", part)
        return
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{name} must be a number; got {checks.brief(value)}.")
    try:
        float(value)
    except OverflowError:
        raise InputError(f"{name} must be finite in float64; got {checks.brief(value)}.") from None


def _array_of(name: str, value: Any, meaning: str) -> NDArray[np.float64]:
    try:
        return np.array(value, dtype=np.float64)
    except ValueError:
        lengths = sorted({len(row) if isinstance(row, list) else 0 for row in value})
        raise InputError(
            f"{name} must be numbers of shape {meaning}; got rows of different lengths, {lengths[0]} to {lengths[-1]}."
        ) from None


def positive(name: str, numbers: NDArray[np.float64], unit: str) -> NDArray[np.float64]:
    """The array, checked to be > 0 everywhere."""
    bad = np.flatnonzero(numbers <= 0)
    if len(bad):
        at = f"[{bad[0]}]" if numbers.ndim else ""
        raise InputError(f"{name} must be > 0 {unit}; {name}{at} is {float(numbers.flat[bad[0]])!r}.")
    return numbers


def text_of(numbers: NDArray[np.float64]) -> str:
    """An array as TOML, from which the same bits are read."""
    if numbers.ndim == 0:
        return repr(float(numbers))
    if numbers.ndim == 1:
        return f"[{', '.join(map(repr, numbers.tolist()))}]"
    if len(numbers) <= 1:
        return f"[{', '.join(map(text_of, numbers))}]"
    return "[\n" + "".join(f"    {text_of(row)},\n" for row in numbers) + "]"


def is_small(numbers: NDArray[np.float64]) -> bool:
    """Whether an array is written into the scene file itself."""
    return numbers.ndim == 0 or len(numbers) <= INLINE


# --- Values as lines of TOML, large arrays as files beside it

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


# --- Rules for the keys of a scene file: those for the Python arguments, and arrays from files

Numbers = NDArray[np.float64]
Check = Callable[[str, Any, ValidationInfo], Any]


def checked(check: Check) -> PlainValidator:
    """A validator that calls one of mpsim's own checks, which raise InputError."""

    def validate(value: Any, info: ValidationInfo) -> Any:
        return check(str(info.field_name), value, info)

    return PlainValidator(validate)


def plain(check: Callable[..., Any], *rule: Any) -> PlainValidator:
    """A validator that calls a check with name, value and the given further arguments."""
    return checked(lambda name, value, _: check(name, value, *rule))


def as_in(*examples: Any, words: bool = False, numbers: bool = True) -> PlainValidator:
    """A validator with the rule of a class of mpsim for this argument: see `_rule_of`."""
    return checked(_rule_of(*examples, words=words, numbers=numbers and not words))


def _rule_of(*examples: Any, words: bool = False, numbers: bool = True) -> Check:
    """The rule of a class of mpsim for this argument.

    It is applied by making an instance with this argument replaced in otherwise valid ones. Where validity depends on
    another argument there are several examples, of which one must accept the value.
    words: whether the value is a word or a list of words.
    numbers: whether a list must hold numbers; else the class checks it.
    """

    def check(name: str, value: Any, _: ValidationInfo) -> Any:
        if words and not isinstance(value, str | list):
            raise InputError(f"{name} must be a word or a list of words; got {checks.brief(value)}.")
        if isinstance(value, list) and numbers:
            demand_numbers(name, value)
        refused = None
        for kind, arguments in examples:
            try:
                return getattr(kind(**{**arguments, name: value}), name)
            except InputError as error:
                refused = refused or error
        assert refused is not None
        raise refused

    return check


def one_or_many(*examples: Any, row: tuple[int, ...] = ()) -> Any:
    """The rule of a class for this argument; or an array with a value each, as numbers or in a file."""
    one = _rule_of(*examples)

    def check(name: str, value: Any, info: ValidationInfo) -> Any:
        listed = isinstance(value, list) and (not row or any(isinstance(part, list) for part in value))
        if not listed and not isinstance(value, str):
            return one(name, value, info)
        shape = (None, *row)
        return array(name, value, (shape,), str(shape).replace("None", "K"), source_of(info))

    return checked(check)


def array_of(*shapes: tuple[int | None, ...], meaning: str, unit: str | None = None) -> PlainValidator:
    """Numbers, or a file of them; > 0 if a unit is given."""

    def check(name: str, value: Any, info: ValidationInfo) -> Any:
        if unit is not None and isinstance(value, int | float):
            return checks.positive(name, value, unit)
        numbers = array(name, value, shapes, meaning, source_of(info))
        if unit is not None:
            positive(name, numbers, unit)
        return float(numbers) if numbers.ndim == 0 else numbers

    return checked(check)


def source_of(info: ValidationInfo) -> ArraySource:
    """Where arrays may come from: the context of the validation."""
    assert isinstance(info.context, ArraySource)
    return info.context


class Table(pydantic.BaseModel):
    """A table of a scene file: no key but its own, no conversion of one type into another."""

    model_config: ClassVar[pydantic.ConfigDict] = pydantic.ConfigDict(
        extra="forbid", strict=True, frozen=True, arbitrary_types_allowed=True
    )


def _region(name: str, value: Any, info: ValidationInfo) -> tuple[float, float, float, float]:
    numbers = array(name, value, ((4,),), "(4,): x_low, y_low, x_high, y_high", source_of(info)).tolist()
    if numbers[0] > numbers[2] or numbers[1] > numbers[3]:
        raise InputError(f"{name} must be [x_low, y_low, x_high, y_high], low before high; got {numbers}.")
    return tuple(numbers)


Positive = Annotated[float, plain(checks.positive, "[length]")]
Region = Annotated[tuple[float, float, float, float], checked(_region)]
Spacing = Annotated[float, plain(checks.positive, "[length]")]


# --- A feature in scene files: its tables, how its values are made from them, and how it is written

Problem = tuple[str, str]
"""Key path, and the problem there."""


Tables = tuple[tuple[str, str, type[Table]], ...]
"""Of each kind of a table its name in the annotation, its title in the docs, its class."""


class FeatureTables:
    """The tables of one feature.

    Attributes:
        argument: of Scene; the key of the tables.
        several: whether there may be many tables, [[argument]].
        tables: for each kind its name in the annotation ("" if there is only one), its title in the docs, its class.
        annotation, default, description: of the key.
        relies_on_discs: whether missing values come from the discs of the scene.
        advice: what keeps a file with very many of them short, to follow "Let ".
    """

    argument: str
    several: bool = True
    tables: Tables
    annotation: Any
    default: Any = []  # noqa: RUF012 - pydantic copies it
    description: str
    relies_on_discs: bool = False
    advice: str = ""

    def made(self, tables: list[Any], problems: list[Problem]) -> tuple[list[Any], list[int]]:
        """The values of all tables, and the table number of each; problems are appended."""
        values = [each.made() for each in tables]
        owners = [index for index, some in enumerate(values) for _ in some]
        return [value for some in values for value in some], owners

    def capsules(self, values: list[Any]) -> NDArray[np.float64]:
        """Capsules that discs must not overlap, shape (K, 5)."""
        return np.empty((0, 5))

    def lines(self, scene: Scene, target: Path, files: Files) -> list[str]:
        """Its tables as lines of a file; files of its arrays are appended."""
        raise NotImplementedError


class SinglePart(FeatureTables):
    """The table of a feature that a scene has once: its keys are the fields of the feature's class."""

    several = False
    default = None

    def __init__(self, feature: Feature):
        (kind,) = feature.kinds
        examples = [(kind, example) for example in feature.examples]
        words = {name for name, value in feature.examples[0].items() if isinstance(value, str)}

        class SingleTable(Table):
            @model_validator(mode="after")
            def _fits_together(self) -> "SingleTable":
                self.made()
                return self

            def made(self) -> Any:
                """The value."""
                return kind(**dict(self))

        fields: dict[str, Any] = {
            name: (
                Annotated[Any, as_in(*examples, numbers=name not in words), Field(description=meaning)],
                ... if name in feature.examples[0] else None,
            )
            for name, meaning in feature.keys.items()
        }
        table = pydantic.create_model(f"{kind.__name__}Table", __base__=SingleTable, **fields)
        table.__doc__ = f"A {kind.__name__}."
        self._feature = feature
        self.argument: str = feature.argument
        self.tables: Tables = (("", f"`[{feature.argument}]`", table),)
        self.annotation: Any = table | None
        self.description: str = feature.meaning

    def lines(self, scene: Scene, target: Path, files: Files) -> list[str]:
        value = self._feature.of(scene)
        return [] if value is None else [f"[{self.argument}]", *pairs(vars(value)), ""]


# --- Obstacles in scene files: [[obstacles]]

_PEG = (FixedDisc, {"position": (0.0, 0.0), "radius": 1.0})
_LINE = (Polyline, {"points": ((0.0, 0.0), (1.0, 0.0)), "thickness": 0.0})


class PegTable(Table):
    """A FixedDisc."""

    position: Annotated[
        Numbers,
        array_of((2,), (None, 2), meaning="(2,) or (K, 2)"),
        Field(description="centre [x, y]; of many discs [[x, y], ...], or a file"),
    ]
    radius: Annotated[
        float | Numbers,
        array_of((), (None,), meaning="() or (K,)", unit="[length]"),
        Field(description="> 0; one for all, one each, or a file"),
    ]

    @property
    def number(self) -> int:
        """How many obstacles `made` makes."""
        return np.size(self.position) // 2

    def made(self) -> list[Obstacle]:
        """The obstacles of this table."""
        places = np.reshape(self.position, (-1, 2))
        if np.ndim(self.radius) and np.shape(self.radius) != (len(places),):
            raise InputError(
                f"radius must be one number or {len(places)}, one per row of position; got {np.size(self.radius)}."
            )
        return [*fixed_discs(places, self.radius)]


class PegsTable(Table):
    """FixedDiscs on a lattice."""

    places: Annotated[str, plain(checks.choice, LATTICES), Field(description="square or hexagonal")]
    region: Annotated[Region, Field(description="[x_low, y_low, x_high, y_high], where the centres lie")]
    spacing: Annotated[Spacing, Field(description="between neighbours")]
    radius: Annotated[float, as_in(_PEG), Field(description="> 0")]

    @property
    def number(self) -> int:
        """How many obstacles `made` makes."""
        return len(self._sites)

    def made(self) -> list[Obstacle]:
        """The obstacles of this table."""
        return [*fixed_discs(self._sites, self.radius)]

    @property
    def _sites(self) -> Numbers:
        sites = lattice_sites(self.places, self.region, self.spacing)
        if len(sites) > LARGEST_OBSTACLES:
            raise InputError(
                f"spacing must leave at most {LARGEST_OBSTACLES:,} obstacles in the region; got {len(sites):,}. "
                "Use a larger spacing or a smaller region."
            )
        return sites


class LineTable(Table):
    """Polylines, one after the other."""

    points: Annotated[
        Numbers,
        array_of((None, 2), meaning="(K, 2)"),
        Field(description="corners [[x, y], [x, y], ...], or a file"),
    ]
    lengths: Annotated[
        Numbers | None,
        array_of((None,), meaning="(L,)"),
        Field(description="if points holds several lines: number of points of each, or a file"),
    ] = None
    thickness: Annotated[Any, one_or_many(_LINE), Field(description=">= 0; one for all lines, one each, or a file")] = (
        0.0
    )

    @model_validator(mode="after")
    def _fits_together(self) -> "LineTable":
        check_lines(self.points, self._lengths)
        if np.ndim(self.thickness):
            if len(self.thickness) != self.number:
                count = len(self.thickness)
                raise InputError(f"thickness must be one number or {self.number}, one per line; got {count}.")
            checks.non_negative("thickness", float(np.min(self.thickness, initial=0.0)), "[length]")
        return self

    @property
    def _lengths(self) -> NDArray[Any]:
        return np.array([len(self.points)]) if self.lengths is None else self.lengths

    @property
    def number(self) -> int:
        """How many obstacles `made` makes."""
        return len(self._lengths)

    def made(self) -> list[Obstacle]:
        """The obstacles of this table."""
        return [*polylines(self.points, self._lengths, self.thickness)]


def _obstacle_kind(value: Any) -> str:
    keys = value if isinstance(value, dict) else {}
    return "line" if {"points", "lengths", "thickness"} & set(keys) else "pegs" if "places" in keys else "peg"


def _are_too_many(tables: list[Any]) -> bool:
    """Whether the tables have more obstacles than are allowed; those that cannot be counted are left out."""
    found = 0
    for each in tables:
        with suppress(InputError):
            found += each.number
        if found > LARGEST_OBSTACLES:
            return True
    return False


class ObstaclesPart(FeatureTables):
    """Discs, discs on a lattice, and chains of walls."""

    argument = "obstacles"
    tables: Tables = (
        ("peg", "`[[obstacles]]`: a disc", PegTable),
        ("pegs", "`[[obstacles]]`: discs on a lattice", PegsTable),
        ("line", "`[[obstacles]]`: chains of walls", LineTable),
    )
    annotation = list[
        Annotated[
            Annotated[PegTable, Tag("peg")] | Annotated[PegsTable, Tag("pegs")] | Annotated[LineTable, Tag("line")],
            Discriminator(_obstacle_kind),
        ]
    ]
    description = "obstacles in the box"
    advice = "discs follow discs and lines follow lines among the obstacles"

    def made(self, tables: list[Any], problems: list[Problem]) -> tuple[list[Any], list[int]]:
        made: list[Obstacle] = []
        owners: list[int] = []
        if _are_too_many(tables):
            text = f"obstacles must be at most {LARGEST_OBSTACLES:,}; got more. Use fewer, or a larger spacing."
            problems.append(("obstacles", text))
            return [], []
        for index, each in enumerate(tables):
            try:
                some = each.made()
            except InputError as error:
                problems.append((f"obstacles[{index}]", str(error)))
                continue
            made += some
            owners += [index] * len(some)
        return made, owners

    def capsules(self, values: list[Any]) -> NDArray[np.float64]:
        return capsules_of(tuple(values))

    def lines(self, scene: Scene, target: Path, files: Files) -> list[str]:
        lines: list[str] = []
        for kind, group in groupby(OBSTACLES.of(scene), type):
            alike = list(group)
            plain_ones = not any(each.motion or each.surface_velocity for each in alike)
            if len(alike) > INLINE and kind in _TOGETHER and plain_ones:
                arrays = _TOGETHER[kind](alike)
                lines += ["[[obstacles]]", *array_lines(arrays, target, f"obstacles-{len(files)}.", files), ""]
                continue
            for obstacle in alike:
                values = {name: value for name, value in vars(obstacle).items() if value or name == "position"}
                if values.keys() & {"motion", "surface_velocity"}:
                    raise InputError(
                        "a scene file has no keys for a motion or a surface_velocity of an obstacle yet; got "
                        f"{obstacle!r}. Save a checkpoint of a simulation instead, by sim.save."
                    )
                points = {name: values.pop(name) for name in ("points",) if len(values.get(name, ())) > INLINE}
                lines += ["[[obstacles]]", *array_lines(points, target, f"obstacles-{len(files)}.", files)]
                lines += [*pairs(values), ""]
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


_TOGETHER = {FixedDisc: _discs_together, Polyline: _lines_together}
"""Kinds that have a table of many; each obstacle of another kind has a table of its own."""


# --- Emitters in scene files: [[emitters]]

_EMITTERS = tuple(
    (Emitter, {"position": (0.0, 0.0), "velocity": (0.0, 0.0), **timing})
    for timing in ({"interval": 1.0}, {"every": 1})
)


class EmitterTable(Table):
    """An Emitter, or several: then each value may be an array, one row per row of position."""

    position: Annotated[
        Any,
        one_or_many(*_EMITTERS, row=(2,)),
        Field(description="centre of the new disc [x, y]; of many emitters [[x, y], ...], or a file"),
    ]
    velocity: Annotated[
        Any,
        one_or_many(*_EMITTERS, row=(2,)),
        Field(description="of the new disc [vx, vy]; of many emitters [[vx, vy], ...], or a file"),
    ]
    interval: Annotated[
        Any, one_or_many(*_EMITTERS), Field(description="time between two discs; this or every is needed")
    ] = None
    every: Annotated[
        Any,
        one_or_many(*reversed(_EMITTERS)),
        Field(description="instead of interval: frames between two discs, so another scene for each dt"),
    ] = None
    limit: Annotated[Any, one_or_many(*_EMITTERS), Field(description="total number of discs; default: no limit")] = None
    radius: Annotated[Any, one_or_many(*_EMITTERS), Field(description="default: the radius of all discs")] = None
    mass: Annotated[Any, one_or_many(*_EMITTERS), Field(description="default: 1, if all discs have mass 1")] = None

    _made: list[Emitter] = PrivateAttr(default_factory=list)

    @model_validator(mode="after")
    def _has_its_times(self, info: ValidationInfo) -> "EmitterTable":
        source = source_of(info)
        source.emitters += np.size(self.position) // 2
        if source.emitters > LARGEST_EMITTERS:
            raise InputError(f"all emitters must be at most {LARGEST_EMITTERS:,}; got {source.emitters:,}. Use fewer.")
        self._made = self._emitters()
        return self

    def made(self) -> list[Emitter]:
        """The emitters."""
        return self._made

    def _emitters(self) -> list[Emitter]:
        each: dict[str, Any] = {name: value for name, value in dict(self).items() if value is not None}
        many = {name for name, value in each.items() if isinstance(value, np.ndarray)}
        if not many:
            return [Emitter(**each)]
        count = len(self.position) if "position" in many else 1
        for name in sorted(many):
            if len(each[name]) != count:
                raise InputError(f"{name} must have {count} rows, one per row of position; got {len(each[name])}.")
            values = each[name].tolist()
            whole = name in ("every", "limit") and all(value.is_integer() for value in values)
            each[name] = [int(value) for value in values] if whole else values
        rows = zip(*(each[name] if name in many else [each[name]] * count for name in each), strict=True)
        return [Emitter(**dict(zip(each, row, strict=True))) for row in rows]


class EmittersPart(FeatureTables):
    """Where discs enter."""

    argument = "emitters"
    tables: Tables = (("", "`[[emitters]]`", EmitterTable),)
    annotation = list[EmitterTable]
    description = "where discs enter"
    relies_on_discs = True
    advice = "emitters those with the same keys"

    def lines(self, scene: Scene, target: Path, files: Files) -> list[str]:
        lines: list[str] = []
        for names, group in groupby(
            getattr(scene, self.argument),
            lambda each: [name for name, value in vars(each).items() if value is not None],
        ):
            alike = list(group)
            if len(alike) > INLINE:
                arrays = {name: [getattr(each, name) for each in alike] for name in names}
                lines += ["[[emitters]]", *array_lines(arrays, target, f"emitters-{len(files)}.", files), ""]
                continue
            for emitter in alike:
                lines += ["[[emitters]]", *pairs(vars(emitter)), ""]
        return lines


# --- The list of all features in scene files

PARTS: tuple[FeatureTables, ...] = (
    ObstaclesPart(),
    EmittersPart(),
    *(SinglePart(feature) for feature in FEATURES if feature.keys),
)
