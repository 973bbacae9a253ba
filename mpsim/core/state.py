"""`State`: all discs at one time."""

from __future__ import annotations

import functools
import hashlib
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import DTypeLike, NDArray

from mpsim.core import checks, columns, files
from mpsim.core.archive import save_arrays
from mpsim.core.columns import ChunkedArray, chunks_of, ranges
from mpsim.errors import InputError

Box = tuple[float, float, float, float]
"""Where the walls are: x_low, x_high, y_low, y_high [length]."""


NOT_DIGESTED: dict[str, str] = {"box": "it follows from the scene and the time"}
"""What the digest of a state leaves out, and why."""


@dataclass(frozen=True, init=False, repr=False)
class State:
    """All discs at one moment: copies, in the order of the scene's discs, in arrays that cannot be written.

    `state.position.copy()` can be written; `Simulation.set` changes a simulation.

    Args:
        position, velocity: as below; velocity may be left out where it is unknown.
        present, image, spin, box: as below, by name; None: all present, no counts, smooth discs, unknown.

    Attributes:
        position: shape (N, 2) [length], in the precision of the run; in [0, length) along a periodic axis.
        velocity: shape (N, 2) [length/time]. Where it is unknown, as in a frame of a file without velocities, an
            InputError says so: measures of positions need none.
        present: shape (N,), bool: False for absorbed discs. They rest where they left, and no observable counts them.
        image: shape (N, 2), int64, the image flags: how often each disc has crossed each periodic border since the
            scene began, negative towards lower coordinates, 0 along axes with walls. None where no axis is periodic.
        spin: shape (N,), angular velocity, counter-clockwise [1/time], in the precision of the run; 0 of absorbed
            discs. None where discs are smooth.
        box: (x_low, x_high, y_low, y_high) [length]: where the walls are now, as one of them may have moved,
            and the period of a periodic axis. None where that is unknown: in a state made by hand.

    Raises:
        InputError: if one of these has another shape, or image comes without box, which has the periods.

    >>> state = State(position=np.array([[1.0, 2.0]]), velocity=np.zeros((1, 2)))
    >>> state.position.tolist(), state.present.tolist()
    ([[1.0, 2.0]], [True])
    >>> state
    <State: 1 disc, float64>
    >>> state.position[0] = 3.0
    Traceback (most recent call last):
        ...
    ValueError: assignment destination is read-only
    """

    position: NDArray[np.floating]
    velocity: NDArray[np.floating]
    image: NDArray[np.int64] | None
    present: NDArray[np.bool_]
    spin: NDArray[np.floating] | None
    box: Box | None

    def __init__(
        self,
        position: NDArray[np.floating],
        velocity: NDArray[np.floating] | None = None,
        *,
        present: NDArray[np.bool_] | None = None,
        image: NDArray[np.int64] | None = None,
        spin: NDArray[np.floating] | None = None,
        box: Box | None = None,
    ):
        position = _two_each("position", position, None)
        count = len(position)
        velocity = None if velocity is None else _two_each("velocity", velocity, count)
        here = np.ones(count, np.bool_) if present is None else np.asarray(present, np.bool_)
        if here.shape != (count,):
            raise InputError(f"present of a state must have shape ({count},), one per disc; got {here.shape}.")
        image, spin = (
            None if given is None else column.of_state(given, count)
            for column, given in ((columns.IMAGE, image), (columns.SPIN, spin))
        )
        if image is not None and box is None:
            raise InputError("image of a state needs box, which has the periods; got None. Give both, or neither.")
        walls = None if box is None else tuple(checks.finite_array("box of a state", box, (4,), "(4,)").tolist())
        vars(self).update(position=position, velocity=velocity, image=image, present=here, spin=spin, box=walls)
        if velocity is None:
            del vars(self)["velocity"]
        for name, value in vars(self).items():
            if isinstance(value, np.ndarray):
                vars(self)[name] = checks.read_only(cast(Any, value).view())  # the caller's can still be written

    @classmethod
    def _taken_over(
        cls,
        position: NDArray[np.floating],
        velocity: NDArray[np.floating],
        present: NDArray[np.bool_],
        box: Box,
        found: Mapping[str, NDArray[Any]],
    ) -> State:
        """A state of arrays that are known to be right, without copies: they become read-only.

        found: further columns of a state, by name.
        """
        state = cls.__new__(cls)
        image, spin = found.get(columns.IMAGE.name), found.get(columns.SPIN.name)
        for array in (position, velocity, image, present, spin):
            if array is not None:
                array.setflags(write=False)
        vars(state).update(position=position, velocity=velocity, image=image, present=present, spin=spin, box=box)
        return state

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> object:
            if name == "velocity":
                raise InputError(
                    f"velocity must be in a state for this; got {self!r} without velocities, as of a file that does "
                    "not hold them. Give State(position, velocity)."
                )
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")

    @property
    def unwrapped(self) -> NDArray[np.float64]:
        """Positions without the periodic borders, shape (N, 2), float64 [length]: position + image * period.

        These coordinates are continuous where a disc crosses a border: differences of two states are displacements.
        Where image is None they are the positions.

        >>> place, image = np.array([[4.0, 2.0]]), np.array([[1, 0]])
        >>> State(place, np.zeros((1, 2)), image=image, box=(0, 10, 0, 5)).unwrapped.tolist()
        [[14.0, 2.0]]
        """
        places = np.asarray(self.position, np.float64)
        if self.image is None or self.box is None:
            return places.copy()
        x_low, x_high, y_low, y_high = self.box
        return places + self.image * np.array([x_high - x_low, y_high - y_low])

    def digest(self) -> str:
        """Hex digest of the bits of position and velocity; equal digests mean equal bits.

        Image flags and other arrays of the discs are included if there are any, and which discs are present after one
        has left.

        >>> State(np.zeros((1, 2)), np.ones((1, 2))).digest() == State(np.zeros((1, 2)), np.ones((1, 2))).digest()
        True
        """
        return digest_of(self._held())

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write a NumPy .npz with position, velocity, present, and the other attributes that are not None.

        `State(**numpy.load(path))` is the same state. An existing file is replaced completely or not at all; a symbolic
        link raises an error.

        Raises:
            InputError: if the path does not end in .npz.
            OutputError: if it cannot be written.
        """
        return save_arrays("a state", files.ending_as("state.npz", path, "a state"), self._held())

    def _held(self) -> dict[str, Any]:
        """What there is of its attributes, by name, in the order of digests and files."""
        return {name: value for name, value in vars(self).items() if value is not None}

    def __repr__(self) -> str:
        count, absent = len(self.position), len(self.present) - int(np.count_nonzero(self.present))
        words = [f"{count} disc{'s' * (count != 1)}"]
        words += [f"{absent} absorbed"] if absent else []
        words += ["with spins"] if self.spin is not None else []
        if self.box is not None:
            words.append(f"in {self.box[1] - self.box[0]:g} x {self.box[3] - self.box[2]:g}")
        return f"<State: {', '.join(words)}, {self.position.dtype}>"


class StateInChunks:
    """All discs at one moment, of which any range can be read: for sums over them where no process holds them whole.

    Args:
        between: called with (first, last), gives the state of the discs of these numbers, as long as none moves.
        count: number of all discs.
    """

    def __init__(self, between: Callable[[int, int], State], count: int):
        self.count: int = count
        # Kept: who reads one attribute of a range, or sums over it, reads the others next.
        self.between: Callable[[int, int], State] = functools.lru_cache(maxsize=1)(between)

    def _held(self) -> dict[str, Any]:
        """The attributes of the state, by name, those of discs each to be read in chunks."""

        def chunked(name: str, none: NDArray[Any]) -> ChunkedArray:
            shape, between = (self.count, *none.shape[1:]), self.between
            return ChunkedArray(none.dtype, shape, lambda first, last: getattr(between(first, last), name))

        found = {name: value for name, value in vars(self.between(0, 0)).items() if value is not None}
        return {name: value if name in NOT_DIGESTED else chunked(name, value) for name, value in found.items()}


Discs = State | StateInChunks
"""All discs at one moment: their state, or what reads it in chunks."""


def count_of(discs: Discs) -> int:
    """Number of discs, N, absorbed ones included."""
    if isinstance(discs, State):
        return len(discs.position)
    if not isinstance(discs, StateInChunks):  # pyright: ignore[reportUnnecessaryIsInstance] - callers without a checker
        raise no_state("state must be a State", discs)
    return discs.count


def _two_each(name: str, value: Any, count: int | None) -> NDArray[np.floating]:
    """Two numbers of each disc; an array in the precision that it has."""
    number = "N" if count is None else count
    if getattr(getattr(value, "dtype", None), "kind", "") != "f":
        return checks.finite_array(f"{name} of a state", value, (count, 2), f"({number}, 2)")
    if np.ndim(value) != 2 or np.shape(value) != (len(value) if count is None else count, 2):
        raise InputError(f"{name} of a state must have shape ({number}, 2), one row per disc; got {np.shape(value)}.")
    return value


def no_state(rule: str, given: object) -> InputError:
    """The error for what should be a state, with where to get one."""
    return InputError(
        f"{rule}; got {type(given).__name__}. Use sim.state of a Simulation, frame.state of a Trajectory's frame, and "
        "State(scene.position, scene.velocity) of a Scene."
    )


def moved_into(state: State, box: Box, periodic: tuple[bool, bool], corner: tuple[float, float]) -> State:
    """The same discs seen from the point `corner`, wrapped into their box along periodic axes; image flags follow.

    box: of the state [length]. Discs that are there already keep their bits.
    """
    (x, y), sides, real = corner, (box[1] - box[0], box[3] - box[2]), state.position.dtype
    if corner == (0, 0) and not any(periodic):
        return state
    places = np.subtract(state.position, corner, dtype=np.float64)
    image = None if state.image is None else state.image.copy()
    with np.errstate(invalid="ignore"):  # measures refuse what is not finite
        for axis in np.flatnonzero(periodic):
            inside = np.mod(places[:, axis], sides[axis]).astype(real)
            inside[inside >= sides[axis]] = 0  # by rounding
            if image is not None:
                image[:, axis] += np.rint((places[:, axis] - inside) / sides[axis]).astype(np.int64)
            places[:, axis] = inside
    if corner == (0, 0) and np.array_equal(places, state.position):
        return state
    others = {name: value for name, value in vars(state).items() if name not in ("position", "image", "box")}
    here = None if state.box is None else (box[0] - x, box[1] - x, box[2] - y, box[3] - y)
    return State(places.astype(real), image=image, box=here, **others)


def part_of(state: State, first: int, last: int) -> State:
    """The discs numbered `first` to `last` - 1, whose arrays are views."""
    if (first, last) == (0, count_of(state)):
        return state
    parts = {name: value[first:last] for name, value in vars(state).items() if name != "box" and value is not None}
    return State(**parts, box=state.box)


def parts_of(discs: Discs) -> Iterator[tuple[slice, State]]:
    """The discs in the order of their numbers, a chunk at a time: which they are, and their state.

    Where there are no discs, one part without any.
    """
    count = count_of(discs)
    between = functools.partial(part_of, discs) if isinstance(discs, State) else discs.between
    yield from ((slice(*each), between(*each)) for each in ranges(count) or [(0, 0)])


def digest_of(values: Mapping[str, Any]) -> str:
    """The digest of a state with such attributes, by name, in their order; arrays may be read in chunks."""
    digest = hashlib.blake2b(digest_size=16)
    for name, array in values.items():  # what only some scenes have changes no digest of others
        if name in NOT_DIGESTED or (name == "present" and all(chunk.all() for chunk in chunks_of(array))):
            continue
        little_endian: DTypeLike = array.dtype.newbyteorder("<")
        digest.update(f"{array.dtype.name} {array.shape} ".encode())
        for chunk in chunks_of(array):
            content: Any = chunk.astype(little_endian, copy=False).reshape(-1).view(np.uint8)
            digest.update(content)
    return digest.hexdigest()


def present_in(state: State) -> Any:
    """An index of the discs that are present, for arrays of one row per disc; where all are, it copies nothing."""
    return slice(None) if state.present.all() else state.present
