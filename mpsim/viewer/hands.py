"""Actions that change discs: drag, add and remove them, draw walls, change parameters.

All of it goes through the doors of the simulation (`set`, `add`, `remove`, `add_wall`, `change`), so that the journal
has it. What these refuse becomes a note for the page; the simulation is then as it was.
"""

import contextlib
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mpsim.core.errors import BusyError, InputError, OutputError
from mpsim.engine.simulation import Simulation
from mpsim.engine.solvers.methods import capabilities_of
from mpsim.features.masses import has_masses
from mpsim.features.radii import has_radii
from mpsim.measure.pairs import lengths_of, to_nearest_image
from mpsim.viewer.sliders import Sliders
from mpsim.viewer.undo import Undo
from mpsim.viewer.wire import Action

HOLD_SECONDS = 3.0
"""A disc is let go when its page has said nothing for so long; it repeats itself every second."""

MOST_HELD = 16
"""Discs that pages may hold at a time: each is put in its place before all frames."""

MOST_ADDED = 10_000
"""Discs that pages may add to one simulation."""

MOST_WALLS = 1000
"""Walls that pages may draw in one simulation: the page is told all of them at each one."""

THICKNESS = 0.5
"""Thickness of a wall that is drawn, in radii of a disc of the middle size: enough to be seen on a projector."""

REFUSALS = (InputError, BusyError, OutputError)
"""Errors that leave the simulation as it was: for the page, a note."""


class _NoRoomError(InputError):
    """A part of a stroke has room for no disc, which is not worth a note."""


@dataclass
class _Held:
    """A disc that is held: its number, where it is to be [length], and until when without another word [s]."""

    disc: int
    place: tuple[float, float]
    until: float


Key = tuple[str, Any]
"""A gesture: its action, and the disc that is held or the parameter that is changed."""


