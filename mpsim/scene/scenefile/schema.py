"""The tables and keys of a scene file, and the scene that is made from them."""

import dataclasses
import functools
import logging
import math
from collections.abc import Callable, Iterator
from itertools import islice
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import pydantic
from numpy.typing import NDArray
from pydantic import Field, model_validator

from mpsim.core import checks
from mpsim.errors import InputError
from mpsim.features import NUMBERS, PER_DISC, VECTORS
from mpsim.features.edges import check_boundary, wraps_of
from mpsim.features.feature import PerDisc
from mpsim.scene.scene import FASTEST, LARGEST_COUNT, SLOWEST, Scene
from mpsim.scene.scenefile.parts import (
    MOST_PROBLEMS,
    PARTS,
    Numbers,
    Positive,
    Problem,
    Region,
    Spacing,
    Table,
    array_of,
    as_in,
    plain,
)
from mpsim.scene.settings import Settings
from mpsim.scene.starts import LATTICES, Taken, demand_area, lattice_sites, random_places, side_for, thermal_velocities

# --- The tables and keys of a scene file. Every rule is that of the corresponding Python class

SCHEMA = 1
"""Version of this format."""


def _text(name: str, value: Any) -> str:
    if not isinstance(value, str):
        raise InputError(f"{name} must be a text in quotation marks; got {checks.brief(value)}.")
    return value


def version_problem(value: Any) -> str:
    """The error text for a version that is not SCHEMA."""
    return (
        f"schema must be {SCHEMA}, the version of scene files that this mpsim reads; got {checks.brief(value)}. "
        "A newer mpsim may read it."
    )


def _version(_: str, value: Any) -> int:
    if isinstance(value, bool) or value != SCHEMA or not isinstance(value, int):
        raise InputError(version_problem(value))
    return value


Text = Annotated[str, plain(_text)]
Count = Annotated[int, plain(checks.whole, 0, LARGEST_COUNT, "Give a number in this range.")]
Seed = Annotated[int, plain(checks.whole, 0, 2**63 - 1, "Any whole number will do.")]


class About(Table):
    """Title and texts for people."""

    title: Annotated[Text, Field(description="a line")]
    text: Annotated[Text, Field(description="what it is")] = ""
    look_for: Annotated[Text, Field(description="what to look for when it runs")] = ""


_SETTINGS: dict[str, Any] = {
    field.name: (Annotated[Any, as_in((Settings, {}), numbers=False)], field.default)
    for field in dataclasses.fields(Settings)
}
if TYPE_CHECKING:

    class SettingsTable(Table):
        """Recommended settings, by the names of Settings: made below, where its keys are known."""
else:
    SettingsTable = pydantic.create_model("SettingsTable", __base__=Table, **_SETTINGS)
    SettingsTable.__doc__ = "Recommended settings, by the names of Settings."


def _key_of(each: PerDisc) -> tuple[Any, Any]:
    """Type and default of a key for a value of each disc."""
    if each.components:
        rule = array_of((2,), (None, 2), meaning="(2,) or (N, 2)")
        forms, otherwise = f"[{', '.join(each.components)}] for all, one row each, or a file", "none"
    else:
        rule = array_of((), (None,), meaning="() or (N,)", unit=each.unit or None)
        forms, otherwise = "one for all, one each, or a file", f"{each.default:g}" if each.default is not None else ""
    description = "; ".join(filter(None, (each.meaning, forms, otherwise and f"default: {otherwise}")))
    default = ... if each.default is None else None
    return Annotated[float | Numbers | None, rule, Field(description=description)], default


def _start(name: str, value: Any) -> str:
    """A word for the start of a group; the others belong elsewhere."""
    if value == "compressed":
        raise InputError(
            f"{name} must be a start of one group; got 'compressed', which is for all groups together. Use 'random' "
            "here, and a table [compressed]."
        )
    return checks.choice(name, value, ("random", *LATTICES))


