"""Checks of user input, objects that refuse assignments or are closed, and observers that refuse other simulations."""

import difflib
import functools
import inspect
import math
import numbers
import reprlib
import weakref
from collections.abc import Callable, Iterable
from typing import Any, ClassVar, NoReturn, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from mpsim.errors import InputError, MpsimError, UnknownArgumentError

Floats = NDArray[np.float64]
Refused = TypeVar("Refused", bound=MpsimError)
Number = TypeVar("Number", bound=np.generic)

# --- All checks of user input: finite, dtype, shape, range. Messages: name, rule, value received, what to do


def refusal(what: str, rule: str, got: str, instead: str = "", error: type[Refused] = InputError) -> Refused:
    """The error to raise for something that breaks a rule. Every refusal of mpsim has these four parts.

    Args:
        what: the argument, file or call.
        rule: what it must do or be, in words that follow "must".
        got: what was received, in words; `brief(value)` of a value.
        instead: what to do, a sentence.
        error: its class.

    >>> raise refusal("dt", "be a number > 0 [time]", brief(-1), "Use 0.01.")
    Traceback (most recent call last):
        ...
    mpsim.InputError: dt must be a number > 0 [time]; got -1. Use 0.01.
    """
    return error(f"{what} must {rule}; got {got}.{instead and f' {instead}'}")


