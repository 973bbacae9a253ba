"""Changes that users make by hand: drag, add and remove discs, draw walls, change parameters.

All changes use public methods of the simulation (`set`, `add`, `remove`, `add_wall`, `change`), so that the journal
records them. If a method refuses a change, the page shows a note and the simulation stays as it was.
"""

import contextlib
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mpsim.core import checks
from mpsim.engine import changes
from mpsim.engine.checkpoint import Snapshot
from mpsim.engine.simulation import Simulation
from mpsim.engine.solvers.methods import capabilities_of
from mpsim.errors import BusyError, InputError
from mpsim.features.capsules import of_discs, shifted
from mpsim.features.obstacles import Obstacle, Polyline, capsules_of
from mpsim.features.properties import has_masses, has_radii
from mpsim.scene.scene import Scene
from mpsim.viewer.comparison import History
from mpsim.viewer.protocol import DISC, Action, command, number

# --- The parameters that a page can change, with the values and ranges of their sliders

MOST_PASSES, MOST_SUBSTEPS = 4, 16
"""Upper ends of these sliders. If the value of the simulation is larger, the slider ends there."""

DECADE = 10.0  # sliders of times, rates and temperatures go from a tenth to ten times the initial value
ROUNDING = 0.005  # relative rounding error of a slider's value: pages send three digits


def _rate(scene: Scene, name: str) -> Any:
    return next((value for each in scene.emitters if (value := getattr(each, name)) is not None), None)


def _friction(scene: Scene, name: str) -> float | None:
    coefficient = getattr(scene, name)
    return coefficient if 0 < coefficient < math.inf else None


def _wall_temperature(scene: Scene) -> float | None:
    """The temperature of the thermal walls; None: there are none, or they differ."""
    found = set() if scene.thermal_walls is None else set(scene.thermal_walls.temperatures.values())
    return found.pop() if len(found) == 1 else None


VALUES: Mapping[str, Callable[[Scene], Any]] = {
    "gravity": lambda scene: [0.0, 0.0] if scene.gravity is None else scene.gravity.tolist(),
    "restitution": lambda scene: scene.restitution,
    "wall_restitution": lambda scene: scene.wall_restitution,
    **{name: partial(_friction, name=name) for name in changes.OF_FRICTION},
    "piston_speed": lambda scene: getattr(scene.piston, "speed", None),
    "temperature": lambda scene: None if scene.thermostat is None else scene.thermostat.temperature,
    "wall_temperature": _wall_temperature,
    "interval": partial(_rate, name="interval"),
    "every": partial(_rate, name="every"),
}
"""Parameters of a scene that a page can change, with functions that give their values; None: the scene has no such
parameter."""


class Sliders:
    """The sliders of one simulation. Their ranges follow from its initial values: they stay when values change."""

    def __init__(self, sim: Simulation):
        self._sim = sim
        scene, self._dt = sim.journal.scene, sim.journal.settings.dt
        self._first = {name: value_of(scene) for name, value_of in VALUES.items()}
        self._gravity = longest_gravity(scene)

    def demand_offered(self, name: str, value: Any) -> None:
        """Refuse numbers outside the sliders: they could make a frame so long that the page stops responding."""
        offered = {each["name"]: each for each in self.told()}
        if name not in offered:
            raise InputError(
                f"{name} must be a parameter that the page offers here, one of {', '.join(offered)}; got "
                f"{checks.brief(value)}. Use Simulation.change in a program."
            )
        low, high = offered[name]["low"], offered[name]["high"]
        for each in value if isinstance(value, list) else [value]:
            if not low - ROUNDING * abs(low) <= each <= high + ROUNDING * abs(high):
                raise InputError(
                    f"{name} must be from {low:.4g} to {high:.4g} here; got {each:g}. Use the slider, or "
                    "Simulation.change in a program."
                )

    def told(self) -> Iterator[dict[str, Any]]:
        """Name, value and range of each slider, as sent to pages.

        log: whether the scale is logarithmic. whole: whether only whole numbers can be chosen. The value of gravity is
        (x, y), each of which has a slider.
        """
        settings = self._sim.settings
        for name, value_of in VALUES.items():
            value, first = value_of(self._sim.scene), self._first[name]
            if value is None or first is None:
                continue
            if name == "gravity":
                largest = max(self._gravity, *map(abs, value))
                yield {"name": name, "value": value, "low": -largest, "high": largest, "log": False, "whole": False}
            elif name.endswith("restitution"):
                if settings.law == "elastic":
                    yield _slider(name, value, 0.0, 1.0)
            elif name == "every":
                yield _slider(name, value, 1, int(first * DECADE), log=True, whole=True)
            else:
                yield _slider(name, value, *sorted((first / DECADE, first * DECADE)), log=True)
        yield _slider("dt", settings.dt, self._dt / DECADE, self._dt * DECADE, log=True)
        if capabilities_of(settings).has_steps:
            yield _slider("passes", settings.passes, 1, MOST_PASSES, whole=True)
            yield _slider("substeps", settings.substeps, 1, MOST_SUBSTEPS, whole=True)


