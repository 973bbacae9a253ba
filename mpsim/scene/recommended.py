"""What a scene recommends for runs of it: length, settings, pictures and what to measure."""

# pyright: reportUnnecessaryIsInstance=false
# Arguments are checked when the program runs as well, for callers without a type checker.

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from mpsim.core import checks
from mpsim.core.views import view
from mpsim.errors import InputError
from mpsim.scene.settings import Settings

NAMES = ("duration", "settings", "picture_interval", "measures")
"""Arguments of Scene that are recommendations: they are no part of its digest."""


class Recommends:
    """The recommendations of a scene.

    Attributes:
        duration: length of a run [time]; None without one.
        settings: how to simulate it; None: the defaults.
        picture_interval: time between two pictures [time]; None without one.
        measures: names of what to measure.
    """

    duration: float | None = None
    settings: Settings | None = None
    picture_interval: float | None = None
    measures: tuple[str, ...] = ()


def check_recommended(
    duration: Any, settings: Any, picture_interval: Any, measures: Iterable[str] | str
) -> dict[str, Any]:
    """The recommendations that were given, checked.

    Raises:
        InputError: naming the argument, its rule and the value received.
    """
    found: dict[str, Any] = {"duration": None if duration is None else checks.positive("duration", duration, "[time]")}
    if settings is not None:
        found["settings"] = _checked(settings)
    if picture_interval is not None:
        found["picture_interval"] = checks.positive("picture_interval", picture_interval, "[time]")
    if not isinstance(measures, Iterable):
        raise InputError(f"measures must be names of measures; got {checks.brief(measures)}.")
    if names := (measures,) if isinstance(measures, str) else tuple(measures):
        known = view("measure_names")
        found["measures"] = tuple(checks.choice("measures", name, known) for name in names)
    return found


def no_scene(value: object) -> InputError:
    """The error for a value that should be a scene; for a text, which may be a scene's name, it says how to load it."""
    remedy = f"Use mpsim.Scene.load({value!r})" if isinstance(value, str) else "Make one with Scene(...)"
    return InputError(f"scene must be an mpsim.Scene; got {type(value).__name__}. {remedy}.")


def settings_for(scene: Recommends, settings: Settings | None) -> Settings:
    """The settings for a run: those given, else those that the scene recommends, else the defaults.

    Raises:
        InputError: if scene is not a Scene, or settings are not Settings.
    """
    if not isinstance(scene, Recommends):
        raise no_scene(scene)
    if settings is None:
        return scene.settings or Settings()
    return _checked(settings)


def frames_between_pictures(scene: Recommends, settings: Settings) -> int | None:
    """The recommended picture interval in frames of these settings, at least 1; None without one."""
    if scene.picture_interval is None:
        return None
    return max(round(scene.picture_interval / settings.dt), 1)


def _checked(settings: object) -> Settings:
    if not isinstance(settings, Settings):
        raise InputError(f"settings must be mpsim.Settings; got {type(settings).__name__}. Use Settings(dt=...).")
    return settings
