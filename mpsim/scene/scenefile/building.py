"""Makes the Scene from the tables of a checked scene file."""

import functools
import logging
import math
from collections.abc import Callable, Iterator
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpsim.errors import InputError
from mpsim.features import NUMBERS, PER_DISC, VECTORS
from mpsim.features.edges import check_boundary, wraps_of
from mpsim.scene.scene import LARGEST_COUNT, Scene
from mpsim.scene.scenefile.limits import MOST_PROBLEMS
from mpsim.scene.scenefile.part import Problem
from mpsim.scene.scenefile.parts import PARTS
from mpsim.scene.scenefile.schema import Compressed, Discs, SceneTable
from mpsim.scene.settings import Settings
from mpsim.scene.starts import Taken, demand_area, lattice_sites, random_places, side_for, thermal_velocities

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
    discs: Discs, box: tuple[float, float], taken: Taken, periodic: tuple[bool, bool], variation: int | None
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


def _own(discs: Discs, count: int) -> Arguments:
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


def _places(discs: Discs, box: tuple[float, float]) -> NDArray[np.float64]:
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
