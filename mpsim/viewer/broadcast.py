"""What a source sends to the pages that show it: pictures and messages, packed once for all of them."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from mpsim.core.state import State
from mpsim.engine.solvers.in_place import InPlace, in_place
from mpsim.scene.scene import Scene
from mpsim.viewer import wire
from mpsim.viewer.colours import SpeedScale


@dataclass(frozen=True)
class Shown:
    """A picture for pages.

    Attributes:
        serial: its number, from 1.
        packed: `wire.pack`.
        radii: `wire.pack_radii` of its discs, the same object as long as these are.
    """

    serial: int
    packed: bytes | bytearray
    radii: bytes


class Audience(Protocol):
    """The pages. Called by the thread of a source; must return at once."""

    def show(self, picture: Shown) -> None:
        """Take a picture, in place of those before."""
        ...

    def tell(self, kind: str, text: str) -> None:
        """Take a message for all pages, in place of the one of this kind before."""
        ...


class Broadcast:
    """Packs pictures and messages for an audience.

    Args:
        audience: who gets them.
        scene: whose discs the pictures show.

    Attributes:
        scale: from speeds to colours, of the pictures that follow.
    """

    def __init__(self, audience: Audience, scene: Scene):
        self._audience = audience
        self._scene = scene
        self._serial = 0
        self._radii: tuple[NDArray[np.float64], bytes] | None = None
        self._last: dict[str, str] = {}
        self.scale: SpeedScale = SpeedScale(1.0, 2.0)

    def forget_radii(self) -> None:
        """The discs are others now, or have other radii."""
        self._radii = None

    def show(self, state: State, radii: NDArray[np.float64], frame: int, moment: float) -> None:
        """Send a picture of a state."""
        self.show_in_place(in_place(state, self._scene.box, frame, moment, radii))

    def show_in_place(self, discs: InPlace, colours: NDArray[np.uint8] | None = None) -> None:
        """Send a picture of discs that a simulation has; no view of them is kept. colours: instead of their speeds'."""
        self._serial += 1
        scene, walls = self._scene, discs.box
        header = wire.Header(self._serial, discs.frame, discs.time, walls, (scene.width, scene.height), self.scale)
        if self._radii is None or len(self._radii[0]) != len(discs.number):
            self._radii = discs.radii, wire.pack_radii(discs.radii, header)
        self._audience.show(Shown(self._serial, wire.pack(header, discs, scene.periodic, colours), self._radii[1]))

    def tell_scene(self, name: str, **more: Any) -> None:
        """Send what stays the same from picture to picture: the scene, and what its source has to say beside it."""
        scene = self._scene
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
        """Send a message of a kind; see `wire.text_of`."""
        self._last[kind] = wire.text_of(kind, values)
        self._audience.tell(kind, self._last[kind])

    def tell_if_new(self, kind: str, values: Mapping[str, Any]) -> None:
        """Send a message of a kind, unless it is the same as the last one."""
        if wire.text_of(kind, values) != self._last.get(kind):
            self.tell(kind, values)