class _Places(Table):
    """Where the discs of a group are."""

    position: Annotated[
        Numbers | None, array_of((None, 2), meaning="(N, 2)"), Field(description="centres [[x, y], ...], or a file")
    ] = None
    places: Annotated[
        str | None,
        plain(_start),
        Field(description="instead of position: random, square or hexagonal (a lattice)"),
    ] = None
    count: Annotated[Count | None, Field(description="number of discs; default for a lattice: all that fit")] = None
    spacing: Annotated[
        Spacing | None, Field(description="between neighbours of a lattice; default: the widest that fits count discs")
    ] = None
    region: Annotated[
        Region | None,
        Field(description="[x_low, y_low, x_high, y_high] of the centres; default: the box, a radius inside"),
    ] = None
    seed: Annotated[Seed, Field(description="seed of random positions and thermal velocities")] = 0


if TYPE_CHECKING:

    class _Own(_Places):
        """And what features have of each: made below, where its keys are known."""

        radius: float | Numbers
        mass: float | Numbers | None = None
else:
    _Own = pydantic.create_model("_Own", __base__=_Places, **{name: _key_of(each) for name, each in PER_DISC.items()})


class DiscGroup(_Own):
    """A group of discs: initial positions and velocities, radii, masses."""

    velocity: Annotated[
        Numbers | None,
        array_of((2,), (None, 2), meaning="(2,) or (N, 2)"),
        Field(description="[vx, vy] for all, one row each, or a file; default: at rest"),
    ] = None
    temperature: Annotated[
        float | None,
        plain(checks.non_negative, "[mass length^2/time^2]"),
        Field(description="instead of velocity: kT of normally distributed ones, without drift, scaled to be exact"),
    ] = None

    @model_validator(mode="after")
    def _fits_together(self) -> "DiscGroup":
        if (self.position is None) == (self.places is None):
            got = "neither" if self.position is None else "both"
            raise InputError(f"discs must have either position or places; got {got}.")
        if self.velocity is not None and self.temperature is not None:
            raise InputError("discs must have velocity or temperature, not both; got both.")
        needless = [name for name in ("count", "spacing", "region") if getattr(self, name) is not None]
        if self.position is not None and needless:
            raise InputError(f"{needless[0]} goes with places, but these discs have positions. Leave it out.")
        if self.places == "random":
            if self.count is None:
                raise InputError("count must be given for places = 'random'; got none.")
            if self.spacing is not None:
                raise InputError("spacing belongs to a lattice; got it for places = 'random'. Leave it out.")
        if self.places in LATTICES and self.count is None and self.spacing is None:
            raise InputError(f"count or spacing must be given for places = {self.places!r}; got neither.")
        return self


class Compressed(Table):
    """The start is compressed: the arguments of Scene.compressed."""

    packing: Annotated[
        float,
        plain(checks.positive, "(a fraction of the area)"),
        Field(description="packing fraction of the scene, above that of the box as it is given"),
    ]
    rate: Annotated[
        float,
        plain(checks.between, SLOWEST, FASTEST),
        Field(description="speed at which discs grow, as a fraction of the thermal speed, 1e-6 to 10"),
    ] = 0.01


_SCENE = (Scene, {"width": 1.0, "height": 1.0, "position": (), "velocity": (), "radius": 0.1})


class _Box(Table):
    """The box of a scene file."""

    schema_: Annotated[int, plain(_version), Field(alias="schema", description=f"version of the format, {SCHEMA}")]
    width: Annotated[Positive | None, Field(description="width of the box")] = None
    height: Annotated[Positive | None, Field(description="height of the box")] = None
    packing: Annotated[
        float | None,
        plain(checks.positive, "(a fraction of the area)"),
        Field(description="instead of width and height: of a square box, made to fit the discs"),
    ] = None
    boundary: Annotated[
        Any,
        as_in(_SCENE, words=True),
        Field(description='"walls", "periodic", or one for x and one for y: ["periodic", "walls"]'),
    ] = "walls"


_NUMBERS: dict[str, Any] = {
    name: (Annotated[Any, as_in(_SCENE), Field(description=meaning)], default)
    for name, (default, meaning) in ({name: (None, meaning) for name, meaning in VECTORS.items()} | NUMBERS).items()
}
if TYPE_CHECKING:

    class _Physics(_Box):
        """And what features have of the scene: made below, where its keys are known."""
else:
    _Physics = pydantic.create_model("_Physics", __base__=_Box, **_NUMBERS)