def finite_array(name: str, value: Any, shape: tuple[int | None, ...], meaning: str) -> Floats:
    """A read-only float64 copy of `value` with the given shape (None: any length). `meaning` is the shape in words."""
    try:
        given = np.asarray(value)
        if given.dtype.kind in "SUT" or (given.dtype == object and any(isinstance(x, str | bytes) for x in given.flat)):
            raise TypeError("text")  # of which NumPy would make numbers
        if given.dtype.kind in "cmM":
            raise TypeError(f"of dtype {given.dtype}")
        array = np.array(given, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:  # the last for a whole number beyond float64
        raise InputError(f"{name} must be numbers of shape {meaning}; got {brief(value)} ({error!s:.200}).") from None
    finite = np.isfinite(array)
    if not finite.all():
        bad = np.argwhere(~finite)
        at = tuple(int(index) for index in bad[0])
        where = list(at) if at else ""
        raise InputError(
            f"{name} must be finite; {name}{where} is {array[at]} (such values: {len(bad)}). "
            "Correct them, or leave them out."
        )
    if array.size == 0 and shape[:1] in ((None,), (0,)):  # an empty list has lost its second axis
        array = array.reshape((0, *[length or 0 for length in shape[1:]]))
    fits = array.ndim == len(shape) and all(
        wanted in (None, got) for wanted, got in zip(shape, array.shape, strict=True)
    )
    if not fits:
        raise refusal(name, f"have shape {meaning}", f"shape {array.shape}", "Reshape the array.")
    return read_only(array)


def read_only(array: NDArray[Number]) -> NDArray[Number]:
    """The same array, which cannot be written any more."""
    array.setflags(write=False)
    return array


def dimensions(value: Any) -> int:
    """How many axes an array of a value would have; -1 of rows that differ in length, which `finite_array` refuses."""
    try:
        return np.ndim(value)
    except ValueError:
        return -1


def rows(value: Any) -> Any:
    """A pair as one row; anything else as it is, for `finite_array`."""
    return [value] if dimensions(value) == 1 else value


def resolution(array: NDArray[np.floating]) -> float:
    """The relative spacing (eps) of the precision in which numbers were computed: float32 if each fits one exactly.

    The dtype does not show it: results of a float32 run may come as float64, from a file or through arithmetic.

    >>> resolution(np.array([0.5, np.float32(0.1)])) == 2.0**-23, resolution(np.array([0.5, 0.1])) == 2.0**-52
    (True, True)
    """
    with np.errstate(over="ignore"):
        single = bool((array.astype(np.float32) == array).all())
    return float(np.finfo(np.float32 if single else np.float64).eps)


def number(name: str, value: Any, rule: str, fits: Callable[[float], bool] = lambda found: True) -> float:
    """A number, which may be infinite or none if `fits` says so; `rule` says in words what it must be."""
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        raise refusal(name, f"be {rule}", brief(value))
    try:
        found = float(value)
    except OverflowError:
        raise refusal(name, f"be {rule}, finite in float64", brief(value)) from None
    if not fits(found):
        raise refusal(name, f"be {rule}", brief(value))
    return found


def positive(name: str, value: Any, unit: str) -> float:
    """A finite number above 0."""
    return number(name, value, f"a finite number > 0 {unit}", lambda found: 0 < found < math.inf)


def time_to_come(name: str, value: Any) -> float:
    """A number >= 0, or infinity, which stands for the end of all motion."""
    return number(name, value, "a number >= 0 [time], or infinity", lambda found: found >= 0)


def non_negative(name: str, value: Any, unit: str) -> float:
    """A finite number >= 0."""
    return number(name, value, f"a finite number >= 0 {unit}", lambda found: 0 <= found < math.inf)


def between(name: str, value: Any, low: float, high: float) -> float:
    """A number from `low` to `high`."""
    return number(name, value, f"a number from {low:g} to {high:g}", lambda found: low <= found <= high)


def one_or_each(name: str, value: Any, count: int, unit: str) -> float | Floats:
    """A positive number for all discs, or one each, shape (count,); equal ones become one number."""
    if np.ndim(value) == 0:
        return positive(name, value, unit)
    array = finite_array(name, value, (count,), f"() or ({count},), one per row of position")
    if len(bad := np.flatnonzero(array <= 0)):
        raise InputError(f"{name} must be > 0 {unit}; {name}[{bad[0]}] is {array[bad[0]]} (such values: {len(bad)}).")
    return float(array[0]) if count and (array == array[0]).all() else array


def masses(value: Any, count: int) -> Floats | None:
    """One mass per disc, or None where all are 1."""
    each = np.broadcast_to(one_or_each("mass", value, count, "[mass]"), count)
    if (each == 1).all():
        return None
    return finite_array("mass", each, (count,), f"({count},)")


def whole(name: str, value: Any, low: int, high: int, remedy: str) -> int:
    """A whole number in [low, high]."""
    if isinstance(value, bool) or not isinstance(value, numbers.Integral) or not low <= int(value) <= high:
        if isinstance(value, float) and low <= value <= high:
            between = value % 1 and value < high
            remedy = f"Give {int(value)} or {int(value) + 1}." if between else f"Give {int(value)}."
        raise refusal(name, f"be a whole number from {low} to {high}", brief(value), remedy)
    return int(value)


def truth(name: str, value: Any) -> bool:
    """True or False, not a value that is merely truthy."""
    if not isinstance(value, bool | np.bool_):
        raise refusal(name, "be True or False", brief(value))
    return bool(value)


def text(name: str, value: Any, kind: str = "a text") -> str:
    """A text; `kind` says in words what it must be."""
    if not isinstance(value, str):
        raise refusal(name, f"be {kind}", brief(value))
    return value


def fitting(name: str, array: Floats, precision: str, first: int = 0) -> float:
    """The largest value, unless its square overflows in the precision of the run; `first`: number of the first row."""
    largest, sizes = float(np.sqrt(np.finfo(precision).max)) / 4, np.abs(array)
    if (most := float(sizes.max(initial=0.0))) > largest:
        at = tuple(int(index) for index in np.argwhere(sizes > largest)[0])
        row = [first + at[0], *at[1:]]
        raise InputError(
            f"{name} must be at most {largest:.3g} in {precision}, so that squares fit; {name}{row} is "
            f"{array[at]:g}. {_wider(precision)}"
        )
    return most


def equal(one: NDArray[Any], other: NDArray[Any]) -> bool:
    """Whether two arrays have one shape and equal elements.

    numpy.array_equal would turn an exception of a signal handler, such as a time limit, into False.
    """
    return one.shape == other.shape and bool((one == other).all())


def not_vanishing(name: str, value: float, least: float, precision: str) -> None:
    """Refuse a positive value that vanishes in the precision of the run."""
    if value < least:
        rule = f"be at least {least:.3g} in {precision}, below which it counts as 0"
        raise refusal(name, rule, brief(value), _wider(precision))


def _wider(precision: str) -> str:
    return "Use other units." if precision == "float64" else "Use other units or precision='float64'."


def choice(name: str, value: Any, allowed: Iterable[str]) -> str:
    """One of the allowed words; the error suggests one that is similar."""
    words = list(allowed)
    if isinstance(value, str) and value in words:  # an array would be compared word by word
        return str(value)
    raise InputError(must_be_one_of(name, value, words))


def must_be_one_of(name: str, value: Any, words: Iterable[str]) -> str:
    """The refusal of a word that is none of those allowed, with one that is similar."""
    meant = near(value, words)
    hint = f" Did you mean {meant!r}?" if meant else ""
    return f"{name} must be one of {', '.join(map(repr, words))}; got {brief(value)}.{hint}"


def known_arguments(function: str, names: Iterable[str], known: Iterable[str]) -> None:
    """Refuse names that are no argument of a function: the first of them, with one that is similar."""
    words = list(dict.fromkeys(known))
    for name in names:
        if name not in words:
            raise UnknownArgumentError(must_be_one_of(f"an argument of {function}", name, words))


def names_of(function: Callable[..., Any]) -> tuple[str, ...]:
    """The names of the arguments that may be given by keyword.

    >>> names_of(lambda frames, /, until, *rest, dt=1.0, **others: None)
    ('until', 'dt')
    """
    by_keyword = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    parameters = inspect.signature(function).parameters.values()
    return tuple(each.name for each in parameters if each.kind in by_keyword and each.name not in ("self", "cls"))


MOST_BITS = 200  # whole numbers of fewer bits are written out: these have LONGEST digits at most
LONGEST = 60  # largest length of a value in a message, in characters


class _Brief(reprlib.Repr):
    """repr, shortened where a value is large or deep; works for any whole number."""

    def __init__(self) -> None:
        super().__init__()
        self.maxlevel = 6
        self.maxlist = self.maxtuple = self.maxdict = self.maxset = self.maxfrozenset = 20
        self.maxstring = self.maxother = 200

    def repr_int(self, x: int, level: int) -> str:
        if x.bit_length() < MOST_BITS:
            return repr(x)
        return f"a whole number of {int(math.log10(abs(x))) + 1:,} digits"


_words = _Brief().repr


def brief(value: Any) -> str:
    """A value as text for a message, in at most LONGEST characters, however large or deep it is.

    >>> brief("word"), brief(10**5000), len(brief([[1.5] * 1000] * 1000))
    ("'word'", 'a whole number of 5,001 digits', 60)
    """
    return shortened(_words(value))


def shortened(text: str) -> str:
    """A text cut to LONGEST characters."""
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 3]}..."


