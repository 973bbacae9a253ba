"""What a feature of a scene is: everything that other modules need to know about it, in one class.

Each feature has a module of its own with a subclass, of which `mpsim.features.FEATURES` holds an instance. Questions
to every feature are put to all in that list. The methods here are those of a feature that changes nothing.
"""

# pyright: reportPrivateUsage=false
# Names of Scene that begin with an underscore are for all of mpsim.

from __future__ import annotations

import dataclasses
import json
import numbers
from collections.abc import Callable, Iterable
from decimal import Decimal
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from mpsim.core import checks
from mpsim.core.checks import Floats
from mpsim.core.columns import Column
from mpsim.errors import InputError, OutputError
from mpsim.features.capsules import Deepest
from mpsim.features.edges import MovingWall

if TYPE_CHECKING:
    from mpsim.scene.scene import Scene

MOST_VALUES = 1_000_000  # more obstacles or emitters than this are taken for a mistake


class Invalidation(NamedTuple):
    """Measures that a feature makes meaningless, the reason in words, and what to do instead."""

    measures: tuple[str, ...]
    what: str
    remedy: str


NEED_ALL_DISCS = ("virial", "collision_rate", "contact_rate", "energy_drift", "momentum_drift")
"""Measures that mean nothing where the number of discs changes."""


class PerDisc(NamedTuple):
    """An argument of Scene with a value for each disc.

    Attributes:
        check: makes what a scene keeps, from the value given and the number of discs.
        components: names of the components of a vector; () of a number.
        unit: of a number that must be > 0; "" for any number.
        default: of a disc for which a scene file gives none, in a vector of each component; None if it is required.
    """

    check: Callable[[Any, int], Any]
    components: tuple[str, ...] = ()
    unit: str = ""
    default: float | None = 0.0


class AddedDiscs(NamedTuple):
    """Discs to be added, for which there must be room.

    name: of the argument that holds their positions, for the texts of errors. position: shape (K, 2) [length]. radius:
    shape (K,) [length]. present: radii of the discs already there, shape (N,) [length]. time: when they are added.
    """

    name: str
    position: Floats
    radius: Floats
    present: Floats
    time: float


class Continuation(NamedTuple):
    """Where a run has come to, from which another scene starts: its walls [length], and the time."""

    box: tuple[float, float, float, float]
    time: float


