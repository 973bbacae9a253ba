"""Changes that users make by hand: drag, add and remove discs, draw walls, change parameters.

All changes use public methods of the simulation (`set`, `add`, `remove`, `add_wall`, `change`), so that the journal
records them. If a method refuses a change, the page shows a note and the simulation stays as it was.
"""

import contextlib
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpsim.engine.simulation import Simulation
from mpsim.engine.solvers.methods import capabilities_of
from mpsim.errors import BusyError, InputError, OutputError
from mpsim.features.properties import has_masses, has_radii
from mpsim.measure.correlation import lengths_of, to_nearest_image
from mpsim.viewer.sliders import Sliders
from mpsim.viewer.undo import Undo
from mpsim.viewer.wire import Action

HOLD_SECONDS = 3.0
"""A held disc is released when its page has sent nothing for so long. The page repeats `hold` every second."""

MOST_HELD = 16
"""Discs that pages may hold at a time. Before frames are run, each is put back in its place."""

MOST_ADDED = 10_000
"""Discs that pages may add to one simulation."""

MOST_WALLS = 1000
"""Walls that pages may draw in one simulation: all of them are sent again with each new one."""

THICKNESS = 0.5
"""Thickness of a drawn wall, in radii of the median disc: wide enough for a projector."""

REFUSALS = (InputError, BusyError, OutputError)
"""Errors that leave the simulation as it was; the page shows a note."""


class _NoRoomError(InputError):
    """There is no free place along a part of a stroke; the page shows no note for this."""


@dataclass
class _Held:
    """A held disc: its number, its place [length], and the time at which it is released unless it is held again [s]."""

    disc: int
    place: tuple[float, float]
    until: float


Key = tuple[str, Any]
"""A gesture: its action, and the disc that is held or the parameter that is changed."""