class _SceneTable(_Physics):
    """A scene file, without the tables of its features."""

    absorbing: Annotated[
        Any,
        as_in(_SCENE, words=True),
        Field(description='edges at which discs leave: a list of "left", "right", "bottom", "top"'),
    ] = ()
    duration: Annotated[float | None, as_in(_SCENE), Field(description="time that a run should last")] = None
    picture_interval: Annotated[
        float | None, as_in(_SCENE), Field(description="time between two pictures of an animation or a trajectory")
    ] = None
    measures: Annotated[Any, as_in(_SCENE, words=True), Field(description="recommended measures: a list of names")] = ()
    about: Annotated[About | None, Field(description="title and texts")] = None
    settings: Annotated[SettingsTable | None, Field(description="recommended settings")] = None
    compressed: Annotated[
        Compressed | None, Field(description="the start is compressed to a higher packing, in a smaller box")
    ] = None
    discs: Annotated[list[DiscGroup], Field(description="groups of discs")] = []  # noqa: RUF012 - pydantic copies it

    @model_validator(mode="after")
    def _box_is_given_once(self) -> "_SceneTable":
        both = self.width is not None and self.height is not None
        if (self.packing is None) != both or (self.packing is not None and (self.width or self.height)):
            raise InputError(
                "the box must be given either by packing or by width and height; "
                f"got packing={self.packing!r}, width={self.width!r}, height={self.height!r}."
            )
        return self


_PARTS: dict[str, Any] = {
    part.argument: (Annotated[part.annotation, Field(description=part.description)], part.default) for part in PARTS
}
if TYPE_CHECKING:

    class SceneTable(_SceneTable):
        """A scene file: made below, where its keys are known."""
else:
    SceneTable = pydantic.create_model("SceneTable", __base__=_SceneTable, **_PARTS)
    SceneTable.__doc__ = "A scene file."

LEVELS: dict[str, list[type[Table]]] = {
    "": [SceneTable],
    "about": [About],
    "settings": [SettingsTable],
    "compressed": [Compressed],
    "discs": [DiscGroup],
    **{part.argument: [table for _, _, table in part.tables] for part in PARTS},
}
"""Tables by their key."""


def keys_of(table: type[Table]) -> list[str]:
    """The keys of a table, as they are written."""
    return [field.alias or name for name, field in table.model_fields.items()]


def reference() -> str:
    """All keys as tables in Markdown, for docs/scenes.md."""
    parts: list[tuple[str, type[Table]]] = [
        ("The file itself", SceneTable),
        ("`[about]`", About),
        ("`[compressed]`", Compressed),
        ("`[[discs]]`", DiscGroup),
    ]
    for part in PARTS:
        parts += [(title, table) for _, title, table in part.tables]
    lines: list[str] = []
    for title, table in parts:
        lines += [f"### {title}", "", "| key | default | meaning |", "|---|---|---|"]
        for name, field in table.model_fields.items():
            default = "needed" if field.is_required() else _default_text(field.default)
            lines.append(f"| `{field.alias or name}` | {default} | {field.description} |")
        lines.append("")
    return "\n".join(lines)


def _default_text(default: Any) -> str:
    return "-" if default is None or default in ((), [], "") else f"`{default}`".replace("'", '"')


# --- Makes the Scene from the tables of a checked scene file

logger: logging.Logger = logging.getLogger("mpsim")

Arguments = dict[str, Any]
"""Position, velocity and what features have of each disc, of a group of discs."""


class ProblemsError(Exception):
    """Problems of a scene whose tables are valid one by one."""

    def __init__(self, problems: list[Problem]):
        super().__init__()
        self.problems = problems


