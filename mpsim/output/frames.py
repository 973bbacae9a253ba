"""One frame of a trajectory, and the common parts of all formats."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mpsim.core import checks
from mpsim.core.columns import IN_STATE, ChunkedArray, Column
from mpsim.core.state import Box, State, StateInChunks, present_in
from mpsim.engine.simulation import Simulation
from mpsim.engine.solvers.methods import capabilities_of
from mpsim.errors import InputError, TrajectoryError
from mpsim.features.edges import check_boundary, wraps_of


@dataclass(frozen=True)
class Frame:
    """The discs at one moment, in the order of their numbers. Absorbed discs are not in it.

    Attributes:
        frame: number of the frame of the simulation.
        box: width and height at that moment [length]: a moving wall changes it.
        origin: lower left corner of the box at that moment [length]; (0, 0) unless the left or bottom wall moves.
        periodic: whether x, and whether y, is periodic.
        position: shape (N, 2) [length], in the precision of the run and the coordinates of the scene.
        source: the file, for error texts.
        known: those of time, velocity, radius, mass, ids and the further columns of a state that the file holds. Each
            is also an attribute, which raises TrajectoryError if the file lacks it.

    >>> corner = Frame(0, (4.0, 2.0), (0.0, 0.0), (True, False), np.array([[1.0, 1.0]]), Path("run.xyz"),
    ...                {"image": np.array([[-2, 0]])})
    >>> corner.unwrapped.tolist()
    [[-7.0, 1.0]]
    """

    frame: int
    box: tuple[float, float]
    origin: tuple[float, float]
    periodic: tuple[bool, bool]
    position: NDArray[np.floating]
    source: Path
    known: dict[str, Any]

    @property
    def time(self) -> float:
        """Simulated time [time]."""
        return float(self._get("time"))

    @property
    def velocity(self) -> NDArray[np.floating]:
        """Velocities, shape (N, 2) [length/time], in the precision of the run."""
        return self._get("velocity")

    @property
    def radius(self) -> NDArray[np.float64]:
        """Radii, shape (N,) [length]."""
        return self._get("radius")

    @property
    def mass(self) -> NDArray[np.float64]:
        """Masses, shape (N,) [mass]."""
        return self._get("mass")

    @property
    def image(self) -> NDArray[np.int64]:
        """Periodic borders that each disc has crossed, shape (N, 2): +1 to the right and up; 0 along walls."""
        if "image" not in self.known and not any(self.periodic):
            return np.zeros(self.position.shape, np.int64)
        return self._get("image")

    @property
    def spin(self) -> NDArray[np.floating]:
        """Angular velocities, shape (N,) [1/time], in the precision of the run; smooth discs have none."""
        return self._get("spin")

    @property
    def unwrapped(self) -> NDArray[np.float64]:
        """Positions as if there were no periodic borders, shape (N, 2) [length]: position + image * box."""
        return self.position.astype(np.float64) + self.image * np.array(self.box)

    @property
    def ids(self) -> NDArray[np.int64]:
        """Numbers of the discs in their scene, shape (N,); 0, 1, 2, ... for a file without numbers."""
        return self.known.get("ids", np.arange(len(self.position)))

    @property
    def state(self) -> State:
        """The frame as a State, which knows its digest: positions, velocities, walls and the other columns.

        Without velocities in the file, it has none: measures of positions work, and those of velocities say so.
        """
        (width, height), (left, low) = self.box, self.origin
        walls = (left, left + width, low, low + height)
        others: Any = {column.name: self.known.get(column.name) for column in IN_STATE}
        return State(self.position, self.known.get("velocity"), box=walls, **others)

    def whole(self) -> "Frame":
        """The same frame, with all its data in memory."""
        known = {
            name: np.asarray(value) if hasattr(value, "__array__") else value for name, value in self.known.items()
        }
        return replace(self, position=np.asarray(self.position), known=known)

    def _get(self, name: str) -> Any:
        if name not in self.known:
            found = ", ".join(["position", *sorted(self.known)])
            raise TrajectoryError(
                f"{name} must be in a trajectory to be read from it; {str(self.source)!r} holds only {found}. "
                f"Have the program that wrote it write {WRITTEN_AS[name]}, too"
                f"{', or give Trajectory(path, radius=...)' * (name == 'radius')}."
            )
        return self.known[name]

    def __repr__(self) -> str:
        time = f", time {self.time:g}" if "time" in self.known else ""
        return f"<Frame {self.frame}: {len(self.position)} discs in {self.box[0]:g} x {self.box[1]:g}{time}>"


@dataclass(frozen=True)
class Given:
    """What the reader of a trajectory is told about frames that do not say it themselves.

    Attributes:
        box: (x_low, x_high, y_low, y_high) [length].
        periodic: whether x, and whether y, is periodic; None: both.
        radius: of all discs [length].
    """

    box: Box | None = None
    periodic: tuple[bool, bool] | None = None
    radius: float | None = None

    @classmethod
    def of(cls, box: object, boundary: object, radius: object) -> "Given":
        """From arguments of the user."""
        walls: Any = None
        if box is not None:
            rule = "(width, height) or (x_low, x_high, y_low, y_high)"
            numbers = checks.finite_array("box", box, (None,), rule).tolist()
            walls = (0.0, numbers[0], 0.0, numbers[1]) if len(numbers) == 2 else tuple(numbers)
            if len(walls) != 4 or not (walls[0] < walls[1] and walls[2] < walls[3]):
                raise InputError(f"box must be {rule}, with sides above 0; got {checks.brief(box)}.")
        wraps = None if boundary is None else wraps_of(check_boundary(boundary))
        return cls(walls, wraps, None if radius is None else checks.positive("radius", radius, "[length]"))

    def frame(
        self,
        where: str,
        number: int,
        box: tuple[float, float] | None,
        origin: tuple[float, float],
        periodic: tuple[bool, bool] | None,
        position: NDArray[np.floating],
        source: Path,
        known: dict[str, Any],
    ) -> Frame:
        """A frame of a file, in the order of its ids; what it lacks, None among these arguments, is taken from here.

        Args:
            where: its name for error texts.
            position: shape (N, 2) or (N, 3), of which the last must be the same of all discs; likewise the velocity
                in `known`, where it must be 0.
            number, box, origin, periodic, source, known: as of a Frame.

        Raises:
            InputError: if something is given that the frame has.
            TrajectoryError: if the frame is three-dimensional, has no box, or an id twice.
        """
        own = {"box": box, "boundary": periodic, "radius": known.get("radius")}
        for name, given in (("box", self.box), ("boundary", self.periodic), ("radius", self.radius)):
            if given is not None and own[name] is not None:
                raise InputError(
                    f"{name} can be given only for frames that do not hold it; {where} holds "
                    f"{checks.brief(own[name])}. Leave it out."
                )
        if self.radius is not None:
            known["radius"] = np.full(len(position), self.radius)
        if box is None and self.box is not None:
            x_low, x_high, y_low, y_high = self.box
            box, origin = (x_high - x_low, y_high - y_low), (x_low, y_low)
        if box is None:
            raise TrajectoryError(
                f"{where} must hold the box, as the key Lattice of extended XYZ; it does not. Have the program that "
                "wrote it write that, or give box=(width, height)."
            )
        for name in ("radius", "mass"):
            if name in known and (known[name] < 0).any():
                raise TrajectoryError(f"{where} must hold no {name} below 0; got {known[name].min()}.")
        if "ids" in known:
            order = np.argsort(known["ids"], kind="stable")
            if len(twice := np.flatnonzero(np.diff(known["ids"][order]) == 0)):
                raise TrajectoryError(f"{where} must hold each id once; got {known['ids'][order[twice[0]]]} twice.")
            if (order[1:] < order[:-1]).any():
                position = position[order]
                known = {name: value if np.ndim(value) == 0 else value[order] for name, value in known.items()}
        position = _in_plane("position", position, position[:1, 2:], max(box), where)
        if "velocity" in known:
            speed = known["velocity"]
            known["velocity"] = _in_plane("velocity", speed, 0.0, np.abs(speed).max(initial=0.0), where)
        return Frame(number, box, origin, periodic or self.periodic or (True, True), position, source, known)


ROUNDING = 1e-9  # largest component of an upright box off its axes, relative to its sides

FLAT = 1e-6
"""Largest difference of z among discs in a plane, relative to the box; of their velocities, relative to the largest."""


def _in_plane(name: str, vectors: NDArray[Any], z: ArrayLike, scale: float, where: str) -> NDArray[Any]:
    """Vectors of shape (N, 2), from some of shape (N, 2) or (N, 3) whose last component must be `z`."""
    if len(off := np.flatnonzero(np.abs(vectors[:, 2:] - z) > FLAT * scale)):
        raise TrajectoryError(
            f"{where} must be two-dimensional, with the same z for all discs, and no velocity along z; got a {name} "
            f"with z = {vectors[off[0], 2]:g} of disc {off[0]}, not {np.max(z):g}. Write one layer: mpsim has no third "
            "dimension."
        )
    return np.ascontiguousarray(vectors[:, :2])


def kind_of(column: Column) -> str:
    """Type and width of a column in extended XYZ, where pairs are vectors that have a z as well."""
    return f"{'I' if column.integer else 'R'}:{3 if column.components else 1}"


WRITTEN_AS = {
    each.name: f"the column {each.name}:{kind_of(each)} (extended XYZ) or log/particles/mpsim/{each.name} (GSD)"
    for each in IN_STATE
} | {
    "time": "the key Time (extended XYZ), log/mpsim/time (GSD) or ITEM: TIME (LAMMPS)",
    "velocity": "the column velo:R:3 (extended XYZ), particles/velocity (GSD) or vx vy (LAMMPS)",
    "radius": "the column radius:R:1 (extended XYZ), particles/diameter (GSD) or radius (LAMMPS)",
    "mass": "the column masses:R:1 (extended XYZ), particles/mass (GSD) or mass (LAMMPS)",
    "image": "the column map_shift:I:3 (extended XYZ), particles/image (GSD) or ix iy (LAMMPS)",
}
"""Where formats have what a frame may lack; the later ones have a name of their own in them."""


def frame_of(sim: Simulation) -> Frame:
    """The discs of a simulation as they are now, between two frames.

    On ranks, where no process has all discs, it is read in chunks, unless the scene absorbs discs, so that numbers have
    gaps.
    """
    if capabilities_of(sim.settings).on_ranks and not sim.scene._loses_discs:
        state, found = sim.state_between(0, 0), StateInChunks(sim.state_between, sim.count)._held()
        known = {name: values for name, values in found.items() if name not in ("present", "box")}
        ids: Any = ChunkedArray(np.dtype(np.int64), (sim.count,), np.arange)
        known |= {"radius": sim.radii, "mass": sim.masses, "ids": ids}
    else:
        state = sim.state
        values: dict[str, Any] = {name: value for name, value in vars(state).items() if name not in ("present", "box")}
        values |= {"radius": sim.radii, "mass": sim.masses, "ids": np.arange(len(state.position))}
        here = present_in(state)
        known = {name: value[here] for name, value in values.items() if value is not None}
    assert state.box is not None  # the walls of a simulation are known
    x_low, x_high, y_low, y_high = state.box
    since, began = sim.origin
    # sim.time but for the rounding of the exact solver's clock
    known["time"] = began + (sim.frame - since) * sim.settings.dt
    box, origin, position = (x_high - x_low, y_high - y_low), (x_low, y_low), known.pop("position")
    return Frame(sim.frame, box, origin, sim.scene.periodic, position, Path(), known)


def select(frame: Frame, ids: NDArray[np.int64]) -> Frame:
    """The discs of a frame whose numbers are among these."""
    these = np.isin(frame.ids, ids)
    known = {name: value[these] if isinstance(value, np.ndarray) else value for name, value in frame.known.items()}
    return replace(frame, position=frame.position[these], known=known)


def differs(a: Frame, b: Frame) -> str | None:
    """What differs between two frames, or None if they have the same bits."""
    for name in ("frame", "box", "origin", "periodic", "time"):
        if getattr(a, name) != getattr(b, name):
            return f"its {name} is {getattr(a, name)} and not {getattr(b, name)}"
    ours, theirs = ({"position": frame.position, **frame.known} for frame in (a, b))
    for name in ("ids", "position", "velocity", "radius", "mass", *(column.name for column in IN_STATE)):
        both = (name in ours) + (name in theirs)
        if both == 1 or (both and not checks.equal(ours[name], theirs[name])):
            return f"its {name} of the discs differs"
    return None
