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
class Stage:
    """What one stage shows.

    Attributes:
        packed: `wire.pack`.
        radii: `wire.pack_radii` of its discs, the same object as long as these are.
    """

    packed: bytes | bytearray
    radii: bytes


@dataclass(frozen=True)
class Shown:
    """A picture for pages.

    Attributes:
        serial: its number, from 1.
        packed, radii: as those of `Stage`, of the first stage or the only one.
        capsules: obstacles of both, as of `Scene.capsules`, at this moment.
        second: the second stage at the same moment; None: there is none.
    """

    serial: int
    packed: bytes | bytearray
    radii: bytes
    capsules: NDArray[np.float64]
    second: Stage | None = None


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
        scene: as given; another one has the same box.
        scale: from speeds to colours, of the pictures that follow.
    """

    def __init__(self, audience: Audience, scene: Scene):
        self._audience = audience
        self.scene: Scene = scene
        self._serial = 0
        self._radii: list[tuple[NDArray[np.float64], bytes] | None] = [None, None]
        self._last: dict[str, str] = {}
        self.scale: SpeedScale = SpeedScale(1.0, 2.0)

    def forget_radii(self) -> None:
        """The discs are others now, or have other radii."""
        self._radii = [None, None]

    def show(self, state: State, radii: NDArray[np.float64], frame: int, moment: float, *, plain: bool = False) -> None:
        """Send a picture of a state; plain: as `wire.pack` has it."""
        self.show_in_place(in_place(state, self.scene.box, frame, moment, radii), plain=plain)

    def show_in_place(
        self,
        discs: InPlace,
        colours: NDArray[np.uint8] | None = None,
        second: InPlace | None = None,
        *,
        plain: bool = False,
    ) -> None:
        """Send a picture of discs that a simulation has; no view of them is kept.

        Args:
            discs: of the first stage, or the only one.
            colours: instead of those of their speeds, on both stages.
            second: discs of the second stage; None: there is none.
            plain: as `wire.pack` has it.
        """
        self._serial += 1
        first = self._stage(0, discs, colours, plain)
        other = None if second is None else self._stage(1, second, colours, plain)
        self._audience.show(Shown(self._serial, first.packed, first.radii, self.scene.capsules, other))

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
        """Send what stays the same from picture to picture: the scene, and what its source has to say beside it."""
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
        """Send a message of a kind; see `wire.text_of`."""
        self._last[kind] = wire.text_of(kind, values)
        self._audience.tell(kind, self._last[kind])

    def tell_if_new(self, kind: str, values: Mapping[str, Any]) -> None:
        """Send a message of a kind, unless it is the same as the last one."""
        if wire.text_of(kind, values) != self._last.get(kind):
            self.tell(kind, values)
