"""Makes the source of pictures for a scene, a simulation, a trajectory or a link."""

from typing import Any

from numpy.typing import ArrayLike

from mpsim.engine.simulation import Simulation
from mpsim.errors import InputError
from mpsim.output.trajectory import Trajectory
from mpsim.scene.scene import Scene
from mpsim.scene.settings import Settings
from mpsim.viewer import wire
from mpsim.viewer.broadcast import Audience
from mpsim.viewer.colouring import own_colours
from mpsim.viewer.link import Link
from mpsim.viewer.playback import Playback
from mpsim.viewer.recording import Recording
from mpsim.viewer.session import Session
from mpsim.viewer.source import Source

Viewed = Scene | Simulation | Trajectory | Recording | Link
"""What a view can show. A recording is the file of a trajectory together with its scene; a link names a scene."""


def demand_viewed(viewed: object, settings: object, beside: object = None) -> None:
    """Refuse what a view cannot show, before anything is opened.

    Raises:
        InputError: if the source, its settings, or those of a second stage are of the wrong type.
    """
    if not isinstance(viewed, Viewed):
        raise InputError(
            f"a view shows an mpsim.Scene, an mpsim.Simulation or an mpsim.Trajectory; got {type(viewed).__name__}. "
            "Use mpsim.Scene.load(...) for the file of a scene, mpsim.Trajectory(...) for that of a run."
        )
    if settings is not None and not isinstance(settings, Settings):
        raise InputError(f"settings must be mpsim.Settings; got {type(settings).__name__}. Use Settings(dt=...).")
    if beside is not None and not isinstance(beside, Settings):
        raise InputError(f"beside must be mpsim.Settings; got {type(beside).__name__}. Use Settings(method='event').")
    if settings is not None and isinstance(viewed, Trajectory | Recording):
        raise InputError(
            "settings can be given only with a scene; got them with a trajectory, which is only shown. Leave them out."
        )


def source_of(
    viewed: Viewed,
    settings: Settings | None,
    *,
    name: str,
    playing: bool,
    audience: Audience,
    colour: ArrayLike | None = None,
    beside: Settings | None = None,
) -> Source:
    """Make the source for the pages of a view.

    Raises:
        InputError, TrajectoryError: as `Session` and `Recording`; also if colours are given with a trajectory.
    """
    name = wire.in_utf8(name)
    if isinstance(viewed, Trajectory):
        viewed = Recording(viewed.path, **viewed.given)
    if not isinstance(viewed, Recording):
        own = own_colours(colour, viewed.given.count if isinstance(viewed, Link) else viewed.count)
        options: dict[str, Any] = {"name": name, "playing": playing, "colour": own, "beside": beside}
        return Session(viewed, settings, **options, audience=audience)
    if beside is not None:
        raise InputError(
            "beside can be given only with a scene; got it with a trajectory, which is only shown. Leave it out."
        )
    if colour is not None:
        raise InputError(
            "colour can be given only with a scene or a simulation; got it with a trajectory, whose discs are coloured "
            "by speed. Leave it out."
        )
    return Playback(viewed, name=name, playing=playing, audience=audience)