class Hands:
    """Applies changes by hand to the simulation of a view, which may be replaced by another one.

    Args:
        owned: whether the simulation belongs to the view. Only then can changes be undone, because undo replaces the
            simulation by another one.

    Attributes:
        undo: the moments before each gesture. A gesture lasts from press to release and is one step of undo, even if
            several pages change the simulation at the same time.
        note: why the last action was refused, or how it differed from the request; None: it was done as requested.

    >>> from mpsim import Scene
    >>> hands, sim = Hands(owned=True), Simulation(Scene.random(count=5, packing=0.2, radius=0.5, seed=1))
    >>> hands.begin(sim)
    >>> sim = hands.do(sim, Action("remove", {"id": 3, "same": False}), now=0.0)
    >>> sim.state.present.tolist(), hands.told(sim)["undo"]
    ([True, True, True, False, True], 1)
    >>> sim = hands.do(sim, Action("undo", {}), now=0.0)
    >>> bool(sim.state.present.all())
    True
    >>> sim.close(); hands.close()
    """

    def __init__(self, owned: bool):
        self.note: str | None = None
        self._said: str | None = None  # the last note, sent to pages until there is another one
        self._notes = 0
        self._owned = owned
        self.undo: Undo = Undo()
        self._held: dict[int, _Held] = {}  # by their numbers
        self._gestures: dict[Key, int] = {}  # that "same" can continue: number of the moment before each
        self._added = self._walls = 0
        self._sliders: Sliders | None = None
        self._acts: Mapping[str, Callable[..., None]] = {
            "add": self._add,
            "stroke": self._stroke,
            "remove": self._remove,
            "wall": self._wall,
            "change": self._change,
        }

    def begin(self, sim: Simulation) -> None:
        """Begin with another simulation."""
        self._held, self._gestures, self.note = {}, {}, None
        self._added = self._walls = 0
        self.undo.clear()
        self._sliders = Sliders(sim)

    def close(self) -> None:
        """Remove the checkpoints."""
        self.undo.close()

    def told(self, sim: Simulation) -> dict[str, Any]:
        """The message for pages, for `wire.text_of`."""
        assert self._sliders is not None  # `begin` was called
        return {
            "held": sorted(self._held),
            "undo": len(self.undo) if self._owned else None,
            "note": self._said,
            "notes": self._notes,
            "dt": sim.settings.dt,
            "parameters": self._sliders.of(sim),
        }

    def do(self, sim: Simulation, action: Action, now: float) -> Simulation:
        """Do an action. Returns the simulation; after "undo" it is another object.

        now: time of a clock [s].
        """
        self.note = None
        try:
            if action.name == "undo":
                return self._back(sim)
            if action.name == "hold":
                self._hold(sim, now, **action.values)
            elif action.name == "release":  # ends a gesture, so no moment is remembered
                self._release(sim, **action.values)
            else:
                self._with_mark(sim, action)
        except _NoRoomError:
            pass
        except REFUSALS as error:
            self._say(str(error))
        return sim

    def hold_still(self, sim: Simulation, now: float) -> bool:
        """Put held discs back in their places, before frames are run; returns whether anything changed."""
        different = False
        for held in list(self._held.values()):
            try:
                if now <= held.until:
                    different |= _put(sim, held)
                    continue
            except REFUSALS as error:  # the disc is absent, or its place is no longer free
                self._say(str(error))
            del self._held[held.disc]
            different = True
        return different

    def _say(self, note: str) -> None:
        self.note = self._said = note
        self._notes += 1

    # --- moments before gestures, and undo

    def _with_mark(self, sim: Simulation, action: Action) -> None:
        """Do an action that can be undone. If it continues a gesture, it is undone together with that."""
        values = dict(action.values)
        key = ("add" if action.name == "stroke" else action.name, values.get("name"))
        with self._marked(sim, key, values.pop("same", False) and key in self._gestures):
            self._acts[action.name](sim, **values)

    @contextlib.contextmanager
    def _marked(self, sim: Simulation, key: Key, goes_on: bool) -> Iterator[None]:
        """Remember the moment before a gesture, unless the gesture was begun earlier or is refused."""
        if goes_on:
            yield
            return
        if self._owned:
            self.undo.mark(sim)
        try:
            yield
        except REFUSALS:
            self._gestures.pop(key, None)
            if self._owned:
                self.undo.forget_last()
            raise
        self._gestures[key] = self.undo.last
        self.undo.trim({})

    def _back(self, sim: Simulation) -> Simulation:
        if not self._owned:
            raise InputError(
                "undo needs a simulation of the view's own; this one belongs to a program. Open the view with its "
                "scene, or use sim.journal."
            )
        again = self.undo.back(sim)
        kept = self.undo.numbers  # gestures that began later are gone
        self._gestures = {key: number for key, number in self._gestures.items() if number in kept}
        self._held = {disc: held for disc, held in self._held.items() if ("hold", disc) in self._gestures}
        return again

    # --- actions

    def _hold(self, sim: Simulation, now: float, id: int, x: float, y: float) -> None:
        if id not in self._held and len(self._held) >= MOST_HELD:
            raise InputError(f"pages may hold at most {MOST_HELD} discs at a time; got one more. Release another one.")
        held = _Held(id, (x, y), now + HOLD_SECONDS)
        with self._marked(sim, ("hold", id), goes_on=id in self._held):
            _put(sim, held)
        self._held[id] = held

    def _release(self, sim: Simulation, id: int, vx: float, vy: float) -> None:
        if self._held.pop(id, None) is None:
            return
        (limit, why), speed = _fastest(sim, id), math.hypot(vx, vy)
        if speed > limit:
            vx, vy = vx * limit / speed, vy * limit / speed
        if speed:
            sim.set([id], velocity=(vx, vy))
        if speed > limit:
            self._say(f"thrown at speed {limit:.3g}, {why}")

    def _add(self, sim: Simulation, x: float, y: float) -> None:
        self._demand_more()
        own = _own_of_new(sim)
        _demand_room(sim, np.array([x, y]), own.get("radius", sim.scene.largest_radius))
        sim.add((x, y), (0.0, 0.0), **own)
        self._added += 1

    def _stroke(self, sim: Simulation, places: list[list[float]]) -> None:
        """Add discs at the free ones of several places."""
        self._demand_more()
        own = _own_of_new(sim)
        free = _free(sim, np.array(places), own.get("radius", sim.scene.largest_radius))[: MOST_ADDED - self._added]
        before = sim.count
        try:
            if len(free):
                sim.add(free, np.zeros_like(free), **{name: np.full(len(free), value) for name, value in own.items()})
        except InputError:  # an obstacle is in one of the places
            for place in free:
                with contextlib.suppress(InputError):
                    sim.add(place, (0.0, 0.0), **own)
        self._added += sim.count - before
        if sim.count == before:
            raise _NoRoomError

    def _demand_more(self) -> None:
        if self._added >= MOST_ADDED:
            raise InputError(f"pages may add at most {MOST_ADDED} discs; got one more. Reset, or begin with more.")

    def _remove(self, sim: Simulation, id: int) -> None:
        self._held.pop(id, None)
        sim.remove([id])

    def _wall(self, sim: Simulation, ax: float, ay: float, bx: float, by: float) -> None:
        if self._walls >= MOST_WALLS:
            raise InputError(f"pages may draw at most {MOST_WALLS:,} walls; got one more. Reset the view.")
        radius, length = _typical(sim.radii, sim.absorbed), math.hypot(bx - ax, by - ay)
        if length < 2 * radius:
            raise InputError(
                f"a wall must be at least as long as a disc is wide, {2 * radius:.4g}; got {length:.4g}. Drag further."
            )
        sim.add_wall([(ax, ay), (bx, by)], THICKNESS * radius)
        self._walls += 1

    def _change(self, sim: Simulation, name: str, value: Any) -> None:
        assert self._sliders is not None  # `begin` was called
        self._sliders.demand_offered(sim, name, value)
        sim.change(**{name: value})  # type: ignore[misc]  # one of Parameters, checked by wire