def _slider(name: str, value: float, low: float, high: float, log: bool = False, whole: bool = False) -> dict[str, Any]:
    ends = {"low": min(low, value), "high": max(high, value)}
    return {"name": name, "value": value, **ends, "log": log, "whole": whole}


def longest_gravity(scene: Scene) -> float:
    """Largest gravity along x and y that a page offers, 1, 2 or 5 times a power of ten [length/time^2].

    It is twice the gravity of the scene. Without gravity it is 2 v^2 / height, with v the root mean square speed. This
    is strong enough to keep most discs in the lower part of the box.
    """
    longest = 0.0 if scene.gravity is None else 2 * float(np.hypot(*scene.gravity))
    if not longest and scene.count:
        longest = 2 * float(np.mean(np.sum(scene.velocity**2, axis=1))) / scene.height
    longest = longest or 10 * scene.height
    power = 10.0 ** np.floor(np.log10(longest))
    return float(next(step * power for step in (1, 2, 5, 10) if step * power >= longest * (1 - 1e-12)))


# --- Changes by hand

HOLD_SECONDS = 3.0
"""A held disc is released when its page has sent nothing for this long. The page repeats `hold` every second."""

MOST_HELD = 16  # discs that pages may hold at a time. Before frames are run, each is put back in its place

MOST_ADDED, MOST_WALLS = 10_000, 1000
"""Discs and walls that pages may add to one simulation, moved walls included: all walls are sent again with each."""

MOST_MOMENTS, MOST_BYTES = 16, 2**28  # largest number and size of the moments of undo; the oldest ones are forgotten
THICKNESS = 0.5  # thickness of a drawn wall, in radii of the median disc: wide enough for a projector
BUILDING = ("add", "wall")  # gestures that first push discs aside
REFUSALS = (InputError, BusyError)  # errors that leave the simulation as it was; the page shows a note


Place = tuple[float, float]  # [length]
Key = tuple[str, Any]  # a gesture: its command, and the disc that is held or the parameter that is changed


def _parameter_value(name: str, value: Any) -> Any:
    """Check a number or a pair of numbers. The simulation checks which of them the parameter takes."""
    if isinstance(value, list) and len(value) == 2:
        return [number(name, each) for each in value]
    checked = number(name, value)
    return value if isinstance(value, int) else checked


class Moment(NamedTuple):
    """A moment of a view, to which undo can go back: its simulation, the collisions so far, the second stage."""

    snapshot: Snapshot
    collisions: float
    second: tuple[Snapshot, History] | None

    @property
    def nbytes(self) -> int:
        """Memory of its arrays."""
        return self.snapshot.nbytes + (0 if self.second is None else self.second[0].nbytes)