def build(table: SceneTable, variation: int | None = None) -> Scene:
    """The scene that the tables describe.

    Args:
        table: of the file.
        variation: None: drawn with the seeds of the file; a number: with other random numbers.

    Raises:
        ProblemsError: with all problems.
    """
    problems: list[Problem] = []
    sides = _box(table, problems)
    made = {part.argument: part.made(getattr(table, part.argument), problems) for part in PARTS if part.several}
    taken = Taken(capsules=np.vstack([part.capsules(made[part.argument][0]) for part in PARTS if part.several]))
    groups: list[Arguments] = []
    width, height = sides or (1.0, 1.0)
    for index, discs in enumerate(table.discs):
        if sides is None and discs.places is not None:
            continue  # without a box there are no places
        if taken.count + (discs.count or 0) > LARGEST_COUNT:
            problems.append((f"discs[{index}]", f"all discs must be at most {LARGEST_COUNT:,}; got more. Use fewer."))
            break
        try:
            groups.append(_group(discs, (width, height), taken, wraps_of(check_boundary(table.boundary)), variation))
        except InputError as error:
            problems.append((f"discs[{index}]", str(error)))
    if problems:
        raise ProblemsError(problems)
    box = {"width": width, "height": height, "boundary": table.boundary}
    parts: Arguments = {"absorbing": table.absorbing}
    for part in PARTS:
        value = getattr(table, part.argument)
        single = None if part.several or value is None else value.made()
        parts[part.argument] = made[part.argument][0] if part.several else single
    names = (*VECTORS, *NUMBERS, "duration", "picture_interval", "measures")
    plain = {name: getattr(table, name) for name in names}
    plain["settings"] = None if table.settings is None else Settings(**dict(table.settings))
    try:
        scene = Scene(**box, **_joined(groups), **parts, **plain)
        if any(discs.places == "random" or discs.temperature for discs in table.discs):
            scene.redraw_with(functools.partial(build, table.model_copy(update={"compressed": None})))
    except InputError as error:
        tables = {name: owners for name, (_, owners) in made.items()}
        found = list(islice(_all_problems(box, groups, parts, tables), MOST_PROBLEMS + 1))
        raise ProblemsError(found or [("", str(error))]) from None
    return scene if table.compressed is None else _compressed(scene, table.compressed)


def _compressed(scene: Scene, wanted: Compressed) -> Scene:
    """The scene that starts from the one given."""
    logger.info("mpsim: compressing %r to packing %g", scene, wanted.packing)
    try:
        return scene.compressed(**dict(wanted))
    except InputError as error:
        raise ProblemsError([("compressed", str(error))]) from None


def _box(table: SceneTable, problems: list[Problem]) -> tuple[float, float] | None:
    """Width and height, with `packing` computed from the discs; None if they cannot be computed."""
    if table.width is not None and table.height is not None:
        return table.width, table.height
    area, largest = 0.0, 0.0
    for index, discs in enumerate(table.discs):
        count = discs.count if discs.position is None else len(discs.position)
        if count is None:
            problems.append((f"discs[{index}].count", "count must be given where packing makes the box; got none."))
            continue
        try:
            demand_area("radius", discs.radius)
        except InputError as error:
            problems.append((f"discs[{index}].radius", str(error)))
            continue
        if isinstance(discs.radius, float):
            area += count * math.pi * discs.radius**2
        else:
            area += math.pi * float(np.square(discs.radius).sum())
        largest = max(largest, float(np.max(discs.radius, initial=0.0)))
    if not area and not problems:
        problems.append(("packing", "packing needs discs to make a box for; got none. Give width and height."))
    if problems:
        return None
    assert table.packing is not None
    try:
        side = side_for(table.packing, area, largest, check_boundary(table.boundary))
    except InputError as error:
        problems.append(("packing", str(error)))
        return None
    return side, side


def _group(
    discs: DiscGroup, box: tuple[float, float], taken: Taken, periodic: tuple[bool, bool], variation: int | None
) -> Arguments:
    """One group of discs as arguments of Scene, which is also added to `taken`."""
    rng = np.random.default_rng(discs.seed if variation is None else [discs.seed, variation])
    if discs.places == "random":
        assert discs.count is not None
        own = _own(discs, discs.count)
        position = random_places(discs.radius, discs.count, box, discs.region, taken, rng, periodic)
    else:
        position = _places(discs, box)
        own = _own(discs, len(position))
    count = len(position)
    if discs.temperature is not None:
        velocity = thermal_velocities(count, discs.temperature, discs.mass, rng)
    else:
        velocity = _rows("velocity", np.zeros(2) if discs.velocity is None else discs.velocity, count)
    taken.add(position, np.broadcast_to(discs.radius, count))
    return {"position": position, "velocity": velocity, **own}