def near(value: Any, words: Iterable[str]) -> str | None:
    """The word that was probably meant, if one is similar to the value."""
    likely = isinstance(value, str) and len(value) <= LONGEST
    return next(iter(difflib.get_close_matches(value, list(words), n=1)), None) if likely else None


def finite(name: str, value: Any) -> float:
    """A finite number, which an array of shape () may hold."""
    is_plain = type(value) is float and math.isfinite(value)  # an array takes 15 us, and there may be a million pegs
    return value if is_plain else float(finite_array(name, value, (), "()"))


def point(name: str, value: object) -> tuple[float, float]:
    """x and y, finite."""
    if (
        isinstance(value, list | tuple)
        and len(value) == 2
        and all(type(x) is float and math.isfinite(x) for x in value)
    ):
        return value[0], value[1]  # an array takes 15 us, and there may be a million pegs
    x, y = finite_array(name, value, (2,), "(2,)").tolist()
    return x, y


# --- Objects that a block closes, and those that refuse assignments, which would be ignored or leave them unchecked


def keep_fields(thing: Any, **rules: Callable[[str, Any], Any] | str) -> None:
    """Check fields of a frozen dataclass, except those of None by default, and keep the results.

    rules: of each field its check, called with a name, such as "radius of a Circle", and the value; or the unit of a
    number > 0.
    """
    kind = type(thing)
    for name, rule in rules.items():
        value = getattr(thing, name)
        if value is not None or getattr(kind, name, 0) is not None:
            what = f"{name} of {of_a(kind)}"
            vars(thing)[name] = positive(what, value, rule) if isinstance(rule, str) else rule(what, value)