class Interactions:
    """Applies changes by hand to a simulation of a view.

    A gesture lasts from press to release and is one step of undo, even if several pages change the simulation at the
    same time. The argument `same` of a command says that it continues the gesture before. Only a simulation that is
    `owned` by the view has undo, because that takes back frames, too. `moment` remembers the present moment, and `back`
    goes back to it.
    """

    def __init__(self, sim: Simulation, owned: bool, moment: Callable[[], Moment], back: Callable[[Moment], None]):
        self._sim, self._sliders = sim, Sliders(sim)
        self._moment, self._back = moment, back
        self._undo: dict[int, Moment] = {}  # before each gesture, by numbers that are never used twice
        self._made = 0
        self._note: str | None = None  # why an action was refused, or how it differed from the request
        self._notes = 0
        self._owned = owned
        self._now = 0.0
        self._held: dict[int, tuple[Place, float]] = {}  # held discs, and the time of a clock when each is released [s]
        self._gestures: dict[Key, int] = {}  # that "same" can continue: numbers of the moments before them
        self._added = self._walls = 0

    def told(self) -> dict[str, Any]:
        """The message for pages, for `protocol.text_of`."""
        return {
            "held": sorted(self._held),
            "undo": len(self._undo) if self._owned else None,
            "note": self._note,
            "notes": self._notes,
            "dt": self._sim.settings.dt,
            "parameters": list(self._sliders.told()),
        }

    def do(self, action: Action, now: float) -> None:
        """Do an action at this time of a clock [s]."""
        self._now = now
        try:
            getattr(self, f"do_{action.name}")(**action.values)
        except REFUSALS as error:
            self._say(str(error))

    def hold_still(self, now: float) -> bool:
        """Put held discs back in their places, before frames are run; returns whether anything changed."""
        different = False
        for disc, (place, until) in list(self._held.items()):
            try:
                if now <= until:
                    different |= _put(self._sim, disc, place)
                    continue
            except REFUSALS as error:  # the disc is absent, or its place is no longer free
                self._say(str(error))
            del self._held[disc]
            different = True
        return different

    def _say(self, note: str) -> None:
        self._note = note
        self._notes += 1

    @contextlib.contextmanager
    def _gesture(self, key: Key, same: bool = False) -> Iterator[None]:
        """Remember the moment before a gesture, unless `same` continues it; go back to it if the gesture is refused."""
        same = same and key in self._gestures
        before = self._moment() if key[0] in BUILDING or (self._owned and not same) else None
        try:
            yield
        except REFUSALS:
            if not same:
                self._gestures.pop(key, None)
            if before is not None and len(self._sim.journal) > len(before.snapshot.changes):
                self._back(before)
            raise
        if same:
            return
        self._made += 1
        self._gestures[key] = self._made
        if self._owned and before is not None:
            self._undo[self._made] = before
        while len(self._undo) > MOST_MOMENTS or sum(each.nbytes for each in self._undo.values()) > MOST_BYTES:
            del self._undo[min(self._undo)]

    # --- commands

    @command()
    def do_undo(self) -> None:
        """Go back to the moment before the last gesture."""
        if not self._owned:
            raise InputError(
                "undo needs a simulation of the view's own; this one belongs to a program. Open the view with its "
                "scene, or use sim.journal."
            )
        if not self._undo:
            raise InputError("undo needs a remembered change; got none. Reset goes back to the start.")
        self._back(self._undo.pop(max(self._undo)))
        # gestures that began later are gone
        self._gestures = {key: made for key, made in self._gestures.items() if made in self._undo}
        self._held = {disc: held for disc, held in self._held.items() if ("hold", disc) in self._gestures}

    @command(replaces=True, id=DISC, x=number, y=number)
    def do_hold(self, id: int, x: float, y: float) -> None:
        """Hold a disc at a place."""
        if id not in self._held and len(self._held) >= MOST_HELD:
            raise InputError(f"pages may hold at most {MOST_HELD} discs at a time; got one more. Release another one.")
        with self._gesture(("hold", id), same=id in self._held):
            _put(self._sim, id, (x, y))
        self._held[id] = (x, y), self._now + HOLD_SECONDS

    @command(id=DISC, vx=number, vy=number)
    def do_release(self, id: int, vx: float, vy: float) -> None:
        """Throw a held disc, which ends its gesture."""
        if self._held.pop(id, None) is None:
            return
        (limit, why), speed = _fastest(self._sim, id), math.hypot(vx, vy)
        if speed > limit:
            vx, vy = vx * limit / speed, vy * limit / speed
        if speed:
            self._sim.set([id], velocity=(vx, vy))
        if speed > limit:
            self._say(f"thrown at speed {limit:.3g}, {why}")

    @command(x=number, y=number, same=checks.truth)
    def do_add(self, x: float, y: float, same: bool) -> None:
        """Add a disc; others make room for it."""
        with self._gesture(("add", None), same):
            if self._added >= MOST_ADDED:
                raise InputError(f"pages may add at most {MOST_ADDED} discs; got one more. Reset, or begin with more.")
            own = _own_of_new(self._sim)
            changes.make_room(self._sim, of_discs([(x, y)], own.get("radius", self._sim.scene.largest_radius)))
            self._sim.add((x, y), (0.0, 0.0), **own)
            self._added += 1

    @command(id=DISC, same=checks.truth)
    def do_remove(self, id: int, same: bool) -> None:
        """Remove a disc."""
        with self._gesture(("remove", None), same):
            self._held.pop(id, None)
            self._sim.remove([id])

    @command(ax=number, ay=number, bx=number, by=number)
    def do_wall(self, ax: float, ay: float, bx: float, by: float) -> None:
        """Add a wall between two places; discs make room for it."""
        with self._gesture(("wall", None)):
            radius, length = _typical(self._sim.radii, self._sim.absorbed), math.hypot(bx - ax, by - ay)
            if length < 2 * radius:
                raise InputError(
                    f"a wall must be at least as long as a disc is wide, {2 * radius:.4g}; got {length:.4g}. Drag "
                    "further."
                )
            self._build(Polyline([(ax, ay), (bx, by)], THICKNESS * radius))

    @command(id=DISC, dx=number, dy=number)
    def do_move_wall(self, id: int, dx: float, dy: float) -> None:
        """Put an obstacle elsewhere, from where it is now; discs make room. It gets another number, and rests."""
        with self._gesture(("wall", None)):
            obstacles = self._sim.scene.obstacles
            self._sim.remove_wall(id)
            wall = obstacles[id]
            place = wall.at_place(shifted(capsules_of((wall,), self._sim.time), np.array([dx, dy])))
            self._build(replace(wall, **place, motion=None))

    @command(id=DISC, same=checks.truth)
    def do_remove_wall(self, id: int, same: bool) -> None:
        """Remove a wall, or another obstacle."""
        with self._gesture(("remove", None), same):
            self._sim.remove_wall(id)

    def _build(self, wall: Obstacle) -> None:
        if self._walls >= MOST_WALLS:
            raise InputError(f"pages may draw or move at most {MOST_WALLS:,} walls; got one more. Reset the view.")
        changes.make_room(self._sim, capsules_of((wall,)))
        self._sim.add_wall(wall)
        self._walls += 1

    @command(name=partial(checks.choice, allowed=changes.PARAMETER_NAMES), value=_parameter_value, same=checks.truth)
    def do_change(self, name: str, value: Any, same: bool) -> None:
        """Change a parameter."""
        with self._gesture(("change", name), same):
            self._sliders.demand_offered(name, value)
            self._sim.change(**{name: value})  # type: ignore[misc]  # one of Parameters, checked above


