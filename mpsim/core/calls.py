"""Wrong calls of public functions, explained: a name that does not exist, a value without its name, one too many.

A right call passes through one frame that does nothing. Where a function cannot be called with its arguments, Python's
TypeError becomes an UnknownArgumentError that says which argument was meant. A TypeError that was raised while the
function ran, such as that of a callback, stays as it is.
"""

import functools
import inspect
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from types import ModuleType
from typing import Any

from mpsim.core import checks
from mpsim.errors import MpsimError, UnknownArgumentError

_EXPLAINED = "_explained_by_mpsim"


def explain_wrong_calls(
    module: ModuleType, names: Iterable[str], instead: Mapping[str, Mapping[str, str]] | None = None
) -> None:
    """Explain wrong calls of functions of a module, and of constructors and public methods of its classes.

    Args:
        module: in which the names are replaced, and where their functions are defined.
        names: of functions and classes; others are left alone.
        instead: by the name of a class, what to write in place of arguments that its constructor does not have.

    >>> def draw(*, colour): ...
    >>> shapes = ModuleType("shapes")
    >>> shapes.draw = draw
    >>> explain_wrong_calls(shapes, ["draw"])
    >>> shapes.draw(color="red")
    Traceback (most recent call last):
        ...
    mpsim.errors.UnknownArgumentError: an argument of draw must be one of 'colour'; got 'color'. Did you mean 'colour'?
    """
    for name in names:
        thing = getattr(module, name)
        if inspect.isfunction(thing):
            made = _explained(thing)
            for place in (module, sys.modules.get(thing.__module__)):  # so that it can be pickled
                if place is not None and vars(place).get(thing.__name__, thing) is thing:
                    setattr(place, name, made)
        elif inspect.isclass(thing) and not issubclass(thing, BaseException):
            for owner, attribute, value in _methods(thing):
                made = _explained(getattr(value, "__func__", value), (instead or {}).get(name))
                setattr(owner, attribute, type(value)(made) if hasattr(value, "__func__") else made)


def _methods(kind: type[Any]) -> Iterator[tuple[Any, str, Any]]:
    """The constructor and the public methods of a class, with the class of mpsim that has each."""
    for owner in kind.__mro__:
        if owner.__module__.startswith("mpsim."):
            for name, value in list(vars(owner).items()):
                is_method = inspect.isfunction(value) or isinstance(value, classmethod | staticmethod)
                if is_method and (name == "__init__" or not name.startswith("_")):
                    yield owner, name, value


def _explained(function: Callable[..., Any], instead: Mapping[str, str] | None = None) -> Callable[..., Any]:
    """The same function, whose wrong calls are explained."""
    if hasattr(function, _EXPLAINED):
        return function

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        try:
            return function(*args, **kwargs)
        except TypeError as error:
            if isinstance(error, MpsimError) or (why := _why_not(function, args, kwargs, instead or {})) is None:
                raise
        raise UnknownArgumentError(why)

    setattr(call, _EXPLAINED, True)
    return call


def _why_not(
    function: Callable[..., Any], args: tuple[Any, ...], kwargs: dict[str, Any], instead: Mapping[str, str]
) -> str | None:
    """Why a function cannot be called with such arguments, in words; None if it can."""
    every = inspect.signature(function).parameters.values()
    kinds = {each.kind for each in every}
    own = function.__qualname__.removesuffix(".__init__")
    open_ended = inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD
    by_place = [each.name for each in every if each.kind < inspect.Parameter.VAR_POSITIONAL]
    by_name = [each.name for each in every if each.kind is inspect.Parameter.KEYWORD_ONLY]
    names = checks.names_of(function)
    needed = [each.name for each in every if each.default is inspect.Parameter.empty and each.kind not in open_ended]
    placed = by_place[: len(args)]
    missing = [name for name in needed if name not in placed and name not in kwargs]
    unknown = [name for name in kwargs if name not in names]
    if unknown and (open_ended[1] not in kinds or checks.near(unknown[0], missing)):
        hint = f" Use {instead[unknown[0]]}." if unknown[0] in instead else ""
        return checks.must_be_one_of(f"an argument of {own}", unknown[0], names) + hint
    surplus = len(args) - len(by_place) if open_ended[0] not in kinds else 0
    if surplus > 0 and by_name:
        name = next((name for name in by_name if name not in kwargs), by_name[0])
        value = checks.brief(args[len(by_place)])
        return f"an argument of {own} must be given with its name, such as {name}=...; got {value} alone."
    if twice := [name for name in placed if name in kwargs]:
        return f"{twice[0]} of {own} must be given once; got two. Leave one out."
    if missing:
        words = ", ".join(f"{name}=..." for name in missing)
        got = ", ".join(unknown) or "none"
        return f"{', '.join(missing)} of {own} must be given; got {got}. Write {own}({words})."
    if surplus > 0:
        words = ", ".join(name for name in by_place if name not in ("self", "cls"))
        return f"{own} must be given no more values than {words}; got {surplus} more. Leave them out."
    return None