class Feature:
    """One optional argument of Scene.

    Questions with a scene are asked where the scene has it, except `of`, `is_in` and `brief`.

    Attributes:
        argument: its name, also the key in scene files and checkpoints.
        kinds: dataclasses of its value; () if the value is words.
        within: further dataclasses that can be in it.
        several: whether its value is a tuple of them; None: it is one, or a tuple of at least two.
        numbers: if it consists of numbers instead, these arguments of Scene with their defaults.
        vectors: likewise (x, y) or None.
        per_disc: likewise a value for each disc, or None: those that are no columns, or need more than these declare.
        law: the only law of the settings that it works with; "" for any.
        examples: valid values, such that each valid value of a field is valid in one of its class. A scene file names
            all that is wrong in a table of such a class, and one table may hold very many, as arrays.
        not_exact: what `event` cannot do, for the text of its refusal.
        drives: what sets discs at rest in motion, for the text that asks for such a thing.
        relief: what makes room for compressed discs, for the text of the warning.
        invalidates: measures that it makes meaningless.
        draws: whether it uses random numbers while the scene runs, which follow from the `seed` of its value.
        heats: whether it changes the energy of discs other than in contacts.
        on_tiles: whether `event` can do it on several workers.
        excludes: whether it keeps discs out of regions of the box.
        adds_discs, removes_discs: whether the number of discs grows, or falls, while the scene runs.
        columns: numbers that it has of each disc, as `mpsim.core.columns` declares them; a scene with the feature has
            them. Those that are given are further arguments, None if the scene gives none.
    """

    argument: ClassVar[str]
    kinds: ClassVar[tuple[type[Any], ...]] = ()
    within: ClassVar[tuple[type[Any], ...]] = ()
    several: ClassVar[bool | None] = True
    numbers: ClassVar[dict[str, float]] = {}
    vectors: ClassVar[tuple[str, ...]] = ()
    per_disc: ClassVar[dict[str, PerDisc]] = {}
    law: ClassVar[str] = ""
    examples: ClassVar[tuple[Any, ...]] = ()
    not_exact: ClassVar[str] = ""
    drives: ClassVar[str] = ""
    relief: ClassVar[str] = ""
    invalidates: ClassVar[tuple[Invalidation, ...]] = ()
    draws: ClassVar[bool] = False
    heats: ClassVar[bool] = False
    on_tiles: ClassVar[bool] = True
    excludes: ClassVar[bool] = False
    adds_discs: ClassVar[bool] = False
    removes_discs: ClassVar[bool] = False
    columns: ClassVar[tuple[Column, ...]] = ()

    @property
    def classes(self) -> tuple[type[Any], ...]:
        """All dataclasses that its value is made of."""
        return *self.kinds, *self.within

    def of(self, scene: Scene) -> Any:
        """Its value in a scene."""
        return getattr(scene, self.argument)

    def is_in(self, scene: Scene) -> bool:
        """Whether the scene has it."""
        value = self.of(scene)
        return value is not None and not (isinstance(value, tuple) and not value)

    # --- the scene

    def check(self, scene: Scene) -> None:
        """Refuse, naming the argument, what does not fit the rest of a scene that is being made."""

    def check_law(self, scene: Scene, law: str) -> None:
        """Refuse a law of the settings that it does not work with."""
        if self.law and law != self.law:
            raise InputError(
                f"law must be {self.law!r} in a scene with {self.argument}, which needs the impulse of a contact; got "
                f"{law!r}. Leave one of them out."
            )

    def dissipates(self, scene: Scene) -> bool:
        """Whether it lets contacts take energy from the motion of the discs."""
        return False

    def check_room(self, scene: Scene, new: AddedDiscs) -> None:
        """Refuse, naming the argument, discs for which it leaves no room."""

    def deepest(self, scene: Scene, position: Floats, radius: Floats, time: float) -> Deepest | None:
        """The disc that overlaps it most at a time, positions (N, 2), radii (N,) [length]; None if no disc does."""
        return None

    def moving_walls(self, scene: Scene) -> tuple[MovingWall, ...]:
        """The walls of the box that it moves."""
        return ()

    def surface_speed(self, scene: Scene) -> float:
        """The highest speed of a surface that it moves [length/time]."""
        return max((wall.speed for wall in self.moving_walls(scene)), default=0.0)

    def running_speed(self, scene: Scene) -> float:
        """The highest speed at which a surface of it runs along itself [length/time]."""
        return 0.0

    def works(self, scene: Scene) -> tuple[int | str, ...]:
        """What of it does work on discs or heats them, as `Simulation.work` names it."""
        return ()

    def continued(self, scene: Scene, moment: Continuation) -> Any:
        """Its value in a scene that starts from a moment of a run of this one."""
        return self.of(scene)

    def thermal_speed(self, scene: Scene) -> float:
        """Speed along one axis that it gives to discs [length/time]."""
        return 0.0

    def exchange_rate(self, scene: Scene, temperature: float) -> float:
        """Rate at which it exchanges the energy of an elastic gas, at most, at kT in the gas [1/time]."""
        return 0.0

    # --- the shared block

    def arrays(self, scene: Scene, real: np.dtype) -> dict[str, NDArray[Any]]:
        """Arrays and records (of shape ()) that its kernels need, by name in the block; real: dtype of floats."""
        return {}

    def begin(self, scene: Scene, arrays: dict[str, Any], dt: float, origin: tuple[int, float]) -> None:
        """Write what depends on the length of frames, dt [time], and on the frame and time from which they count."""

    # --- people

    def brief(self, scene: Scene) -> str:
        """What the repr of a scene says about it; "" for nothing."""
        return self.argument if self.is_in(scene) else ""

    def description(self, scene: Scene) -> str:
        """Description in words for a scene that has it; "" if the description of the discs includes it."""
        return ""


# --- What changes the number of discs in a scene, or their energy: fields, losses, heat baths, moving surfaces


def mean_mass(scene: Scene) -> float:
    """Of the discs at the start; 1 without any [mass]."""
    return float(scene.mass.mean()) if scene.mass is not None and scene.count else 1.0


def _largest(field: Floats | None) -> float:
    """Largest absolute value of a field; 0 without discs, or without the field."""
    return 0.0 if field is None else float(np.hypot(*np.atleast_2d(field).T).max(initial=0.0))


def gravity_strength(scene: Scene) -> float:
    """|g|; 0 without gravity [length/time^2]."""
    return _largest(scene.gravity)


def acceleration_bound(scene: Scene) -> float:
    """An upper bound: |g| plus the largest acceleration given for a disc [length/time^2]."""
    return gravity_strength(scene) + _largest(scene.acceleration)


def strongest_field(scene: Scene) -> float:
    """The larger of |g| and the largest acceleration given for a disc: a scale, not a bound [length/time^2]."""
    return max(gravity_strength(scene), _largest(scene.acceleration))


def has_body_force(scene: Scene) -> bool:
    """Whether the scene gives gravity, or accelerations of the discs, even if they are zero."""
    return scene.gravity is not None or scene.acceleration is not None


def is_inelastic(scene: Scene) -> bool:
    """Whether a restitution below 1 takes energy, in contacts of two discs or of a disc with anything else."""
    has_surfaces = not all(scene.periodic) or any(each.excludes for each in scene._features)
    return scene.restitution < 1 or (scene.wall_restitution < 1 and has_surfaces)


def has_losses(scene: Scene) -> bool:
    """Whether contacts take energy from the motion of the discs."""
    return is_inelastic(scene) or any(feature.dissipates(scene) for feature in scene._features)