class Hands:
    """Actions of pages on one simulation after the other.

    Args:
        owned: whether the simulations are the view's own. Others are changed, but not replaced: nothing is undone.

    Attributes:
        undo: the moments before their gestures. A gesture is what a hand does from press to release, and one entry,
            however many pages have their hands on the simulation at the same time.
        note: why the last action was refused, or what was different from what was asked for; None: nothing.

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
        self._said: str | None = None  # the last note, which pages are told until there is another one
        self._notes = 0
        self._owned = owned
        self.undo: Undo = Undo()
        self._held: dict[int, _Held] = {}  # by their numbers
        self._gestures: dict[Key, int] = {}  # that "same" can go on with: the moment before each
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
        """What pages are told, as `wire.text_of` takes it."""
        assert self._sliders is not None  # since the beginning
        return {
            "held": sorted(self._held),
            "undo": len(self.undo) if self._owned else None,
            "note": self._said,
            "notes": self._notes,
            "dt": sim.settings.dt,
            "parameters": self._sliders.of(sim),
        }

    def do(self, sim: Simulation, action: Action, now: float) -> Simulation:
        """Do an action; returns the simulation as it is then: after "undo" it is another one.

        now: time of a clock [s].
        """
        self.note = None
        try:
            if action.name == "undo":
                return self._back(sim)
            if action.name == "hold":
                self._hold(sim, now, **action.values)
            elif action.name == "release":  # which ends a gesture that has begun
                self._release(sim, **action.values)
            else:
                self._with_mark(sim, action)
        except _NoRoomError:
            pass
        except REFUSALS as error:
            self._say(str(error))
        return sim

    def hold_still(self, sim: Simulation, now: float) -> bool:
        """Put held discs where they are held, before frames are run; returns whether something is different then."""
        different = False
        for held in list(self._held.values()):
            try:
                if now <= held.until:
                    different |= _put(sim, held)
                    continue
            except REFUSALS as error:  # it has left, or there is no room any more
                self._say(str(error))
            del self._held[held.disc]
            different = True
        return different

    def _say(self, note: str) -> None:
        self.note = self._said = note
        self._notes += 1

    # --- marks, and back to them

    def _with_mark(self, sim: Simulation, action: Action) -> None:
        """Do an action that can be taken back, together with the gesture that it goes on with."""
        values = dict(action.values)
        key = ("add" if action.name == "stroke" else action.name, values.get("name"))
        with self._marked(sim, key, values.pop("same", False) and key in self._gestures):
            self._acts[action.name](sim, **values)

    @contextlib.contextmanager
    def _marked(self, sim: Simulation, key: Key, goes_on: bool) -> Iterator[None]:
        """Remember this moment as that before a gesture, unless it goes on, or what follows is refused."""
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
        kept = self.undo.numbers  # what has begun later is no longer there
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
        """Add discs at those of several places that are free."""
        self._demand_more()
        own = _own_of_new(sim)
        free = _free(sim, np.array(places), own.get("radius", sim.scene.largest_radius))[: MOST_ADDED - self._added]
        before = sim.count
        try:
            if len(free):
                sim.add(free, np.zeros_like(free), **{name: np.full(len(free), value) for name, value in own.items()})
        except InputError:  # an obstacle is at one of them
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
        assert self._sliders is not None  # since the beginning
        self._sliders.demand_offered(sim, name, value)
        sim.change(**{name: value})  # type: ignore[misc]  # one of Parameters, checked by wire


def _put(sim: Simulation, held: _Held) -> bool:
    """Put a disc where it is held, at rest; returns whether it was not."""
    if held.disc >= sim.count:
        raise InputError(f"id must be the number of a disc, from 0 to {sim.count - 1}; got {held.disc}. Take another.")
    disc = sim.state_between(held.disc, held.disc + 1)
    place = np.array(held.place, disc.position.dtype)
    if disc.present[0] and (disc.position[0] == place).all() and not disc.velocity.any():
        return False
    sim.set([held.disc], position=held.place, velocity=(0.0, 0.0))
    return True


def _fastest(sim: Simulation, disc: int) -> tuple[float, str]:
    """Largest speed of a throw [length/time], and why.

    One radius in a step; where there are no steps, the shorter side of the box in a frame, whose events are then few.
    """
    scene, dt = sim.scene, sim.settings.dt
    if not capabilities_of(sim.settings).has_steps:
        return min(scene.width, scene.height) / dt, "one side of the box a frame: a faster disc makes frames long"
    return float(sim.radii[disc]) * sim.substeps / dt, "one radius a step: a faster disc may pass through others"


def _typical(values: NDArray[np.float64], absorbed: NDArray[np.bool_]) -> float:
    """One that a disc has: of those that are there the middle one by size, or of all where none is there."""
    there = values[~absorbed] if not absorbed.all() else values
    return float(np.sort(there)[len(there) // 2]) if len(there) else 1.0


def _own_of_new(sim: Simulation) -> dict[str, float]:
    """What a new disc has of its own, where discs differ: that of a usual one."""
    own = dict[str, float]()
    if has_radii(sim.scene):
        own["radius"] = _typical(sim.radii, sim.absorbed)
    if has_masses(sim.scene):
        own["mass"] = _typical(sim.masses, sim.absorbed)
    return own


def _free(sim: Simulation, places: NDArray[np.float64], radius: float) -> NDArray[np.float64]:
    """Those of several places, shape (K, 2), at which no disc stands, if discs of a radius are put at them in turn."""
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
    """Refuse a place on which a disc stands; walls and obstacles are those of `Simulation.add`."""
    state = sim.state
    apart = to_nearest_image(state.position.astype(np.float64) - place, lengths_of(sim.scene))
    gap = np.hypot(*apart.T) - sim.radii - radius
    gap[~state.present] = np.inf
    if len(gap) and gap.min() < 0:
        raise InputError(
            f"a new disc needs a free place; got ({place[0]:.4g}, {place[1]:.4g}), where disc {gap.argmin()} is. "
            "Choose another."
        )