def _put(sim: Simulation, held: _Held) -> bool:
    """Put a held disc in its place, at rest; returns whether it was not there or not at rest."""
    if held.disc >= sim.count:
        raise InputError(f"id must be the number of a disc, from 0 to {sim.count - 1}; got {held.disc}. Take another.")
    disc = sim.state_between(held.disc, held.disc + 1)
    place = np.array(held.place, disc.position.dtype)
    if disc.present[0] and (disc.position[0] == place).all() and not disc.velocity.any():
        return False
    sim.set([held.disc], position=held.place, velocity=(0.0, 0.0))
    return True


def _fastest(sim: Simulation, disc: int) -> tuple[float, str]:
    """Largest speed of a throw [length/time], and the reason for this limit.

    The limit is one radius per step. A method without steps has another limit, which keeps the number of events in a
    frame small: the shorter side of the box per frame.
    """
    scene, dt = sim.scene, sim.settings.dt
    if not capabilities_of(sim.settings).has_steps:
        return min(scene.width, scene.height) / dt, "one side of the box a frame: a faster disc makes frames long"
    return float(sim.radii[disc]) * sim.substeps / dt, "one radius a step: a faster disc may pass through others"


def _typical(values: NDArray[np.float64], absorbed: NDArray[np.bool_]) -> float:
    """The median of the values of the present discs, or of all discs if none is present."""
    there = values[~absorbed] if not absorbed.all() else values
    return float(np.sort(there)[len(there) // 2]) if len(there) else 1.0


def _own_of_new(sim: Simulation) -> dict[str, float]:
    """Radius and mass of a new disc, where discs differ in them: the median values."""
    own = dict[str, float]()
    if has_radii(sim.scene):
        own["radius"] = _typical(sim.radii, sim.absorbed)
    if has_masses(sim.scene):
        own["mass"] = _typical(sim.masses, sim.absorbed)
    return own


def _free(sim: Simulation, places: NDArray[np.float64], radius: float) -> NDArray[np.float64]:
    """The free ones of several places, shape (K, 2), if discs of this radius are put at them one after the other."""
    state, lengths = sim.state, lengths_of(sim.scene)
    middle = places[len(places) // 2]
    reach = np.hypot(*to_nearest_image(places - middle, lengths).T).max() + radius + sim.radii.max(initial=0)
    near = np.hypot(*to_nearest_image(state.position.astype(np.float64) - middle, lengths).T) < reach
    near &= state.present
    taken, radii = state.position[near].astype(np.float64), sim.radii[near]
    for place in places:
        if (np.hypot(*to_nearest_image(taken - place, lengths).T) >= radii + radius).all():
            taken, radii = np.vstack([taken, place]), np.append(radii, radius)
    return taken[np.count_nonzero(near) :]


def _demand_room(sim: Simulation, place: NDArray[np.float64], radius: float) -> None:
    """Refuse a place at which a new disc would overlap another one; `Simulation.add` checks walls and obstacles."""
    state = sim.state
    apart = to_nearest_image(state.position.astype(np.float64) - place, lengths_of(sim.scene))
    gap = np.hypot(*apart.T) - sim.radii - radius
    gap[~state.present] = np.inf
    if len(gap) and gap.min() < 0:
        raise InputError(
            f"a new disc needs a free place; got ({place[0]:.4g}, {place[1]:.4g}), where disc {gap.argmin()} is. "
            "Choose another."
        )