def thermal_speed(scene: Scene) -> float:
    """Speed along one axis that thermostats and thermal walls give to discs; 0 without any [length/time]."""
    return max((each.thermal_speed(scene) for each in scene._features), default=0.0)


def adds_discs(scene: Scene) -> bool:
    """Whether discs enter while the scene runs."""
    return any(each.adds_discs for each in scene._features)


def removes_discs(scene: Scene) -> bool:
    """Whether discs may leave while the scene runs."""
    return any(each.removes_discs for each in scene._features)


def conserves_energy(scene: Scene) -> bool:
    """Whether the kinetic energy is constant: no fields, moving walls, heating or losses, always the same discs."""
    changes = scene._works or has_losses(scene) or adds_discs(scene) or removes_discs(scene)
    return not changes and acceleration_bound(scene) == 0


# --- Values of arguments, and in files


def given(name: str, value: Any, kind: type[Any]) -> dict[str, Any]:
    """What a scene keeps of an argument, by name: nothing if there is none, so that the digest is unchanged."""
    if value is not None and not isinstance(value, kind):
        raise InputError(f"{name} must be an mpsim.{kind.__name__}; got {checks.brief(value)}.")
    return {} if value is None else {name: value}


def tuple_of(name: str, values: object, kinds: tuple[type[Any], ...], *others: type[Any]) -> tuple[Any, ...]:
    """What an argument holds, of these classes or others that texts do not name; one may come without a list."""
    found: tuple[Any, ...] = tuple(cast(Any, values)) if isinstance(values, Iterable) else (values,)
    if len(found) > MOST_VALUES:
        raise InputError(f"{name} must be at most {MOST_VALUES:,}; got {len(found):,}. Use fewer.")
    for index, each in enumerate(found):
        if not isinstance(each, (*kinds, *others)):
            names = " or ".join(f"mpsim.{kind.__name__}" for kind in kinds)
            raise InputError(f"{name}[{index}] must be an {names}; got {type(each).__name__}.")
    return found


def chosen(value: Any) -> dict[str, Any]:
    """The fields of a dataclass that differ from their defaults."""
    values = {each.name: (getattr(value, each.name), each.default) for each in dataclasses.fields(value)}
    return {name: own for name, (own, default) in values.items() if own != default}


def plain(value: Any, kinds: tuple[type[Any], ...] = ()) -> Any:
    """A dataclass as its name and its fields, an array or a tuple as a list, numbers as Python's; all else as it is.

    kinds: classes that can be read again; (): it is not to be saved.

    Raises:
        OutputError: for an object of another class.
    """
    if isinstance(value, np.ndarray | np.generic):
        value = cast(Any, value.tolist())
    if isinstance(value, list | tuple):
        return [plain(each, kinds) for each in cast(Any, value)]
    if dataclasses.is_dataclass(value):
        if kinds:
            demand_kind(value, kinds)
        return [type(value).__name__, {name: plain(each, kinds) for name, each in chosen(value).items()}]
    if isinstance(value, bool):
        return value
    if isinstance(value, numbers.Integral):
        return int(value)
    return float(value) if isinstance(value, numbers.Real | Decimal) else value


def demand_kind(value: Any, kinds: tuple[type[Any], ...]) -> None:
    """Refuse what is to be saved and is of none of these classes: of a subclass only these could be read again."""
    if type(value) not in kinds:
        base = next((each.__name__ for each in kinds if isinstance(value, each)), "a class of mpsim")
        raise OutputError(
            f"what is saved must be of classes of mpsim; got a {type(value).__name__}. Use {base} itself."
        )


def restored(values: Any, kinds: Iterable[type[Any]]) -> Any:
    """The value of which `plain` made plain values; kinds: classes that it may be made of.

    Raises:
        ValueError, LookupError, TypeError, InputError: if it is of no such class.
    """
    if not isinstance(values, list):
        return values
    if not (values and isinstance(values[-1], dict)):
        return [restored(each, kinds) for each in cast(Any, values)]
    name, fields = cast(Any, values)
    known = {each.__name__: each for each in kinds}
    if name not in known:
        raise ValueError(f"it has a {name!r:.60}, and this version of mpsim knows {', '.join(known)}")
    return known[name](**{key: restored(each, kinds) for key, each in fields.items()})


def in_toml(value: Any) -> str:
    """A value as TOML, from which the same bits are read; a dataclass, or values by name, as a table in the line."""
    if isinstance(value, str):
        # JSON's escapes are valid in TOML, which requires one more.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, tuple | list | np.ndarray):
        return f"[{', '.join(map(in_toml, cast(Any, value)))}]"
    if dataclasses.is_dataclass(value):
        value = chosen(value)
    if isinstance(value, dict):
        return f"{{ {', '.join(pairs(cast(Any, value)))} }}"
    return repr(int(value) if isinstance(value, numbers.Integral) else float(value))


def pairs(values: dict[str, Any]) -> list[str]:
    """A line for each value that is not None."""
    return [f"{name} = {in_toml(value)}" for name, value in values.items() if value is not None]
