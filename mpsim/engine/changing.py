"""The public methods that change a simulation between two frames, with checks of their input."""

from __future__ import annotations

from typing import NoReturn, Unpack

from numpy.typing import ArrayLike

from mpsim.core.columns import GivenColumns
from mpsim.core.read_only import ReadOnly
from mpsim.engine import changes, insertion
from mpsim.engine.access import Access, exclusive, reading
from mpsim.engine.coordinator import Coordinator
from mpsim.engine.journal import Journal
from mpsim.engine.parameters import Parameters, check_names, demand_steps, plain
from mpsim.errors import InputError


class Changing(ReadOnly):
    """A simulation, as far as it is changed from outside.

    Between two frames: between two calls of `run`, or in a callback of one. A change is made as a whole or, if it is
    refused, not at all. It is an entry of the journal, and the same on any number of workers.
    """

    _instead = "Use sim.change(...) for parameters and settings, and sim.set(...) for discs"

    _access: Access
    _coordinator: Coordinator

    def __reduce__(self) -> NoReturn:
        raise InputError(
            "a Simulation cannot be pickled or copied, as its discs are in shared memory. Pass sim.state on, or a file "
            "of sim.save(...), from which Simulation.resume(...) continues."
        )

    @exclusive
    def add(
        self,
        position: ArrayLike,
        velocity: ArrayLike,
        acceleration: ArrayLike | None = None,
        *,
        radius: ArrayLike | None = None,
        mass: ArrayLike | None = None,
        **others: Unpack[GivenColumns],
    ) -> None:
        """Add one disc, or several.

        Args:
            position, velocity: shape (2,) or (K, 2); centres inside the box as it is now, clear of what stands in it
                [length], [length/time]. A new disc may overlap others: the next frames push them apart.
            acceleration: as position, only in a scene that has it; left out it is zero [length/time^2].
            radius, mass: one or one each; needed in a scene whose discs have one each, and only there. No disc may be
                larger than the largest of the scene [length], [mass].
            others: what else discs of the scene have, by name, such as spin [1/time] in a scene of rough discs: one or
                one each; left out it is zero.

        Raises:
            InputError: naming the argument, its rule and the value received; then nothing was added.
            TooFastError: as settings.on_fast says; then nothing was added either.
        """
        given = position, velocity, acceleration, radius, mass, others
        self._coordinator.open_solver().demand_alike("the discs that are added", given)
        place = self._place()
        brought = {"acceleration": acceleration, **others}
        radii = place.solver.radii[~place.solver.absorbed] if place.scene.loses_discs else place.solver.radii
        now = place.scene, place.precision, place.solver.time, radii
        new = insertion.checked(*now, position, velocity, radius, mass, brought)
        changes.check_momentum(place.solver, "velocity", new.velocity, new.mass)
        substeps = self._coordinator.look(new)
        self._access.notices.give()  # where a filter makes an error of a warning, nothing is added
        self._coordinator.add(place.change(changes.ADD, insertion.arguments_of(place.scene, new)), new, substeps)

    @exclusive
    def set(
        self,
        ids: ArrayLike,
        position: ArrayLike | None = None,
        velocity: ArrayLike | None = None,
        acceleration: ArrayLike | None = None,
        **others: Unpack[GivenColumns],
    ) -> None:
        """Put discs elsewhere, or give them other velocities, between two frames.

        What is left out stays as it is; image flags do, so that a disc that is put elsewhere has jumped.

        Args:
            ids: numbers of discs that are there, one or shape (K,), each once.
            position: shape (2,) for one disc or (K, 2); centres inside the box as it is now, clear of what stands in it
                [length]. Discs may overlap others, which the next frames push apart; of `event` they must not.
            velocity: one for all, shape (2,), or one each, shape (K, 2) [length/time].
            acceleration: shape (K, 2), only in a scene that has it [length/time^2].
            others: what else discs of the scene have, by name, such as spin [1/time] in a scene of rough discs: one or
                one each.

        Raises:
            InputError: naming the argument, its rule and the value received; then nothing is changed.
            TooFastError: as settings.on_fast says; then nothing is changed either.

        >>> from mpsim import Scene, Simulation
        >>> scene = Scene(width=4, height=3, position=[[1, 1], [3, 2]], velocity=[[1, 0], [0, 0]], radius=0.5)
        >>> with Simulation(scene) as sim:
        ...     sim.set(1, position=(2.5, 1.5), velocity=(0, 1))
        ...     sim.state.position.tolist(), sim.state.velocity.tolist()
        ([[1.0, 1.0], [2.5, 1.5]], [[1.0, 0.0], [0.0, 1.0]])
        """
        self._coordinator.open_solver().demand_alike("what is set", (ids, position, velocity, acceleration, others))
        place = self._place("set")
        self._coordinator.change(changes.checked_set(place, ids, position, velocity, acceleration, others))

    @exclusive
    def kick(self, ids: ArrayLike, impulse: ArrayLike) -> None:
        """Give discs a kick between two frames: impulse / mass is added to their velocities.

        Args:
            ids: numbers of discs that are there, one or shape (K,), each once.
            impulse: one for all, shape (2,), or one each, shape (K, 2) [mass length/time].

        Raises:
            InputError, TooFastError: as `set`.

        >>> from mpsim import Scene, Simulation
        >>> scene = Scene(width=4, height=3, position=[[1, 1]], velocity=[[1, 0]], radius=0.5)
        >>> with Simulation(scene) as sim:
        ...     sim.kick(0, (0.5, 2.0))
        ...     sim.state.velocity.tolist()
        [[1.5, 2.0]]
        """
        self._coordinator.open_solver().demand_alike("the kick", (ids, impulse))
        self._coordinator.change(changes.checked_kick(self._place("kick"), ids, impulse))

    @exclusive
    def remove(self, ids: ArrayLike) -> None:
        """Take discs out between two frames.

        The numbers of the others stay. A removed disc keeps its own, as one does that an edge has absorbed: `count` and
        the rows of arrays include it, `sim.state.present` is False for it, it rests where it was, meets nobody, and no
        observable, picture or trajectory has it. It does not come back; add another one.

        The first one that is removed from a scene without absorbing edges makes the simulation load other kernels,
        compiled once on each machine, and the exact solver then plays the box as a whole, in one process.

        Args:
            ids: numbers of discs that are there, one or shape (K,), each once.

        Raises:
            InputError: naming the rule and the value received; then nothing is changed.

        >>> from mpsim import Scene, Simulation
        >>> scene = Scene.random(count=5, packing=0.2, radius=0.5, seed=1)
        >>> with Simulation(scene) as sim:
        ...     sim.remove([1, 3])
        ...     sim.count, sim.state.present.tolist()
        (5, [True, False, True, False, True])
        """
        self._coordinator.open_solver().demand_alike("the discs that are removed", ids)
        self._coordinator.change(changes.checked_remove(self._place("remove"), ids))

    @exclusive
    def change(self, **parameters: Unpack[Parameters]) -> None:
        """Change parameters of the scene or the settings between two frames; those not given stay as they are.

        `scene` and `settings` then are those in force.

        Args:
            parameters: by name, as Scene, Emitter and Settings have them: gravity, restitution, wall_restitution, dt,
                contact, passes, substeps (the last three not of "event", which has no steps), workers; friction and
                wall_friction, of a scene in which they are > 0, and > 0 again; temperature, of a thermostat;
                wall_temperature, one number for all thermal walls or a list with one for each, in the order left,
                right, bottom, top; interval or every of emitters, one number for all that have it or a list with one
                for each; piston_speed, of a piston that then goes on from where it is. What is left of an emitter's
                interval shrinks or grows as the interval does. dt not in a callback of `run`.

        Raises:
            InputError: naming the parameter, its rule and the value received, and what can be changed; then nothing is
                changed.
            TooFastError: as settings.on_fast says; then nothing is changed either.

        >>> from mpsim import Scene, Simulation
        >>> scene = Scene(width=9, height=9, position=[[4, 5]], velocity=[[0, 0]], radius=0.5, gravity=(0, -1))
        >>> with Simulation(scene) as sim:
        ...     sim.change(gravity=(1, 0), dt=0.005)
        ...     sim.run(frames=200).frames, sim.state.velocity.round(12).tolist(), round(sim.time, 12)
        (200, [[1.0, 0.0]], 1.0)
        """
        given = dict(parameters)
        self._coordinator.open_solver().demand_alike("the parameters that are changed", given)
        place = self._place("change")
        check_names(given)
        demand_steps(given, self._coordinator.settings)
        use = self._access.use
        if "dt" in given and use is not None and use.outer is not None:
            raise InputError(
                "dt can be changed between two runs, not in a callback of a run, which counts frames of this "
                "length; got "
                f"{given['dt']!r}. Return from the run before."
            )
        self._coordinator.change_parameters(place.change(changes.PARAMETERS, plain(given)))

    @exclusive
    def add_wall(self, points: ArrayLike, thickness: float = 0.0) -> None:
        """Put up a wall between two frames: one more Polyline among the obstacles of `scene`.

        The first obstacle of a scene makes the simulation load other kernels, compiled once on each machine. Measures
        that mean nothing in a scene with obstacles are NaN for a run in which a wall is put up.

        Args:
            points: its corners, shape (K, 2), K >= 2 [length], in the box; neighbours differ.
            thickness: of the wall, >= 0 [length].

        Raises:
            InputError: naming the argument, its rule and the value received, also where it leaves a disc, an emitter or
                the piston no room; then nothing is changed.

        >>> from mpsim import Scene, Simulation
        >>> scene = Scene(width=8, height=4, position=[[2, 2]], velocity=[[1, 0]], radius=0.5)
        >>> with Simulation(scene) as sim:
        ...     sim.add_wall([(4, 0), (4, 4)])
        ...     report = sim.run(frames=300)
        ...     sim.scene.obstacles, sim.state.velocity.tolist()
        ((Polyline(points=((4.0, 0.0), (4.0, 4.0)), thickness=0.0),), [[-1.0, 0.0]])
        """
        coordinator = self._coordinator
        coordinator.open_solver().demand_alike("the wall", (points, thickness))
        place, start = self._place("add_wall"), coordinator.start_of_all[0]
        coordinator.add_wall(changes.checked_wall(place, start, points, thickness))

    @property
    @reading
    def journal(self) -> Journal:
        """What the simulation started from, and every change by set, kick, remove, add, change and add_wall, in order.

        A checkpoint holds it, so that of a resumed simulation begins where the first one did. `journal.save` writes it,
        and `Simulation.replay` runs it again, with the same bits. On ranks all ask for it; one of them saves it.

        >>> from mpsim import Scene, Simulation
        >>> scene = Scene.random(count=5, packing=0.2, radius=0.5, seed=1)
        >>> with Simulation(scene) as sim:
        ...     sim.kick([0, 1], impulse=(1, 0))
        ...     [(change.frame, change.what, change.values["ids"].tolist()) for change in sim.journal]
        [(0, 'kick', [0, 1])]
        """
        coordinator = self._coordinator
        solver = coordinator.open_solver()
        return Journal(*coordinator.start_of_all, tuple(coordinator.journal), solver.frame, solver.digest())

    @property
    @reading
    def origin(self) -> tuple[int, float]:
        """Frame and time [time] of the last `change` of dt, since which frames are counted; (0, 0.0) without one."""
        frame, time = self._coordinator.open_solver().origin
        return frame, time

    def _place(self, what: str = "") -> changes.Place:
        """Where the simulation stands; what: the call, if that needs a whole frame."""
        coordinator = self._coordinator
        solver = coordinator.open_solver()
        if what:
            changes.demand_whole_frame(solver, what)
        return changes.Place(solver, coordinator.scene, coordinator.settings.precision)