def _put(sim: Simulation, disc: int, place: Place) -> bool:
    """Put a held disc in its place, at rest; returns whether it was not there or not at rest."""
    if disc >= sim.count:
        raise InputError(f"id must be the number of a disc, from 0 to {sim.count - 1}; got {disc}. Take another.")
    now = sim.state_between(disc, disc + 1)
    if now.present[0] and (now.position[0] == np.array(place, now.position.dtype)).all() and not now.velocity.any():
        return False
    sim.set([disc], position=place, velocity=(0.0, 0.0))
    return True


def _fastest(sim: Simulation, disc: int) -> tuple[float, str]:
    """Largest speed of a throw [length/time], and the reason for this limit."""
    scene, dt = sim.scene, sim.settings.dt
    if not capabilities_of(sim.settings).has_steps:
        return min(scene.width, scene.height) / dt, "one side of the box a frame: a faster disc makes frames long"
    return float(sim.radii[disc]) * sim.substeps / dt, "one radius a step: a faster disc may pass through others"


def _typical(values: NDArray[np.float64], absorbed: NDArray[np.bool_]) -> float:
    """The median of the values of the present discs, or of all discs if none is present."""
    there = values[~absorbed] if not absorbed.all() else values
    return float(np.sort(there)[len(there) // 2]) if len(there) else 1.0


def _own_of_new(sim: Simulation) -> dict[str, Any]:
    """Radius and mass of a new disc, where discs differ in them: the median values."""
    own = dict[str, Any]()
    if has_radii(sim.scene):
        own["radius"] = _typical(sim.radii, sim.absorbed)
    if has_masses(sim.scene):
        own["mass"] = _typical(sim.masses, sim.absorbed)
    return own
