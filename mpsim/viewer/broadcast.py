"""Sends pictures and messages from a source to its pages; each is packed once for all pages."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from mpsim.core.state import State
from mpsim.engine.solvers.base import InPlace, in_place
from mpsim.scene.scene import Scene
from mpsim.viewer import wire
from mpsim.viewer.colouring import SpeedScale


@dataclass(frozen=True)
class Stage:
    """The picture on one stage.

    Attributes:
        packed: the discs, from `wire.pack`.
        radii: their radii, from `wire.pack_radii`. It is the same object until the radii change.
    """

    packed: bytes | bytearray
    radii: bytes


@dataclass(frozen=True)
class SentPicture:
    """A picture for the pages.

    Attributes:
        serial: its number, from 1.
        packed, radii: as in `Stage`, for the first or only stage.
        capsules: obstacles of both stages at this moment, as in `Scene.capsules`.
        second: the second stage at the same moment; None: there is none.
    """

    serial: int
    packed: bytes | bytearray
    radii: bytes
    capsules: NDArray[np.float64]
    second: Stage | None = None


class Audience(Protocol):
    """The pages. The thread of the source calls these methods; they must return at once."""

    def show(self, picture: SentPicture) -> None:
        """Take a picture, which replaces the one before."""
        ...

    def tell(self, kind: str, text: str) -> None:
        """Take a message for all pages, which replaces the last one of its kind."""
        ...


class Broadcast:
    """Packs pictures and messages for an audience.

    Args:
        audience: the pages that receive them.
        scene: the scene that the pictures show.

    Attributes:
        scene: as given. It may be replaced by a scene with the same box.
        scale: maps speeds to colours in the next pictures.
    """

    def __init__(self, audience: Audience, scene: Scene):
        self._audience = audience
        self.scene: Scene = scene
        self._serial = 0
        self._radii: list[tuple[NDArray[np.float64], bytes] | None] = [None, None]
        self._last: dict[str, str] = {}
        self.scale: SpeedScale = SpeedScale(1.0, 2.0)

    def forget_radii(self) -> None:
        """Send the radii again with the next picture: the discs or their radii have changed."""
        self._radii = [None, None]

    def show(self, state: State, radii: NDArray[np.float64], frame: int, moment: float, *, plain: bool = False) -> None:
        """Send a picture of a state; plain: as in `wire.pack`."""
        self.show_in_place(in_place(state, self.scene.box, frame, moment, radii), plain=plain)

    def show_in_place(
        self,
        discs: InPlace,
        colours: NDArray[np.uint8] | None = None,
        second: InPlace | None = None,
        *,
        plain: bool = False,
    ) -> None:
        """Send a picture of discs in the arrays of a simulation; their data are copied.

        Args:
            discs: discs of the first or only stage.
            colours: colours of the discs on both stages; None: those of their speeds.
            second: discs of the second stage; None: there is none.
            plain: as in `wire.pack`.
        """
        self._serial += 1
        first = self._stage(0, discs, colours, plain)
        other = None if second is None else self._stage(1, second, colours, plain)
        self._audience.show(SentPicture(self._serial, first.packed, first.radii, self.scene.capsules, other))

    def _stage(self, stage: int, discs: InPlace, colours: NDArray[np.uint8] | None, plain: bool) -> Stage:
        scene, count = self.scene, len(discs.number)
        extent = scene.width, scene.height
        header = wire.Header(self._serial, discs.frame, discs.time, discs.box, extent, self.scale, stage)
        known = self._radii[stage]
        if known is None or len(known[0]) != count:
            known = self._radii[stage] = discs.radii, wire.pack_radii(discs.radii, header)
        fitting = None if colours is None or len(colours) != count else colours
        return Stage(wire.pack(header, discs, scene.periodic, fitting, plain=plain), known[1])

    def tell_scene(self, name: str, **more: Any) -> None:
        """Send what rarely changes: the scene, and more values from its source."""
        scene = self.scene
        wall = scene.moving_wall
        fixed = {
            "version": wire.VERSION,
            "name": name,
            "width": scene.width,
            "height": scene.height,
            "periodic": list(scene.periodic),
            "capsules": scene.capsules.tolist(),
            "wall": None if wall is None else wall.edge,
        }
        self.tell("scene", {**fixed, **more})

    def tell(self, kind: str, values: Mapping[str, Any]) -> None:
        """Send a message of this kind; see `wire.text_of`."""
        self._last[kind] = wire.text_of(kind, values)
        self._audience.tell(kind, self._last[kind])

    def tell_if_new(self, kind: str, values: Mapping[str, Any]) -> None:
        """Send a message of this kind, unless it equals the last one."""
        if wire.text_of(kind, values) != self._last.get(kind):
            self.tell(kind, values)