def _own(discs: DiscGroup, count: int) -> Arguments:
    """What features have of each disc of a group: a number for all, or one each; vectors as rows; None if not given."""
    own: Arguments = {}
    for name in PER_DISC:
        own[name] = value = getattr(discs, name)
        if value is None:
            continue
        if PER_DISC[name].components:
            own[name] = _rows(name, value, count)
        elif np.ndim(value) and len(value) != count:
            raise InputError(f"{name} must be one number or {count}, one per disc; got {len(value)}.")
    return own


def _places(discs: DiscGroup, box: tuple[float, float]) -> NDArray[np.float64]:
    """Given centres, or those on a lattice."""
    if discs.position is not None:
        return discs.position
    assert discs.places is not None
    margin = float(np.max(discs.radius))
    region = discs.region or (margin, margin, max(box[0] - margin, margin), max(box[1] - margin, margin))
    return lattice_sites(discs.places, region, discs.spacing, discs.count)


def _rows(name: str, value: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """One row per disc, from one for all or one each."""
    if value.ndim == 1:
        return np.tile(value, (count, 1))
    if len(value) != count:
        raise InputError(f"{name} must be one row or {count}, one per disc; got {len(value)}.")
    return value


def _joined(groups: list[Arguments]) -> Arguments:
    """The arguments of all groups as those of one."""
    if len(groups) == 1:
        return groups[0]
    if not groups:
        return {"position": (), "velocity": (), "radius": np.empty(0)}
    joined: Arguments = {name: np.concatenate([group[name] for group in groups]) for name in ("position", "velocity")}
    counts = [len(group["position"]) for group in groups]
    for name, each in PER_DISC.items():
        if all(group[name] is None for group in groups):
            continue
        values: list[Any] = [each.default if group[name] is None else group[name] for group in groups]
        if not any(map(np.ndim, values)) and len(set(values)) == 1:
            joined[name] = values[0]  # one number for all, which emitters may then use
        else:
            shape = (2,) if each.components else ()
            every = [np.broadcast_to(value, (count, *shape)) for value, count in zip(values, counts, strict=True)]
            joined[name] = np.concatenate(every)
    return joined


def _all_problems(
    box: Arguments, groups: list[Arguments], parts: Arguments, tables: dict[str, list[int]]
) -> Iterator[Problem]:
    """All problems of a scene that was refused: each part is tried in the box by itself.

    tables: for each feature, the numbers of the tables that its values come from.
    """
    bare: Arguments = {**box, **_joined([])}
    every = _joined(groups)
    # An emitter may take radius and mass from the discs.
    few = {name: value for name, value in every.items() if name in ("radius", "mass") and not np.ndim(value)}
    trials: list[tuple[str, list[int], list[Any], Callable[[list[Any]], Arguments]]] = [
        ("discs", [*range(len(groups))], groups, lambda some: {**box, **_joined(some)}),
    ]
    for part in PARTS:
        name, own = part.argument, few if part.relies_on_discs else {}
        if part.several:
            trials.append((name, tables[name], parts[name], lambda some, n=name, o=own: {**bare, **o, n: some}))
    edges = {"absorbing": parts["absorbing"]}
    trials.append(("absorbing", [], [()], lambda _: {**bare, **edges}))
    for name in (part.argument for part in PARTS if not part.several):
        trials.append((name, [], [()], lambda _, n=name: {**bare, n: parts[n]}))
        trials.append((name, [], [()], lambda _, n=name: {**bare, **edges, n: parts[n]}))
    known: set[str] = set()
    for name, numbers, members, arguments in trials:
        for at, error in islice(_refused(members, arguments), MOST_PROBLEMS + 1):
            key = f"{name}[{numbers[at]}]" if numbers else name
            text = str(error).replace(f"{name}[0]", key) if numbers else str(error)
            if text not in known:
                known.add(text)
                yield key, text


def _refused(
    members: list[Any], arguments: Callable[[list[Any]], Arguments], first: int = 0
) -> Iterator[tuple[int, InputError]]:
    """Members that Scene refuses, by index, with the error, found by bisection."""
    if not members:
        return
    try:
        Scene(**arguments(members))
    except InputError as error:
        if len(members) == 1:
            yield first, error
            return
        half = len(members) // 2
        yield from _refused(members[:half], arguments, first)
        yield from _refused(members[half:], arguments, first + half)