@functools.cache
def of_a(kind: type[Any]) -> str:
    """An object of a class in words, such as "an Emitter"."""
    name = kind.__name__
    return name if name.endswith("s") else f"{'an' if name[0] in 'AEIO' else 'a'} {name}"


class Closable:
    """An object that a `with` block closes."""

    def close(self) -> None:
        raise NotImplementedError

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()


class ReadOnly:
    """An object whose public attributes are set by its `__init__`, each once, and by nobody else.

    A class outside mpsim that inherits from it may add attributes of its own.

    >>> class Box(ReadOnly):
    ...     _instead, _set_once = "Make another Box", frozenset({"width"})
    ...     def __init__(self, width):
    ...         self.width = width
    >>> Box(3).width = 4
    Traceback (most recent call last):
        ...
    mpsim.InputError: width of a Box cannot be assigned; got 4. Make another Box.
    """

    _instead: ClassVar[str] = ""
    """What to do instead of an assignment."""

    _set_once: ClassVar[frozenset[str]] = frozenset()
    """The attributes that `__init__` assigns."""

    def __setattr__(self, name: str, value: Any) -> None:
        if not (name.startswith("_") or self._may_set(name)):
            self._refuse(name, f"assigned; got {brief(value)}")
        super().__setattr__(name, value)

    def __delattr__(self, name: str) -> None:
        if not name.startswith("_") and not self._may_set(name):
            self._refuse(name, "deleted")
        super().__delattr__(name)

    def _may_set(self, name: str) -> bool:
        if name in self._set_once:
            return name not in vars(self)
        own, *_ = (each for each in type(self).__mro__ if each.__module__.startswith("mpsim."))
        return type(self) is not own and not hasattr(own, name)

    def _refuse(self, name: str, what: str) -> NoReturn:
        raise InputError(f"{name} of a {type(self).__name__} cannot be {what}. {self._instead}.")


# --- Observers that refuse other simulations than their first


class Binding:
    """Refers to the first simulation of an observer, and does not keep it alive.

    name, advice, error: the observer in words, what to do with another simulation, and the error to raise.
    """

    def __init__(self, name: str, advice: str, error: type[MpsimError] = InputError):
        self._name, self._advice, self._error = name, advice, error
        self._first: weakref.ref[Any] | None = None
        self._restores = 0

    def bind_or_check(self, one: Any) -> None:
        """Bind to this simulation the first time; then refuse another one, or this one after it has gone back."""
        if self._first is None:
            self._first, self._restores = weakref.ref(one), getattr(one, "restores", 0)
        first, owner = self._first(), ""
        if first is not one:
            owner = f"one simulation, {'which is gone by now' if first is None else first}; got another, {one}"
        elif getattr(one, "restores", 0) != self._restores:
            owner = f"frames that may be undone, as sim.restore(...) was called; got {one} again"
        if owner:
            raise self._error(f"{self._name} belongs to {owner}. {self._advice}")
